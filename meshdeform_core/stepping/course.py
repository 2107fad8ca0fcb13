"""A motion to impose: data common to all of its steps, and the log of attempts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

import numpy as np

from ..boundary import Kind
from ..boundary.crossing import torn_faces
from ..boundary.motions.motion import far_motion, positions_as_displacements
from ..boundary.prescribed import largest_displacement
from ..grid import FloatArray
from ..grid.precision import rounded
from ..methods import Options, PreparedMethod, Progress
from ..notices import Notice, first_of_each_kind, kind_of
from ..parallel import Nodes
from ..repair.limit import Limit
from ..repair.onset import unhealthy_cells
from ..repair.options import Effort
from ..repair.outcome import Judged, Outcome
from ..repair.tuned import AS_PLANE, FARTHEST
from ..setup import BoundaryMotion, Setup, Start, Timing

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


@dataclass
class Log:
    """Attempts and warnings, in the order in which they were made."""

    attempts: list[Attempt] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def warn(self, *warnings: str) -> None:
        """Add warnings."""
        self.warnings += warnings


class LastPrepared:
    """The method prepared last and the grid that it was prepared on.

    Steps from the same grid share it. Only one is kept, as two dense systems may not fit into memory.
    """

    def __init__(self) -> None:
        self._last: tuple[FloatArray, Options, PreparedMethod] | None = None

    def get(self, points: FloatArray, options: Options) -> PreparedMethod | None:
        """The method prepared with these options on these coordinates, if it is the last one."""
        last = self._last
        return last[2] if last and last[0] is points and last[1] is options else None

    def put(self, points: FloatArray, options: Options, prepared: PreparedMethod | None) -> None:
        """Replace the method kept; ``None`` keeps none."""
        self._last = None if prepared is None else (points, options, prepared)


@dataclass(frozen=True, eq=False)
class Course:
    """A motion to impose on a set-up.

    Attributes
    ----------
    path : displacement of the boundary at a fraction of the motion
    precision : of the coordinates that will be written, to which verdicts apply
    start : the grid from which the motion is imposed
    limit : limit on the time and work of repairs and further attempts
    log : attempts and warnings
    """

    setup: Setup
    path: BoundaryMotion
    precision: str
    timing: Timing
    progress: Progress | None
    start: Start
    limit: Limit
    log: Log = field(default_factory=Log)
    latest: LastPrepared = field(default_factory=LastPrepared)

    @cached_property
    def total(self) -> FloatArray:
        """Displacement (n_unique, 3) of the boundary at the end of the motion."""
        return self.path(1.0)

    @cached_property
    def max_displacement(self) -> float:
        """Largest displacement of the boundary at the end of the motion."""
        return largest_displacement(self.total)

    @cached_property
    def begin(self) -> FloatArray:
        """Displacement (n_unique, 3) of the boundary in the starting grid, exactly zero if it is undeformed."""
        first, undeformed, points = self.setup.topology.first, self.setup.grid.points, self.start.points
        if points is undeformed:
            return np.broadcast_to(np.zeros(3), (len(first), 3))
        return np.asarray(Nodes.of(points).at(first) - Nodes.of(undeformed).at(first))

    def prescribed(self, fraction: float) -> FloatArray:
        """Boundary displacement (n_unique, 3) at a fraction of the motion: along the motion's path if it starts from
        the undeformed grid, otherwise linear."""
        if fraction == 1.0:
            return self.total
        if not self.begin.any():
            return self.path(fraction)
        return self.begin + fraction * (self.total - self.begin)

    def rounded(self, points: FloatArray) -> FloatArray:
        """Coordinates as they will be written."""
        found = rounded(points, self.precision)
        Nodes.of(found).keep_like(self.setup.grid.points)
        return found

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

    def repaired(self, start: Judged, effort: Effort, polish: bool) -> Outcome | None:
        """A repair of the grid at the ``start``; ``None`` if no cell needs it."""
        if not polish and start.verdict.valid and not unhealthy_cells(self.setup.original, start.points, AS_PLANE).size:
            return None
        return self.repairer.repair(start, polish, effort)

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
        found.append("nothing moves: the displacement is zero everywhere")
    elif not one_of_many:
        found += _coarsely_rounded(course)
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
            f"the plane follows there; its other nodes stay in it"
        )
        found.append(Notice(text, "motion out of a sliding plane"))
    return found


def _coarsely_rounded(course: Course) -> list[str]:
    """A warning if rounding coordinates to the precision of the output changes a visible part of the motion."""
    setup = course.setup
    moving = setup.topology.first[course.total.any(axis=1)]
    farthest = float(np.abs(setup.grid.points[moving]).max())
    unit = float(np.spacing(np.dtype(course.precision).type(farthest)))
    if course.max_displacement >= _FEWEST_UNITS * unit:
        return []
    remedy = "a grid nearer to the origin"
    if course.precision == "float32":
        remedy = "--variant precision=float64, or " + remedy
    return [
        f"coordinates of {farthest:.3g} in {course.precision} are multiples of {unit:.2g}, to which the motion of at "
        f"most {course.max_displacement:.3g} is rounded; more accurate: {remedy}"
    ]
