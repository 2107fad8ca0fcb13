"""Measures that matter to flow solvers: aspect ratio, growth, non-orthogonality, skewness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..numerics.arrays import extent
from ..numerics.cell.shape import measure_shape
from .listed import Worst

DEFINITIONS = {
    "aspect_ratio": "longest over shortest mean edge of a cell, over the index directions with more than one cell",
    "growth_ratio": "larger over smaller mean edge of two neighbours, along the grid line that joins them",
    "non_orthogonality_deg": "angle between the line of two cell centres and the normal of their face (as checkMesh)",
    "skewness": "where that line meets the face: distance to the face's centre over the line's length",
}
"""Definitions of the measures; neighbours are cells of the same block."""


_NO_CELLS = np.empty((0, 0, 0, 4))


@dataclass(frozen=True)
class ShapeMeasure:
    """A measure over a whole grid: its mean, its largest value, and the cell with that value."""

    mean: float
    max: float
    worst: Worst


def shape_measures(grid: Grid) -> dict[str, ShapeMeasure]:
    """All measures of :data:`DEFINITIONS` of a grid.

    Collapsed edges and faces have no ratio or direction and are skipped.
    """
    best = np.full(4, -1.0)
    cells: list[tuple[int, IntArray]] = [(0, np.zeros(3, dtype=np.int64))] * 4
    total, count, thickness = np.zeros(4), np.zeros(4, dtype=np.int64), thickness_of(grid)
    for block in range(grid.n_blocks):
        worst, place = np.full(4, -1.0), np.zeros((4, 3), dtype=np.int64)
        x, resolved = _solid(grid, block, grid.block(block), thickness)
        measure_shape(x, resolved, worst, place, total, count, _NO_CELLS)
        for m in np.flatnonzero(worst > best):
            best[m], cells[m] = worst[m], (block, place[m])
    return {
        name: ShapeMeasure(float(total[m] / count[m]), float(best[m]), _worst(grid, float(best[m]), *cells[m]))
        for m, name in enumerate(DEFINITIONS)
        if count[m]
    }


def shape_of_cells(
    grid: Grid, block: int, cells: tuple[slice, slice, slice], thickness: FloatArray | None
) -> FloatArray:
    """The measures of :data:`DEFINITIONS` of a box of cells with explicit ends, (ci, cj, ck, 4).

    For measures between neighbours a cell gets the largest value of its faces. ``thickness`` is that of a plane grid.
    """
    # The outer cells of the box also depend on the neighbours around it.
    low = [max(c.start - 1, 0) for c in cells]
    high = [min(c.stop + 1, n) for c, n in zip(cells, grid.cell_shapes[block], strict=True)]
    window = [slice(a, min(b + 1, n)) for a, b, n in zip(low, high, grid.shapes[block], strict=True)]
    around, resolved = _solid(grid, block, grid.box(block, window), thickness)
    values = np.zeros((*(n - 1 for n in around.shape[:3]), 4))
    extremes = np.full(4, -1.0), np.zeros((4, 3), dtype=np.int64), np.zeros(4), np.zeros(4, dtype=np.int64)
    measure_shape(around, resolved, *extremes, values)
    return np.asarray(values[tuple(slice(c.start - a, c.stop - a) for c, a in zip(cells, low, strict=True))])


def thickness_of(grid: Grid) -> FloatArray | None:
    """Vector by which a plane grid is extruded by one layer of cells; ``None`` for any other grid."""
    normal = plane_normal(grid)
    if normal is None:
        return None
    low, high = extent(grid.points)
    return np.asarray(normal * float((high - low).max()))


def _solid(grid: Grid, block: int, x: FloatArray, thickness: FloatArray | None) -> tuple[FloatArray, IntArray]:
    """Nodes ``x`` of a block (of a 2-D one extruded by one layer), and its index axes with more than one cell."""
    resolved = np.array([n > 1 for n in grid.cell_shapes[block]], dtype=np.int64)
    if thickness is not None:
        x = np.concatenate([x, x + thickness], axis=grid.shapes[block].index(1))
    if not resolved.any():
        resolved[:] = 1
    return np.ascontiguousarray(x), resolved


def _worst(grid: Grid, value: float, block: int, cell: IntArray) -> Worst:
    i, j, k = (int(n) for n in cell)
    center = grid.block(block)[i : i + 2, j : j + 2, k : k + 2].reshape(-1, 3).mean(axis=0)
    return Worst(
        value, grid.names[block], (i + 1, j + 1, k + 1), (float(center[0]), float(center[1]), float(center[2]))
    )
