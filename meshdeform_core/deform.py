"""The program: a grid, its boundary and a method give a deformed grid and a verdict."""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from .boundary import Boundary, BoundarySpec, Kind, classify
from .boundary.classification import UNSELECTED
from .boundary.prescribed import prescribed_displacement
from .boundary.unselected import opening_notes
from .errors import CaseError, MotionError
from .grid import FloatArray, Grid
from .grid.connectivity import check_connections
from .grid.extent import require_extent
from .grid.openings import find_openings
from .grid.topology import RELATIVE_TOLERANCE, Topology, find_topology
from .memory import UNLIMITED, MemoryLimit
from .methods import Account, Options, PreparedMethod, Problem, Progress, make_method
from .methods.limits import PatchMotion, patch_motions
from .numerics.jit import compile_seconds
from .parallel import current_ranks, empty, for_rows
from .quality import Assessment, Original, assess
from .quality.validity import newly_invalid

MAX_HALVINGS = 8

BoundaryMotion = Callable[[float], FloatArray]
"""``motion(fraction)``: displacement (n_unique, 3) of all face nodes with that fraction of the motion imposed."""


@dataclass(frozen=True)
class Case:
    """What to do with a grid: its boundary entries, the constants of their formulas, the method.

    ``tolerance`` is the largest distance of coincident nodes, relative to the local edge; ``notes`` are doubts that
    came up when the case was made, for the report's warnings; ``open_faces`` are outside faces (``True``: all) that are
    meant to lie close to others.
    """

    boundaries: tuple[BoundarySpec, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    method: Options = field(default_factory=Options)
    tolerance: float = RELATIVE_TOLERANCE
    notes: tuple[str, ...] = ()
    open_faces: bool | tuple[str, ...] = False

    def __post_init__(self) -> None:
        if not isinstance(self.method, Options):
            raise CaseError(f"method = {self.method!r} of a case; expected Options, like Options('idw-tfi')")
        if not all(isinstance(spec, BoundarySpec) for spec in self.boundaries):
            raise CaseError(f"boundaries = {self.boundaries!r} of a case; expected BoundarySpec entries")

    @property
    def depends_on_time(self) -> bool:
        """Whether any motion uses t."""
        return any("t" in spec.motion.names for spec in self.boundaries if spec.motion)


@dataclass
class Timing:
    """Seconds spent per stage; compiling loops, once per installation, is the stage ``compile`` wherever it happens."""

    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        start, before = clock.perf_counter(), compile_seconds()
        try:
            yield
        finally:
            compiling = compile_seconds() - before
            self._add(name, clock.perf_counter() - start - compiling)
            if compiling:
                self._add("compile", compiling)

    def _add(self, name: str, seconds: float) -> None:
        self.seconds[name] = self.seconds.get(name, 0.0) + max(seconds, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class Setup:
    """A grid with everything that is known before anything moves; what ``--dry-run`` shows."""

    grid: Grid
    case: Case
    topology: Topology
    boundary: Boundary
    warnings: tuple[str, ...]
    memory: MemoryLimit = UNLIMITED

    def __repr__(self) -> str:
        return f"Setup({self.grid!r}, {self.case.method.name})"

    @cached_property
    def problem(self) -> Problem:
        """What methods are prepared on."""
        return Problem(self.grid, self.topology, self.boundary, self.memory)

    @cached_property
    def original(self) -> Original:
        """The undeformed cells, against which every result is judged."""
        return Original(self.grid, self.topology)

    def displacement(self, time: float, fraction: float = 1.0) -> FloatArray:
        """Prescribed displacement of all unique face nodes (n_unique, 3)."""
        return prescribed_displacement(self.grid, self.topology, self.boundary, time, fraction)

    def motion(self, time: float) -> BoundaryMotion:
        """The case's motion as it is at ``time``."""
        return partial(self.displacement, time)


@dataclass(frozen=True)
class Start:
    """Where a motion sets out when it is a level of a series.

    ``points`` (n_nodes, 3) are the undeformed coordinates or those of an earlier level; ``prepared`` is the method
    prepared on them, if it already is.
    """

    points: FloatArray
    prepared: PreparedMethod | None = None


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A deformed grid, how it was made and how good it is.

    ``reached`` is the fraction of the motion that was imposed: below 1 only when marching stopped before a step that
    would have made cells invalid; the invalid cells of the assessment are then those of that step.
    """

    setup: Setup
    grid: Grid
    assessment: Assessment
    account: Account
    steps: int
    reached: float
    max_displacement: float
    timing: Timing
    warnings: tuple[str, ...]
    motion: tuple[PatchMotion, ...] = ()

    def __repr__(self) -> str:
        return f"Result(valid={self.valid}, steps={self.steps}, reached={self.reached:g})"

    @property
    def valid(self) -> bool:
        """The whole motion was imposed and no cell became invalid."""
        return self.reached == 1.0 and self.assessment.valid


def set_up(grid: Grid, case: Case, timing: Timing | None = None, memory: MemoryLimit = UNLIMITED) -> Setup:
    """Find the topology and classify the boundary; ``memory`` is what the method may take beside the grid.

    Raises
    ------
    CaseError, MotionError
        When a boundary entry matches nothing or no node would move.
    """
    timing = timing or Timing()
    require_extent(grid)
    with timing.stage("topology"):
        topology = current_ranks().once(lambda: find_topology(grid, case.tolerance))
        warnings = [*grid.notes, *case.notes, *check_connections(grid, topology)]
        if topology.crowded:
            warnings.append(f"{topology.crowded} face quads are shared by more than two blocks")
        openings = current_ranks().once(lambda: find_openings(grid, topology))
        topology, boundary = classify(grid, topology, case.boundaries, case.constants)
        unselected = boundary.quads_of(lambda patch: patch.name == UNSELECTED)
        moving = boundary.quads_of(lambda patch: patch.kind is Kind.MOVING)
        warnings += opening_notes(grid, topology, openings, unselected, moving, case.open_faces)
    if not boundary.count(Kind.MOVING):
        raise MotionError(
            "no node moves: no boundary entry of kind moving selects any node; "
            'expected a [[boundary]] with kind = "moving" and a motion, or a displacement table'
        )
    return Setup(grid, case, topology, boundary, (*warnings, *boundary.notes), memory)


def deform(
    grid: Grid,
    case: Case,
    *,
    time: float = 0.0,
    steps: int | str = 1,
    precision: str | None = None,
    memory: MemoryLimit = UNLIMITED,
    progress: Progress | None = None,
    warn: Callable[[Sequence[str]], object] | None = None,
) -> Result:
    """Deform ``grid`` as ``case`` says and judge the result.

    Parameters
    ----------
    time : at which motions are evaluated
    steps : increments, each from the last grid; ``"auto"`` halves them until the grid stays valid
    precision : ``float32`` or ``float64`` of the file that will be written (default: the grid's own); the verdict is
        about the coordinates as written
    memory : what the method may take beside the grid
    warn : called with the warnings of the set-up, which the result has too, before anything is computed

    Raises
    ------
    MeshDeformError
        For anything that is the input's fault.
    """
    timing = Timing()
    setup = set_up(grid, case, timing, memory)
    if warn:
        warn(setup.warnings)
    return impose(setup, setup.motion(time), steps, precision or grid.precision, timing, progress)


def impose(
    setup: Setup,
    motion: BoundaryMotion,
    steps: int | str,
    precision: str,
    timing: Timing,
    progress: Progress | None = None,
    start: Start | None = None,
) -> Result:
    """Impose a motion of the boundary, from the undeformed grid or from ``start``; see :func:`deform`."""
    march = _March(setup, motion, precision, timing, progress, start)
    if steps == "auto":
        march.adaptively()
    elif isinstance(steps, int) and steps > 0:
        march.in_equal_steps(steps)
    else:
        raise CaseError(f'steps = {steps!r}; expected a whole number >= 1 or "auto"')
    return march.result()


class _March:
    """A motion imposed step by step, each step from the last grid."""

    def __init__(
        self,
        setup: Setup,
        motion: BoundaryMotion,
        precision: str,
        timing: Timing,
        progress: Progress | None,
        start: Start | None = None,
    ):
        self.setup, self.motion, self.precision = setup, motion, precision
        self.timing, self.progress = timing, progress
        self.fraction, self.steps = 0.0, 0
        self.points = start.points if start else setup.grid.points
        # Exactly zero from the undeformed grid.
        first = setup.topology.first
        self.begin = self.points[first] - setup.grid.points[first]
        self.moved = self.begin
        self.failed: FloatArray | None = None
        self.first_bad: dict[int, int] = {}
        self.warnings = list(setup.warnings)
        self.notices: dict[str, str] = {}
        self._prepared: tuple[FloatArray, PreparedMethod] | None = None
        if start and start.prepared:
            self._prepared = start.points, start.prepared
        self._inspect_motion(alone=start is None)

    def _inspect_motion(self, alone: bool) -> None:
        self.total = self.motion(1.0)
        self.max_displacement = float(np.linalg.norm(self.total, axis=1).max())
        # A level of a series may stand still.
        if alone and self.max_displacement == 0.0:
            self.warnings.append("nothing moves: the displacement is zero everywhere")
        departure = self.setup.boundary.slip.departure(self.total)
        # A motion that comes back to nothing leaves round-off in all directions.
        boundary = self.setup.grid.points[self.setup.topology.first]
        round_off = 1e-12 * float(np.ptp(boundary, axis=0).max())
        if departure > max(1e-6 * self.max_displacement, round_off):
            self.warnings.append(
                f"the motion carries nodes out of a slip or symmetry plane by up to {departure:.3g}; "
                f"the plane follows there, its other nodes stay in it"
            )

    def in_equal_steps(self, count: int) -> None:
        self._foresee(1 / count)
        for step in range(1, count + 1):
            self._accept(step / count, self._trial(step / count))

    def adaptively(self) -> None:
        """In one step if that keeps the grid valid; a step that breaks cells, and all that follow, are halved."""
        # Steps that are halved until they succeed are never too large.
        self._foresee(0.0)
        increment, smallest = 1.0, 0.5**MAX_HALVINGS
        while self.fraction < 1.0:
            target = min(1.0, self.fraction + increment)
            points = self._trial(target)
            if not newly_invalid(self.setup.original, self._rounded(points)).size:
                self._accept(target, points)
            elif increment > smallest:
                increment /= 2
            else:
                self.failed = points
                self.warnings.append(
                    f"the motion was imposed to {self.fraction:.1%} only; a step of {increment:.2%} more makes cells "
                    f"invalid. The grid reached so far is kept"
                )
                return

    def _foresee(self, first: float) -> None:
        sources = self.setup.problem.source_numbers
        motion, step = ((self._prescribed(part) - self.moved)[sources] for part in (1.0, first))
        self.warnings += self._method().foresee(motion, step)

    def _trial(self, fraction: float) -> FloatArray:
        """Coordinates after going from the current grid to ``fraction`` of the motion."""
        setup = self.setup
        prepared = self._method()
        increment = (self._prescribed(fraction) - self.moved)[setup.problem.source_numbers]
        with self.timing.stage("apply"):
            moved = prepared.apply(increment, self.progress)
            for_rows(lambda rows: np.add(self.points[rows], moved[rows], out=moved[rows]), moved)
            return moved

    def _prescribed(self, fraction: float) -> FloatArray:
        """Boundary displacement part of the way: on the motion's own path from the undeformed grid, else straight."""
        if fraction == 1.0:
            return self.total
        if not self.begin.any():
            return self.motion(fraction)
        return self.begin + fraction * (self.total - self.begin)

    def _method(self) -> PreparedMethod:
        """The method prepared on the current grid; kept while trials start from the same grid."""
        if self._prepared is None or self._prepared[0] is not self.points:
            with self.timing.stage("prepare"):
                problem = dataclasses.replace(self.setup.problem, grid=self.setup.grid.moved(self.points))
                self._prepared = self.points, make_method(self.setup.case.method).prepare(problem)
        return self._prepared[1]

    def _accept(self, fraction: float, points: FloatArray) -> None:
        self.moved = self._prescribed(fraction)
        self.account = self._method().account
        self.notices |= self.account.notices
        self.points, self.fraction, self.steps = points, fraction, self.steps + 1
        if fraction == 1.0:
            # What the last step broke, the assessment finds.
            return
        with self.timing.stage("quality"):
            for cell in newly_invalid(self.setup.original, points).tolist():
                self.first_bad.setdefault(cell, self.steps)

    def _rounded(self, points: FloatArray) -> FloatArray:
        if self.precision != "float32":
            return points
        rounded: FloatArray = empty(points.shape)
        for_rows(lambda rows: np.copyto(rounded[rows], points[rows].astype(np.float32)), rounded)
        return rounded

    def result(self) -> Result:
        setup = self.setup
        final = self._rounded(self.points)
        with self.timing.stage("quality"):
            assessment = assess(setup.original, final, setup.boundary)
            if self.failed is not None:
                # The kept grid is valid; what the user needs to know is which cells the next step would break.
                broken = assess(setup.original, self._rounded(self.failed), setup.boundary)
                assessment = dataclasses.replace(assessment, invalid=broken.invalid, groups=broken.groups)
            assessment = assessment.with_steps(setup.grid, self.first_bad, self.steps + (self.failed is not None))
        return Result(
            setup,
            setup.grid.moved(final),
            assessment,
            self.account if self.steps else self._method().account,
            self.steps,
            self.fraction,
            self.max_displacement,
            self.timing,
            (*self.warnings, *self.notices.values()),
            patch_motions(setup.problem, self.total),
        )
