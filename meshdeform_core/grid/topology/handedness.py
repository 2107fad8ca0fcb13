"""Handedness of blocks, and the winding of their face quads."""

from __future__ import annotations

import numpy as np

from ...numerics.arrays import BoolArray, batches, spread
from ...numerics.geometry.coincidence import ascending
from ...parallel import Nodes
from ..blocks import FloatArray, Grid, IntArray
from ..sizes import strides_of

_SAMPLED_CELLS = 8
_TOGETHER = 100_000
"""Cell corners processed at a time: few enough for the processor's cache."""


def block_handedness(grid: Grid) -> IntArray:
    """+1 or -1 per block, from the majority of a regular sample of at most 8 cells per direction.

    Of a grid in parts, each rank looks at the blocks that it holds, and all of them at those that are cut.
    """
    whole = _held(grid)
    mine = np.flatnonzero(whole == grid.nodes.ranks.number)
    own = _signs(grid, grid.nodes.rows, mine)
    cut = np.flatnonzero(whole < 0)
    sign = np.empty(grid.n_blocks, dtype=np.int64)
    sign[cut] = _signs(grid, grid.points, cut)
    # Ranks hold consecutive blocks.
    sign[whole >= 0] = np.concatenate(grid.nodes.gather(own))
    return sign


def _held(grid: Grid) -> IntArray:
    """The rank (n_blocks,) that holds all nodes of each block, -1 for those of which several have some."""
    bounds = grid.nodes.bounds
    first, last = (np.searchsorted(bounds, row, side="right") - 1 for row in (grid.offsets[:-1], grid.offsets[1:] - 1))
    return np.where(first == last, first, -1)


def _signs(grid: Grid, points: FloatArray, blocks: IntArray) -> IntArray:
    """Handedness of ``blocks``, from their rows of ``points``; blocks of the same kind together."""
    shapes = np.array(grid.shapes, dtype=np.int64)[blocks]
    taken = np.clip(shapes - 1, 1, _SAMPLED_CELLS)
    kind = np.ravel_multi_index((*taken.T, *(shapes == 1).T.astype(int)), (_SAMPLED_CELLS + 1,) * 3 + (2,) * 3)
    sign = np.empty(len(blocks), dtype=np.int64)
    for one in ascending(kind):
        alike = np.flatnonzero(kind == one)
        for lo, hi in batches(np.full(len(alike), 8 * taken[alike[0]].prod()), _TOGETHER):
            sign[alike[lo:hi]] = _handedness(grid, points, blocks[alike[lo:hi]])
    return sign


def _handedness(grid: Grid, points: FloatArray, blocks: IntArray) -> IntArray:
    """Handedness of ``blocks`` with the same number of sampled cells and, in 2-D, the same axis of one node."""
    shapes = np.array([grid.shapes[block] for block in blocks])
    axes = [axis for axis in range(3) if shapes[0, axis] > 1]
    edges = _mean_edges(grid, points, blocks, shapes, axes)
    if len(axes) == 3:
        volume = np.einsum("...i,...i->...", edges[0], np.cross(edges[1], edges[2]))
        return np.where(np.sign(volume).sum(axis=1) < 0, -1, 1)
    # A 2-D block is treated as one layer of cells extruded along +x, +y or +z, whichever is normal to its plane.
    normal = np.cross(edges[0], edges[1])
    main = np.argmax(np.abs(normal).sum(axis=1), axis=1)
    total = np.sign(np.take_along_axis(normal, main[:, None, None], axis=2)).sum(axis=(1, 2))
    # Index order (a, b) is cyclic for a flat i or k axis and reversed for a flat j axis.
    return np.where((total < 0) != (axes[1] - axes[0] == 2), -1, 1)


def _mean_edges(
    grid: Grid, points: FloatArray, blocks: IntArray, shapes: IntArray, axes: list[int]
) -> list[FloatArray]:
    """Mean edge vectors (n_blocks, n_cells, 3) of every sampled cell along each of the ``axes``."""
    strides = strides_of(shapes)
    first = grid.offsets[blocks][:, None]
    for axis in range(3):
        picks = spread(np.maximum(shapes[:, axis] - 1, 1), _SAMPLED_CELLS)[1].reshape(len(blocks), -1)
        first = (first[..., None] + (picks * strides[:, axis, None])[:, None]).reshape(len(blocks), -1)
    corners = np.empty((*(2,) * len(axes), *first.shape, 3))
    for corner in np.ndindex(*(2,) * len(axes)):
        corners[corner] = Nodes.of(points).at(first + (strides[:, axes] @ np.array(corner))[:, None])
    others = [tuple(a for a in range(len(axes)) if a != own) for own in range(len(axes))]
    means = [corners.mean(axis=other) for other in others]
    return [mean[1] - mean[0] for mean in means]


def index_order(grid: Grid, handedness: IntArray) -> BoolArray:
    """(n_blocks, 6) whether the index order of a side winds its quads counter-clockwise as seen from outside the block.

    In 2-D the outside of the block lies to the right, looking against the plane's positive normal.
    """
    axis, far = np.divmod(np.arange(6), 2)
    outward = (np.where(far == 1, 1, -1) * handedness[:, None]) > 0
    if grid.dimension == 2:
        # (i, j), (j, k) planes are cyclic, the (i, k) plane is not: the same rule as for the normals in 3-D.
        flat = np.argmin(grid.shapes, axis=1)[:, None]
        first_axis = axis < 3 - axis - flat
        return np.where(first_axis, outward, ~outward)
    # e_b x e_c points along +a for a = i and k, along -a for a = j.
    return np.where(axis != 1, outward, ~outward)
