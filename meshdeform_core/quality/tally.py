"""Totals over the cells of a grid."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, IntArray
from ..parallel import empty
from .cells import CellMeasures, Slab

HISTOGRAM_BINS = 20


@dataclass(frozen=True)
class Range:
    """Smallest and largest value."""

    min: float
    max: float


@dataclass(frozen=True)
class Skew:
    """Distribution of f_skew: 1 is orthogonal, 0 is invalid. ``histogram`` counts cells in 20 equal bins of [0, 1]."""

    harmonic_mean: float
    mean: float
    min: float
    p01: float
    histogram: tuple[int, ...]


class Tally:
    """The cells of one grid: one row per slab, summed in the grid's order when everything is there.

    ``sums`` (n_slabs, 5): 1/f_skew, f_skew, volume, cells with negative volume, with a bad corner; ``lows`` (n_slabs,
    2): smallest f_skew and scaled Jacobian; ``counts`` (n_slabs, 20): histogram of f_skew; ``skews`` (n_cells,).
    """

    def __init__(self, n_cells: int, n_slabs: int):
        # Single precision is enough for the quantile and the histogram.
        self.skews = empty([n_cells], np.float32)
        self.sums, self.lows = np.empty((n_slabs, 5)), np.empty((n_slabs, 2))
        self.counts = np.empty((n_slabs, HISTOGRAM_BINS), dtype=np.int64)

    def put(self, number: int, slab: Slab, m: CellMeasures) -> None:
        """Note one slab."""
        with np.errstate(divide="ignore"):
            inverse = (1.0 / m.skew).sum()
        self.sums[number] = inverse, m.skew.sum(), m.volume.sum(), (m.volume <= 0).sum(), (m.bad != 0).sum()
        self.lows[number] = m.skew.min(), m.scaled.min()
        skews = self.skews[slab.cells]
        skews[:] = m.skew.ravel()
        self.counts[number] = np.bincount(_bins(skews), minlength=HISTOGRAM_BINS)

    @property
    def per_slab(self) -> list[np.ndarray]:
        """Arrays with one row per slab."""
        return [self.sums, self.lows, self.counts]

    @property
    def volume(self) -> float:
        return float(self.sums[:, 2].sum())

    @property
    def negative(self) -> int:
        return int(self.sums[:, 3].sum())

    @property
    def bad(self) -> int:
        return int(self.sums[:, 4].sum())

    @property
    def scaled(self) -> float:
        return float(self.lows[:, 1].min())

    def skew(self) -> Skew:
        n = len(self.skews)
        inverse, total = self.sums[:, 0].sum(), self.sums[:, 1].sum()
        histogram = self.counts.sum(axis=0)
        at = max(0, -(-n // 100) - 1)
        # Of millions of cells only those in the lowest bins are copied and sorted.
        last = int(np.searchsorted(np.cumsum(histogram), at, side="right"))
        parts = np.array_split(self.skews, len(self.counts))
        lowest = np.concatenate([part[_bins(part) <= last] for part in parts])
        p01 = float(np.partition(lowest, at)[at])
        harmonic = n / float(inverse) if np.isfinite(inverse) else 0.0
        return Skew(harmonic, float(total) / n, float(self.lows[:, 0].min()), p01, tuple(histogram.tolist()))


def _bins(skews: FloatArray) -> IntArray:
    """Bin of the histogram for each value."""
    return np.minimum((skews * HISTOGRAM_BINS).astype(np.uint8), HISTOGRAM_BINS - 1)
