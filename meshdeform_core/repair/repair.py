"""Nodes around invalid cells are moved until every cell is sound; the boundary stays where it is."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, IntArray
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.cell.foldover import measure_samples
from ..numerics.systems.newton import NewtonSystem
from ..parallel import alone, current_ranks, empty, for_rows
from ..quality import Original
from ..quality.validity import Verdict, judge
from .neighbourhood import Neighbourhood, Plot
from .untangle import Region, Untangler

WEAK = 0.2
"""Cells with a corner below this share of its undeformed Jacobian are the middle of what a repair moves."""
COLLAPSING = 0.01
"""Valid cells below this share are nearly collapsed: they are repaired too, and what stays is a warning."""
_LAYERS = (8, 32, 1 << 30)
_STEPS, _IMPROVING = 40, 16
_ROUNDS = 2
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6
# More layers are tried while the largest density is above this; of valid grids, if the first ones lower it by a tenth.
_ENOUGH, _GAIN = 6.0, 0.9
# Regions of more nodes than this are not improved beyond validity: of the largest grids that would take minutes.
_LARGE = 300_000
_CORNERS = (1 << 8) - 1

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Repair:
    """What repairs did.

    ``cells`` that were invalid or nearly collapsed before, ``nodes`` moved and how far at most (grid length unit),
    Newton steps, seconds.
    """

    cells: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float

    def __add__(self, other: Repair) -> Repair:
        return Repair(
            self.cells + other.cells,
            max(self.nodes, other.nodes),
            max(self.max_movement, other.max_movement),
            self.newton_steps + other.newton_steps,
            self.seconds + other.seconds,
        )


@dataclass(frozen=True)
class Outcome:
    """Coordinates (n_nodes, 3) after a repair, their verdict, and what was done."""

    points: FloatArray
    verdict: Verdict
    repair: Repair


class Repairer:
    """Repairs of deformed states of one grid.

    Parameters
    ----------
    rounded : coordinates as they will be written; the verdict is about those
    memory : what a repair may take
    """

    def __init__(
        self,
        original: Original,
        boundary: Boundary,
        rounded: Callable[[FloatArray], FloatArray] = lambda points: points,
        memory: MemoryLimit = UNLIMITED,
        progress: Progress | None = None,
    ):
        self.original, self.boundary, self.rounded = original, boundary, rounded
        self.memory, self.progress = memory, progress

    @cached_property
    def _neighbourhood(self) -> Neighbourhood:
        return Neighbourhood(self.original.grid, self.original.topology, self.boundary)

    def needed(self, verdict: Verdict) -> bool:
        """Are there cells that are invalid or nearly collapsed?"""
        return bool(verdict.failed.any() or (verdict.ratio < COLLAPSING).any())

    def repair(self, points: FloatArray, verdict: Verdict, polish: bool = False) -> Outcome:
        """Make cells sound; the coordinates returned may still have invalid ones, but not more than ``points``.

        Of the nodes around weak cells, first those within 8 layers move, then more, until all cells are sound and the
        worst one is no longer far from its undeformed shape, or until more nodes do not help. With ``polish`` the
        weakest cells are taken for weak however good they are.
        """
        best = start = _State(points, verdict)
        begin, steps, density = clock.perf_counter(), 0, np.inf
        now, weak = start, WEAK
        if polish:
            weak = max(WEAK, min(1.0, 2.0 * float(verdict.ratio.min())))
        for layers in _LAYERS:
            for _ in range(_ROUNDS):
                found = self._attempt(now, layers, weak)
                if found is None:
                    break
                steps += found.steps
                now = self._moved(now, found)
                if now.verdict.valid or not found.untangled:
                    break
            if found is None:
                break
            if start.verdict.valid and found.density > _GAIN * found.before:
                # Weak cells that are not to be helped.
                break
            if now.count < best.count or (now.count == best.count and found.density < density):
                best, density = now, found.density
            if now.verdict.valid and density < _ENOUGH:
                break
        return Outcome(best.points, best.verdict, self._record(start, best, steps, clock.perf_counter() - begin))

    def _attempt(self, now: _State, layers: int, limit: float) -> _Attempt | None:
        """Move the nodes within so many layers of weak cells; ``None`` where there are none, or too many."""
        weak = np.flatnonzero((now.verdict.failed != 0) | (now.verdict.ratio < limit))

        def make() -> _Attempt | None:
            with alone():
                free = self._neighbourhood.around(weak, layers)
                if not free.size or NewtonSystem.memory(free.size) > self.memory.size:
                    return None
                if now.verdict.valid and free.size > _LARGE:
                    return None
                return self._solve(self._neighbourhood.plot(free), now.points)

        return current_ranks().once(make)

    def _solve(self, plot: Plot, points: FloatArray) -> _Attempt:
        start = points[plot.nodes]
        weak_first(plot.region, start)
        untangler = Untangler(plot.region, start, progress=self.progress)
        before = untangler.state(start, 0.0).highest
        untangled = untangler.untangle(max(_FEWEST, min(_STEPS, _WORK // plot.region.n_unknowns)))
        density = untangler.improve(_IMPROVING) if untangled and plot.region.n_unknowns < _LARGE else np.inf
        shift = (untangler.x - start)[plot.at]
        return _Attempt(plot.moved, shift, untangled, before, density, untangler.steps)

    def _moved(self, now: _State, found: _Attempt) -> _State:
        points: FloatArray = empty(now.points.shape)
        for_rows(lambda rows: np.copyto(points[rows], now.points[rows]), points)

        def put() -> None:
            points[found.moved] += found.shift

        current_ranks().alter(points, put)
        return _State(points, judge(self.original, self.rounded(points)))

    def _record(self, start: _State, end: _State, steps: int, seconds: float) -> Repair:
        moved = (end.points - start.points).reshape(-1, 3)
        distance = np.sqrt((moved**2).sum(axis=1))
        bad = (start.verdict.failed != 0) | (start.verdict.ratio < COLLAPSING)
        return Repair(int(bad.sum()), int((distance > 0).sum()), float(distance.max()), steps, seconds)


@dataclass(frozen=True)
class _State:
    points: FloatArray
    verdict: Verdict

    @property
    def count(self) -> int:
        """Invalid cells."""
        return int(np.count_nonzero(self.verdict.failed))


@dataclass(frozen=True)
class _Attempt:
    """Block nodes ``moved`` (k,) with their ``shift`` (k, 3); whether no sample is inverted any more; the largest
    density before, infinite where one was, and after."""

    moved: IntArray
    shift: FloatArray
    untangled: bool
    before: float
    density: float
    steps: int


def weak_first(region: Region, x: FloatArray) -> None:
    """Take all samples of weak hexahedra, and only the corners of the others."""
    sound = region.mask
    if region.cells.shape[1] == 8:
        region.mask = sound & _CORNERS
        lowest, _ = measure_samples(x, *region.energy)
        weak = lowest < WEAK
        region.mask[weak] = sound[weak]
