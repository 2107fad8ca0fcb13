"""Totals over the cells of a grid."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..parallel import Ranks
from .cells import Slab

HISTOGRAM_BINS = 20
_DIGIT = 8
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


@dataclass
class Sums:
    """Sums over some cells: 1 / f_skew, f_skew, histogram of f_skew, counts; in 2-D also the area."""

    inverse: float
    skew: float
    counts: IntArray
    negative: int = 0
    bad: int = 0
    area: float = 0.0

    @classmethod
    def of(cls, skew: FloatArray, volume: FloatArray, bad: BoolArray) -> Sums:
        """Sums over cells (m,); ``bad`` marks those with a corner Jacobian <= 0."""
        sums = cls(0.0, 0.0, np.zeros(HISTOGRAM_BINS, dtype=np.int64), area=float(volume.sum()))
        sums.add(skew, volume, bad)
        return sums

    def add(self, skew: FloatArray, volume: FloatArray, bad: BoolArray) -> None:
        """Add cells (m,), except for their area."""
        with np.errstate(divide="ignore"):
            self.inverse += float((1.0 / skew).sum())
        self.skew += float(skew.sum())
        bins = np.minimum((skew.astype(np.float32) * HISTOGRAM_BINS).astype(np.uint8), HISTOGRAM_BINS - 1)
        self.counts += np.bincount(bins, minlength=HISTOGRAM_BINS)
        self.negative += int((volume <= 0).sum())
        self.bad += int(bad.sum())


class Tally:
    """Sums over the cells of one grid: one row per slab, added in the order of the grid once all are complete.

    ``sums`` (n_slabs, 5): 1/f_skew, f_skew, area (2-D), cells with negative volume, with a bad corner; ``lows``
    (n_slabs, 2): smallest f_skew and scaled Jacobian; ``low_cells`` (n_slabs, 2): their cells; ``counts``
    (n_slabs, 20): histogram of f_skew; ``lowest``: the one per cent of cells with the smallest f_skew.
    """

    def __init__(self, n_cells: int, n_slabs: int):
        self.n_cells, self.lowest = n_cells, Lowest(-(-n_cells // 100))
        self.sums, self.lows = np.empty((n_slabs, 5)), np.empty((n_slabs, 2))
        self.counts, self.low_cells = (np.empty((n_slabs, n), dtype=np.int64) for n in (HISTOGRAM_BINS, 2))
        self.solid: float | None = None

    def put(self, number: int, slab: Slab, skew: FloatArray, scaled: FloatArray, sums: Sums) -> None:
        """Record one slab of cells with these values (n,)."""
        # Single precision is enough for the quantile and the histogram.
        self.lowest.add(skew.astype(np.float32, copy=False))
        at = int(skew.argmin()), int(scaled.argmin())
        self.lows[number] = skew[at[0]], scaled[at[1]]
        self.low_cells[number] = slab.start + at[0], slab.start + at[1]
        self.sums[number] = sums.inverse, sums.skew, sums.area, sums.negative, sums.bad
        self.counts[number] = sums.counts

    @property
    def per_slab(self) -> list[np.ndarray]:
        """Arrays with one row per slab."""
        return [self.sums, self.lows, self.low_cells, self.counts]

    @property
    def volume(self) -> float:
        """Total volume; in 2-D area."""
        return float(self.sums[:, 2].sum()) if self.solid is None else self.solid

    @property
    def negative(self) -> int:
        return int(self.sums[:, 3].sum())

    @property
    def bad(self) -> int:
        return int(self.sums[:, 4].sum())

    @property
    def smallest_scaled(self) -> tuple[int, float]:
        """The cell with the smallest scaled Jacobian, and its value."""
        slab = int(self.lows[:, 1].argmin())
        return int(self.low_cells[slab, 1]), float(self.lows[slab, 1])

    @property
    def worst(self) -> tuple[int, float]:
        """The cell with the smallest f_skew, and its value."""
        slab = int(self.lows[:, 0].argmin())
        return int(self.low_cells[slab, 0]), float(self.lows[slab, 0])

    @cached_property
    def skew(self) -> Skew:
        """The distribution of f_skew, once all rows are complete."""
        n = self.n_cells
        inverse, total = self.sums[:, 0].sum(), self.sums[:, 1].sum()
        harmonic = n / float(inverse) if np.isfinite(inverse) else 0.0
        histogram = tuple(self.counts.sum(axis=0).tolist())
        return Skew(harmonic, float(total) / n, float(self.lows[:, 0].min()), self.lowest.largest, histogram)


class Lowest:
    """The ``count`` smallest of at least as many values that are not negative; they are added in parts, of which the
    result is independent, as of their order."""

    def __init__(self, count: int):
        self._count, self._limit = count, np.float32(np.inf)
        self._parts: list[np.ndarray] = []
        self._size = 0

    def add(self, values: np.ndarray) -> None:
        """Add values (n,) float32; may be called by several threads."""
        found = values[values < self._limit]
        with _adding:
            self._parts.append(found)
            self._size += found.size
            if self._size > 2 * self._count:
                self._shorten()

    def complete(self, ranks: Ranks) -> None:
        """Combine the values of all ranks, which must all call this; none sends its values to the others.

        More values may follow, and another call.
        """
        if ranks.count == 1:
            self._shorten()
            return
        # Digit by digit: the bits of numbers that are not negative are in the order of the numbers.
        values = np.concatenate([np.empty(0, np.float32), *self._parts])
        keys = (values + np.float32(0.0)).view(np.uint32)
        found, left = 0, self._count
        for shift in range(32 - _DIGIT, -1, -_DIGIT):
            digits = (keys >> np.uint32(shift)) & np.uint32((1 << _DIGIT) - 1)
            counts = ranks.gather([np.bincount(digits, minlength=1 << _DIGIT)])
            ends = np.cumsum(np.sum(counts, axis=0))
            digit = int(np.searchsorted(ends, left))
            found, left = found << _DIGIT | digit, left - int(ends[digit - 1] if digit else 0)
            keys = keys[digits == digit]
        self._limit = np.uint32(found).view(np.float32)
        values = values[values <= self._limit]
        self._parts, self._size = [values], values.size

    @property
    def largest(self) -> float:
        """The largest of the ``count`` smallest values, once all have been added."""
        return float(self._limit)

    def _shorten(self) -> None:
        values = np.concatenate(self._parts)
        if values.size >= self._count:
            values = np.partition(values, self._count - 1)[: self._count]
            self._limit = values[-1]
        self._parts, self._size = [values], values.size
