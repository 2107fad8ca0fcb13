"""The verdict: which cells were valid and no longer are.

A cell is sound if its Jacobian is positive everywhere. In 2-D the corners decide; in 3-D the corners and a proof for
the interior (:mod:`..numerics.cell.positivity`). Corners collapsed in the undeformed grid have no sign and are not
judged; cells whose undeformed Jacobian is negative somewhere are judged by their other corners and their volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..parallel import Nodes
from .cells import Slab, cells_alike, for_slabs, hold_cells
from .inspection import Failure, SlabMeasures, inspect_slab
from .original import Original

__all__ = ["Failure", "Verdict", "judge", "newly_invalid"]


@dataclass(frozen=True)
class Verdict:
    """The verdict on all cells, numbered block after block, C-ordered within each block.

    ``failed`` (n_cells,) int8, :class:`Failure`; ``ratio`` (n_cells,) float32, smallest corner Jacobian relative to the
    undeformed one, infinite where the undeformed cell has no sound corner; in parts if the grid is.
    """

    failed: np.ndarray
    ratio: np.ndarray

    @classmethod
    def blank(cls, grid: Grid) -> Verdict:
        """Empty arrays for :meth:`put` to fill."""
        return cls(cells_alike(grid, np.int8), cells_alike(grid, np.float32))

    def put(self, slab: Slab, figures: SlabMeasures) -> None:
        """Record one slab."""
        for values, found in zip((self.failed, self.ratio), (figures.failed, figures.ratio), strict=True):
            Nodes.of(values).rows[slab.cells] = found

    @property
    def invalid(self) -> IntArray:
        """Numbers of the cells that failed a test."""
        return Nodes.of(self.failed).nonzero_rows()

    def weak(self, limit: float) -> IntArray:
        """Numbers of this rank's cells that failed a test or whose ``ratio`` is below a limit."""
        low, high = Nodes.of(self.failed).ends
        failed, ratio = self.failed[low:high], self.ratio[low:high]
        return np.asarray(low + np.flatnonzero((failed != 0) | (ratio < limit)))

    @property
    def valid(self) -> bool:
        return not self.failed.any()

    @property
    def smallest_ratio(self) -> float:
        """The smallest ``ratio``."""
        return float(self.ratio.min())


def judge(original: Original, after: FloatArray) -> Verdict:
    """Judge coordinates ``after`` (n_nodes, 3)."""
    verdict = Verdict.blank(original.grid)
    hold_cells(original.grid, original.grid.points, after)
    for_slabs(original.grid, lambda _, slab: verdict.put(slab, inspect_slab(original, after, slab, both=False)))
    return verdict


def newly_invalid(original: Original, after: FloatArray) -> IntArray:
    """Numbers of the cells that coordinates ``after`` (n_nodes, 3) make invalid."""
    return judge(original, after).invalid
