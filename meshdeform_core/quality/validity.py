"""The verdict: which cells were valid and no longer are; and their totals, distributions and extremes.

A cell is sound if its Jacobian is positive everywhere. In 2-D the corners decide; in 3-D the corners and a proof for
the interior (:mod:`..numerics.cell.measures`). Corners collapsed in the undeformed grid have no sign and are not
judged; cells whose undeformed Jacobian is negative somewhere are judged by their other corners and their volume.

In 3-D a pass in single precision (:mod:`..numerics.cell.inspection`) leaves doubtful cells undecided. These are
measured here in double precision and judged by the proof.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple, cast

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..numerics.cell import inspection as rows
from ..numerics.cell.measures import COLLAPSED, CellMeasures, decide, measure_cells
from ..parallel import Nodes
from .cells import Slab, block_volumes, cells_alike, corners_of, for_slabs, hold_cells, places, slabs
from .original import Original

_TOGETHER = 1 << 13
"""Cells measured at a time in double precision, which keeps them in the cache."""
HISTOGRAM_BINS = 20
INVERSE, SKEW, VOLUME, NEGATIVE, BAD, INHERITED, HISTOGRAM = 0, 1, 2, 3, 4, 5, 6
TOTALS = HISTOGRAM + HISTOGRAM_BINS
"""Totals of cells: sums of 1 / f_skew, of f_skew and, in 2-D, of areas; numbers of cells with negative volume, with a
corner Jacobian <= 0, and of those that had one before, too, and failed no test; from ``HISTOGRAM`` on, histogram of
f_skew."""


class Failure(IntEnum):
    """Why a cell is invalid.

    ``CORNER``: a corner Jacobian that was positive is no longer, or is below the smallest share allowed; ``INSIDE``:
    the Jacobian is negative between positive corners, or could not be proved positive; ``VOLUME``: only the volume is
    negative.
    """

    NONE = 0
    CORNER = 1
    INSIDE = 2
    VOLUME = 3

    @property
    def label(self) -> str:
        return self.name.lower()


class SlabMeasures(NamedTuple):
    """Arrays (n,) of a slab of n cells, in 3-D float32, unless said otherwise; ordered as in :mod:`.cell.inspection`.

    Those of a 3-D grid are views of a per-thread buffer, overwritten by the next call in the same thread.

    Attributes
    ----------
    skew, scaled : f_skew and smallest scaled corner Jacobian, deformed
    ratio : smallest corner Jacobian relative to the undeformed one, infinite where that has no sound corner
    change : volume relative to the undeformed one, NaN where that has none
    failed : int8, :class:`Failure`
    totals : (TOTALS,)
    """

    skew: FloatArray
    scaled: FloatArray
    ratio: FloatArray
    change: FloatArray
    failed: np.ndarray
    totals: FloatArray


_memory = threading.local()


def inspect_slab(original: Original, after: FloatArray, slab: Slab) -> SlabMeasures:
    """Measures of one slab with coordinates ``after`` (n_nodes, 3)."""
    grid, count, kinds, totals = original.grid, slab.stop - slab.start, rows.OPEN, np.zeros(TOTALS)
    if grid.dimension == 2:
        out, is_open = np.empty((kinds, count)), np.ones(count, dtype=bool)
    else:
        # Reused by all slabs of a thread.
        if getattr(_memory, "size", 0) < count:
            _memory.size, _memory.out, _memory.open = count, np.empty(kinds * count, np.float32), np.empty(count, bool)
        out, is_open = _memory.out[: kinds * count].reshape(kinds, count), _memory.open[:count]
        before, x = (grid.block(slab.block, Nodes.of(points).rows) for points in (grid.points, after))
        shape, sign = (slab.last - slab.first, *grid.cell_shapes[slab.block][1:]), original.topology.handedness
        # The reciprocal of a cell size, correct to within some orders of magnitude.
        part = before[np.ix_([slab.first, slab.last], [0, -1], [0, before.shape[2] // 2])].reshape(-1, 3)
        size = float(np.abs(part - part.mean(axis=0)).max()) / max(before.shape[1:3])
        scale = 2.0 ** -round(np.log2(size)) if 0.0 < size < np.inf else 1.0
        rows.inspect_hexahedra(
            before, x, after is not grid.points, float(sign[slab.block]), scale, slab.first, slab.last,
            out.reshape(kinds, *shape), is_open.reshape(shape), totals, rows.Scratch.new(),
        )  # fmt: skip
    figures = SlabMeasures._make([*out, np.zeros(count, np.int8), totals])
    left = np.flatnonzero(is_open)
    for lo in range(0, left.size, _TOGETHER):
        _measure_open(original, after, slab, left[lo : lo + _TOGETHER], figures)
    if original.min_jacobian > 0.0:
        near = np.abs(figures.ratio - original.min_jacobian) <= 1e-3 * original.min_jacobian
        cells = slab.start + np.flatnonzero(near & ~is_open)
        figures.ratio[cells - slab.start] = relative_jacobian(*(
            measure_cells(corners_of(grid, Nodes.of(points).rows, cells), original.sides(slab.block)).jacobian
            for points in (grid.points, after)
        ))  # fmt: skip
    figures.failed[_low(original, figures.ratio)] = Failure.CORNER
    return figures


def _low(original: Original, ratio: FloatArray) -> BoolArray:
    """Which smallest relative Jacobians (n,) make a cell invalid."""
    return np.asarray((ratio <= 0.0) | (ratio < original.min_jacobian))


def _measure_open(original: Original, after: FloatArray, slab: Slab, cells: IntArray, f: SlabMeasures) -> None:
    """Measure and judge ``cells`` of a slab, numbered from its first one, in double precision."""
    grid, side = original.grid, original.sides(slab.block)
    x0, x = (corners_of(grid, Nodes.of(points).rows, slab.start + cells) for points in (grid.points, after))
    old, new = measure_cells(x0, side), measure_cells(x, side)
    for values, exact in zip(f, _in_double(old, new), strict=False):
        values[cells] = exact
    if grid.dimension == 3:
        reason = decide(x0, x, np.full(cells.size, side))
        f.failed[cells] = np.array([Failure.NONE, Failure.INSIDE, Failure.VOLUME])[reason]
    bad, was_bad = (np.asarray((each.jacobian <= 0).any(axis=1)) for each in (new, old))
    kept = (f.failed[cells] == 0) & ~_low(original, f.ratio[cells])
    with np.errstate(divide="ignore"):
        inverse = (1.0 / new.skew).sum()
    sums = new.volume.sum(), (new.volume <= 0).sum(), bad.sum(), (bad & was_bad & kept).sum()
    bins = np.minimum((new.skew.astype(np.float32) * HISTOGRAM_BINS).astype(np.uint8), HISTOGRAM_BINS - 1)
    f.totals[:] += [inverse, new.skew.sum(), *sums, *np.bincount(bins, minlength=HISTOGRAM_BINS)]


def _in_double(old: CellMeasures, new: CellMeasures) -> tuple[FloatArray, ...]:
    """The first arrays of :class:`SlabMeasures`, in its order, from measures in double precision."""
    change = np.divide(new.volume, old.volume, out=np.full(old.volume.size, np.nan), where=old.volume > 0)
    return new.skew, new.scaled, relative_jacobian(old.jacobian, new.jacobian), change


def relative_jacobian(old: FloatArray, new: FloatArray) -> FloatArray:
    """Smallest of the corner Jacobians ``new`` (m, c) relative to ``old``, collapsed corners aside."""
    sound = old > COLLAPSED * old.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.where(sound, new / np.where(sound, old, 1.0), np.inf).min(axis=1))


@dataclass(frozen=True)
class Verdict:
    """The verdict on all cells, numbered block after block, C-ordered within each block.

    ``failed`` (n_cells,) int8, :class:`Failure`; ``ratio`` (n_cells,) float32, smallest corner Jacobian relative to the
    undeformed one, infinite where the undeformed cell has no sound corner; in parts if the grid is.
    """

    failed: np.ndarray
    ratio: np.ndarray

    def put(self, slab: Slab, figures: SlabMeasures) -> None:
        """Record one slab."""
        for values, found in zip((self.failed, self.ratio), (figures.failed, figures.ratio), strict=True):
            Nodes.of(values).rows[slab.cells] = found

    @property
    def invalid(self) -> IntArray:
        """Numbers of the cells that failed a test."""
        failed = Nodes.of(self.failed)
        return np.concatenate(failed.gather(failed.ends[0] + np.flatnonzero(failed.own)))

    def weak(self, limit: float) -> IntArray:
        """Numbers of this rank's cells that failed a test or whose ``ratio`` is below a limit."""
        failed, ratio = Nodes.of(self.failed), Nodes.of(self.ratio)
        return np.asarray(failed.low + np.flatnonzero((failed.own != 0) | (ratio.own < limit)))

    @property
    def valid(self) -> bool:
        return not len(self.invalid)

    @property
    def smallest_ratio(self) -> float:
        """The smallest ``ratio``."""
        ratio = Nodes.of(self.ratio)
        return min(ratio.gather(float(ratio.own.min(initial=np.inf))))


