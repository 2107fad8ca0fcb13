"""How a motion is imposed: in a given number of steps, or in as many attempts as it takes until the grid is valid.

The parameters were tuned together. How many large motions succeed, and what the attempts cost, is measured by
``studies/robustness_table.py`` and ``studies/default_method.py``; results are in docs/validity.md. Whoever changes one
number runs these studies for all of them.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from .boundary import Kind
from .boundary.classification import largest_displacement, overlap_advice
from .boundary.crossing import torn_faces
from .boundary.motions.motion import positions_as_displacements
from .errors import MethodError
from .grid import FloatArray
from .grid.blocks import rounded
from .grid.openings import find_overlaps
from .methods import Account, Options, PreparedMethod, Progress, prepare_method
from .numerics.arrays import extent
from .parallel import Nodes
from .quality.listed import find_pinned
from .quality.validity import Comparison, Verdict, judge
from .repair.options import Effort, Limit
from .repair.outcome import Judged, Repair, unhealthy_cells
from .repair.tuned import AS_PLANE, COLLAPSING, FARTHEST
from .setup import Attempt, BoundaryMotion, Setup, Timing
from .wording import Notice, first_of_each_kind, kind_of, vector

if TYPE_CHECKING:
    from .repair.repair import Repairer

MAX_HALVINGS, MAX_REPAIRED_HALVINGS = 8, 4
"""How often a step may be halved until the grid is valid: by the method alone, and with a repair of each step, which is
far more expensive."""
MAX_ATTEMPTS = 24
"""Largest number of steps tried with repairs, to bound the time spent on hopeless cases."""
BEFORE = 0.9
"""If the boundary crosses itself, this fraction of the motion up to that point is tried and reported to the user."""
RESCUE = "rbf-tfi"
"""The method tried when the chosen one finds no valid grid: it succeeds most often."""
RESCUE_STEPS = (8, 16)
"""Numbers of steps without repairs in which it is tried first (studies/repairs.py, pipes that close to 3 %)."""
SQUEEZED = ("tfi", RESCUE)
"""Methods tried when the best valid grid is nearly collapsed; in narrow gaps TFI often preserves grid lines better."""
_FAR = 10.0
"""Sizes of the grid beyond which a displacement is hardly in its length unit."""
_FEWEST_UNITS = 100
"""Below this many units in the last place of the coordinates, a motion is visibly rounded."""


@dataclass(frozen=True, eq=False)
class Course:
    """A motion to impose on a set-up.

    Attributes
    ----------
    path : displacement of the boundary at a fraction of the motion
    precision : of the coordinates that will be written, to which verdicts apply
    limit : limit on the time and work of repairs and further attempts
    attempts, warnings : in the order in which they were made
    latest : the method prepared last, with the coordinates and options for which it was; steps from the same grid share
        it. There is one at most, as two dense systems may not fit into memory
    """

    setup: Setup
    path: BoundaryMotion
    precision: str
    timing: Timing
    progress: Progress | None
    limit: Limit
    attempts: list[Attempt] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    latest: list[tuple[FloatArray, Options, PreparedMethod]] = field(default_factory=list)

    @cached_property
    def total(self) -> FloatArray:
        """Displacement (n_unique, 3) of the boundary at the end of the motion."""
        return self.path(1.0)

    def prescribed(self, fraction: float) -> FloatArray:
        """Boundary displacement (n_unique, 3) at a fraction of the motion."""
        return self.total if fraction == 1.0 else self.path(fraction)

    @cached_property
    def rounded(self) -> Callable[[FloatArray], FloatArray]:
        """Rounds coordinates as they will be written."""
        # Not a method: with a reference cycle, large arrays would stay until the garbage collector runs.
        return partial(rounded, precision=self.precision)

    @cached_property
    def repairer(self) -> Repairer:
        """The repairer, which compares cells with the undeformed grid."""
        # Imported late, as its loops take time to load, which most motions do not need.
        from .repair.repair import Repairer

        basis, memory = self.setup.undeformed.repairs, self.setup.memory
        return Repairer(
            basis, self.rounded, memory, self.progress, self.limit, FARTHEST * largest_displacement(self.total)
        )

    @property
    def repairing(self) -> bool:
        """Whether the case asks for repairs."""
        return self.setup.case.repair.mode != "off"

    @property
    def polishing(self) -> bool:
        """Whether the case asks for better cells even in a valid grid."""
        return self.setup.case.repair.mode == "polish"


def doubts(course: Course, one_of_many: bool) -> Sequence[str]:
    """Warnings about a motion before it is imposed; zero displacement is not one of them for ``one_of_many`` levels."""
    boundary, largest = course.setup.boundary, largest_displacement(course.total)
    # Tables of a sequence are read only when their time is reached.
    warnings = boundary.tables.warnings() if boundary.tables else []
    found = first_of_each_kind(warnings, map(kind_of, course.setup.warnings))
    if not one_of_many and largest == 0.0:
        found.append("nothing moves: the displacement is zero everywhere; check --time, formulas, angles and tables")
    elif not one_of_many:
        moved = course.setup.topology.first[course.total.any(axis=1)]
        farthest = float(np.abs(course.setup.grid.points[moved]).max())
        unit = float(np.spacing(np.dtype(course.precision).type(farthest)))
        if largest < _FEWEST_UNITS * unit:
            exact = "--variant precision=float64, or " if course.precision == "float32" else ""
            found.append(
                f"coordinates of {farthest:.3g} in {course.precision} are multiples of {unit:.2g}, to which the motion "
                f"of at most {largest:.3g} is rounded; more accurate: {exact}a grid nearer to the origin"
            )
    moving = np.flatnonzero(boundary.kind == Kind.MOVING)
    points = course.setup.grid.points[course.setup.topology.first[moving]]
    found += positions_as_displacements(points, course.total[moving])
    # Faces enclose the grid.
    low, high = extent(course.setup.grid.nodes.at(course.setup.topology.first))
    size = float(np.linalg.norm(high - low))
    if largest > _FAR * size:
        found.append(
            f"the largest displacement, {largest:.4g}, is {largest / size:.3g} times the size of the grid, {size:.4g}: "
            "is it in the length unit of the grid?"
        )
    found += torn_faces(course.setup.grid, course.setup.topology, boundary, course.total)
    departure = boundary.slip.departure(course.total)
    # A motion that returns to zero leaves round-off in all directions.
    if departure > 1e-6 * largest and departure > 1e-12 * float((high - low).max()):
        text = (
            f"the motion carries nodes out of a slip or symmetry plane by up to {departure:.3g}; "
            f"the plane follows there, its other nodes stay in it; if not meant, check the axis or move the plane"
        )
        found.append(Notice(text, "motion out of a sliding plane"))
    return found


@dataclass(frozen=True, eq=False)
class State:
    """The grid at a fraction of the motion, from which the next step starts; whoever does not want it drops it.

    Attributes
    ----------
    found : the grid as judged, with the repair of the last step
    moved : (n_unique, 3) displacement of the boundary imposed so far
    steps : number of steps so far
    plain : as ``found``, before the repair of the last step
    earlier : joint summary of the repairs of the steps before
    account : account of the method in the last step
    notices : the method's warnings in all steps, the last one of each kind
    first_bad : cell number -> the earlier step that made it invalid
    failed : a further step, which is not valid, after the last state that is
    """

    course: Course
    options: Options
    found: Judged
    moved: FloatArray
    fraction: float = 0.0
    steps: int = 0
    plain: Judged | None = None
    earlier: Repair | None = None
    account: Account = field(default_factory=Account)
    notices: Mapping[str, str] = field(default_factory=dict)
    first_bad: Mapping[int, int] = field(default_factory=dict)
    failed: State | None = None

    @property
    def valid(self) -> bool:
        """Whether no cell is invalid."""
        return self.found.verdict.valid

    @property
    def repair(self) -> Repair | None:
        """That of the last step."""
        return self.found.repair

    @property
    def smallest_scaled(self) -> float:
        """The smallest scaled Jacobian, which polishing must not reduce although it minimises another measure."""
        return self.found.smallest_scaled_jacobian(self.course.setup.original, self.course.rounded)

    @property
    def repairs(self) -> Repair | None:
        """Joint summary of the repairs of all steps."""
        return self.earlier + self.repair if self.earlier and self.repair else self.repair or self.earlier


def beginning(course: Course, options: Options) -> State:
    """The state before the first step, in which no cell has failed, with a method."""
    undeformed = course.setup.undeformed
    found = Judged(undeformed.grid.points, Verdict(np.zeros(0, np.int8), np.ones(1, np.float32)))
    return State(course, options, found, np.zeros((undeformed.topology.n_unique, 3)))


def prepared_on(state: State) -> PreparedMethod:
    """The method of a state, prepared on its grid."""
    course, setup, points = state.course, state.course.setup, state.found.points
    for known, options, prepared in course.latest:
        if known is points and options is state.options:
            return prepared
    course.latest.clear()
    problem = setup.problem
    if points is not setup.grid.points:
        problem = dataclasses.replace(problem, grid=setup.grid.moved(points))
    with course.timing.stage("prepare"):
        found = prepare_method(state.options, problem)
    course.latest.append((points, state.options, found))
    return found


def warnings_ahead(course: Course, prepared: PreparedMethod, steps: int | str | None) -> list[str]:
    """The method's warnings for the motion before its first step; adaptive ``steps``, which are halved until they
    succeed, are never too large."""
    first = course.prescribed(1 / steps if isinstance(steps, int) else 0.0)
    sources = course.setup.problem.source_numbers
    return prepared.warnings_for(course.total[sources], first[sources])


def step(state: State, fraction: float, effort: Effort = "quick") -> State:
    """Move from the grid of a state to ``fraction`` of the motion, and repair the result if the case asks for it."""
    return repaired(plain_step(state, fraction), effort)


def plain_step(state: State, fraction: float) -> State:
    """As :func:`step`, without a repair."""
    course, prepared, before = state.course, prepared_on(state), state.found
    sources, boundary = course.setup.problem.source_numbers, course.prescribed(fraction)
    with course.timing.stage("apply"):
        moved = prepared.apply(boundary[sources] - state.moved[sources], course.progress)

        def add(rows: slice) -> None:
            np.add(before.points[rows], moved[rows], out=moved[rows])
            # Checked here, while rows are in the cache, as not-a-number passes all tests of cells.
            if not np.isfinite(moved[rows].sum()):
                _require_finite(state, moved[rows], rows.start)

        Nodes.of(moved).each(add)
    original, final, number = course.setup.original, course.rounded(moved), state.steps + 1
    with course.timing.stage("quality"):
        # At the end of the motion also all quality measures, as the grid is usually the result.
        cells = Comparison(original, final) if fraction >= 1.0 else None
        found = Judged(moved, cells.verdict if cells else judge(original, final), cells)
    # A copy, as a prepared method changes its own account with every displacement.
    account = Account(dict(prepared.account.settings), dict(prepared.account.notices))
    bad = {**dict.fromkeys(before.verdict.invalid.tolist(), state.steps), **state.first_bad}
    notices = {**state.notices, **account.notices}
    now = State(course, state.options, found, boundary, fraction, number, found, state.repairs, account, notices, bad)
    return _noted(now)


def _require_finite(state: State, points: FloatArray, first: int) -> None:
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if bad.size:
        setup = state.course.setup
        node = setup.grid.node_label(first + int(bad[0]))
        # Nodes of one block on a moving face of another are sources and interior nodes at once.
        if not setup.grid.nodes.divided and (overlaps := find_overlaps(setup.grid, setup.topology)):
            raise MethodError(
                f"{overlaps[0].describe(setup.grid)}, so that {state.options.name} finds no place for {node}"
                f"{overlap_advice(setup.grid)}"
            )
        raise MethodError(
            f"{state.options.name} moves {node} to {vector(points[bad[0]])}; expected finite coordinates, from options "
            "and a motion of the size of the grid"
        )


def repaired(state: State, effort: Effort = "quick") -> State:
    """A plain step, repaired if its cells need it and the case asks for it."""
    if not state.course.repairing:
        return state
    if state.course.polishing:
        polished = _repaired(state, effort, polish=True)
        if not state.valid or polished.smallest_scaled >= state.smallest_scaled:
            return polished
    return _repaired(state, effort)


def insist(state: State) -> State:
    """Repair the plain grid of a step again, with a patient strategy; returns the better of the two results."""
    plain = state.plain
    if plain is None or state.course.limit.reached or (state.repair and state.repair.left_out):
        return state
    other = _repaired(dataclasses.replace(state, found=plain), "patient", polish=state.course.polishing)
    better = other if other.found.count < state.found.count else state
    if state.repair and other.repair:
        # Both began with the same grid, whose bad cells count once.
        both, invalid, weak = state.repair + other.repair, state.repair.invalid, state.repair.weak
        found = dataclasses.replace(better.found, repair=dataclasses.replace(both, invalid=invalid, weak=weak))
        return dataclasses.replace(better, found=found)
    return better


def _repaired(state: State, effort: Effort, polish: bool = False) -> State:
    course, plain = state.course, state.found
    with course.timing.stage("repair"):
        needed = polish or not state.valid or unhealthy_cells(course.setup.original, plain.points, AS_PLANE).size
        outcome = course.repairer.repair(plain, polish, effort) if needed else None
    if outcome is None:
        return state
    moved = outcome.repair and outcome.repair.newton_steps
    found = outcome if moved else dataclasses.replace(plain, repair=outcome.repair)
    return _noted(dataclasses.replace(state, found=found), repair=True)


def _noted(state: State, repair: bool = False) -> State:
    attempt = Attempt(state.options.name, state.steps, repair, state.found.count, state.fraction)
    state.course.attempts.append(attempt)
    return state


def in_equal_steps(state: State, count: int) -> State:
    """Impose the motion in as many steps as the user asked for, valid or not."""
    for number in range(1, count + 1):
        state = step(state, number / count)
        # A repair that fails is repeated with a patient strategy.
        if state.course.repairing and not state.valid:
            state = insist(state)
    return state


def adaptively(state: State) -> State:
    """Impose the motion in one step if that keeps the grid valid; else halve this step and all that follow.

    Stops at the last valid grid when no step succeeds any more. A moving grid jumps where the number of steps changes,
    of which a series warns.
    """
    smallest = 0.5**MAX_HALVINGS
    reached = _march(state, 1.0, smallest)
    if reached.failed:
        text = (
            f"only {reached.fraction:.1%} of the motion was imposed; a further step of {smallest:.2%} makes "
            "cells invalid. The grid reached so far is kept; another method, or planes that slide, may allow more"
        )
        state.course.warnings.append(Notice(text, "a part of the motion"))
    return reached


def _march(state: State, increment: float, smallest: float, growth: int = 1) -> State:
    """Take steps until the motion is complete or one of the ``smallest`` increment fails; others that fail are halved,
    and after one that succeeds the increment grows. With repairs it also ends when enough has been tried."""
    while state.fraction < 1.0 and not (state.course.repairing and _enough(state.course)):
        further = step(state, min(1.0, state.fraction + increment))
        if further.valid:
            state, increment = further, growth * increment
        elif increment > smallest:
            increment /= 2
        else:
            return dataclasses.replace(state, failed=further)
    return state


def until_valid(state: State) -> State:
    """Try one step with a quick repair, then several with another method and no repair, then a patient repair, then
    smaller steps with a repair in each, and the same with the other method. If the boundary alone shows that no valid
    grid exists, only one step and a part of the motion are tried, each with a short repair.

    If the valid grid of one step is nearly collapsed, the best one of several methods is kept. If nothing succeeds, the
    grid with the fewest invalid cells is kept, with its boundary as prescribed; the warnings say why, and for which
    part of the motion a valid grid was found.
    """
    course, plain = state.course, plain_step(state, 1.0)
    # Reasons visible in the boundary alone why no valid grid exists, and the part of the motion up to which there are
    # none.
    reasons, fraction = list[str](), 1.0
    if not plain.valid:
        setup, contact = course.setup, course.setup.undeformed.contact(course.path)
        pinned = find_pinned(setup.original, setup.boundary, course.total)
        reasons = [found for found in (contact and contact.message, pinned) if found]
        fraction = contact.fraction if contact else 1.0
    best = repaired(plain, "hasty" if reasons else "quick")
    if reasons and not best.valid:
        course.warnings.extend(reasons)
        step(state, BEFORE * fraction, "hasty")
    elif not best.valid:
        best = _persistently(best)
    collapsing = best.steps == 1 and best.valid and best.found.verdict.smallest_ratio < COLLAPSING
    if collapsing and not (best.repair and best.repair.converged):
        stepped = _without_repairs(course)
        if stepped and stepped.smallest_scaled > best.smallest_scaled:
            return stepped
        for other in _with_other_methods(course, SQUEEZED, best.options):
            if other.valid and other.found.verdict.smallest_ratio > best.found.verdict.smallest_ratio:
                best = other
    if not best.valid:
        attempts = course.attempts
        reached = max((a.reached for a in attempts if not a.invalid_cells), default=0.0)
        if course.limit.exhausted:
            nodes = course.setup.grid.n_nodes
            text = f"the motion was given up after as much work as is done for {nodes:,} nodes (docs/validity.md)"
            course.warnings.append(Notice(text, "the limit on work"))
        elif course.limit.reached:
            course.warnings.append(f"the time limit of {course.limit.seconds:g} s was reached ([repair] time_limit)")
        part = f"only for {reached:.1%} of it" if reached else "nor for any part of it that was tried"
        text = (
            f"no valid grid was found for the whole motion, {part}. The grid kept has the whole "
            f"motion and the fewest invalid cells of {len(attempts)} attempts"
        )
        course.warnings.append(Notice(text, "no valid grid"))
    return best


def _persistently(first: State) -> State:
    """After a failed quick repair: the grid of smaller steps if these reach the whole motion, or the best of one."""
    course = first.course
    if stepped := _without_repairs(course):
        return stepped
    best = first
    for found in itertools.chain([first], _with_other_methods(course, (RESCUE,), first.options)):
        other = found if found.valid else insist(found)
        if found is first or other.found.count < best.found.count:
            best = other
        if best.valid:
            return best
        reached = _march(beginning(course, found.options), 0.5, 0.5**MAX_REPAIRED_HALVINGS, growth=2)
        if reached.fraction == 1.0:
            return reached
    return best


def _without_repairs(course: Course) -> State | None:
    """Equal steps with another method, of which only the last may be repaired; ``None`` if every number fails."""
    for count in RESCUE_STEPS:
        state = beginning(course, Options(RESCUE))
        while state.valid and state.fraction < 1.0:
            if course.limit.reached:
                return None
            try:
                state = plain_step(state, (state.steps + 1) / count)
            except MethodError as error:
                course.warnings.append(Notice(f"{RESCUE} was not tried: {error}", f"{RESCUE} not tried"))
                return None
        if state.valid:
            return repaired(state)
    return None


def _enough(course: Course) -> bool:
    return len(course.attempts) >= MAX_ATTEMPTS or course.limit.reached


def _with_other_methods(course: Course, names: tuple[str, ...], chosen: Options) -> Iterator[State]:
    """One step with each of the named methods, except the chosen one and any that does not fit into memory."""
    for name in names:
        if name == chosen.name or _enough(course):
            continue
        try:
            yield step(beginning(course, Options(name)), 1.0)
        except MethodError as error:
            course.warnings.append(Notice(f"{name} was not tried: {error}", f"{name} not tried"))
