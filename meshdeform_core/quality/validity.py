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
from ..numerics.cell.measures import scattered_hexahedra
from ..numerics.cell.positivity import COLLAPSED, decide, judge_quads
from ..parallel import Nodes
from .cells import Slab, cells_alike, corners_of, for_slabs, hold_cells, measure_block, side_of_good_quads
from .original import Original
from .tally import HISTOGRAM_BINS, Sums


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
    """Measures of a slab of n cells: arrays (n,) float32 unless said otherwise.

    The arrays are views of a per-thread buffer, overwritten by the next call in the same thread.

    Attributes
    ----------
    skew, scaled : f_skew and smallest scaled corner Jacobian, deformed
    ratio : smallest corner Jacobian relative to the undeformed one, infinite where that has no sound corner
    change : volume relative to the undeformed one, NaN where that has none
    failed : int8, :class:`Failure`
    after, before : sums; ``before`` only on request
    inherited : cells with a bad corner before and after that failed no test
    skew_before, scaled_before : of the undeformed cells, only on request
    """

    skew: FloatArray
    scaled: FloatArray
    ratio: FloatArray
    change: FloatArray
    failed: np.ndarray
    after: Sums
    before: Sums
    inherited: int = 0
    skew_before: FloatArray | None = None
    scaled_before: FloatArray | None = None


def inspect_slab(original: Original, after: FloatArray, slab: Slab, both: bool) -> SlabMeasures:
    """Measures of one slab with coordinates ``after`` (n_nodes, 3); with ``both``, of the undeformed cells, too."""
    figures = (_quads if original.grid.dimension == 2 else _hexahedra)(original, after, slab, both)
    low = (figures.ratio <= 0.0) | (figures.ratio < original.min_jacobian)
    figures.failed[low] = Failure.CORNER
    return figures


_memory = threading.local()


def _scratch(cells: int) -> tuple[FloatArray, BoolArray]:
    """Arrays for the results of a slab, reused by all slabs of a thread."""
    if getattr(_memory, "size", 0) < cells:
        _memory.size, _memory.out, _memory.open = cells, np.empty(6 * cells, np.float32), np.empty(cells, dtype=bool)
    return _memory.out[: 6 * cells].reshape(6, cells), _memory.open[:cells]


def _hexahedra(original: Original, after: FloatArray, slab: Slab, both: bool) -> SlabMeasures:
    grid, sign = original.grid, float(original.topology.handedness[slab.block])
    before, x = (grid.block(slab.block, Nodes.of(points).rows) for points in (grid.points, after))
    shape = (slab.last - slab.first, *grid.cell_shapes[slab.block][1:])
    out, is_open = _scratch(slab.stop - slab.start)
    sums, counts = np.zeros((2, 2)), np.zeros((2, HISTOGRAM_BINS), dtype=np.int64)
    compare = after is not grid.points
    rows.inspect_hexahedra(
        before, x, compare, both, sign, _scale(before, slab), slab.first, slab.last,
        out.reshape(6, *shape), is_open.reshape(shape), sums, counts,
    )  # fmt: skip
    figures = SlabMeasures(
        out[rows.SKEW], out[rows.SCALED], out[rows.RATIO], out[rows.CHANGE], np.zeros(len(is_open), np.int8),
        Sums(float(sums[0, 0]), float(sums[0, 1]), counts[0]), Sums(float(sums[1, 0]), float(sums[1, 1]), counts[1]),
        skew_before=out[rows.SKEW_BEFORE] if both else None, scaled_before=out[rows.SCALED_BEFORE] if both else None,
    )  # fmt: skip
    _look_again(original, after, slab, np.flatnonzero(is_open), figures)
    if original.min_jacobian > 0.0:
        near = np.abs(figures.ratio - original.min_jacobian) <= 1e-3 * original.min_jacobian
        cells = np.flatnonzero(near & ~is_open)
        signs = np.full(cells.size, sign)
        old, new = (scattered_hexahedra(c, signs)[2] for c in _corners(original, after, slab, cells))
        figures.ratio[cells] = relative_jacobian(old, new)
    return figures


