"""The cells of a deformed grid compared with those of the original: totals, distributions, extremes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import cast

import numpy as np

from ..grid import FloatArray
from ..numerics.cell.measures import CellMeasures, measure_cells
from ..parallel import Nodes, Ranks
from .cells import Slab, block_volumes, cells_alike, corners_of, for_slabs, hold_cells, places, slabs
from .original import Original
from .validity import (
    BAD,
    HISTOGRAM,
    INHERITED,
    INVERSE,
    NEGATIVE,
    SKEW,
    TOTALS,
    VOLUME,
    SlabMeasures,
    Verdict,
    inspect_slab,
    relative_jacobian,
)


@dataclass(frozen=True)
class Range:
    """Smallest and largest value."""

    min: float
    max: float


@dataclass(frozen=True)
class Spread:
    """Root mean square and largest value."""

    rms: float
    max: float

    @classmethod
    def of(cls, values: FloatArray) -> Spread:
        if values.size == 0:
            return cls(0.0, 0.0)
        return cls(float(np.sqrt(np.mean(values**2))), float(np.abs(values).max()))


@dataclass(frozen=True)
class Skew:
    """Distribution of f_skew: 1 is orthogonal, 0 is invalid. ``histogram`` counts cells in 20 equal bins of [0, 1]."""

    harmonic_mean: float
    mean: float
    min: float
    p01: float
    histogram: tuple[int, ...]


class Tally:
    """Totals over the cells with coordinates ``points`` (n_nodes, 3), added in the order of the grid.

    ``totals`` (n_slabs, TOTALS), see :data:`.validity.TOTALS`; ``lows``, ``low_cells`` (n_slabs, 2): smallest f_skew
    and scaled Jacobian of every slab, and their cells; ``p01``: the quantile of f_skew; ``volume``: of all cells, in
    2-D the area. ``also`` is called with every slab and its measures, and may fill arrays ``per_slab``.
    """

    def __init__(
        self,
        original: Original,
        points: FloatArray,
        also: Callable[[int, Slab, SlabMeasures], None] = lambda *_: None,
        per_slab: tuple[np.ndarray, ...] = (),
    ):
        grid, n_slabs = original.grid, len(slabs(original.grid))
        self.n_cells, self.totals = grid.n_cells, np.empty((n_slabs, TOTALS))
        self.low_cells = np.empty((n_slabs, 2), dtype=np.int64)
        # Single precision is enough for the quantile.
        skew = cells_alike(grid, np.float32)

        def put(number: int, slab: Slab) -> None:
            found = inspect_slab(original, points, slab)
            Nodes.of(skew).rows[slab.cells], self.totals[number] = found.skew, found.totals
            self.low_cells[number] = slab.start + int(found.skew.argmin()), slab.start + int(found.scaled.argmin())
            also(number, slab, found)

        hold_cells(grid, grid.points, points)
        for_slabs(grid, put, [self.totals, self.low_cells, *per_slab])
        self.p01 = kth_smallest(grid.nodes.ranks, Nodes.of(skew).own, -(-grid.n_cells // 100))
        exact = measure_again(original, points, self.low_cells.ravel())
        self.lows = np.stack([exact.skew[0::2], exact.scaled[1::2]], axis=1)
        self.volume = float(self.totals[:, VOLUME].sum())
        if grid.dimension == 3:
            self.volume = sum(block_volumes(grid, points, original.topology.handedness).tolist())

    @property
    def negative(self) -> int:
        """Number of cells with a negative volume."""
        return int(self.totals[:, NEGATIVE].sum())

    @property
    def bad(self) -> int:
        """Number of cells with a corner Jacobian that is not positive."""
        return int(self.totals[:, BAD].sum())

    @property
    def inherited(self) -> int:
        """Number of cells that were bad in the undeformed grid, too, and are no worse."""
        return int(self.totals[:, INHERITED].sum())

    @property
    def worst(self) -> tuple[int, float]:
        """The cell with the smallest f_skew, and its value."""
        return _extreme(self.low_cells[:, 0], self.lows[:, 0])

    @property
    def smallest_scaled(self) -> tuple[int, float]:
        """The cell with the smallest scaled Jacobian, and its value."""
        return _extreme(self.low_cells[:, 1], self.lows[:, 1])

    @cached_property
    def skew(self) -> Skew:
        """The distribution of f_skew."""
        inverse, total = self.totals[:, INVERSE].sum(), self.totals[:, SKEW].sum()
        harmonic = self.n_cells / float(inverse) if np.isfinite(inverse) else 0.0
        counts = tuple(int(count) for count in self.totals[:, HISTOGRAM:].sum(axis=0))
        return Skew(harmonic, float(total) / self.n_cells, float(self.lows[:, 0].min()), self.p01, counts)


def measured(original: Original) -> Tally:
    """Totals over the cells of the undeformed grid, found once."""
    if original.measured is None:
        original.measured = Tally(original, original.grid.points)
    return cast("Tally", original.measured)


def kth_smallest(ranks: Ranks, values: np.ndarray, k: int) -> float:
    """The k-th smallest, k >= 1, of the values of all ranks, which must all call this; reorders this rank's (n,)."""
    if values.size > k:
        values.partition(k - 1)
    return float(np.sort(np.concatenate(ranks.gather([values[:k]])))[k - 1])


