"""The cells of a deformed grid against those of the original."""

from __future__ import annotations

import numpy as np

from ..grid import BoolArray, FloatArray
from .cells import CellMeasures, Slab, measure_cells, slabs
from .original import Original
from .tally import Range, Tally
from .validity import Test, Verdict, judge_slab


class Comparison:
    """The cells with coordinates ``after`` (n_nodes, 3), measured, and the verdict on them."""

    def __init__(self, original: Original, after: FloatArray):
        grid, n_slabs = original.grid, len(slabs(original.grid))
        self._original, self.after = original, Tally(grid.n_cells, n_slabs)
        self.verdict, self._points = Verdict.blank(grid.n_cells), after
        self._inherited, self._ratio = np.empty(n_slabs), np.empty((n_slabs, 2))
        per_cell = [self.after.skews, *self.verdict.arrays]
        per_slab = [*self.after.per_slab, self._inherited, self._ratio]
        measure_cells(grid, original.topology, after, self._put, per_cell, per_slab)

    def _put(self, number: int, slab: Slab, new: CellMeasures) -> None:
        self.after.put(number, slab, new)
        old, bad = self._original.bad[slab.cells], new.bad.ravel()
        judge_slab(self._original, self._points, slab, self.verdict)
        sound = self.verdict.failed[slab.cells] == Test.NONE
        self._inherited[number] = ((old != 0) & (bad != 0) & sound).sum()
        volume = self._original.volume[slab.cells]
        solid = volume > 0
        change = new.volume.ravel()[solid] / volume[solid]
        self._ratio[number] = change.min(initial=np.inf), change.max(initial=-np.inf)

    @property
    def broken(self) -> BoolArray:
        """(n_cells,) cells that became invalid."""
        return np.asarray(self.verdict.failed != Test.NONE)

    @property
    def inherited(self) -> int:
        """Cells that were bad before and are no worse."""
        return int(self._inherited.sum())

    @property
    def ratio(self) -> Range:
        """Volumes after over volumes before, of cells that had one."""
        low, high = float(self._ratio[:, 0].min()), float(self._ratio[:, 1].max())
        return Range(low, high) if low <= high else Range(1.0, 1.0)
