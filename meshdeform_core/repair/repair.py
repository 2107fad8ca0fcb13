"""Nodes are moved until every cell is sound; the boundary stays where it is.

The repaired grid is the minimum of an energy over all nodes, a smooth function of the displacement of the boundary:
see :mod:`.onset`. Where that minimum is out of reach, cells are untangled in regions around the invalid ones.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, IntArray
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.cell.health import all_healthy
from ..parallel import alone, current_ranks, empty, for_rows
from ..quality import Original
from ..quality.comparison import Comparison
from ..quality.validity import Verdict, judge
from .constraints import Constraints
from .extrusion import Extrusion, find_extrusion
from .neighbourhood import Neighbourhood, Plot
from .newton import NewtonSystem
from .onset import share_of
from .region import COLLAPSED, HEALTHY, SOFT, Penalty
from .time_limit import TimeLimit
from .untangle import Pace, Untangler
from .weakness import POOR, is_weak

WEAK = 0.35
"""Cells with a corner below this share of its undeformed Jacobian are the middle of what a repair moves."""
COLLAPSING = 0.01
"""Valid cells below this share are nearly collapsed: a warning."""
_LAYERS: dict[int, tuple[int | None, ...]] = {2: (32, None), 3: (8, 32, None)}
# A regularisation that begins large and falls slowly finds valid grids where a quick one is caught.
_QUICK, _PATIENT = Pace(60, 2.0, 0.2), Pace(200, 50.0, 0.1)
# Where no valid grid exists, most cells that can become valid do so early.
_HASTY = Pace(30, 2.0, 0.3)
_IMPROVING, _CONVERGING = 20, 60
_ROUNDS, _LAST_ROUNDS = 2, 6
# A region of n nodes takes at most _WORK / n Newton steps, so that time is bounded on large grids.
_WORK, _FEWEST = 20_000_000, 6
# More layers are tried while the largest f is above this; for valid grids, if the first ones lower it by a tenth.
_ENOUGH, _GAIN = 2.9, 0.9
LARGE = 300_000
"""Regions of more nodes than this are not improved beyond validity: on the largest grids that would take minutes."""


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

    ``cells`` that were invalid or weak before, ``nodes`` moved and how far at most (grid length unit), Newton steps,
    seconds. ``converged``: the grid is the minimum of the energy over all nodes, a smooth function of the displacement
    of the boundary; otherwise it depends on the way on which it was found, and the next one may differ much.
    """

    cells: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float
    converged: bool = False

    def __add__(self, other: Repair) -> Repair:
        return Repair(
            self.cells + other.cells,
            max(self.nodes, other.nodes),
            max(self.max_movement, other.max_movement),
            self.newton_steps + other.newton_steps,
            self.seconds + other.seconds,
            other.converged,
        )


@dataclass(frozen=True)
class Outcome:
    """Coordinates (n_nodes, 3) after a repair, their verdict, and what was done."""

    points: FloatArray
    verdict: Verdict
    repair: Repair


class Basis:
    """What all repairs of one undeformed grid share; its parts are made when the first one needs them."""

    def __init__(self, original: Original, boundary: Boundary | Constraints):
        self.original, self._boundary = original, boundary

    @cached_property
    def _constraints(self) -> Constraints:
        if isinstance(self._boundary, Constraints):
            return self._boundary
        return Constraints.of(self.original.grid, self.original.topology, self._boundary)

    @cached_property
    def neighbourhood(self) -> Neighbourhood:
        return Neighbourhood(self._constraints)

    @cached_property
    def extrusion(self) -> tuple[Extrusion, Basis] | None:
        """The plane grid that this one is extruded from."""
        found = find_extrusion(self._constraints)
        if found is None:
            return None
        original = Original(found.plane, found.constraints.topology, self.original.min_jacobian)
        return found, Basis(original, found.constraints)

    def healthy(self, points: FloatArray) -> bool:
        """Whether the corners of all cells are healthy, told without building a region; not of plane grids."""
        grid = self.original.grid
        if grid.dimension == 2 or grid.n_nodes > 2 * LARGE:
            return False
        blocks = (grid.moved(points).block(n) for n in range(grid.n_blocks))
        pairs = zip(blocks, (grid.block(n) for n in range(grid.n_blocks)), strict=True)
        return all(all_healthy(x, start, HEALTHY, SOFT, COLLAPSED) for x, start in pairs)

    @cached_property
    def whole(self) -> Whole | None:
        """All nodes that may move, ``None`` where there are none or too many."""
        if self.original.grid.n_nodes > 2 * LARGE:
            return None
        free = self.neighbourhood.around(np.empty(0, dtype=np.int64), None)
        if not 0 < free.size <= LARGE:
            return None
        plot = self.neighbourhood.plot(free)
        return Whole(plot, plot.region.energy.edges())