def _extreme(cells: np.ndarray, values: FloatArray, sign: float = 1.0) -> tuple[int, float]:
    """The cell with the smallest of the values (n,), or with ``sign`` -1 the largest, and that value."""
    slab = int((sign * values).argmin())
    return int(cells[slab]), float(values[slab])


def measure_again(original: Original, points: FloatArray, cells: np.ndarray) -> CellMeasures:
    """Measures in double precision of cells, by number, with coordinates ``points`` (n_nodes, 3)."""
    return measure_cells(corners_of(original.grid, points, cells), original.sides(places(original.grid, cells)[0]))


class Comparison:
    """The cells with coordinates ``after`` (n_nodes, 3), measured, and the verdict on them."""

    def __init__(self, original: Original, after: FloatArray):
        n_slabs = len(slabs(original.grid))
        self.verdict = Verdict.blank(original.grid)
        # Smallest and largest volume ratio and smallest relative Jacobian, and their cells.
        self._extremes, self._cells = np.empty((n_slabs, 3)), np.empty((n_slabs, 3), dtype=np.int64)

        def put(number: int, slab: Slab, figures: SlabMeasures) -> None:
            self.verdict.put(slab, figures)
            self._extremes[number], self._cells[number] = _extremes(slab, figures)

        self.after = Tally(original, after, put, (self._extremes, self._cells))
        if after is original.grid.points:
            original.measured = self.after
        else:
            # In double precision, as they were found in single precision.
            cells, shape = self._cells.ravel(), self._cells.shape
            old, new = (measure_again(original, points, cells) for points in (original.grid.points, after))
            blank = np.full(cells.size, np.nan)
            change = np.divide(new.volume, old.volume, out=blank, where=old.volume > 0).reshape(shape)
            solid = np.isfinite(change[:, :2])
            self._extremes[:, :2][solid] = change[:, :2][solid]
            self._extremes[:, 2] = relative_jacobian(old.jacobian, new.jacobian).reshape(shape)[:, 2]

    @property
    def smallest_ratio(self) -> tuple[int, float]:
        """The cell with the smallest corner Jacobian relative to the undeformed one, and its value."""
        return _extreme(self._cells[:, 2], self._extremes[:, 2])

    @property
    def volume_ratios(self) -> tuple[tuple[int, float], tuple[int, float]] | None:
        """The cells with the smallest and the largest volume relative to the undeformed one, and their values; ``None``
        if no cell had a volume."""
        low = _extreme(self._cells[:, 0], self._extremes[:, 0])
        high = _extreme(self._cells[:, 1], self._extremes[:, 1], -1.0)
        return None if low[1] > high[1] else (low, high)


def _extremes(slab: Slab, f: SlabMeasures) -> tuple[tuple[float, float, float], tuple[int, int, int]]:
    low = high = f.change
    if not np.isfinite(f.change.sum()):
        sound = np.isfinite(f.change)
        low, high = (np.where(sound, f.change, other) for other in (np.inf, -np.inf))
    at = int(low.argmin()), int(high.argmax()), int(f.ratio.argmin())
    values = float(low[at[0]]), float(high[at[1]]), float(f.ratio[at[2]])
    return values, (slab.start + at[0], slab.start + at[1], slab.start + at[2])
