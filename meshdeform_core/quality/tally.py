"""Totals over the cells of a grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..parallel import empty
from .cells import Slab

HISTOGRAM_BINS = 20


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
        """Sums over cells (m,) with these values; ``bad``: with a corner Jacobian <= 0."""
        sums = cls(0.0, 0.0, np.zeros(HISTOGRAM_BINS, dtype=np.int64), area=float(volume.sum()))
        sums.add(skew, volume, bad)
        return sums

    def add(self, skew: FloatArray, volume: FloatArray, bad: BoolArray) -> None:
        """Add cells (m,); their area is left alone."""
        with np.errstate(divide="ignore"):
            self.inverse += float((1.0 / skew).sum())
        self.skew += float(skew.sum())
        self.counts += np.bincount(_bins(skew.astype(np.float32)), minlength=HISTOGRAM_BINS)
        self.negative += int((volume <= 0).sum())
        self.bad += int(bad.sum())


class Tally:
    """Sums over the cells of one grid: one row per slab, added in the order of the grid once all are complete.

    ``sums`` (n_slabs, 5): 1/f_skew, f_skew, area (2-D), cells with negative volume, with a bad corner; ``lows``
    (n_slabs, 2): smallest f_skew and scaled Jacobian; ``low_cells`` (n_slabs, 2) where; ``counts`` (n_slabs, 20):
    histogram of f_skew; ``skews`` (n_cells,).
    """

    def __init__(self, n_cells: int, n_slabs: int):
        # Single precision is enough for the quantile and the histogram.
        self.skews = empty([n_cells], np.float32)
        self.sums, self.lows = np.empty((n_slabs, 5)), np.empty((n_slabs, 2))
        self.counts, self.low_cells = (np.empty((n_slabs, n), dtype=np.int64) for n in (HISTOGRAM_BINS, 2))
        self.solid: float | None = None

    def put(self, number: int, slab: Slab, skew: FloatArray, scaled: FloatArray, sums: Sums) -> None:
        """Record one slab of cells with these values (n,)."""
        self.skews[slab.cells] = skew
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
        """Totals over all cells; in 2-D their area."""
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
        n = len(self.skews)
        inverse, total = self.sums[:, 0].sum(), self.sums[:, 1].sum()
        histogram = self.counts.sum(axis=0)
        at = max(0, -(-n // 100) - 1)
        # Only the cells in the lowest bins are copied and sorted, as there may be millions.
        last = int(np.searchsorted(np.cumsum(histogram), at, side="right"))
        bound = np.float32((last + 1) / HISTOGRAM_BINS + 1e-5)
        parts = np.array_split(self.skews, len(self.counts))
        lowest = np.concatenate([part[part < bound] for part in parts])
        p01 = float(np.partition(lowest, at)[at])
        harmonic = n / float(inverse) if np.isfinite(inverse) else 0.0
        return Skew(harmonic, float(total) / n, float(self.lows[:, 0].min()), p01, tuple(histogram.tolist()))


def _bins(skews: FloatArray) -> IntArray:
    """Bin of the histogram for each value."""
    return np.minimum((skews * HISTOGRAM_BINS).astype(np.uint8), HISTOGRAM_BINS - 1)
