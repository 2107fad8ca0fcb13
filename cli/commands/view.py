"""``meshdeform view``: a grid in a window, to turn and cut."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import click

from ..measures import MEASURES, measured
from ..options import PATH, GridInput, force_option, grid_options
from ..outputs import check_output


@click.command("view")
@grid_options
@click.option("--reference", type=PATH, help="The undeformed grid, for measures that compare with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help="Colour by this; as for `meshdeform plot`.")  # fmt: skip
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--lines/--no-lines", default=True, show_default=True, help="Draw grid lines.")
@click.option("--screenshot", type=PATH, metavar="FILE", help="Draw into a .png file instead of a window.")
@force_option
def command(
    source: GridInput, reference: Path | None, metric: str, log: bool, lines: bool, screenshot: Path | None, force: bool
) -> int:
    """Show GRID in a window: walls and a movable cut, coloured by a measure of the cells.

    \b
    Examples:
      meshdeform view wing.cgns
      meshdeform view bent.cgns --reference wing.cgns --metric volume_ratio
      meshdeform view bent.cgns --reference wing.cgns --screenshot bent.png

    The left mouse button rotates the view, the middle one moves it, the right one and the wheel zoom; q closes the
    window. Check boxes at the left show other boundaries. Invalid cells have a colour of their own and are always
    visible. Needs pyvista (extra `view`).
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
    """Refuse to open a window where there is no display."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise click.UsageError("There is no display for a window; use --screenshot FILE.png or `meshdeform plot`.")


def check_screenshot(path: Path, force: bool, *inputs: Path | None) -> None:
    """Refuse a path that cannot be written or is not a .png file."""
    if path.suffix.lower() != ".png":
        raise click.UsageError(
            f"--screenshot {path}: expected a .png file; `meshdeform plot` writes .svg and .pdf too."
        )
    check_output(path, force, *inputs)
