"""The verdict: which cells were valid and no longer are.

A cell is sound if its Jacobian is positive everywhere. In 2-D the corners decide; in 3-D the corners and a proof for
the interior (:mod:`..numerics.cell.positivity`). Corners collapsed in the undeformed grid have no sign and are not
judged; cells whose undeformed Jacobian is negative somewhere are judged by their other corners and their volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grid import FloatArray, IntArray
from ...parallel import empty
from ..measures.cells import Slab, for_slabs
from .inspection import Failure, SlabMeasures, inspect_slab
from .original import Original

__all__ = ["Failure", "Verdict", "judge", "newly_invalid"]


@dataclass(frozen=True)
class Verdict:
    """The verdict on all cells, numbered block after block, C-ordered within each block.

    ``failed`` (n_cells,) int8, :class:`Failure`; ``ratio`` (n_cells,) float32, smallest corner Jacobian relative to the
    undeformed one, infinite where the undeformed cell has no sound corner.
    """

    failed: np.ndarray
    ratio: np.ndarray

    @classmethod
    def blank(cls, n_cells: int) -> Verdict:
        """Empty arrays for :meth:`put` to fill."""
        return cls(empty([n_cells], np.int8), empty([n_cells], np.float32))

    def put(self, slab: Slab, figures: SlabMeasures) -> None:
        """Record one slab."""
        self.failed[slab.cells], self.ratio[slab.cells] = figures.failed, figures.ratio

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
    for_slabs(
        original.grid,
        lambda _, slab: verdict.put(slab, inspect_slab(original, after, slab, both=False)),
        verdict.arrays,
    )
    return verdict


def newly_invalid(original: Original, after: FloatArray) -> IntArray:
    """Numbers of the cells that coordinates ``after`` (n_nodes, 3) make invalid."""
    return judge(original, after).invalid
