"""Pictures of grid planes and surfaces, coloured by a quality metric."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FloatArray, Grid, Side
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import Topology, side_nodes
from meshdeform_core.quality.cells import measure_block

from .files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SUFFIXES = (".png", ".svg", ".pdf")
METRICS = {"f_skew": "skew", "scaled_jacobian": "scaled", "volume": "volume"}
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 220,
    # The same picture is the same file.
    "svg.hashsalt": "meshdeform",
    "svg.fonttype": "none",
}
COLOURS = "viridis"
_RASTER_ABOVE = 20_000


@dataclass(frozen=True)
class Facets:
    """Quads to draw: corners (n, 4, 3) and one value each (n,)."""

    corners: FloatArray
    values: FloatArray


def plane_facets(grid: Grid, topology: Topology, axis: int, index: int | None, metric: str) -> Facets:
    """The cells of the index plane ``index`` (0-based node, ``None``: the middle) along ``axis`` of every block.

    Blocks that do not reach the index are left out; a 2-D grid is drawn whole.
    """
    planes = []
    for block, shape in enumerate(grid.shapes):
        along = shape.index(1) if grid.dimension == 2 else axis
        at = (shape[along] - 1) // 2 if index is None or grid.dimension == 2 else index
        if at < shape[along]:
            planes.append(block_facets(grid, topology, block, along, at, metric))
    if not planes:
        longest = max(shape[axis] for shape in grid.shapes)
        raise CaseError(f"no block has a node plane {'ijk'[axis]} = {(index or 0) + 1}; the largest is {longest}")
    return joined(planes)


def block_facets(grid: Grid, topology: Topology, block: int, axis: int, index: int, metric: str) -> Facets:
    """The cells behind the node plane ``index`` (0-based) along ``axis`` of one block."""
    measures = _metric(grid, topology, block, metric)
    layer = min(index, measures.shape[axis] - 1)
    quads = _quads(np.take(grid.block(block), index, axis=axis))
    return Facets(quads, np.take(measures, layer, axis=axis).ravel())


def joined(parts: list[Facets]) -> Facets:
    """Several sets of quads as one."""
    return Facets(np.concatenate([p.corners for p in parts]), np.concatenate([p.values for p in parts]))


def surface_facets(grid: Grid, topology: Topology, patterns: tuple[str, ...], metric: str) -> Facets:
    """External faces selected by patterns (as in a case file), with the value of the cell behind each."""
    if grid.dimension == 2:
        raise CaseError("a 2-D grid has no surfaces to select; leave --select out to draw the whole grid")
    quads = select_quads(grid, topology, patterns, "plot")
    corners, values = [], []
    for block_side in np.unique(topology.quads.block_side[quads]):
        block, side = int(block_side) // 6, Side(int(block_side) % 6)
        local = quads[topology.quads.block_side[quads] == block_side] - topology.quads.start[block, side]
        measures = np.take(_metric(grid, topology, block, metric), -1 if side % 2 else 0, axis=side.axis)
        corners.append(_quads(grid.points[side_nodes(grid, block, side)])[local])
        values.append(measures.ravel()[local])
    return Facets(np.concatenate(corners), np.concatenate(values))


def _metric(grid: Grid, topology: Topology, block: int, metric: str) -> FloatArray:
    measures = measure_block(grid.block(block), float(topology.handedness[block]), plane_normal(grid))
    return np.asarray(getattr(measures, METRICS[metric]))


def _quads(x: FloatArray) -> FloatArray:
    return np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2).reshape(-1, 4, 3)


def view_directions(facets: Facets, view: str) -> tuple[FloatArray, FloatArray, FloatArray, tuple[str, str]]:
    """Unit vectors to the right, up and towards the viewer, and axis labels, for ``auto x y z iso``."""
    if view == "auto":
        view = "xyz"[int(np.argmin(np.ptp(facets.corners.reshape(-1, 3), axis=0)))]
    if view == "iso":
        right, up = np.array([1.0, -1.0, 0.0]) / 2**0.5, np.array([-1.0, -1.0, 2.0]) / 6**0.5
        return right, up, np.cross(right, up), ("", "")
    right_axis, up_axis = {"x": (1, 2), "y": (0, 2), "z": (0, 1)}[view]
    unit = np.eye(3)
    return unit[right_axis], unit[up_axis], unit["xyz".index(view)], ("xyz"[right_axis], "xyz"[up_axis])


def draw(
    axes: Axes, facets: Facets, *, view: str = "auto", limits: tuple[float, float] | None = None, lines: bool = True
) -> Any:
    """Draw facets into matplotlib axes, far ones first; returns the collection (for a colour bar).

    ``limits`` of the colours default to 0..1, or to the range of the values where they leave it.
    """
    from matplotlib.collections import PolyCollection

    right, up, towards, labels = view_directions(facets, view)
    depth = np.argsort(facets.corners.mean(axis=1) @ towards, kind="stable")
    flat = np.stack([facets.corners @ right, facets.corners @ up], axis=-1)[depth]
    many = len(flat) > _RASTER_ABOVE
    collection = PolyCollection(
        list(flat),
        array=facets.values[depth],
        cmap=COLOURS,
        edgecolors="black" if lines else "face",
        linewidths=0.08 if many else 0.2,
        rasterized=many,
    )
    low, high = float(facets.values.min()), float(facets.values.max())
    collection.set_clim(*(limits or ((0.0, 1.0) if low >= 0.0 and high <= 1.0 else (low, high))))
    axes.add_collection(collection)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set_xlabel(labels[0])
    axes.set_ylabel(labels[1])
    return collection


def save_picture(
    facets: Facets, path: Path, *, metric: str, view: str, title: str, zoom: tuple[float, ...] | None, lines: bool
) -> None:
    """One picture with a colour bar; the suffix picks png, svg or pdf.

    Parameters
    ----------
    zoom : left, right, bottom, top in grid length units
    """
    check_picture_path(path)
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.0, 5.0), layout="constrained")
        collection = draw(axes, facets, view=view, lines=lines)
        if zoom:
            axes.set_xlim(zoom[0], zoom[1])
            axes.set_ylim(zoom[2], zoom[3])
        axes.set_title(title)
        figure.colorbar(collection, ax=axes, label=metric, shrink=0.8, pad=0.02)
        with replacing(path) as partial:
            figure.savefig(partial, bbox_inches="tight")
        plt.close(figure)


def check_picture_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix.lower() not in SUFFIXES:
        raise FormatError(f"picture {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")