class Whole:
    """The region of all nodes that may move, and the shortest undeformed edges (n,) at its nodes."""

    def __init__(self, plot: Plot, edges: FloatArray):
        self.plot, self.edges = plot, edges

    @cached_property
    def system(self) -> NewtonSystem:
        return NewtonSystem(self.plot.region)


class Repairer:
    """Repairs of deformed states of one grid.

    Parameters
    ----------
    rounded : coordinates as they will be written; the verdict is about those
    memory, limit : of a repair, the latter of all repairs together
    """

    def __init__(
        self,
        basis: Basis,
        rounded: Callable[[FloatArray], FloatArray] = lambda points: points,
        memory: MemoryLimit = UNLIMITED,
        progress: Progress | None = None,
        limit: TimeLimit | None = None,
    ):
        self.basis, self.original, self.rounded = basis, basis.original, rounded
        self.memory, self.progress, self.limit = memory, progress, limit or TimeLimit()

    def needed(self, points: FloatArray, verdict: Verdict, cells: Comparison | None = None) -> bool:
        """Are there cells that are invalid or weak? ``cells`` are those measured already, if any."""
        if verdict.failed.any():
            return True

        def weak() -> bool:
            flat, basis = self._flattened(points) or (points, self.basis)
            if basis.healthy(flat):
                return False
            if basis.whole is None:
                return is_weak(self.original, verdict, cells)
            plot = basis.whole.plot
            return share_of(plot.region.energy, plot.inside(flat))[0] > 0.0

        return current_ranks().once(weak)

    def repair(
        self,
        points: FloatArray,
        verdict: Verdict,
        polish: bool = False,
        ways: tuple[Way, ...] = EVERY_WAY,
        guess: FloatArray | None = None,
    ) -> Outcome:
        """Make cells sound; the coordinates returned may still have invalid ones, but not more than ``points``.

        The grid is the minimum of the energy over all nodes, if that is found. Newton's method starts from ``guess``
        (n_nodes, 3), the displacement by the repair of a grid close to this one, which saves time.

        If not, of the nodes around weak cells, first those within some layers move, then more, until all cells are
        sound and the worst one is no longer far from its undeformed shape, or until more nodes do not help. The
        ``ways`` are tried in turn until one succeeds; those that are patient move all nodes. ``polish``: the weakest
        cells count as weak however good they are.
        """
        plane = self._in_plane(points, verdict, polish, ways, guess)
        if plane is not None:
            return plane
        begin, start = clock.perf_counter(), _State(points, verdict)
        best, steps, converged = start, 0, False
        if not any(way.hasty for way in ways):
            best, steps, converged = self._minimum(start, polish, guess)
        if guess is not None and not (converged and best.verdict.valid):
            best, more, converged = self._minimum(start, polish, None)
            steps += more
        if not best.verdict.valid:
            best, more = self._by_regions(start, best, polish, ways)
            steps += more
            if best.verdict.valid and best is not start:
                nearer, more, converged = self._minimum(start, polish, best.points - points)
                best, steps = (nearer if nearer.verdict.valid else best), steps + more
        record = self._record(start, best, steps, clock.perf_counter() - begin)
        return Outcome(best.points, best.verdict, replace(record, converged=converged and best.verdict.valid))

    def _by_regions(self, start: _State, best: _State, polish: bool, ways: tuple[Way, ...]) -> tuple[_State, int]:
        weak = max(WEAK, min(1.0, 2.0 * float(start.verdict.ratio.min()))) if polish else WEAK
        steps = 0
        for way in ways:
            other, more = self._grow(start, weak, way)
            best, steps = (other if other.count < best.count else best), steps + more
            if best.verdict.valid or self.limit.reached:
                break
        return best, steps

    def _minimum(self, start: _State, polish: bool, guess: FloatArray | None) -> tuple[_State, int, bool]:
        """The minimum of the energy over all nodes, or what was reached of it, Newton steps, and whether it was."""
        late = self._late

        def make() -> _Attempt | None:
            whole = self.basis.whole
            if whole is None or NewtonSystem.memory(whole.plot.moved.size, len(whole.plot.axes)) > self.memory.size:
                return None
            with alone():
                return _minimise(whole, start.points, polish, guess, self.progress, late)

        found = current_ranks().once(make)
        if found is None:
            return start, 0, False
        return self._moved(start, found), found.steps, found.untangled

    @property
    def _late(self) -> Callable[[], bool]:
        # Several machines compute the same, but not equally fast.
        return (lambda: self.limit.reached) if current_ranks().count == 1 else (lambda: False)

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

    def _flattened(self, points: FloatArray) -> tuple[FloatArray, Basis] | None:
        """The same on the plane grid that this one is extruded from, if the motion stays in its plane."""
        if self.basis.extrusion is None:
            return None
        extrusion, basis = self.basis.extrusion
        change = extrusion.flattened(points - self.original.grid.points)
        return None if change is None else (extrusion.plane.points + change, basis)

    def _in_plane(
        self, points: FloatArray, verdict: Verdict, polish: bool, ways: tuple[Way, ...], guess: FloatArray | None
    ) -> Outcome | None:
        """The repair on the plane grid that this one is extruded from, if the motion stays in its plane."""
        begin, found = clock.perf_counter(), self._flattened(points)
        if found is None or self.basis.extrusion is None:
            return None
        (flat, basis), extrusion = found, self.basis.extrusion[0]
        repairer = Repairer(basis, self.rounded, self.memory, self.progress, self.limit)
        guess = None if guess is None else extrusion.flattened(guess)
        end = repairer.repair(flat, judge(basis.original, self.rounded(flat)), polish, ways, guess)
        spread = extrusion.spread(self.original.grid.points, points, end.points - extrusion.plane.points)
        after = _State(spread, judge(self.original, self.rounded(spread)))
        seconds = clock.perf_counter() - begin
        record = self._record(_State(points, verdict), after, end.repair.newton_steps, seconds)
        return Outcome(spread, after.verdict, replace(record, converged=end.repair.converged))

    def _attempt(self, now: _State, layers: int | None, limit: float, way: Way, done: int) -> _Attempt | None:
        """Move the nodes within ``layers`` layers of weak cells; ``None`` if there are none, too many, or only those
        that have been ``done``."""
        weak = np.flatnonzero((now.verdict.failed != 0) | (now.verdict.ratio < limit))
        late = self._late

        def make() -> _Attempt | None:
            with alone():
                neighbourhood = self.basis.neighbourhood
                free = neighbourhood.around(weak, layers)
                size = NewtonSystem.memory(free.size, self.original.grid.dimension)
                if free.size in (0, done) or size > self.memory.size:
                    return None
                if now.verdict.valid and free.size > LARGE:
                    return None
                return self._solve(neighbourhood.plot(free, way.even), now.points, way, late)

        return current_ranks().once(make)

    def _solve(self, plot: Plot, points: FloatArray, way: Way, late: Callable[[], bool]) -> _Attempt:
        start, region = plot.inside(points), plot.region
        share, energy = share_of(region.energy, start)
        region = replace(region, energy=energy)
        untangler = Untangler(region, start, start, NewtonSystem(region), progress=self.progress, late=late)
        before = untangler.state(start, Penalty()).highest
        most = max(_FEWEST, _WORK // region.n_unknowns)
        untangled = untangler.untangle(replace(way.pace, steps=min(way.pace.steps, most)))
        if untangled and not way.hasty and region.n_unknowns < LARGE:
            untangler.minimise(max(share, 1.0), min(_IMPROVING, most), region.energy.edges())
        density = untangler.state(untangler.x, Penalty()).highest
        return _Attempt(plot.moved, plot.shift(untangler.x - start), untangled, before, density, untangler.steps)

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
        bad = (start.verdict.failed != 0) | (start.verdict.ratio < POOR)
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
    """Block nodes ``moved`` (k,) with their ``shift`` (k, 3); whether no sample is inverted any more, or the minimum is
    reached; the largest f before, infinite where one was inverted, and after."""

    moved: IntArray
    shift: FloatArray
    untangled: bool
    before: float
    density: float
    steps: int


def _minimise(
    whole: Whole,
    points: FloatArray,
    polish: bool,
    guess: FloatArray | None,
    progress: Progress | None,
    late: Callable[[], bool],
) -> _Attempt | None:
    """The minimum of the energy over all nodes; ``None`` where no cell is weak."""
    plot = whole.plot
    reference = plot.inside(points)
    share, energy = share_of(plot.region.energy, reference)
    if polish:
        share = max(share, 1.0)
    if share == 0.0:
        return None
    region = replace(plot.region, energy=energy)
    start = reference if guess is None else plot.inside(points + guess)
    untangler = Untangler(region, start, reference, whole.system, progress=progress, late=late)
    converged = untangler.untangle(_QUICK) and untangler.minimise(share, _CONVERGING, whole.edges)
    return _Attempt(plot.moved, plot.shift(untangler.x - reference), converged, 0.0, 0.0, untangler.steps)
