"""A motion over time: one grid per time level, each made from the undeformed grid, so that equal boundaries give equal
grids; everything that depends on the undeformed grid only is computed once."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .boundary import Kind
from .deform import Result, Setup, Timing, impose
from .errors import CaseError
from .grid import Field, FloatArray
from .methods import PreparedMethod, Progress
from .velocity import PAST, VELOCITIES, Moment, Smoothness, face_fields, grid_velocity, shortest_edges, smoothness

REVISION = 23
"""Revision of the algorithms: a series is continued only by a program of the same revision.

Increase it with every change that gives a level of any series different coordinates or a different verdict.
"""

_RECENT = 2
"""Number of preceding levels needed for the smoothness of a level, and at most for its velocities."""


@dataclass(frozen=True)
class Schedule:
    """The time levels, and what is made at each.

    Attributes
    ----------
    times : of the levels, ascending
    velocity : order of the backward differences of the grid velocity, ``swept``: with the volumes that faces sweep, or
        ``none``
    steps : increments of each level, or ``"auto"``; see :func:`meshdeform_core.deform.deform`
    """

    times: tuple[float, ...]
    velocity: str = "none"
    steps: int | str | None = None

    def __post_init__(self) -> None:
        if self.velocity not in VELOCITIES:
            known = ", ".join(VELOCITIES)
            raise CaseError(f"velocity = {self.velocity!r} of a series is unknown; known are {known}")
        if not self.times or not np.isfinite(self.times).all() or (np.diff(self.times) <= 0).any():
            shown = ", ".join(f"{t:g}" for t in self.times[:5])
            more = ", ..." if len(self.times) > 5 else ""
            raise CaseError(f"the times of a series must ascend; found [{shown}{more}]")

    def past(self, number: int) -> int:
        """Number of levels before level ``number`` that are needed to make it."""
        return min(number, PAST[self.velocity])


@dataclass(frozen=True)
class Level:
    """One time level.

    ``velocity`` (n_nodes, 3) is the grid velocity, zero at the first level; ``faces`` are fields at the cell faces.
    """

    number: int
    time: float
    result: Result
    velocity: FloatArray | None
    faces: tuple[Field, ...]
    smoothness: Smoothness


def deform_series(
    setup: Setup,
    schedule: Schedule,
    precision: str,
    progress: Progress | None = None,
    first: int = 0,
    finished: Callable[[int], FloatArray] | None = None,
    plain: Sequence[bool] = (),
) -> Iterator[Level]:
    """Make the levels ``first``, ``first + 1``, ... in order; only the data that the next one needs are kept.

    An invalid level does not stop the series; its result says so. Times that a table does not cover are refused before
    the first level.

    Parameters
    ----------
    precision : of the files that will be written. Velocities use the coordinates as written, so that they match the
        files and a continued series equals an uninterrupted one
    finished : returns the coordinates (n_nodes, 3), as written, of a level before ``first``; required if ``first``
        needs any
    plain : for each level before ``first``, see :class:`.Moment`, if ``finished`` can return their coordinates
    """
    for spec in setup.case.boundaries:
        if spec.motion:
            spec.motion.require(schedule.times)
    times, walls = schedule.times, setup.topology.first[setup.boundary.kind == Kind.MOVING]
    recent = list[Moment]()
    if finished:
        read = range(first - max(schedule.past(first), min(len(plain), _RECENT)), first)
        recent = [Moment(times[n], finished(n), bool(plain) and plain[n]) for n in read]
    prepared: PreparedMethod | None = None
    edges: FloatArray | None = None
    for number in range(first, len(times)):
        known, timing = times[: number + 1], Timing(progress=progress)
        if prepared is None:
            with timing.stage("prepare"):
                prepared = setup.prepare()
        result = impose(setup, setup.motion(times[number]), schedule.steps, precision, timing, progress, prepared)
        plainly = result.repair is None and result.steps == 1
        recent = [*recent[-_RECENT:], Moment(times[number], result.grid.points, plainly)]
        last = [moment.points for moment in recent[-1 - schedule.past(number) :]]
        velocity, faces = None, tuple[Field, ...]()
        if schedule.velocity != "none":
            velocity = grid_velocity(known, last, schedule.velocity)
        if schedule.velocity == "swept":
            with timing.stage("velocity"):
                faces = face_fields(setup.grid, known, last)
        edges = shortest_edges(setup.grid) if edges is None else edges
        smooth = smoothness(recent, walls, edges)
        if smooth.warning:
            result = dataclasses.replace(result, warnings=(*result.warnings, smooth.warning))
        yield Level(number, times[number], result, velocity, faces, smooth)
