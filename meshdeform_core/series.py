"""A motion over time: one grid per time level, with everything that depends on the undeformed grid computed once."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from .boundary import Kind
from .deform import Result, Setup, Start, Timing, impose
from .errors import CaseError
from .grid import Field, FloatArray, IntArray
from .methods import PreparedMethod, Progress
from .numerics.arrays import lengths
from .parallel import Nodes
from .smoothness import Moment, Smoothness, shortest_edges, smoothness
from .velocity import PAST, VELOCITIES, face_fields, grid_velocity

REVISION = 18
"""Revision of the algorithms: a series is continued only by a program of the same revision.

Increase it with every change that gives a level of any series different coordinates or a different verdict.
"""

ORIGINS = ("reference", "last")
_RECENT = 2
"""Number of preceding levels needed for the smoothness of a level."""


@dataclass(frozen=True)
class Schedule:
    """The time levels and the grid from which each is made.

    Attributes
    ----------
    times : of the levels, ascending
    origin : ``reference``: every level is made from the undeformed grid, so that equal boundaries give equal grids;
        ``last``: each level from the previous one (marching), which reaches larger motions but drifts
    velocity : order of the backward differences of the grid velocity, ``swept``: with the volumes that faces sweep, or
        ``none``
    steps : increments of each level, or ``"auto"``; see :func:`meshdeform_core.deform.deform`
    """

    times: tuple[float, ...]
    origin: str = "reference"
    velocity: str = "none"
    steps: int | str | None = None

    def __post_init__(self) -> None:
        for name, value, known in (("origin", self.origin, ORIGINS), ("velocity", self.velocity, VELOCITIES)):
            if value not in known:
                raise CaseError(f"{name} = {value!r} of a series is unknown; known are {', '.join(known)}")
        if not self.times or not np.isfinite(self.times).all() or (np.diff(self.times) <= 0).any():
            shown = ", ".join(f"{t:g}" for t in self.times[:5])
            more = ", ..." if len(self.times) > 5 else ""
            raise CaseError(f"the times of a series must ascend; found [{shown}{more}]")

    def past(self, number: int) -> int:
        """Number of levels before level ``number`` that are needed to make it."""
        wanted = max(PAST[self.velocity], int(self.origin == "last"))
        return min(number, wanted)


@dataclass(frozen=True)
class Drift:
    """Distance (grid length unit) between a marched grid and the one made in one step from the undeformed grid."""

    max: float
    rms: float


class Made(NamedTuple):
    """How a level was made: ``plain`` and ``way`` as in :class:`Moment`."""

    plain: bool
    way: str


@dataclass(frozen=True)
class Level:
    """One time level.

    ``rotation`` is the largest rotation of a moving wall relative to the undeformed grid (degrees), ``velocity``
    (n_nodes, 3) the grid velocity, zero at the first level; ``faces`` are fields at the cell faces. ``made`` is what
    later levels need to know about this one in addition to its coordinates.
    """

    number: int
    time: float
    result: Result
    rotation: float
    drift: Drift | None
    velocity: FloatArray | None
    faces: tuple[Field, ...]
    timing: Timing
    smoothness: Smoothness
    made: Made


def deform_series(
    setup: Setup,
    schedule: Schedule,
    precision: str,
    progress: Progress | None = None,
    first: int = 0,
    finished: Callable[[int], FloatArray] | None = None,
    made: Sequence[Made] = (),
) -> Iterator[Level]:
    """Make the levels ``first``, ``first + 1``, ... in order; only the data that the next one needs are kept.

    An invalid level does not stop the series; its result says so. Times that a table does not cover are refused before
    the first level.

    Parameters
    ----------
    precision : of the files that will be written. Marching and velocities use the coordinates as written, so that
        they match the files and a continued series equals an uninterrupted one
    finished : returns the coordinates (n_nodes, 3), as written, of a level before ``first``; required if ``first``
        needs any
    made : how the levels before ``first`` were made, if ``finished`` can return their coordinates; without it, the
        smoothness is computed from ``first`` on only
    """
    for spec in setup.case.boundaries:
        if spec.motion:
            spec.motion.require(schedule.times)
    series = _Series(setup, schedule, precision, progress)
    past: list[FloatArray] = []
    if finished:
        read = max(schedule.past(first), min(len(made), _RECENT))
        past = series.recall([finished(n) for n in range(first - read, first)], first, made)
    for number in range(first, len(schedule.times)):
        level = series.level(number, past)
        yield level
        past = [*past, level.result.grid.points]
        past = past[len(past) - schedule.past(number + 1) :]


class _Series:
    """Data shared by all levels: the set-up and the method prepared on the undeformed grid."""

    def __init__(self, setup: Setup, schedule: Schedule, precision: str, progress: Progress | None):
        self.setup, self.schedule, self.precision, self.progress = setup, schedule, precision, progress
        self.problem = setup.problem
        self._reference: PreparedMethod | None = None
        self._recent: list[Moment] = []

    def recall(self, past: list[FloatArray], first: int, made: Sequence[Made]) -> list[FloatArray]:
        """Continue after the levels ``made``, with the coordinates ``past`` of the last ones; returns those that level
        ``first`` needs."""
        if made:
            numbers = range(first - min(first, _RECENT), first)
            self._recent = [
                Moment(self.schedule.times[n], past[n - first], made[n].plain, made[n].way) for n in numbers
            ]
        return past[len(past) - self.schedule.past(first) :]

    def level(self, number: int, past: list[FloatArray]) -> Level:
        setup, schedule = self.setup, self.schedule
        time, timing = schedule.times[number], Timing(progress=self.progress)
        if self._reference is None:
            with timing.stage("prepare"):
                self._reference = setup.prepare()
        reference = self._reference
        marching = schedule.origin == "last" and bool(past)
        start = Start(past[-1]) if marching else Start(setup.grid.points, reference)
        result = impose(setup, setup.motion(time), schedule.steps, self.precision, timing, self.progress, start)
        displacement = result.displacement[self.problem.source_numbers]
        drift = velocity = None
        if schedule.origin == "last":
            with timing.stage("drift"):
                drift = self._drift(result, reference.apply(displacement, self.progress))
        if schedule.velocity != "none":
            points = [*past, result.grid.points]
            velocity = grid_velocity(schedule.times[: number + 1], points, schedule.velocity)
        faces: tuple[Field, ...] = ()
        if schedule.velocity == "swept":
            with timing.stage("velocity"):
                faces = face_fields(setup.grid, schedule.times[: number + 1], [*past[-2:], result.grid.points])
        self._recent = [
            *self._recent[-_RECENT:],
            Moment(time, result.grid.points, result.repair is None and result.steps == 1, result.way),
        ]
        smooth = smoothness(self._recent, self._walls, self._edges)
        if smooth.warning:
            result = dataclasses.replace(result, warnings=(*result.warnings, smooth.warning))
        made = Made(self._recent[-1].plain, result.way)
        rotation = float(np.degrees(lengths(self.problem.rotations.vectors(displacement)).max()))
        return Level(number, time, result, rotation, drift, velocity, faces, timing, smooth, made)

    @cached_property
    def _walls(self) -> IntArray:
        boundary, topology = self.setup.boundary, self.setup.topology
        return np.asarray(topology.first[boundary.kind == Kind.MOVING])

    @cached_property
    def _edges(self) -> FloatArray:
        return shortest_edges(self.setup.grid)

    def _drift(self, result: Result, displacement: FloatArray) -> Drift:
        """The distance of a result from a ``displacement`` (n_nodes, 3), which is overwritten."""
        grid, end, squares = self.setup.grid, result.grid.points, displacement

        def fill(rows: slice) -> None:
            np.square(end[rows] - grid.points[rows] - displacement[rows], out=squares[rows])

        Nodes.of(squares).each(fill)
        low, high = Nodes.of(squares).ends
        largest = max(Nodes.of(squares).gather(float(squares[low:high].sum(axis=1).max(initial=0.0))))
        return Drift(math.sqrt(largest), math.sqrt(grid.total_of(squares).sum() / grid.n_nodes))
