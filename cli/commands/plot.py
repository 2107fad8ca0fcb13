"""``meshdeform plot``: a picture of a grid."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from .. import completion
from ..measures import MEASURES, measured
from ..options import PATH, FiniteNumber, GridInput, force_option, grid_options, quiet_option
from ..outputs import check_output
from ..process.progress import ProgressBar

if TYPE_CHECKING:
    from meshdeform_core.quality.fields import CellFields
    from meshdeform_formats.picture.subject import Subject


@click.command("plot")
@grid_options
@click.option(
    "-o", "--output", type=PATH, required=True, help="Picture, .png .svg or .pdf; film of a series, .gif or .mp4."
)
@click.option("--reference", type=PATH, help="The undeformed grid, for measures that compare with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help=f"Colour by this: {', '.join(MEASURES)}.")  # fmt: skip
@click.option("--plane", metavar="AXIS=N", help="Plane of nodes (k=1, j=mid) or cut in space (z=0.25).")
@click.option("--block", multiple=True, metavar="PATTERN", shell_complete=completion.blocks,
              help="Only these blocks of a plane of nodes (repeatable).")  # fmt: skip
@click.option("--select", multiple=True, metavar="PATTERN", shell_complete=completion.patches,
              help="Patches or block faces (repeatable).")  # fmt: skip
@click.option("--view", default="auto", show_default=True, metavar="auto|x|y|z|iso|X,Y,Z",
              help="Look along an axis, or from a direction.")  # fmt: skip
@click.option("--zoom", metavar="worst|walls|L,R,B,T", help="Close-up, or window: left, right, bottom, top.")
@click.option("--before", type=click.Choice(["side", "overlay"]), help="Draw the reference too.")
@click.option("--arrows", is_flag=True, help="Displacement from the reference as arrows.")
@click.option("--range", "limits", metavar="LOW,HIGH", help="Ends of the colours (default: of the values).")
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--lines/--no-lines", default=True, show_default=True, help="Draw grid lines.")
@click.option("--rate", type=FiniteNumber(min=0, min_open=True), default=10.0, show_default=True,
              help="Levels per second of a film.")  # fmt: skip
@click.option("--title", default=None, help="Default: the file's name.")
@force_option
@quiet_option
def command(
    source: GridInput, output: Path, reference: Path | None, title: str | None, rate: float, force: bool, quiet: bool,
    **options: object,
) -> int:  # fmt: skip
    """Draw GRID coloured by a measure of its cells, or a series as a film.

    \b
    Examples:
      meshdeform plot wing.cgns -o wing.png
      meshdeform plot bent.cgns -o worst.png --reference wing.cgns --zoom worst
      meshdeform plot bent.cgns -o cut.pdf --plane y=0.5 --zoom walls --metric scaled_jacobian
      meshdeform plot bent.cgns -o moved.png --reference wing.cgns --select wing --metric displacement --before side
      meshdeform plot airfoil.p2dfmt -o nose.svg --zoom=-0.1,0.3,-0.2,0.2
      meshdeform plot flutter -o flutter.gif --rate 20

    The default view depends on the grid: plane and extruded grids are seen from above, others as walls in space and a
    cut, with a close-up of walls that are small relative to the grid. Invalid cells have a colour of their own: with
    --reference those that became invalid, otherwise all.

    If GRID is the folder of a series, every level becomes a frame of a .gif, or of an .mp4 if ffmpeg is installed; the
    reference is then the grid of the series, unless its file has changed since.
    """
    from meshdeform_formats.files import shown
    from meshdeform_formats.picture.film import check_film_path, film, save_film
    from meshdeform_formats.picture.page import check_picture_path, save_page
    from meshdeform_formats.picture.request import PlotOptions, picture
    from meshdeform_formats.series.manifest import is_series, open_levels

    request = PlotOptions(**options, lead="--")  # type: ignore[arg-type]
    if not is_series(source.path):
        check_picture_path(output)
        check_output(output, force, *source.files, reference)
        name = shown(Path(source.path.name)) if title is None else title
        with ProgressBar(not quiet):
            save_page(picture(_of(measured(source.read(), reference)), request, name), output)
        return 0
    check_film_path(output)
    check_output(output, force, reference)
    levels = open_levels(source.path)
    first = _of(measured(levels.read(0), reference or levels.undeformed))
    name = shown(Path(source.path.resolve().name)) if title is None else title
    with ProgressBar(not quiet) as progress:

        def every() -> Iterator[tuple[str, Subject]]:
            for number, time in enumerate(levels.times):
                progress("draw", next(drawn), 2 * len(levels.times))
                moved = first.grid.moved(levels.read(number).points)
                yield f"{name}, t = {time:g}", dataclasses.replace(first, grid=moved)

        drawn = itertools.count()
        save_film(film(every, request), output, rate)
    return 0


def _of(cells: CellFields) -> Subject:
    from meshdeform_formats.picture.subject import Subject

    return Subject(cells.grid, cells.topology, cells.reference)
