"""The steps of a motion repeated, for data that are not stored while they are taken."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..methods import PreparedMethod
from ..repair.limit import Limit
from ..setup import BoundaryMotion, Setup, Start, Timing
from .course import Course
from .steps import Trial, accept, beginning, patient_step


def retraced(
    setup: Setup, motion: BoundaryMotion, method: PreparedMethod, fractions: Sequence[float]
) -> Iterator[Trial]:
    """The steps from the undeformed grid to some fractions of a motion, as they are accepted; ``method`` is prepared on
    that grid."""
    limit = Limit.of(setup.grid.n_nodes, setup.case.repair.time_limit)
    start = Start(setup.grid.points, method)
    course = Course(setup, motion, setup.grid.precision, Timing(), None, start, limit)
    course.latest.put(start.points, setup.case.method, method)
    state = beginning(course, setup.case.method)
    for fraction in fractions:
        trial = patient_step(state, fraction)
        yield trial
        state = accept(trial)
