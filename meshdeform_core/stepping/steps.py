"""Steps of a motion: from a state to a trial, and from an accepted trial to the next state."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..boundary.unselected import overlap_advice
from ..errors import MethodError
from ..grid import FloatArray
from ..grid.connectivity.overset import find_overlaps
from ..methods import Account, Options, PreparedMethod, Problem, prepare_method
from ..parallel import Nodes
from ..quality.comparison import Comparison
from ..quality.validity import Verdict, judge
from ..repair.options import Effort
from ..repair.outcome import Judged, Repair
from ..wording import vector
from .course import Attempt, Course


@dataclass(frozen=True, eq=False)
class Coordinates:
    """Coordinates (n_nodes, 3), the verdict on them, and their quality measures if already computed."""

    points: FloatArray
    verdict: Verdict
    cells: Comparison | None = None


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
    last: Coordinates | None = None
    account: Account | None = None
    notices: Mapping[str, str] = field(default_factory=dict)
    repairs: tuple[Repair, ...] = ()
    first_bad: Mapping[int, int] = field(default_factory=dict)
    plain: Coordinates | None = None

    @property
    def way(self) -> str:
        """How the grid was made. Grids made in the same way are a continuous function of the displacement."""
        if self.fraction < 1.0:
            return f"{self.options.name} with a part of the motion"
        way = f"{self.options.name} in {'one step' if self.steps == 1 else f'{self.steps} steps'}"
        if not all(repair.converged for repair in self.repairs):
            return f"{way}, cells untangled in regions"
        polished = self.repairs or not self.course.polishing
        return way if polished else f"{way}, not polished, which would lower the smallest scaled Jacobian"


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
    plain: Coordinates
    found: Coordinates
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
    return State(course, options, course.start.points, course.begin)


def warnings_ahead(state: State, first: float) -> list[str]:
    """The method's warnings for the rest of the motion, whose first step is the fraction ``first`` of it."""
    course = state.course
    sources = course.setup.problem.source_numbers
    motion, step = (course.prescribed(part)[sources] - state.moved[sources] for part in (1.0, first))
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
        _add(state, moved)
    found = _judged(course, fraction, moved)
    return _noted(Trial(state, fraction, found, found, _copy(prepared.account)), repair=False)


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


def patient_step(state: State, fraction: float) -> Trial:
    """A step whose repair is repeated with a patient strategy if it fails."""
    trial = step(state, fraction)
    return insist(trial) if state.course.repairing and not trial.valid else trial


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
    found = course.latest.get(state.points, state.options)
    if found is None:
        course.latest.put(state.points, state.options, None)
        problem: Problem = setup.problem
        if state.points is not setup.grid.points:
            problem = dataclasses.replace(problem, grid=setup.grid.moved(state.points))
        with course.timing.stage("prepare"):
            found = prepare_method(state.options, problem)
        course.latest.put(state.points, state.options, found)
    return found


def _add(state: State, moved: FloatArray) -> None:
    """Turn a displacement (n_nodes, 3) into coordinates, in place."""

    def add(rows: slice) -> None:
        np.add(state.points[rows], moved[rows], out=moved[rows])
        # Checked here, while rows are in the cache, as not-a-number passes all tests of cells.
        if not np.isfinite(moved[rows].sum()):
            _require_finite(state, moved[rows], rows.start)

    Nodes.of(moved).each(add)


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


def _judged(course: Course, fraction: float, points: FloatArray) -> Coordinates:
    """The coordinates with their verdict; at the end of the motion also all quality measures, as the grid is usually
    the result."""
    original, final = course.setup.original, course.rounded(points)
    with course.timing.stage("quality"):
        if fraction < 1.0:
            return Coordinates(points, judge(original, final))
        cells = Comparison(original, final)
        return Coordinates(points, cells.verdict, cells)


def smallest_scaled(course: Course, found: Coordinates) -> float:
    """The smallest scaled Jacobian, which polishing must not reduce although it minimises another measure."""
    cells = found.cells or Comparison(course.setup.original, course.rounded(found.points))
    return cells.after.smallest_scaled[1]


def _repaired(trial: Trial, effort: Effort, polish: bool = False) -> Trial:
    course, plain = trial.state.course, trial.plain
    with course.timing.stage("repair"):
        outcome = course.repaired(Judged(plain.points, plain.verdict), effort, polish)
    if outcome is None:
        return trial
    done = outcome.repair
    found = Coordinates(outcome.points, outcome.verdict) if done.newton_steps else plain
    repair = trial.repair + done if trial.repair else done
    return _noted(dataclasses.replace(trial, found=found, repair=repair), repair=True)


def _noted(trial: Trial, repair: bool) -> Trial:
    state = trial.state
    attempt = Attempt(state.options.name, state.steps + 1, repair, trial.invalid_cells, trial.fraction)
    state.course.log.attempts.append(attempt)
    return trial


def _copy(account: Account) -> Account:
    """A copy of the account, as a prepared method changes its own with every displacement."""
    return Account(dict(account.settings), dict(account.notices))
