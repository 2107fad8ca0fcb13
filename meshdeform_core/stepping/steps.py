"""A motion to impose, and its steps: from a state to a trial, and from an accepted trial to the next state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..boundary import Kind
from ..boundary.classification import overlap_advice
from ..boundary.crossing import torn_faces
from ..boundary.motions.motion import far_motion, positions_as_displacements
from ..boundary.prescribed import largest_displacement
from ..errors import MethodError
from ..grid import FloatArray
from ..grid.blocks import rounded
from ..grid.openings import find_overlaps
from ..methods import Account, Options, PreparedMethod, Problem, Progress, prepare_method
from ..notices import Notice, first_of_each_kind, kind_of
from ..parallel import Nodes
from ..quality.validity import Comparison, judge
from ..repair.limit import Limit
from ..repair.onset import unhealthy_cells
from ..repair.options import Effort
from ..repair.outcome import Judged, Repair
from ..repair.tuned import AS_PLANE, FARTHEST
from ..setup import BoundaryMotion, Setup, Timing
from ..wording import vector

if TYPE_CHECKING:
    from ..repair.repair import Repairer

_FEWEST_UNITS = 100
"""Below this many units in the last place of the coordinates, a motion is visibly rounded."""


@dataclass(frozen=True)
class Attempt:
    """One attempted step of the motion: method, with or without repair, and outcome.

    ``steps`` counts the steps up to and including this one; ``reached`` is the fraction of the motion at its end.
    """

    method: str
    steps: int
    repair: bool
    invalid_cells: int
    reached: float


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

    @cached_property
    def max_displacement(self) -> float:
        """Largest displacement of the boundary at the end of the motion."""
        return largest_displacement(self.total)

    def prescribed(self, fraction: float) -> FloatArray:
        """Boundary displacement (n_unique, 3) at a fraction of the motion."""
        return self.total if fraction == 1.0 else self.path(fraction)

    def rounded(self, points: FloatArray) -> FloatArray:
        """Coordinates as they will be written."""
        return rounded(points, self.precision)

    @cached_property
    def repairer(self) -> Repairer:
        """The repairer, which compares cells with the undeformed grid."""
        # Imported late, as its loops take time to load, which most motions do not need.
        from ..repair.repair import Repairer

        setup = self.setup
        # Not `self.rounded`: with a reference cycle, large arrays would stay until the garbage collector runs.
        written = partial(rounded, precision=self.precision)
        farthest = FARTHEST * self.max_displacement
        return Repairer(setup.undeformed.repairs, written, setup.memory, self.progress, self.limit, farthest)

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
    boundary, largest = course.setup.boundary, course.max_displacement
    # Tables of a sequence are read only when their time is reached.
    found = first_of_each_kind(boundary.tables.warnings(), map(kind_of, course.setup.warnings))
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
    outside = course.setup.grid.points[course.setup.topology.first]
    found += far_motion(np.ptp(outside, axis=0), largest)
    found += torn_faces(course.setup.grid, course.setup.topology, boundary, course.total)
    departure = boundary.slip.departure(course.total)
    # A motion that returns to zero leaves round-off in all directions.
    if departure > 1e-6 * largest and departure > course.setup.undeformed.round_off:
        text = (
            f"the motion carries nodes out of a slip or symmetry plane by up to {departure:.3g}; "
            f"the plane follows there, its other nodes stay in it; if not meant, check the axis or move the plane"
        )
        found.append(Notice(text, "motion out of a sliding plane"))
    return found


@dataclass(frozen=True, eq=False)
class State:
    """The grid reached at a fraction of the motion, and the method that continues from it.

    Attributes
    ----------
    points : (n_nodes, 3)
    moved : (n_unique, 3) displacement of the boundary imposed so far
    steps : number of steps so far
    last : the grid as judged after the last step; ``None`` at the beginning
    account : account of the method in the last step
    notices : the method's warnings in all steps, the last one of each kind
    repairs : repairs in all steps
    first_bad : cell number -> the step that made it invalid
    plain : the grid before the repair, if a single repaired step with the chosen method led here
    """

    course: Course
    options: Options
    points: FloatArray
    moved: FloatArray
    fraction: float = 0.0
    steps: int = 0
    last: Judged | None = None
    account: Account | None = None
    notices: Mapping[str, str] = field(default_factory=dict)
    repairs: tuple[Repair, ...] = ()
    first_bad: Mapping[int, int] = field(default_factory=dict)
    plain: Judged | None = None


class Reached(NamedTuple):
    """The state kept in the end, and the failed step if it is not the whole motion."""

    state: State
    failed: Trial | None = None


@dataclass(frozen=True, eq=False)
class Trial:
    """A step from a state that may be accepted.

    ``plain`` is the grid that a repair starts from; ``found`` is the grid after the ``repair``, or ``plain`` itself
    without a repair; ``account`` is that of the method.
    """

    state: State
    fraction: float
    plain: Judged
    found: Judged
    account: Account
    repair: Repair | None = None

    @property
    def valid(self) -> bool:
        """Whether no cell is invalid."""
        return self.found.verdict.valid

    @property
    def invalid_cells(self) -> int:
        """Number of invalid cells."""
        return len(self.found.verdict.invalid)

    @property
    def smallest_ratio(self) -> float:
        """Smallest Jacobian of a corner relative to the undeformed grid."""
        return self.found.verdict.smallest_ratio


def beginning(course: Course, options: Options) -> State:
    """The state before the first step, with a method."""
    undeformed = course.setup.undeformed
    return State(course, options, undeformed.grid.points, np.zeros((undeformed.topology.n_unique, 3)))


def warnings_ahead(state: State, first: float) -> list[str]:
    """The method's warnings for the motion, whose first step is the fraction ``first`` of it; ``state`` is the
    beginning."""
    course = state.course
    sources = course.setup.problem.source_numbers
    motion, step = (course.prescribed(part)[sources] for part in (1.0, first))
    return prepared_on(state).warnings_for(motion, step)


def step(state: State, fraction: float, effort: Effort = "quick") -> Trial:
    """Move from the grid of a state to ``fraction`` of the motion, and repair the result if the case asks for it."""
    return repaired(plain_step(state, fraction), effort)


def plain_step(state: State, fraction: float) -> Trial:
    """As :func:`step`, without a repair."""
    course, prepared = state.course, prepared_on(state)
    sources = course.setup.problem.source_numbers
    increment = course.prescribed(fraction)[sources] - state.moved[sources]
    with course.timing.stage("apply"):
        moved = prepared.apply(increment, course.progress)

        def add(rows: slice) -> None:
            np.add(state.points[rows], moved[rows], out=moved[rows])
            # Checked here, while rows are in the cache, as not-a-number passes all tests of cells.
            if not np.isfinite(moved[rows].sum()):
                _require_finite(state, moved[rows], rows.start)

        Nodes.of(moved).each(add)
    original, final = course.setup.original, course.rounded(moved)
    with course.timing.stage("quality"):
        # At the end of the motion also all quality measures, as the grid is usually the result.
        cells = Comparison(original, final) if fraction >= 1.0 else None
        found = Judged(moved, cells.verdict if cells else judge(original, final), cells)
    # A copy, as a prepared method changes its own account with every displacement.
    account = Account(dict(prepared.account.settings), dict(prepared.account.notices))
    return _noted(Trial(state, fraction, found, found, account), repair=False)


def repaired(trial: Trial, effort: Effort = "quick") -> Trial:
    """A plain trial, repaired if its cells need it and the case asks for it."""
    course, plain = trial.state.course, trial.plain
    if not course.repairing:
        return trial
    if course.polishing:
        polished = _repaired(trial, effort, polish=True)
        if not plain.verdict.valid or smallest_scaled(course, polished.found) >= smallest_scaled(course, plain):
            return polished
    return _repaired(trial, effort)


def insist(trial: Trial) -> Trial:
    """Repair the plain grid of a trial again, with a patient strategy; returns the better of the two results."""
    course = trial.state.course
    if course.limit.reached or (trial.repair and trial.repair.left_out):
        return trial
    plain = dataclasses.replace(trial, found=trial.plain, repair=None)
    other = _repaired(plain, "patient", polish=course.polishing)
    better = other if other.invalid_cells < trial.invalid_cells else trial
    if trial.repair and other.repair:
        return dataclasses.replace(better, repair=trial.repair.again(other.repair))
    return better


def accept(trial: Trial) -> State:
    """The state after a trial."""
    before, course, steps = trial.state, trial.state.course, trial.state.steps + 1
    chosen = before.options is course.setup.case.method
    return dataclasses.replace(
        before,
        points=trial.found.points,
        moved=course.prescribed(trial.fraction),
        fraction=trial.fraction,
        steps=steps,
        last=trial.found,
        account=trial.account,
        notices={**before.notices, **trial.account.notices},
        repairs=(*before.repairs, trial.repair) if trial.repair else before.repairs,
        first_bad={**dict.fromkeys(trial.found.verdict.invalid.tolist(), steps), **before.first_bad},
        plain=trial.plain if steps == 1 and trial.repair and chosen else None,
    )


def prepared_on(state: State) -> PreparedMethod:
    """The method of a state, prepared on its grid."""
    course, setup = state.course, state.course.setup
    for points, options, prepared in course.latest:
        if points is state.points and options is state.options:
            return prepared
    course.latest.clear()
    problem: Problem = setup.problem
    if state.points is not setup.grid.points:
        problem = dataclasses.replace(problem, grid=setup.grid.moved(state.points))
    with course.timing.stage("prepare"):
        found = prepare_method(state.options, problem)
    course.latest.append((state.points, state.options, found))
    return found


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


def smallest_scaled(course: Course, found: Judged) -> float:
    """The smallest scaled Jacobian, which polishing must not reduce although it minimises another measure."""
    return found.smallest_scaled_jacobian(course.setup.original, course.rounded)


def _repaired(trial: Trial, effort: Effort, polish: bool = False) -> Trial:
    course, plain = trial.state.course, trial.plain
    original, needed = course.setup.original, polish or not plain.verdict.valid
    with course.timing.stage("repair"):
        if not needed and not unhealthy_cells(original, plain.points, AS_PLANE).size:
            return trial
        outcome = course.repairer.repair(plain, polish, effort)
    if outcome is None:
        return trial
    done = outcome.repair
    found = outcome if done.newton_steps else plain
    repair = trial.repair + done if trial.repair else done
    return _noted(dataclasses.replace(trial, found=found, repair=repair), repair=True)


def _noted(trial: Trial, repair: bool) -> Trial:
    state = trial.state
    attempt = Attempt(state.options.name, state.steps + 1, repair, trial.invalid_cells, trial.fraction)
    state.course.attempts.append(attempt)
    return trial
