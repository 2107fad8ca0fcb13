"""The cells of a deformed grid compared with those of the original: totals, distributions, extremes."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..grid import FloatArray
from ..numerics.cell.measures import CellMeasures, measure_cells
from ..parallel import Ranks
from .cells import Slab, block_volumes, corners_of, for_slabs, hold_cells, places, slabs
from .original import Original
from .validity import (
    BAD,
    HISTOGRAM,
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

# A lock of the module, as the objects that it guards are copied and locks cannot be.
_adding = threading.Lock()


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


class Lowest:
    """The ``count`` smallest of at least as many values; they are added in parts, on any rank, in any order."""

    def __init__(self, count: int):
        self._count, self._limit = count, np.float32(np.inf)
        self._parts: list[np.ndarray] = []

    def add(self, values: np.ndarray) -> None:
        """Add values (n,) float32; may be called by several threads."""
        found = values[values < self._limit]
        with _adding:
            self._parts.append(found)
            if sum(part.size for part in self._parts) > 2 * self._count:
                self._parts = [self._smallest()]
                self._limit = self._parts[0].max()

    def _smallest(self) -> np.ndarray:
        values = np.concatenate([np.empty(0, np.float32), *self._parts])
        return values if values.size <= self._count else np.partition(values, self._count - 1)[: self._count]

    def largest(self, ranks: Ranks) -> float:
        """The largest of the ``count`` smallest values of all ranks, which must all call this."""
        return float(np.sort(np.concatenate(ranks.gather([self._smallest()])))[self._count - 1])


class Tally:
    """Totals over the cells of one grid, a row per slab, added in the order of the grid.

    ``totals`` (n_slabs, TOTALS), see :data:`.validity.TOTALS`; ``lows``, ``low_cells`` (n_slabs, 2): smallest f_skew
    and scaled Jacobian of every slab, and their cells; ``p01``: the quantile of f_skew; ``volume``: of all cells, in
    2-D the area.
    """

    def __init__(self, n_cells: int, n_slabs: int):
        self.n_cells, self._lowest = n_cells, Lowest(-(-n_cells // 100))
        self.totals, self.lows = np.empty((n_slabs, TOTALS)), np.empty((n_slabs, 2))
        self.low_cells = np.empty((n_slabs, 2), dtype=np.int64)
        self.p01 = self.volume = 0.0

    def put(self, number: int, slab: Slab, skew: FloatArray, scaled: FloatArray, totals: FloatArray) -> None:
        """Record one slab of cells with these values (n,)."""
        # Single precision is enough for the quantile.
        self._lowest.add(skew.astype(np.float32, copy=False))
        self.totals[number] = totals
        self.low_cells[number] = slab.start + int(skew.argmin()), slab.start + int(scaled.argmin())

    def complete(self, original: Original, points: FloatArray) -> None:
        """Find what follows from all rows: the quantile, the volume, in double precision the smallest values."""
        self.p01 = self._lowest.largest(original.grid.nodes.ranks)
        measured = measure_again(original, points, self.low_cells.ravel())
        self.lows[:, 0], self.lows[:, 1] = measured.skew[0::2], measured.scaled[1::2]
        self.volume = float(self.totals[:, VOLUME].sum())
        if original.grid.dimension == 3:
            self.volume = sum(block_volumes(original.grid, points, original.topology.handedness).tolist())

    @property
    def negative(self) -> int:
        """Number of cells with a negative volume."""
        return int(self.totals[:, NEGATIVE].sum())

    @property
    def bad(self) -> int:
        """Number of cells with a corner Jacobian that is not positive."""
        return int(self.totals[:, BAD].sum())

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


def _extreme(cells: np.ndarray, values: FloatArray, sign: float = 1.0) -> tuple[int, float]:
    """The cell with the smallest of the values (n,), or with ``sign`` -1 the largest, and that value."""
    slab = int((sign * values).argmin())
    return int(cells[slab]), float(values[slab])


def measure_again(original: Original, points: FloatArray, cells: np.ndarray) -> CellMeasures:
    """Measures in double precision of cells, by number, with coordinates ``points`` (n_nodes, 3)."""
    return measure_cells(corners_of(original.grid, points, cells), original.sides(places(original.grid, cells)[0]))


class Comparison:
    """The cells with coordinates ``after`` (n_nodes, 3), measured, and the verdict on them.

    The first comparison with an original measures the original as well. ``inherited``: number of cells that were bad
    before and are no worse.
    """

    def __init__(self, original: Original, after: FloatArray):
        grid, n_slabs = original.grid, len(slabs(original.grid))
        self.after, self.verdict = Tally(grid.n_cells, n_slabs), Verdict.blank(grid)
        alone = after is grid.points
        self._before = None if alone or original.measured else Tally(grid.n_cells, n_slabs)
        # Smallest and largest volume ratio and smallest relative Jacobian, and their cells.
        self._extremes, self._cells = np.empty((n_slabs, 3)), np.empty((n_slabs, 3), dtype=np.int64)
        inherited = np.empty(n_slabs)

        def put(number: int, slab: Slab) -> None:
            figures = inspect_slab(original, after, slab, self._before is not None)
            self.after.put(number, slab, figures.skew, figures.scaled, figures.after)
            if self._before:
                self._before.put(number, slab, figures.skew_before, figures.scaled_before, figures.before)
            self.verdict.put(slab, figures)
            inherited[number] = figures.inherited
            self._extremes[number], self._cells[number] = _extremes(slab, figures)

        tallies = [self.after, *([self._before] if self._before else [])]
        per_slab = [array for t in tallies for array in (t.totals, t.low_cells)]
        hold_cells(grid, grid.points, after)
        for_slabs(grid, put, [*per_slab, inherited, self._extremes, self._cells])
        self.inherited = int(inherited.sum())
        for tally, points in zip(tallies, (after, grid.points), strict=False):
            tally.complete(original, points)
        original.measured = original.measured or self._before or self.after
        if not alone:
            # In double precision, as they were found in single precision.
            cells, shape = self._cells.ravel(), self._cells.shape
            old, new = (measure_again(original, points, cells) for points in (grid.points, after))
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
