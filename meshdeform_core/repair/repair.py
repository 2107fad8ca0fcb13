"""Nodes around invalid cells are moved until every cell is sound; the boundary stays where it is."""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..boundary import Boundary
from ..grid import BoolArray, FloatArray, IntArray
from ..memory import UNLIMITED, MemoryLimit
from ..parallel import alone, current_ranks, empty, for_rows
from ..quality import Original
from ..quality.comparison import Comparison
from ..quality.validity import Verdict, judge
from .constraints import Constraints
from .extrusion import Extrusion, find_extrusion
from .neighbourhood import Neighbourhood, Plot
from .newton import NewtonSystem
from .region import Hexahedra, Penalty
from .time_limit import TimeLimit
from .untangle import Pace, Untangler
from .weakness import POOR, is_sounder, is_weak, skewed

WEAK = 0.35
"""Cells with a corner below this share of its undeformed Jacobian are the middle of what a repair moves."""
COLLAPSING = 0.01
"""Valid cells below this share are nearly collapsed: a warning."""
_LAYERS: dict[int, tuple[int | None, ...]] = {2: (32, None), 3: (8, 32, None)}
# A regularisation that begins large and falls slowly finds valid grids where a quick one is caught.
_QUICK, _PATIENT = Pace(60, 2.0, 0.2), Pace(200, 50.0, 0.1)
# Where no valid grid exists, most cells that can become valid do so early.
_HASTY = Pace(30, 2.0, 0.3)
_IMPROVING = 60
_ROUNDS, _LAST_ROUNDS = 2, 6
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6
# More layers are tried while the largest density is above this; for valid grids, if the first ones lower it by a tenth.
_ENOUGH, _GAIN = 2.9, 0.9
# Regions of more nodes than this are not improved beyond validity: on the largest grids that would take minutes.
_LARGE = 300_000


class Way(NamedTuple):
    """How cells are untangled: ``patient`` or quickly; ``even``: cells at walls count like all others; ``hasty``: only
    around weak cells, and no improvement follows."""

    patient: bool = False
    even: bool = False
    hasty: bool = False

    @property
    def pace(self) -> Pace:
        """Of the Newton steps."""
        return _PATIENT if self.patient else _HASTY if self.hasty else _QUICK


