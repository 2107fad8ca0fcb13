"""Measures that matter to flow solvers: aspect ratio, growth, non-orthogonality, skewness, face pyramids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import block_handedness, plane_normal
from ..numerics.arrays import extent
from ..numerics.cell.shape import FLATTEST_PYRAMID, WRONG_PYRAMIDS, measure_shape
from .cells import slabs
from .listed import Worst, worst_cell

DEFINITIONS = {
    "aspect_ratio": "longest over shortest mean edge of a cell, over the index directions with more than one cell",
    "growth_ratio": "larger over smaller mean edge of two neighbours, along the grid line that joins them",
    "non_orthogonality_deg": "angle between the line of two cell centres and the normal of their face (as checkMesh)",
    "skewness": "where that line meets the face: distance to the face's centre over the line's length",
}
"""Definitions of the measures; neighbours are cells of the same block."""


@dataclass(frozen=True)
class ShapeMeasure:
    """A measure over a whole grid: its mean, its largest value, and the cell with that value."""

    mean: float
    max: float
    worst: Worst


@dataclass(frozen=True)
class FacePyramids:
    """Pyramids between the faces and the centres of cells, as checkMesh counts and measures them.

    ``wrong``: how many have a negative volume; ``min``: the smallest volume, in the cell ``worst``.
    """

    wrong: int
    min: float
    worst: Worst


def shape_measures(grid: Grid) -> dict[str, ShapeMeasure | FacePyramids]:
    """All measures of :data:`DEFINITIONS` of a grid, and its ``face_pyramids``.

    Collapsed edges and faces have no ratio or direction and are skipped.
    """
    kinds = len(DEFINITIONS) + 2
    best, cells, total, count = np.full(kinds, -np.inf), [0] * kinds, np.zeros(kinds), np.zeros(kinds, dtype=np.int64)
    thickness, sign = thickness_of(grid), block_handedness(grid)
    for slab in slabs(grid):
        # With one more layer, to which those of the slab are neighbours.
        nodes = grid.block(slab.block)[slab.first : slab.last + 2]
        x, resolved = _solid(grid, slab.block, nodes, thickness)
        for number, _, values in measure_shape(x, resolved, float(sign[slab.block])):
            own = values[: slab.last - slab.first]
            total[number] += own.sum()
            count[number] += own.size
            if own.max(initial=-np.inf) > best[number]:
                best[number] = own.max()
                i, j, k = np.unravel_index(own.argmax(), own.shape)
                _, cj, ck = grid.cell_shapes[slab.block]
                cells[number] = int(slab.start + (i * cj + j) * ck + k)
    found: dict[str, ShapeMeasure | FacePyramids] = {}
    for m, name in enumerate(DEFINITIONS):
        if count[m]:
            place = worst_cell(grid, grid.points, cells[m], float(best[m]))
            found[name] = ShapeMeasure(float(total[m] / count[m]), float(best[m]), place)
    smallest = -float(best[FLATTEST_PYRAMID])
    place = worst_cell(grid, grid.points, cells[FLATTEST_PYRAMID], smallest)
    return found | {"face_pyramids": FacePyramids(int(total[WRONG_PYRAMIDS]), smallest, place)}


def shape_of_cells(
    grid: Grid, block: int, cells: tuple[slice, slice, slice], thickness: FloatArray | None, sign: float
) -> FloatArray:
    """The measures of :data:`DEFINITIONS` of a box of cells with explicit ends, (ci, cj, ck, n).

    For measures between neighbours a cell gets the largest value of its faces. ``thickness`` is that of a plane grid,
    ``sign`` the handedness of the block.
    """
    # The outer cells of the box also depend on the neighbours around it.
    low = [max(c.start - 1, 0) for c in cells]
    high = [min(c.stop + 1, n) for c, n in zip(cells, grid.cell_shapes[block], strict=True)]
    window = [slice(a, min(b + 1, n)) for a, b, n in zip(low, high, grid.shapes[block], strict=True)]
    around, resolved = _solid(grid, block, grid.box(block, window), thickness)
    values = np.zeros((*(n - 1 for n in around.shape[:3]), len(DEFINITIONS)))
    for number, axis, found in measure_shape(around, resolved, sign):
        if number >= len(DEFINITIONS):
            continue
        own = values[..., number]
        for end in (slice(None, -1), slice(1, None)) if axis >= 0 else (slice(None),):
            part = own[(slice(None),) * max(axis, 0) + (end,)]
            np.maximum(part, found, out=part)
    return np.asarray(values[tuple(slice(c.start - a, c.stop - a) for c, a in zip(cells, low, strict=True))])


def thickness_of(grid: Grid) -> FloatArray | None:
    """Vector by which a plane grid is extruded by one layer of cells; ``None`` for any other grid.

    It points to the side to which the handedness of plane blocks refers.
    """
    normal = plane_normal(grid)
    if normal is None:
        return None
    low, high = extent(grid.points)
    side = np.sign(normal[int(np.argmax(np.abs(normal)))])
    return np.asarray(side * normal * float((high - low).max()))


def _solid(grid: Grid, block: int, x: FloatArray, thickness: FloatArray | None) -> tuple[FloatArray, IntArray]:
    """Nodes ``x`` of a block (of a 2-D one extruded by one layer), and its index axes with more than one cell."""
    resolved = np.array([n > 1 for n in grid.cell_shapes[block]], dtype=np.int64)
    if thickness is not None:
        x = np.concatenate([x, x + thickness], axis=grid.shapes[block].index(1))
    if not resolved.any():
        resolved[:] = 1
    return np.ascontiguousarray(x), resolved
