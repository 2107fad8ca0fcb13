"""How a motion is imposed: in a given number of steps, or adaptively so that the grid stays valid.

The parameters were tuned together. How many large motions succeed, and what the attempts cost, is measured by
``studies/robustness_table.py`` and ``studies/default_method.py``; results are in docs/validity.md. Whoever changes one
number runs these studies for all of them.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator

from ..boundary.crossing import find_pinned
from ..errors import MethodError
from ..methods import Options
from ..notices import Notice
from ..repair.tuned import COLLAPSING
from .steps import (
    Course,
    Reached,
    State,
    Trial,
    accept,
    beginning,
    insist,
    plain_step,
    repaired,
    smallest_scaled,
    step,
    warnings_ahead,
)

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


def in_equal_steps(course: Course, count: int) -> Reached:
    """Impose the motion in as many steps as the user asked for, valid or not."""
    state = beginning(course, course.setup.case.method)
    course.warnings.extend(warnings_ahead(state, 1 / count))
    for number in range(1, count + 1):
        trial = step(state, number / count)
        # A repair that fails is repeated with a patient strategy.
        state = accept(insist(trial) if course.repairing and not trial.valid else trial)
    return Reached(state)


def adaptively(course: Course) -> Reached:
    """Impose the motion in one step if that keeps the grid valid; else halve this step and all that follow.

    Stops at the last valid grid when no step succeeds any more. A moving grid jumps where the number of steps changes,
    of which a series warns.
    """
    state = beginning(course, course.setup.case.method)
    # Steps that are halved until they succeed are never too large.
    course.warnings.extend(warnings_ahead(state, 0.0))
    smallest = 0.5**MAX_HALVINGS
    reached = _march(state, 1.0, smallest)
    if reached.failed:
        text = (
            f"only {reached.state.fraction:.1%} of the motion was imposed; a further step of {smallest:.2%} makes "
            "cells invalid. The grid reached so far is kept; another method, or planes that slide, may allow more"
        )
        course.warnings.append(Notice(text, "a part of the motion"))
    return reached


def _march(state: State, increment: float, smallest: float, growth: int = 1) -> Reached:
    """Take steps until the motion is complete or one of the ``smallest`` increment fails; others that fail are halved,
    and after one that succeeds the increment grows. With repairs it also ends when enough has been tried."""
    while state.fraction < 1.0 and not (state.course.repairing and _enough(state.course)):
        trial = step(state, min(1.0, state.fraction + increment))
        if trial.valid:
            state, increment = accept(trial), growth * increment
        elif increment > smallest:
            increment /= 2
        else:
            return Reached(state, trial)
    return Reached(state)


def until_valid(course: Course) -> Reached:
    """Try one step with a quick repair, then several with another method and no repair, then a patient repair, then
    smaller steps with a repair in each, and the same with the other method. If the boundary alone shows that no valid
    grid exists, only one step and a part of the motion are tried, each with a short repair.

    If the valid grid of one step is nearly collapsed, the best one of several methods is kept. If nothing succeeds, the
    grid with the fewest invalid cells is kept, with its boundary as prescribed; the warnings say why, and for which
    part of the motion a valid grid was found.
    """
    state = beginning(course, course.setup.case.method)
    course.warnings.extend(warnings_ahead(state, 0.0))
    plain = plain_step(state, 1.0)
    # Reasons visible in the boundary alone why no valid grid exists, and the part of the motion up to which there are
    # none.
    reasons, fraction = list[str](), 1.0
    if not plain.valid:
        setup, contact = course.setup, course.setup.undeformed.crossing_test.contact(course.path)
        pinned = find_pinned(setup.grid, setup.topology, setup.boundary, course.total)
        reasons = [found for found in (contact and contact.message, pinned) if found]
        fraction = contact.fraction if contact else 1.0
    best = repaired(plain, "hasty" if reasons else "quick")
    if reasons and not best.valid:
        course.warnings.extend(reasons)
        step(state, BEFORE * fraction, "hasty")
    elif not best.valid:
        found = _persistently(best)
        if isinstance(found, State):
            return Reached(found)
        best = found
    if best.valid and best.smallest_ratio < COLLAPSING and not (best.repair and best.repair.converged):
        stepped = _without_repairs(course)
        if stepped and stepped.last and smallest_scaled(course, stepped.last) > smallest_scaled(course, best.found):
            return Reached(stepped)
        for trial in _with_other_methods(course, SQUEEZED, best.state.options):
            if trial.valid and trial.smallest_ratio > best.smallest_ratio:
                best = trial
    if not best.valid:
        attempts = course.attempts
        reached = max((a.reached for a in attempts if not a.invalid_cells), default=0.0)
        if course.limit.exhausted:
            nodes = course.setup.grid.n_nodes
            text = f"the motion was given up after as much work as is done for {nodes:,} nodes (docs/validity.md)"
            course.warnings.append(Notice(text, "the limit on work"))
        elif course.limit.late:
            course.warnings.append(f"the time limit of {course.limit.seconds:g} s was reached ([repair] time_limit)")
        part = f"only for {reached:.1%} of it" if reached else "nor for any part of it that was tried"
        text = (
            f"no valid grid was found for the whole motion, {part}. The grid kept has the whole "
            f"motion and the fewest invalid cells of {len(attempts)} attempts"
        )
        course.warnings.append(Notice(text, "no valid grid"))
    return Reached(accept(best))


def _persistently(first: Trial) -> Trial | State:
    """After a failed quick repair: the best grid of one step, or the state that smaller steps have reached if that is
    the whole motion."""
    course, options = first.state.course, first.state.options
    if stepped := _without_repairs(course):
        return stepped
    best = first
    for trial in itertools.chain([first], _with_other_methods(course, (RESCUE,), options)):
        other = trial if trial.valid else insist(trial)
        if trial is first or other.invalid_cells < best.invalid_cells:
            best = other
        if best.valid:
            return best
        reached = _march(beginning(course, trial.state.options), 0.5, 0.5**MAX_REPAIRED_HALVINGS, growth=2).state
        if reached.fraction == 1.0:
            return reached
    return best


def _without_repairs(course: Course) -> State | None:
    """Equal steps with another method, of which only the last may be repaired; ``None`` if every number fails."""
    for count in RESCUE_STEPS:
        state = beginning(course, Options(RESCUE))
        for number in range(1, count + 1):
            if course.limit.reached:
                return None
            try:
                trial = plain_step(state, number / count)
            except MethodError as error:
                course.warnings.append(Notice(f"{RESCUE} was not tried: {error}", f"{RESCUE} not tried"))
                return None
            if not trial.valid:
                break
            state = accept(repaired(trial) if number == count else trial)
        if state.fraction == 1.0:
            return state
    return None


def _enough(course: Course) -> bool:
    return len(course.attempts) >= MAX_ATTEMPTS or course.limit.reached


def _with_other_methods(course: Course, names: tuple[str, ...], chosen: Options) -> Iterator[Trial]:
    """One step with each of the named methods, except the chosen one and any that does not fit into memory."""
    for name in names:
        if name == chosen.name or _enough(course):
            continue
        try:
            yield step(beginning(course, Options(name)), 1.0)
        except MethodError as error:
            course.warnings.append(Notice(f"{name} was not tried: {error}", f"{name} not tried"))