QUICKLY, PATIENTLY, HASTILY = (Way(),), (Way(patient=True), Way(patient=True, even=True)), (Way(hasty=True),)
EVERY_WAY = QUICKLY + PATIENTLY

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True)
class Repair:
    """Summary of repairs.

    ``cells`` that were invalid or weak before, ``nodes`` moved and how far at most (grid length unit),
    Newton steps, seconds.
    """

    cells: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float

    @classmethod
    def carried(cls, correction: FloatArray) -> Repair:
        """Of a displacement (n_nodes, 3) that an earlier repair has found and that is enough."""
        distance = np.sqrt((correction**2).sum(axis=1))
        return cls(0, int((distance > 0).sum()), float(distance.max()), 0, 0.0)

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
    memory, limit : of a repair, the latter of all repairs together
    """

    def __init__(
        self,
        original: Original,
        boundary: Boundary | Constraints,
        rounded: Callable[[FloatArray], FloatArray] = lambda points: points,
        memory: MemoryLimit = UNLIMITED,
        progress: Progress | None = None,
        limit: TimeLimit | None = None,
    ):
        self.original, self.rounded = original, rounded
        self.memory, self.progress, self.limit = memory, progress, limit or TimeLimit()
        self._boundary = boundary

    @cached_property
    def _constraints(self) -> Constraints:
        if isinstance(self._boundary, Constraints):
            return self._boundary
        return Constraints.of(self.original.grid, self.original.topology, self._boundary)

    @cached_property
    def _neighbourhood(self) -> Neighbourhood:
        return Neighbourhood(self._constraints)

    @cached_property
    def _extrusion(self) -> tuple[Extrusion, Repairer] | None:
        """The plane grid that this one is extruded from, and its repairs."""
        found = find_extrusion(self._constraints)
        if found is None:
            return None
        original = Original(found.plane, found.constraints.topology, self.original.min_jacobian)
        return found, Repairer(original, found.constraints, self.rounded, self.memory, self.progress, self.limit)

    def needed(self, verdict: Verdict, cells: Comparison | None = None) -> bool:
        """Are there cells that are invalid or weak? ``cells`` are those measured already, if any."""
        return is_weak(self.original, verdict, cells)

    def repair(
        self, points: FloatArray, verdict: Verdict, polish: bool = False, ways: tuple[Way, ...] = EVERY_WAY
    ) -> Outcome:
        """Make cells sound; the coordinates returned may still have invalid ones, but not more than ``points``.

        Of the nodes around weak cells, first those within some layers move, then more, until all cells are sound and
        the worst one is no longer far from its undeformed shape, or until more nodes do not help. With ``polish`` the
        weakest cells count as weak however good they are. The ``ways`` are tried in turn until one succeeds; those that
        are patient move all nodes. A valid grid is not replaced by a less sound one.
        """
        plane = self._in_plane(points, verdict, polish, ways)
        if plane is not None:
            return plane
        begin, weak = clock.perf_counter(), WEAK
        cells = Comparison(self.original, self.rounded(points)) if verdict.valid else None
        start = _State(points, verdict, skewed(self.original, cells) if cells else None)
        if polish:
            weak = max(WEAK, min(1.0, 2.0 * float(verdict.ratio.min())))
        best, steps = start, 0
        for way in ways:
            other, more = self._grow(start, weak, way)
            better = other.count < best.count or (verdict.valid and other is not start)
            best, steps = (other if better else best), steps + more
            if best.verdict.valid or self.limit.reached:
                break
        if cells and best is not start:
            after = Comparison(self.original, self.rounded(best.points))
            best = best if is_sounder(self.original, after, cells) else start
        return Outcome(best.points, best.verdict, self._record(start, best, steps, clock.perf_counter() - begin))

    def _grow(self, start: _State, weak: float, way: Way) -> tuple[_State, int]:
        """The best state of regions that grow by stages, and the Newton steps taken."""
        stages = _LAYERS[self.original.grid.dimension][-1 if way.patient else 0 : 1 if way.hasty else None]
        best = now = start
        steps, density, done = 0, np.inf, 0
        for layers in stages:
            if self.limit.reached:
                break
            before, reached, count = 0.0, np.inf, 0
            for _ in range(_ROUNDS if layers else _LAST_ROUNDS):
                found = self._attempt(now, layers, weak, way, done)
                if found is None:
                    return best, steps
                before, reached, count = found.before, found.density, len(found.moved)
                steps += found.steps
                now = self._moved(now, found)
                helped = _ENOUGH < reached < _GAIN * before
                if not found.untangled or (now.verdict.valid and (layers or not helped)):
                    break
            if start.verdict.valid and reached > _GAIN * before:
                # Weak cells that cannot be improved.
                break
            if now.count < best.count or (now.count == best.count and reached < density):
                best, density = now, reached
            if now.verdict.valid and density < _ENOUGH:
                break
            done = count if now.verdict.valid else 0
        return best, steps

    def _in_plane(self, points: FloatArray, verdict: Verdict, polish: bool, ways: tuple[Way, ...]) -> Outcome | None:
        """The same on the plane grid that this one is extruded from, if the motion stays in its plane."""
        if self._extrusion is None:
            return None
        begin, (extrusion, repairer) = clock.perf_counter(), self._extrusion
        before = self.original.grid.points
        change = extrusion.flattened(points - before)
        if change is None:
            return None
        flat = extrusion.plane.points + change
        found = repairer.repair(flat, judge(repairer.original, self.rounded(flat)), polish, ways)
        spread = extrusion.spread(before, points, found.points - extrusion.plane.points)
        after = _State(spread, judge(self.original, self.rounded(spread)))
        steps = found.repair.newton_steps
        record = self._record(_State(points, verdict), after, steps, clock.perf_counter() - begin)
        return Outcome(spread, after.verdict, record)

    def _attempt(self, now: _State, layers: int | None, limit: float, way: Way, done: int) -> _Attempt | None:
        """Move the nodes within ``layers`` layers of weak cells; ``None`` if there are none, too many, or only those
        that have been ``done``."""
        broken = (now.verdict.failed != 0) | (now.verdict.ratio < limit)
        weak = np.flatnonzero(broken if now.skewed is None else broken | now.skewed)
        # Several machines compute the same, but not equally fast.
        late = (lambda: self.limit.reached) if current_ranks().count == 1 else (lambda: False)

        def make() -> _Attempt | None:
            with alone():
                free = self._neighbourhood.around(weak, layers)
                size = NewtonSystem.memory(free.size, self.original.grid.dimension)
                if free.size in (0, done) or size > self.memory.size:
                    return None
                if now.verdict.valid and free.size > _LARGE:
                    return None
                plot = self._neighbourhood.plot(free, way.even, now.points)
                return self._solve(plot, now.points, way, late)

        return current_ranks().once(make)

    def _solve(self, plot: Plot, points: FloatArray, way: Way, late: Callable[[], bool]) -> _Attempt:
        start = plot.inside(points)
        if isinstance(plot.region.energy, Hexahedra):
            plot.region.energy.focus(start, WEAK)
        untangler = Untangler(plot.region, start, progress=self.progress, late=late)
        before = untangler.state(start, Penalty(0.0)).highest
        most = max(_FEWEST, _WORK // plot.region.n_unknowns)
        untangled = untangler.untangle(replace(way.pace, steps=min(way.pace.steps, most)))
        improved = untangled and not way.hasty and plot.region.n_unknowns < _LARGE
        density = untangler.improve(_IMPROVING) if improved else np.inf
        shift = plot.shift(untangler.x - start)
        return _Attempt(plot.moved, shift, untangled, before, density, untangler.steps)

    def _moved(self, now: _State, found: _Attempt) -> _State:
        points: FloatArray = empty(now.points.shape)
        for_rows(lambda rows: np.copyto(points[rows], now.points[rows]), points)

        def put() -> None:
            points[found.moved] += found.shift

        current_ranks().alter(points, put)
        return _State(points, judge(self.original, self.rounded(points)), now.skewed)

    def _record(self, start: _State, end: _State, steps: int, seconds: float) -> Repair:
        moved = (end.points - start.points).reshape(-1, 3)
        distance = np.sqrt((moved**2).sum(axis=1))
        bad = (start.verdict.failed != 0) | (start.verdict.ratio < POOR)
        return Repair(int(bad.sum()), int((distance > 0).sum()), float(distance.max()), steps, seconds)


@dataclass(frozen=True)
class _State:
    """``skewed``: cells that are weak for their shape, in a grid that was valid from the start."""

    points: FloatArray
    verdict: Verdict
    skewed: BoolArray | None = None

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
