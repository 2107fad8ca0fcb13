"""Which nodes the first step of a hybrid method moves: block faces and the faces of virtual sub-blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import Grid, IntArray, Side
from ...numerics.arrays import spans
from ...numerics.pieces import even_cuts
from ..base import Problem

Cuts = tuple[IntArray, IntArray, IntArray]


@dataclass(frozen=True)
class Skeleton:
    """The index planes at which blocks are cut.

    Attributes
    ----------
    cuts : for every block the node indices of the cutting planes along i, j, k, including both ends
    left_out : block sides that the second step moves itself; only their edges belong to the skeleton
    """

    grid: Grid
    cuts: tuple[Cuts, ...]
    left_out: frozenset[tuple[int, Side]] = frozenset()

    def sub_blocks(self) -> IntArray:
        """All sub-blocks (n, 11) of all blocks, see :mod:`...numerics.transfinite.arcs`; the last column is not set."""
        counts = np.array([[max(len(cut) - 1, 1) for cut in cuts] for cuts in self.cuts])
        block, place = spans(counts.prod(axis=1))
        # The single plane of a 2-D block is both ends of a sub-block.
        number = np.stack([place // counts[block, 1:].prod(axis=1), place // counts[block, 2], place]) % counts[block].T
        ends = np.empty((2, len(block), 3), dtype=np.int64)
        for axis, along in enumerate(zip(*self.cuts, strict=True)):
            sizes = np.array([len(cut) for cut in along])
            first = (np.cumsum(sizes) - sizes)[block]
            last = first + sizes[block] - 1
            for end in range(2):
                ends[end, :, axis] = np.concatenate(along)[np.minimum(first + number[axis] + end, last)]
        unset = np.zeros(len(block), dtype=np.int64)
        shapes = np.array(self.grid.shapes, dtype=np.int64)[block]
        return np.column_stack([self.grid.offsets[block], shapes, *ends, unset])

    def nodes(self) -> IntArray:
        """Flat indices, ascending, of all nodes that the first step moves, including coincident ones; if the grid is in
        parts, those of this rank."""
        return np.concatenate([self._of_block(b) for b in range(self.grid.n_blocks)])

    def _of_block(self, block: int) -> IntArray:
        shape, own = self.grid.shapes[block], self.grid.planes(block)
        on = [np.zeros(n, dtype=bool) for n in shape]
        for axis, cut in enumerate(self.cuts[block]):
            # The single plane of a 2-D block is not a cut: it contains the interior.
            on[axis][cut if shape[axis] > 1 else []] = True
        on[0] = on[0][own]
        mask = on[0][:, None, None] | on[1][:, None] | on[2]
        for side in (side for side in Side if (block, side) in self.left_out):
            a, b = side.tangential
            layer = side.layer(shape) - (own.start if side.axis == 0 else 0)
            if 0 <= layer < mask.shape[side.axis]:
                plane: list[slice | int] = [slice(None)] * 3
                plane[side.axis] = layer
                mask[tuple(plane)] = on[a][:, None] | on[b]
        start = self.grid.offsets[block] + own.start * shape[1] * shape[2]
        return np.asarray(start + np.flatnonzero(mask), dtype=np.int64)


_TURNING = np.deg2rad(50.0)
"""Directions whose grid lines turn by more than this within a sub-block are cut twice as often, as TFI does not move
such lines rigidly."""
_LINES = 12
"""Number of grid lines per direction that are sampled for their turning angle."""


def make_skeleton(problem: Problem, max_cells: int) -> Skeleton:
    """Cut every block into sub-blocks of at most ``max_cells`` cells per direction; 0 cuts nothing.

    A direction with more than ``max_cells / 2`` cells is cut at least once; one whose grid lines turn by more than 50
    degrees within ``max_cells`` cells is cut every ``max_cells / 2`` cells.
    """
    grid = problem.grid

    def along(block: int, axis: int) -> IntArray:
        nodes, most = grid.shapes[block][axis], max_cells
        # Coarse blocks turn around a body as much as fine ones do, so only the number of cells decides whether a block
        # remains uncut.
        long = max_cells > 0 and 2 * (nodes - 1) > max_cells
        if long and max_cells > 1 and _turning(grid, block, axis, max_cells) > _TURNING:
            most = -(-max_cells // 2)
        return even_cuts(nodes, most, 2 if long else 1)

    return Skeleton(grid, tuple((along(b, 0), along(b, 1), along(b, 2)) for b in range(grid.n_blocks)))


def _turning(grid: Grid, block: int, axis: int, cells: int) -> float:
    """Largest angle (radians) by which any of the sampled grid lines along ``axis`` turns within ``cells`` cells."""
    shape = grid.shapes[block]
    chosen = [np.unique(np.linspace(0, n - 1, min(n, _LINES)).astype(int)) for n in shape]
    chosen[axis] = np.arange(shape[axis])
    flat = grid.offsets[block] + np.ravel_multi_index(np.ix_(*chosen), shape)
    some = np.moveaxis(grid.points[flat], axis, 0)
    edge = np.diff(some, axis=0)
    cosine = (edge[1:] * edge[:-1]).sum(axis=-1)
    sine = np.linalg.norm(np.cross(edge[1:], edge[:-1]), axis=-1)
    # An edge of zero length has no direction: sine and cosine are zero, and so is the angle.
    total = np.concatenate([np.zeros((1, *some.shape[1:3])), np.cumsum(np.arctan2(sine, cosine), axis=0)])
    window = min(cells, len(total)) - 1
    return float((total[window:] - total[: len(total) - window]).max(initial=0.0))
