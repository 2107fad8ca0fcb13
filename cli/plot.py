"""``meshdeform plot``: a picture of a grid."""

from __future__ import annotations

import math
import re
from pathlib import Path

import click

from meshdeform_core.errors import CaseError

from .options import PATH, GridInput, check_output, force_option, grid_options


@click.command("plot")
@grid_options
@click.option("-o", "--output", type=PATH, required=True, help="Picture, .png .svg or .pdf.")
@click.option(
    "--metric", type=click.Choice(["f_skew", "scaled_jacobian", "volume"]), default="f_skew", show_default=True
)
@click.option("--plane", metavar="AXIS=N", help="Index plane, like k=1 or j=mid (default: k=mid; a 2-D grid whole).")
@click.option("--select", "select", multiple=True, metavar="PATTERN", help="Patches or block faces instead of a plane.")
@click.option(
    "--view",
    type=click.Choice(["auto", "x", "y", "z", "iso"]),
    default="auto",
    show_default=True,
    help="Look along this axis.",
)
@click.option("--zoom", metavar="L,R,B,T", help="Window: left, right, bottom, top.")
@click.option("--title", default=None, help="Default: the file's name.")
@click.option("--lines/--no-lines", default=True, show_default=True, help="Draw grid lines.")
@force_option
def command(
    source: GridInput, output: Path, metric: str, plane: str | None, select: tuple[str, ...], view: str,
    zoom: str | None, title: str | None, lines: bool, force: bool,
) -> int:  # fmt: skip
    """Draw a plane or a surface of GRID, coloured by a quality metric.

    \b
    Examples:
      meshdeform plot deformed.cgns -o plane.png --plane k=1
      meshdeform plot wing.cgns -o wall.png --select wall --view iso
      meshdeform plot airfoil.p2dfmt -o nose.pdf --zoom=-0.1,0.3,-0.2,0.2
    """
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_formats.picture import check_picture_path, plane_facets, save_picture, surface_facets

    if plane and select:
        raise CaseError("--plane and --select exclude each other; give one of them")
    check_picture_path(output)
    check_output(output, force, *source.files)
    axis, index = parse_plane(plane)
    window = parse_zoom(zoom)
    data = source.read()
    topology = find_topology(data)
    facets = (
        surface_facets(data, topology, select, metric) if select else plane_facets(data, topology, axis, index, metric)
    )
    save_picture(facets, output, metric=metric, view=view, title=title or source.path.name, zoom=window, lines=lines)
    return 0


def parse_plane(text: str | None) -> tuple[int, int | None]:
    """``k=3`` as (2, 2); ``mid`` as ``None``."""
    if text is None:
        return 2, None
    match = re.fullmatch(r"([ijk])=(mid|[1-9]\d*)", text)
    if not match:
        raise CaseError(f"--plane {text!r}: expected an index and a node number, like k=1, or k=mid")
    return "ijk".index(match[1]), None if match[2] == "mid" else int(match[2]) - 1


def parse_zoom(text: str | None) -> tuple[float, ...] | None:
    """``L,R,B,T`` as four numbers."""
    if text is None:
        return None
    try:
        window = tuple(float(part) for part in text.split(","))
    except ValueError:
        window = ()
    sound = len(window) == 4 and all(map(math.isfinite, window))
    if not sound or not (window[0] < window[1] and window[2] < window[3]):
        raise CaseError(f"--zoom {text!r}: expected left,right,bottom,top with left < right and bottom < top")
    return window