def judge(original: Original, after: FloatArray) -> Verdict:
    """Judge coordinates ``after`` (n_nodes, 3)."""
    grid = original.grid
    verdict = Verdict(cells_alike(grid, np.int8), cells_alike(grid, np.float32))
    hold_cells(grid, grid.points, after)
    for_slabs(grid, lambda _, slab: verdict.put(slab, inspect_slab(original, after, slab)))
    return verdict


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


EXTREMES = {
    "f_skew": (rows.SKEW, np.argmin, False),
    "min_scaled_jacobian": (rows.SCALED, np.argmin, False),
    "min_relative_jacobian": (rows.RATIO, np.argmin, True),
    "volume_ratio_min": (rows.CHANGE, np.argmin, True),
    "volume_ratio_max": (rows.CHANGE, np.argmax, True),
}
"""Cells that a report names: the measure, its worst value, and whether it compares with undeformed cells."""


def _extreme(values: FloatArray, find: Callable[[FloatArray], Any]) -> int:
    """The place of the smallest or largest of values (n,), those that are not finite aside."""
    if not np.isfinite(values.sum()):
        values = np.where(np.isfinite(values), values, np.inf if find is np.argmin else -np.inf)
    return int(find(values))


class Comparison:
    """The cells with coordinates ``points`` (n_nodes, 3), measured, with the verdict on them.

    Attributes
    ----------
    extremes : the cell of each name of :data:`EXTREMES`, with its value
    volume_ratio : smallest and largest volume relative to the undeformed one, 1 if no cell had a volume
    negative, bad, inherited : numbers of cells with a negative volume, with a corner Jacobian that is not positive, and
        of those that were bad in the undeformed grid, too, and are no worse
    skew : distribution of f_skew
    volume : of all cells, in 2-D the area
    """

    def __init__(self, original: Original, points: FloatArray):
        grid, n_slabs = original.grid, len(slabs(original.grid))
        self.verdict = Verdict(cells_alike(grid, np.int8), cells_alike(grid, np.float32))
        totals, cells = np.empty((n_slabs, TOTALS)), np.empty((n_slabs, len(EXTREMES)), dtype=np.int64)
        # Single precision is enough for the quantile.
        skew = cells_alike(grid, np.float32)

        def put(number: int, slab: Slab) -> None:
            found = inspect_slab(original, points, slab)
            self.verdict.put(slab, found)
            Nodes.of(skew).rows[slab.cells], totals[number] = found.skew, found.totals
            cells[number] = [slab.start + _extreme(found[row], find) for row, find, _ in EXTREMES.values()]

        hold_cells(grid, grid.points, points)
        for_slabs(grid, put, [totals, cells])
        # The quantile: the k-th smallest of all ranks is among the k smallest of each.
        own, k = Nodes.of(skew).own, -(-grid.n_cells // 100)
        if own.size > k:
            own.partition(k - 1)
        self.p01 = float(np.sort(np.concatenate(grid.nodes.ranks.gather([own[:k]])))[k - 1])
        # The extremes, again in double precision.
        chosen = cells.ravel()
        side = original.sides(places(grid, chosen)[0])
        old, new = (measure_cells(corners_of(grid, each, chosen), side) for each in (grid.points, points))
        self.extremes, exact = dict[str, tuple[int, float]](), _in_double(old, new)
        for kind, (name, (row, find, _)) in enumerate(EXTREMES.items()):
            values = exact[row].reshape(cells.shape)[:, kind]
            slab = _extreme(values, find)
            self.extremes[name] = int(cells[slab, kind]), float(values[slab])
        low, high = (self.extremes[f"volume_ratio_{end}"][1] for end in ("min", "max"))
        self.volume_ratio = Range(low, high) if low <= high else Range(1.0, 1.0)
        sums = [column.sum() for column in totals.T]
        self.negative, self.bad, self.inherited = (int(sums[kind]) for kind in (NEGATIVE, BAD, INHERITED))
        harmonic = grid.n_cells / float(sums[INVERSE]) if np.isfinite(sums[INVERSE]) else 0.0
        counts = tuple(int(count) for count in sums[HISTOGRAM:])
        self.skew = Skew(harmonic, float(sums[SKEW]) / grid.n_cells, self.extremes["f_skew"][1], self.p01, counts)
        self.volume = float(sums[VOLUME])
        if grid.dimension == 3:
            self.volume = sum(block_volumes(grid, points, original.topology.handedness).tolist())
        if points is grid.points:
            original.measured = self


def measured(original: Original) -> Comparison:
    """The cells of the undeformed grid, measured once."""
    return cast("Comparison", original.measured or Comparison(original, original.grid.points))