def _scale(x: FloatArray, slab: Slab) -> float:
    """The reciprocal of a cell size, correct to within some orders of magnitude."""
    part = x[np.ix_([slab.first, slab.last], [0, -1], [0, x.shape[2] // 2])].reshape(-1, 3)
    size = float(np.abs(part - part.mean(axis=0)).max()) / max(x.shape[1:3])
    return 2.0 ** -round(np.log2(size)) if 0.0 < size < np.inf else 1.0


def _corners(original: Original, after: FloatArray, slab: Slab, cells: IntArray) -> tuple[FloatArray, FloatArray]:
    """Corners (m, 8, 3) before and after of ``cells`` of a slab, numbered from its first one."""
    number = slab.start + cells
    one, two = (corners_of(original.grid, Nodes.of(points).rows, number) for points in (original.grid.points, after))
    return one, two


def _look_again(original: Original, after: FloatArray, slab: Slab, cells: IntArray, f: SlabMeasures) -> None:
    """Measure and judge ``cells`` of a slab in double precision."""
    if cells.size == 0:
        return
    sign = np.full(cells.size, float(original.topology.handedness[slab.block]))
    old, new = _corners(original, after, slab, cells)
    skew, scaled, jacobian, volume = scattered_hexahedra(new, sign)
    old_skew, old_scaled, old_jacobian, old_volume = scattered_hexahedra(old, sign)
    f.skew[cells], f.scaled[cells], f.ratio[cells] = skew, scaled, relative_jacobian(old_jacobian, jacobian)
    solid = old_volume > 0
    f.change[cells] = np.where(solid, volume / np.where(solid, old_volume, 1.0), np.nan)
    failed = decide(old, new, sign)
    f.failed[cells] = np.array([Failure.NONE, Failure.INSIDE, Failure.VOLUME])[failed]
    bad: BoolArray = np.asarray((jacobian <= 0).any(axis=1))
    old_bad: BoolArray = np.asarray((old_jacobian <= 0).any(axis=1))
    f.after.add(skew, volume, bad)
    sound = (failed == 0) & ~((f.ratio[cells] <= 0.0) | (f.ratio[cells] < original.min_jacobian))
    f.inherited = int((bad & old_bad & sound).sum())
    if f.skew_before is not None and f.scaled_before is not None:
        f.skew_before[cells], f.scaled_before[cells] = old_skew, old_scaled
        f.before.add(old_skew, old_volume, old_bad)


def relative_jacobian(old: FloatArray, new: FloatArray) -> FloatArray:
    """Smallest of the corner Jacobians ``new`` (m, 8) relative to ``old``, collapsed corners aside."""
    sound = old > COLLAPSED * old.max(axis=1, keepdims=True, initial=0.0)
    return np.asarray(np.where(sound, new / np.where(sound, old, 1.0), np.inf).min(axis=1))


def _quads(original: Original, after: FloatArray, slab: Slab, both: bool) -> SlabMeasures:
    grid, sign = original.grid, float(original.topology.handedness[slab.block])
    normal = original.normal
    assert normal is not None
    blocks = [grid.block(slab.block, Nodes.of(points).rows) for points in (grid.points, after)]
    old, new = (measure_block(b, sign, normal, slab.first, slab.last) for b in blocks)
    flat = blocks[0].shape.index(1)
    planes = [np.ascontiguousarray(b.squeeze(axis=flat)) for b in blocks]
    lines = (0, planes[0].shape[0] - 1) if flat == 0 else (slab.first, slab.last)
    ratio: FloatArray = np.empty(new.skew.shape, np.float32)
    judge_quads(planes[0], planes[1], side_of_good_quads(flat, sign, normal), *lines, ratio.squeeze(axis=flat))
    solid = old.volume > 0
    change = np.where(solid, new.volume / np.where(solid, old.volume, 1.0), np.nan).ravel()
    failed = np.zeros(ratio.size, np.int8)
    after_sums, before_sums = (Sums.of(m.skew.ravel(), m.volume.ravel(), m.bad.ravel() != 0) for m in (new, old))
    sound = (ratio > 0.0) & (ratio >= original.min_jacobian)
    inherited = int(((old.bad != 0) & (new.bad != 0) & sound).sum())
    found = SlabMeasures(
        new.skew.ravel(), new.scaled.ravel(), ratio.ravel(), change, failed, after_sums, before_sums, inherited
    )
    if both:
        found.skew_before, found.scaled_before = old.skew.ravel(), old.scaled.ravel()
    return found


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
