"""``meshdeform view``: a grid in a window, to turn and cut."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from ..measured import measured
from ..measures import MEASURES
from ..options import PATH, GridInput, force_option, grid_options
from ..outputs import check_output


@click.command("view")
@grid_options
@click.option("--reference", type=PATH, help="The undeformed grid, for what compares with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help="Colour by this; as for `meshdeform plot`.")  # fmt: skip
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--lines/--no-lines", default=True, show_default=True, help="Draw grid lines.")
@click.option("--screenshot", type=PATH, metavar="FILE", help="Draw into a .png file instead of a window.")
@force_option
def command(
    source: GridInput, reference: Path | None, metric: str, log: bool, lines: bool, screenshot: Path | None, force: bool
) -> int:
    """Show GRID in a window: walls and a cut to drag, coloured by a measure of the cells.

    \b
    Examples:
      meshdeform view wing.cgns
      meshdeform view bent.cgns --reference wing.cgns --metric volume_ratio
      meshdeform view bent.cgns --reference wing.cgns --screenshot bent.png

    Turn it with the left button, move it with the middle one, zoom with the right one or the wheel; q closes the
    window. Boxes at the left show the other boundaries. Invalid cells have a colour of their own, wherever they are.
    Needs pyvista, which comes with the extra `view`.
    """
    from meshdeform_formats.files import shown
    from meshdeform_formats.picture import Choice, Subject
    from meshdeform_formats.picture.viewer import save_screenshot, scene
    from meshdeform_formats.series.levels import is_series

    if is_series(source.path):
        raise click.UsageError(
            f"{source.path} is a series; a window shows one grid: name a level, or draw all with "
            f"`meshdeform plot {source.path} -o film.gif`."
        )
    if screenshot is None:
        require_display()
    else:
        check_screenshot(screenshot, force, *source.files, reference)
    cells = measured(source.read(), reference)
    subject = Subject(cells.grid, cells.topology, cells.reference)
    choice = Choice(metric, logarithmic=log, lines=lines)
    plotter = scene(subject, choice, shown(Path(source.path.name)), off_screen=screenshot is not None)
    if screenshot is None:
        plotter.show()
    else:
        save_screenshot(plotter, screenshot)
    return 0


def require_display() -> None:
    """Refuse a window where none can be opened."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise click.UsageError("There is no display for a window; use --screenshot FILE.png or `meshdeform plot`.")


def check_screenshot(path: Path, force: bool, *inputs: Path | None) -> None:
    """Refuse a name that cannot be written or is no picture."""
    if path.suffix.lower() != ".png":
        raise click.UsageError(
            f"--screenshot {path}: expected a .png file; `meshdeform plot` writes .svg and .pdf too."
        )
    check_output(path, force, *inputs)
