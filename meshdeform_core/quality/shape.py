"""Measures that matter to flow solvers: aspect ratio, growth, non-orthogonality, skewness."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
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
    total, count = np.zeros(4), np.zeros(4, dtype=np.int64)
    for block in range(grid.n_blocks):
        worst, place = np.full(4, -1.0), np.zeros((4, 3), dtype=np.int64)
        x, resolved = _solid(grid, block)
        measure_shape(x, resolved, worst, place, total, count, _NO_CELLS)
        for m in np.flatnonzero(worst > best):
            best[m], cells[m] = worst[m], (block, place[m])
    return {
        name: ShapeMeasure(float(total[m] / count[m]), float(best[m]), _worst(grid, float(best[m]), *cells[m]))
        for m, name in enumerate(DEFINITIONS)
        if count[m]
    }


def shape_of_cells(grid: Grid, block: int, cells: tuple[slice, slice, slice]) -> FloatArray:
    """The measures of :data:`DEFINITIONS` of a box of cells with explicit ends, (ci, cj, ck, 4).

    For measures between neighbours a cell gets the largest value of its faces.
    """
    x, resolved = _solid(grid, block)
    # The outer cells of the box also depend on the neighbours around it.
    low = [max(c.start - 1, 0) for c in cells]
    high = [min(c.stop + 1, n - 1) for c, n in zip(cells, x.shape[:3], strict=True)]
    around = np.ascontiguousarray(x[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))])
    values = np.zeros((*(n - 1 for n in around.shape[:3]), 4))
    extremes = np.full(4, -1.0), np.zeros((4, 3), dtype=np.int64), np.zeros(4), np.zeros(4, dtype=np.int64)
    measure_shape(around, resolved, *extremes, values)
    return np.asarray(values[tuple(slice(c.start - a, c.stop - a) for c, a in zip(cells, low, strict=True))])


def _solid(grid: Grid, block: int) -> tuple[FloatArray, IntArray]:
    """The nodes of a block (a 2-D one extruded by one layer), and its index axes with more than one cell."""
    x = grid.block(block)
    resolved = np.array([n > 1 for n in grid.cell_shapes[block]], dtype=np.int64)
    if grid.dimension == 2:
        flat = grid.shapes[block].index(1)
        normal = plane_normal(grid)
        assert normal is not None
        x = np.concatenate([x, x + normal * float(np.ptp(grid.points, axis=0).max())], axis=flat)
    if not resolved.any():
        resolved[:] = 1
    return np.ascontiguousarray(x), resolved


def _worst(grid: Grid, value: float, block: int, cell: IntArray) -> Worst:
    i, j, k = (int(n) for n in cell)
    center = grid.block(block)[i : i + 2, j : j + 2, k : k + 2].reshape(-1, 3).mean(axis=0)
    return Worst(
        value, grid.names[block], (i + 1, j + 1, k + 1), (float(center[0]), float(center[1]), float(center[2]))
    )
