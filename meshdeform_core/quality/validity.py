"""The verdict: which cells were valid and no longer are.

A cell is sound if its Jacobian is positive everywhere. In 2-D the corners decide; in 3-D the corners and a proof for
the interior (:mod:`..numerics.cell.positivity`). Corners collapsed in the undeformed grid have no sign and are not
judged; cells whose undeformed Jacobian is negative somewhere are judged by their other corners and their volume.

In 3-D a pass in single precision (:mod:`..numerics.cell.inspection`) leaves doubtful cells undecided. These are
measured here in double precision and judged by the proof.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..numerics.cell import inspection as rows
from ..numerics.cell.measures import measure_cells
from ..numerics.cell.positivity import COLLAPSED, decide
from ..parallel import Nodes
from .cells import Slab, cells_alike, corners_of, for_slabs, hold_cells
from .original import Original

_TOGETHER = 1 << 13
"""Cells measured at a time in double precision, which keeps them in the cache."""
HISTOGRAM_BINS = 20
INVERSE, SKEW, VOLUME, NEGATIVE, BAD, HISTOGRAM = 0, 1, 2, 3, 4, 5
TOTALS = HISTOGRAM + HISTOGRAM_BINS
"""Totals of cells: sums of 1 / f_skew, of f_skew and, in 2-D, of areas; numbers of cells with negative volume and with
a corner Jacobian <= 0; from ``HISTOGRAM`` on, histogram of f_skew."""


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


@dataclass
class SlabMeasures:
    """Measures of a slab of n cells: arrays (n,), in 3-D float32, unless said otherwise.

    Those of a 3-D grid are views of a per-thread buffer, overwritten by the next call in the same thread.

    Attributes
    ----------
    skew, scaled : f_skew and smallest scaled corner Jacobian, deformed
    ratio : smallest corner Jacobian relative to the undeformed one, infinite where that has no sound corner
    change : volume relative to the undeformed one, NaN where that has none
    skew_before, scaled_before : of the undeformed cells, only on request
    after, before : (TOTALS,); ``before`` only on request
    failed : int8, :class:`Failure`
    inherited : cells with a bad corner before and after that failed no test
    """

    skew: FloatArray
    scaled: FloatArray
    ratio: FloatArray
    change: FloatArray
    skew_before: FloatArray
    scaled_before: FloatArray
    after: FloatArray
    before: FloatArray
    failed: np.ndarray
    inherited: int = 0


_memory = threading.local()


def _scratch(cells: int) -> tuple[FloatArray, BoolArray]:
    """Arrays for the results of a slab, reused by all slabs of a thread."""
    if getattr(_memory, "size", 0) < cells:
        _memory.size, _memory.out, _memory.open = cells, np.empty(6 * cells, np.float32), np.empty(cells, dtype=bool)
    return _memory.out[: 6 * cells].reshape(6, cells), _memory.open[:cells]


def inspect_slab(original: Original, after: FloatArray, slab: Slab, both: bool) -> SlabMeasures:
    """Measures of one slab with coordinates ``after`` (n_nodes, 3); with ``both``, of the undeformed cells, too."""
    grid, count, totals = original.grid, slab.stop - slab.start, np.zeros((2, TOTALS))
    if grid.dimension == 2:
        out, is_open = np.empty((6, count)), np.ones(count, dtype=bool)
    else:
        out, is_open = _scratch(count)
        before, x = (grid.block(slab.block, Nodes.of(points).rows) for points in (grid.points, after))
        shape = (slab.last - slab.first, *grid.cell_shapes[slab.block][1:])
        rows.inspect_hexahedra(
            before, x, after is not grid.points, both, float(original.topology.handedness[slab.block]),
            _scale(before, slab), slab.first, slab.last, out.reshape(6, *shape), is_open.reshape(shape), totals,
            rows.Scratch.new(),
        )  # fmt: skip
    figures = SlabMeasures(*[*out, *totals, np.zeros(count, np.int8)])
    left = np.flatnonzero(is_open)
    for lo in range(0, left.size, _TOGETHER):
        _measure_open(original, after, slab, left[lo : lo + _TOGETHER], figures, both)
    if original.min_jacobian > 0.0:
        near = np.abs(figures.ratio - original.min_jacobian) <= 1e-3 * original.min_jacobian
        cells = slab.start + np.flatnonzero(near & ~is_open)
        figures.ratio[cells - slab.start] = relative_jacobian(*(
            measure_cells(corners_of(grid, Nodes.of(points).rows, cells), original.sides(slab.block)).jacobian
            for points in (grid.points, after)
        ))  # fmt: skip
    low = (figures.ratio <= 0.0) | (figures.ratio < original.min_jacobian)
    figures.failed[low] = Failure.CORNER
    return figures


def _scale(x: FloatArray, slab: Slab) -> float:
    """The reciprocal of a cell size, correct to within some orders of magnitude."""
    part = x[np.ix_([slab.first, slab.last], [0, -1], [0, x.shape[2] // 2])].reshape(-1, 3)
    size = float(np.abs(part - part.mean(axis=0)).max()) / max(x.shape[1:3])
    return 2.0 ** -round(np.log2(size)) if 0.0 < size < np.inf else 1.0


def _measure_open(
    original: Original, after: FloatArray, slab: Slab, cells: IntArray, f: SlabMeasures, both: bool
) -> None:
    """Measure and judge ``cells`` of a slab, numbered from its first one, in double precision."""
    grid, side = original.grid, original.sides(slab.block)
    x0, x = (corners_of(grid, Nodes.of(points).rows, slab.start + cells) for points in (grid.points, after))
    old, new = measure_cells(x0, side), measure_cells(x, side)
    f.skew[cells], f.scaled[cells], f.ratio[cells] = new.skew, new.scaled, relative_jacobian(old.jacobian, new.jacobian)
    f.change[cells] = np.divide(new.volume, old.volume, out=np.full(cells.size, np.nan), where=old.volume > 0)
    if grid.dimension == 3:
        reason = decide(x0, x, np.full(cells.size, side))
        f.failed[cells] = np.array([Failure.NONE, Failure.INSIDE, Failure.VOLUME])[reason]
    bad, was_bad = (np.asarray((each.jacobian <= 0).any(axis=1)) for each in (new, old))
    kept = (f.failed[cells] == 0) & ~((f.ratio[cells] <= 0.0) | (f.ratio[cells] < original.min_jacobian))
    f.inherited += int((bad & was_bad & kept).sum())
    f.after += _totals(new.skew, new.volume, bad)
    if both:
        f.skew_before[cells], f.scaled_before[cells] = old.skew, old.scaled
        f.before += _totals(old.skew, old.volume, was_bad)


def _totals(skew: FloatArray, volume: FloatArray, bad: BoolArray) -> FloatArray:
    """Totals (TOTALS,) of cells (m,)."""
    with np.errstate(divide="ignore"):
        inverse = (1.0 / skew).sum()
    bins = np.minimum((skew.astype(np.float32) * HISTOGRAM_BINS).astype(np.uint8), HISTOGRAM_BINS - 1)
    counts = np.bincount(bins, minlength=HISTOGRAM_BINS)
    return np.array([inverse, skew.sum(), volume.sum(), (volume <= 0).sum(), bad.sum(), *counts])


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
