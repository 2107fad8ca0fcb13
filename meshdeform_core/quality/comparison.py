"""The cells of a deformed grid compared with those of the original."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, Grid
from ..grid.topology import Topology
from ..numerics.cell.measures import scattered_hexahedra
from .cells import Slab, block_volumes, corners_of, for_slabs, hold_cells, places, slabs
from .original import Original
from .tally import Range, Tally
from .validity import SlabMeasures, Verdict, inspect_slab, relative_jacobian


class Comparison:
    """The cells with coordinates ``after`` (n_nodes, 3), measured, and the verdict on them.

    The first comparison with an original measures the original as well.
    """

    def __init__(self, original: Original, after: FloatArray):
        grid, n_slabs = original.grid, len(slabs(original.grid))
        self._original, self._points = original, after
        self.after, self.verdict = Tally(grid.n_cells, n_slabs), Verdict.blank(grid)
        alone = after is grid.points
        self._before = None if alone or original.measured else Tally(grid.n_cells, n_slabs)
        # Smallest and largest volume ratio and smallest relative Jacobian, and their cells.
        self._inherited, self._extremes, self._cells = (
            np.empty(n_slabs), np.empty((n_slabs, 3)), np.empty((n_slabs, 3), dtype=np.int64)
        )  # fmt: skip
        tallies = [self.after, *([self._before] if self._before else [])]
        per_slab = [array for t in tallies for array in t.per_slab] + [self._inherited, self._extremes, self._cells]
        hold_cells(grid, grid.points, after)
        for_slabs(grid, self._put, per_slab)
        for tally, points in zip(tallies, (after, grid.points), strict=False):
            _complete(tally, grid, original.topology, points)
        original.measured = original.measured or self._before or self.after
        if grid.dimension == 3 and not alone:
            self._measure_extremes()

    def _measure_extremes(self) -> None:
        """Recompute in double precision the values of the extreme cells, which were found in single precision."""
        grid, cells = self._original.grid, self._cells.ravel()
        sign = self._original.topology.handedness[places(grid, cells)[0]].astype(float)
        old, new = (
            scattered_hexahedra(corners_of(grid, points, cells), sign) for points in (grid.points, self._points)
        )
        shape = self._cells.shape
        change = np.where(old[3] > 0, new[3] / np.where(old[3] > 0, old[3], 1.0), np.nan).reshape(shape)
        solid = np.isfinite(change[:, :2])
        self._extremes[:, :2][solid] = change[:, :2][solid]
        self._extremes[:, 2] = relative_jacobian(old[2], new[2]).reshape(shape)[:, 2]

    def _put(self, number: int, slab: Slab) -> None:
        figures = inspect_slab(self._original, self._points, slab, self._before is not None)
        self.after.put(number, slab, figures.skew, figures.scaled, figures.after)
        if self._before and figures.skew_before is not None and figures.scaled_before is not None:
            self._before.put(number, slab, figures.skew_before, figures.scaled_before, figures.before)
        self.verdict.put(slab, figures)
        self._inherited[number] = figures.inherited
        self._extremes[number], self._cells[number] = _extremes(slab, figures)

    @property
    def smallest_ratio(self) -> tuple[int, float]:
        """The cell with the smallest corner Jacobian relative to the undeformed one, and its value."""
        slab = int(self._extremes[:, 2].argmin())
        return int(self._cells[slab, 2]), float(self._extremes[slab, 2])

    @property
    def volume_ratios(self) -> tuple[tuple[int, float], tuple[int, float]] | None:
        """The cells with the smallest and the largest volume relative to the undeformed one, and their values."""
        low, high = int(self._extremes[:, 0].argmin()), int(self._extremes[:, 1].argmax())
        least, most = float(self._extremes[low, 0]), float(self._extremes[high, 1])
        if least > most:
            return None
        return (int(self._cells[low, 0]), least), (int(self._cells[high, 1]), most)

    @property
    def inherited(self) -> int:
        """Cells that were bad before and are no worse."""
        return int(self._inherited.sum())

    @property
    def ratio(self) -> Range:
        """Ratios of the volumes after to those before, for cells that had one."""
        found = self.volume_ratios
        return Range(found[0][1], found[1][1]) if found else Range(1.0, 1.0)


def _extremes(slab: Slab, f: SlabMeasures) -> tuple[tuple[float, float, float], tuple[int, int, int]]:
    change = f.change
    if not np.isfinite(change.sum()):
        sound = np.isfinite(change)
        low, high = (np.where(sound, change, other) for other in (np.inf, -np.inf))
    else:
        low = high = change
    at = int(low.argmin()), int(high.argmax()), int(f.ratio.argmin())
    cells = slab.start + at[0], slab.start + at[1], slab.start + at[2]
    return (float(low[at[0]]), float(high[at[1]]), float(f.ratio[at[2]])), cells


def _complete(tally: Tally, grid: Grid, topology: Topology, points: FloatArray) -> None:
    """Complete a tally: the quantile, the volume, and in double precision the smallest values of every slab."""
    tally.lowest.complete(grid.nodes.ranks)
    if grid.dimension == 2:
        return
    tally.solid = sum(block_volumes(grid, points, topology.handedness).tolist())
    cells = tally.low_cells.ravel()
    sign = topology.handedness[places(grid, cells)[0]].astype(float)
    skew, scaled, *_ = scattered_hexahedra(corners_of(grid, points, cells), sign)
    tally.lows[:, 0], tally.lows[:, 1] = skew[0::2], scaled[1::2]
