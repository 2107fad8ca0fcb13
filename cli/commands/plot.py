"""``meshdeform plot``: a picture of a grid."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path
from typing import TYPE_CHECKING

import click

from meshdeform_core.errors import CaseError

from .. import completion
from ..measured import measured
from ..measures import MEASURES
from ..options import PATH, GridInput, check_output, force_option, grid_options

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_formats.picture import Request, Subject


@dataclasses.dataclass(frozen=True)
class PlotInput:
    """What a picture shows, as the command line says it."""

    metric: str
    plane: str | None
    block: tuple[str, ...]
    select: tuple[str, ...]
    view: str
    zoom: str | None
    before: str | None
    arrows: bool
    limits: str | None
    log: bool
    lines: bool


@click.command("plot")
@grid_options
@click.option("-o", "--output", type=PATH, required=True, help="Picture, .png .svg or .pdf.")
@click.option("--reference", type=PATH, help="The undeformed grid, for what compares with it.")
@click.option("--metric", type=click.Choice(MEASURES), default="f_skew", show_default=True, metavar="MEASURE",
              help=f"Colour by this: {', '.join(MEASURES)}.")  # fmt: skip
@click.option("--plane", metavar="AXIS=N", help="Plane of nodes (k=1, j=mid) or cut in space (z=0.25).")
@click.option(
    "--block",
    multiple=True,
    metavar="PATTERN",
    shell_complete=completion.blocks,
    help="Only these blocks of a plane of nodes (repeatable).",
)
@click.option(
    "--select",
    multiple=True,
    metavar="PATTERN",
    shell_complete=completion.patches,
    help="Patches or block faces (repeatable).",
)
@click.option("--view", default="auto", show_default=True, metavar="auto|x|y|z|iso|X,Y,Z",
              help="Look along an axis, or from a direction.")  # fmt: skip
@click.option("--zoom", metavar="worst|walls|L,R,B,T", help="Close-up, or window: left, right, bottom, top.")
@click.option("--before", type=click.Choice(["side", "overlay"]), help="Draw the reference too.")
@click.option("--arrows", is_flag=True, help="Displacement from the reference as arrows.")
@click.option("--range", "limits", metavar="LOW,HIGH", help="Ends of the colours (default: of the values).")
@click.option("--log", is_flag=True, help="Logarithmic colours.")
@click.option("--lines/--no-lines", default=True, show_default=True, help="Draw grid lines.")
@click.option("--title", default=None, help="Default: the file's name.")
@force_option
def command(
    source: GridInput, output: Path, reference: Path | None, title: str | None, force: bool, **options: object
) -> int:
    """Draw GRID coloured by a measure of its cells.

    \b
    Examples:
      meshdeform plot wing.cgns -o wing.png
      meshdeform plot bent.cgns -o worst.png --reference wing.cgns --zoom worst
      meshdeform plot bent.cgns -o cut.pdf --plane y=0.5 --zoom walls --metric scaled_jacobian
      meshdeform plot bent.cgns -o moved.png --reference wing.cgns --select wing --metric displacement --before side
      meshdeform plot airfoil.p2dfmt -o nose.svg --zoom=-0.1,0.3,-0.2,0.2

    Without options it shows what tells most: a plane grid, also one that is extruded, from above; else the walls in
    space and a cut; what is small beside the whole has a close-up. Invalid cells have a colour of their own: with
    --reference those that became invalid, without it all that are.
    """
    from meshdeform_formats.files import shown
    from meshdeform_formats.picture import check_picture_path, picture, save_page

    asked = PlotInput(**options)  # type: ignore[arg-type]
    check_picture_path(output)
    check_output(output, force, *source.files, reference)
    request = _request(asked)
    subject = _subject(source, reference)
    request = _complete(request, asked, subject.grid)
    save_page(picture(subject, request, shown(Path(source.path.name)) if title is None else title), output)
    return 0


def _subject(source: GridInput, reference: Path | None) -> Subject:
    from meshdeform_formats.picture import Subject

    cells = measured(source.read(), reference)
    return Subject(cells.grid, cells.topology, cells.reference)


def _request(asked: PlotInput) -> Request:
    """What can be said without the grid."""
    from meshdeform_formats.picture import Choice, Request

    if asked.plane and asked.select:
        raise CaseError("--plane and --select exclude each other; give one of them")
    limits = _numbers("--range", asked.limits, "low,high", 2) if asked.limits else None
    if limits and not limits[0] < limits[1]:
        raise CaseError(f"--range {asked.limits!r}: expected low < high")
    close = asked.zoom if asked.zoom in ("worst", "walls") else ""
    return Request(
        Choice(asked.metric, None if limits is None else (limits[0], limits[1]), asked.log, asked.lines),
        index_plane=parse_index_plane(asked.plane),
        select=asked.select,
        view=parse_view(asked.view),
        window=parse_window(asked.zoom) if asked.zoom and not close else None,
        zoom=close,
        before=asked.before or "",
        arrows=asked.arrows,
    )


def _complete(request: Request, asked: PlotInput, grid: Grid) -> Request:
    """What needs the grid: planes in space and blocks by name."""
    from meshdeform_formats.picture import numbered_blocks, space_plane

    if asked.plane and request.index_plane is None:
        axis, at = asked.plane.split("=")
        request = dataclasses.replace(request, space_plane=space_plane(grid, axis, float(at)))
    if asked.block:
        request = dataclasses.replace(request, blocks=numbered_blocks(grid.names, asked.block))
    return request


def parse_index_plane(text: str | None) -> tuple[int, int | None] | None:
    """``k=3`` as (2, 2), ``mid`` as ``None``; nothing for a plane in space like ``z=0.25``."""
    if text is None or re.fullmatch(r"[xyz]=[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", text):
        return None
    match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", text)
    if not match:
        raise CaseError(f"--plane {text!r}: expected a plane of nodes, like k=1 or k=mid, or one in space, like z=0.25")
    return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1


def parse_window(text: str) -> tuple[float, float, float, float]:
    """``L,R,B,T`` as four numbers."""
    left, right, bottom, top = _numbers("--zoom", text, "worst, walls or left,right,bottom,top", 4)
    if not (left < right and bottom < top):
        raise CaseError(f"--zoom {text!r}: expected left,right,bottom,top with left < right and bottom < top")
    return left, right, bottom, top


def parse_view(text: str):  # type: ignore[no-untyped-def]
    """A view by name or direction; nothing for ``auto``."""
    import numpy as np

    from meshdeform_formats.picture import view as views

    if text == "auto":
        return None
    if text == "iso":
        return views.iso()
    if text in ("x", "y", "z"):
        return views.along(text)
    direction = np.array(_numbers("--view", text, "auto, x, y, z, iso or a direction like 1,-1,0.5", 3))
    if not direction.any():
        raise CaseError(f"--view {text!r}: a direction has a length")
    return views.towards(direction)


def _numbers(option: str, text: str, expected: str, count: int) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != count or not all(map(math.isfinite, numbers)):
        raise CaseError(f"{option} {text!r}: expected {expected}")
    return numbers
