"""``meshdeform plot``: a picture of a grid."""

from __future__ import annotations

from pathlib import Path

import click

from ..checks import check_output
from ..options import PATH, GridInput, RunInput, grid_options, packed
from ..process.progress import ProgressBar

MEASURES = (
    "f_skew", "scaled_jacobian", "jacobian", "relative_jacobian", "volume", "volume_ratio", "aspect_ratio",
    "growth_ratio", "non_orthogonality_deg", "skewness", "wall_normal_deviation_deg", "first_cell_height_ratio",
    "interface_kink_deg", "interface_spacing_jump", "wall_distance", "displacement",
)  # fmt: skip
"""Defined in ``meshdeform_core.quality.fields``; repeated because ``--help`` must not load compiled loops."""


@click.command("plot")
@grid_options
@click.option("-o", "--output", type=PATH, required=True, help="Picture, .png .svg or .pdf.")
@click.option("--reference", type=PATH, help="The undeformed grid, for measures that compare with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help=f"Colour by this: {', '.join(MEASURES)}.")  # fmt: skip
@click.option("--plane", metavar="AXIS=N", help="Plane of nodes (k=1, j=mid) or cut in space (z=0.25).")
@click.option("--select", multiple=True, metavar="PATTERN",
              help="Patches or block faces (repeatable).")  # fmt: skip
@click.option("--view", default="auto", show_default=True, metavar="auto|x|y|z|iso|X,Y,Z",
              help="Look along an axis, or from a direction.")  # fmt: skip
@click.option("--zoom", metavar="worst|walls|L,R,B,T", help="Close-up, or window: left, right, bottom, top.")
@click.option("--range", "limits", metavar="LOW,HIGH", help="Ends of the colours (default: of the values).")
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--title", default=None, help="Default: the file's name.")
@packed(RunInput, "run", "force", "quiet")
def command(
    source: GridInput, output: Path, reference: Path | None, title: str | None, run: RunInput, **options: object
) -> int:
    """Draw GRID coloured by a measure of its cells.

    \b
    Examples:
      meshdeform plot wing.cgns -o wing.png
      meshdeform plot bent.cgns -o worst.png --reference wing.cgns --zoom worst
      meshdeform plot bent.cgns -o cut.pdf --plane y=0.5 --zoom walls --metric scaled_jacobian
      meshdeform plot bent.cgns -o moved.png --reference wing.cgns --select wing --metric displacement
      meshdeform plot airfoil.p2dfmt -o nose.svg --zoom=-0.1,0.3,-0.2,0.2

    The default view depends on the grid: plane and extruded grids are seen from above, others as walls in space and a
    cut, with a close-up of walls that are small relative to the grid. Invalid cells have a colour of their own: with
    --reference those that became invalid, otherwise all.
    """
    from meshdeform_formats import read_grid
    from meshdeform_formats.files import shown
    from meshdeform_formats.picture.page import check_picture_path, save_page
    from meshdeform_formats.picture.request import PlotOptions, picture
    from meshdeform_formats.picture.subject import Subject

    request = PlotOptions(**options, lead="--")  # type: ignore[arg-type]
    check_picture_path(output)
    check_output(output, run.force, *source.files, reference)
    name = shown(Path(source.path.name)) if title is None else title
    with ProgressBar(not run.quiet):
        subject = Subject.of(source.read(), None if reference is None else read_grid(reference))
        save_page(picture(subject, request, name), output)
    return 0
