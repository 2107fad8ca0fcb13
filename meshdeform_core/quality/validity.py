"""The verdict: which cells that were sound are not any more?

A cell is sound if its Jacobian is positive everywhere. In 2-D the corners decide; in 3-D the corners and a proof for
the inside (:mod:`..numerics.cell.positivity`). Corners that are collapsed in the undeformed grid have no sign to judge;
cells whose undeformed Jacobian is negative somewhere are judged by their other corners and by their volume.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..numerics.cell.positivity import decide, judge_hexahedra, judge_quads
from ..parallel import empty
from .cells import Slab, for_slabs, side_of_good_quads
from .original import Original


class Test(IntEnum):
    """Which test a cell failed.

    ``CORNER``: a corner Jacobian that was positive is not, or is below the smallest share allowed; ``INSIDE``: the
    Jacobian is negative between positive corners, or could not be proved positive; ``VOLUME``: the volume alone.
    """

    NONE = 0
    CORNER = 1
    INSIDE = 2
    VOLUME = 3

    @property
    def label(self) -> str:
        return self.name.lower()


@dataclass(frozen=True)
class Verdict:
    """The verdict on all cells, counted block after block, C-ordered within each block.

    ``failed`` (n_cells,) int8, :class:`Test`; ``ratio`` (n_cells,) float32, smallest corner Jacobian relative to the
    undeformed one, infinite where the undeformed cell has no sound corner.
    """

    failed: np.ndarray
    ratio: np.ndarray

    @classmethod
    def blank(cls, n_cells: int) -> Verdict:
        """For :func:`judge_slab` to fill."""
        return cls(empty([n_cells], np.int8), empty([n_cells], np.float32))

    @property
    def invalid(self) -> IntArray:
        """Numbers of the cells that failed a test."""
        return np.flatnonzero(self.failed)

    @property
    def valid(self) -> bool:
        return not self.failed.any()

    @property
    def arrays(self) -> list[np.ndarray]:
        return [self.failed, self.ratio]


def judge(original: Original, after: FloatArray) -> Verdict:
    """Judge coordinates ``after`` (n_nodes, 3)."""
    verdict = Verdict.blank(original.grid.n_cells)
    for_slabs(original.grid, lambda _, slab: judge_slab(original, after, slab, verdict), verdict.arrays)
    return verdict


def newly_invalid(original: Original, after: FloatArray) -> IntArray:
    """Numbers of the cells that coordinates ``after`` (n_nodes, 3) make invalid."""
    return judge(original, after).invalid


def judge_slab(original: Original, after: FloatArray, slab: Slab, verdict: Verdict) -> None:
    """Fill the cells of a slab in ``verdict``."""
    grid, normal = original.grid, plane_normal(original.grid)
    sign = float(original.topology.handedness[slab.block])
    before, x = grid.block(slab.block), grid.block(slab.block, after)
    failed = verdict.failed[slab.cells]
    ratio = verdict.ratio[slab.cells].reshape(slab.last - slab.first, *grid.cell_shapes[slab.block][1:])
    failed[:] = Test.NONE
    if normal is None:
        proved = np.empty(ratio.shape, dtype=bool)
        judge_hexahedra(before, x, sign, slab.first, slab.last, proved, ratio)
        open_cells = np.flatnonzero(~proved.ravel() & (ratio.ravel() > 0.0))
        if open_cells.size:
            old, new = (corners_of_cells(grid, slab, open_cells, points) for points in (grid.points, after))
            found = decide(old, new, np.full(open_cells.size, sign))
            failed[open_cells] = np.array([Test.NONE, Test.INSIDE, Test.VOLUME])[found]
    else:
        flat = before.shape.index(1)
        side = side_of_good_quads(flat, sign, normal)
        planes = [np.ascontiguousarray(b.squeeze(axis=flat)) for b in (before, x)]
        rows = (0, planes[0].shape[0] - 1) if flat == 0 else (slab.first, slab.last)
        judge_quads(planes[0], planes[1], side, rows[0], rows[1], ratio.squeeze(axis=flat))
    low = (ratio <= 0.0) | (ratio < original.min_jacobian)
    failed[low.ravel()] = Test.CORNER


def corners_of_cells(grid: Grid, slab: Slab, cells: IntArray, points: FloatArray) -> FloatArray:
    """Corners (m, 8, 3) of ``cells`` of a slab, numbered from its first one."""
    x = grid.block(slab.block, points)
    i, j, k = np.unravel_index(cells, (slab.last - slab.first, *grid.cell_shapes[slab.block][1:]))
    i = i + slab.first
    return np.stack([x[i + a, j + b, k + c] for a, b, c in itertools.product((0, 1), repeat=3)], axis=1)
