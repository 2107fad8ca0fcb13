"""Whether the minimum that a repair has found is the only one: another start is tried where that costs little.

No number of starts proves that there is no other minimum. The two that occur in practice are compared: the grid of the
method alone, from which a single run starts, and the repaired grid of a part of the motion, from which a level of a
series starts.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from ..grid import FloatArray
from ..notices import Notice
from ..numerics.arrays import lengths
from ..parallel import combined, of_all, own_rows
from ..quality.verdict.validity import Verdict, judge
from ..repair.outcome import Outcome
from ..smoothness import shortest_edges
from .course import Course
from .steps import Trial, prepared_on
from .tuned import EFFORT, ENOUGH, FOLLOWED, NEAR, PART, PARTS, SAME, SHORTEST, STEPS


def compared(trial: Trial) -> Trial:
    """The trial with ``repair.unique`` set if another start was tried; warns if that led to a different minimum."""
    course, repair = trial.state.course, trial.repair
    if repair is None or not repair.converged or course.polishing or course.limit.reached:
        return trial
    with course.timing.stage("repair"):
        other = _from_another_start(trial)
        if other is None or not other.repair.converged:
            return trial
        distance = _distance(trial, other.points)
    if distance > SAME:
        text = (
            f"the repair has several solutions here: another start leads to a valid grid that differs by up to "
            f"{distance:.3g} local edges, and grids of nearly the same displacement may differ as much"
        )
        course.log.warn(Notice(text, "several solutions of a repair"))
    return dataclasses.replace(trial, repair=dataclasses.replace(repair, unique=distance <= SAME))


def _from_another_start(trial: Trial) -> Outcome | None:
    course, plain = trial.state.course, trial.plain
    if course.start.correction() is not None:
        if not course.start.compare:
            return None
        return course.repairer.repair(plain.points, plain.verdict, ways=(), close=ENOUGH)
    if plain.verdict.valid or course.repairer.size > FOLLOWED:
        return None
    return _follow(trial)


def _follow(trial: Trial) -> Outcome | None:
    """The minimum at the end of the motion, followed from a part of the motion at which the method keeps cells valid.

    Every step is short enough for the grid to remain valid with the previous repair, or one extrapolated from two.
    ``None`` if that fails, or takes too long.
    """
    course, repairer = trial.state.course, trial.state.course.repairer
    parts = (PART**power for power in range(1, PARTS + 1))
    reached = next((part for part in parts if _verdict(course, _plain(trial, part)).valid), None)
    if reached is None:
        return None
    start = _plain(trial, reached)
    outcome, step = repairer.repair(start, _verdict(course, start), ways=(), close=NEAR), 1.0 - PART
    path = [(reached, combined(np.subtract, outcome.points, start))]
    spent = outcome.repair.newton_steps
    for _ in range(STEPS):
        if reached == 1.0 or step < SHORTEST or spent > EFFORT:
            break
        part = min(1.0, reached + step)
        plain, found = _plain(trial, part), None
        guesses = (guess for guess in _guesses(path, part) if _verdict(course, combined(np.add, plain, guess)).valid)
        if (guess := next(guesses, None)) is not None:
            close = NEAR if part < 1.0 else ENOUGH
            found = repairer.repair(plain, _verdict(course, plain), ways=(), guess=guess, close=close)
            spent += found.repair.newton_steps
        if found and found.repair.converged:
            path = [path[-1], (part, combined(np.subtract, found.points, plain))]
            outcome, reached, step = found, part, 1.5 * step
        else:
            step /= 2
    return outcome if reached == 1.0 else None


def _guesses(path: list[tuple[float, FloatArray]], part: float) -> Iterator[FloatArray]:
    """The repair (n_nodes, 3) to be expected at a part of the motion after those at one or two smaller ones:
    extrapolated, and the last one."""
    (before, first), (reached, last) = path[0], path[-1]
    if before < reached:
        far = (part - reached) / (reached - before)
        yield combined(lambda a, b, out: np.copyto(out, b + far * (b - a)), first, last)
    yield last


def _verdict(course: Course, points: FloatArray) -> Verdict:
    return judge(course.setup.original, course.rounded(points))


def _plain(trial: Trial, fraction: float) -> FloatArray:
    """The method's grid (n_nodes, 3) at a fraction of the motion."""
    state, course = trial.state, trial.state.course
    part = (course.prescribed(fraction) - state.moved)[course.setup.problem.source_numbers]
    return combined(np.add, state.points, prepared_on(state).apply(part, course.progress))


def _distance(trial: Trial, points: FloatArray) -> float:
    """The largest distance of a node from its position in ``points`` (n_nodes, 3), relative to local edges."""
    edges, (low, high) = shortest_edges(trial.state.course.setup.grid), own_rows(points)
    apart = lengths(trial.found.points[low:high] - points[low:high]) / edges
    return max(of_all(points, float(apart.max(initial=0.0))))
