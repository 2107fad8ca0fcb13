"""A grid and its case, everything that is known before the boundary moves; and what a deformation of them returns."""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import TYPE_CHECKING

from .boundary import BoundarySpec
from .boundary.classification import largest_displacement, prescribed_displacement
from .boundary.crossing import Contact, Crossing, CrossingTest
from .errors import CaseError
from .grid import FloatArray, Grid
from .grid.selection import Components
from .grid.topology import RELATIVE_TOLERANCE
from .memory import release_freed
from .methods import Account, Options, PreparedMethod, Problem, Progress, prepare_method
from .methods.limits import PatchMotion
from .numerics.jit import compile_clock
from .quality import Assessment, Original
from .repair import Mode, RepairOptions
from .repair.outcome import Repair

if TYPE_CHECKING:
    from .repair.region import Basis

BoundaryMotion = Callable[[float], FloatArray]
"""``motion(fraction)``: displacement (n_unique, 3) of all face nodes for that fraction of the motion."""


@dataclass(frozen=True)
class Case:
    """Boundary entries, the constants of their formulas, the method and the repair options.

    ``tolerance`` is the largest distance between coincident nodes, relative to the local edge; ``notes`` are warnings
    from reading the case, for the report; ``open_faces`` are outside faces (``True``: all) that are meant to lie close
    to others; ``plates`` are faces between blocks that are walls on both sides; ``components`` are those of an overset
    grid, see :func:`.grid.components.with_components`.
    """

    boundaries: tuple[BoundarySpec, ...]
    constants: Mapping[str, float] = field(default_factory=dict)
    method: Options = field(default_factory=Options)
    tolerance: float = RELATIVE_TOLERANCE
    notes: tuple[str, ...] = ()
    open_faces: bool | tuple[str, ...] = False
    repair: RepairOptions = field(default_factory=RepairOptions)
    plates: tuple[str, ...] = ()
    components: Components = ""

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
    """Seconds spent per stage; compiling loops, once per installation, is the stage ``compile`` wherever it happens.

    ``progress`` is called when a stage begins; memory that earlier ones have freed goes back to the system.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    progress: Progress | None = None

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        if self.progress:
            self.progress(name, 0, 0)
        release_freed()
        start, before = clock.perf_counter(), compile_clock.seconds
        try:
            yield
        finally:
            compiling = compile_clock.seconds - before
            spent = {name: clock.perf_counter() - start - compiling} | ({"compile": compiling} if compiling else {})
            for each, seconds in spent.items():
                self.seconds[each] = self.seconds.get(each, 0.0) + max(seconds, 0.0)


@dataclass(frozen=True, eq=False, repr=False)
class Undeformed(Problem):
    """The undeformed grid and its classified boundary, with data computed from them on first use.

    Set-ups that differ in the method or the repair mode share it. ``min_jacobian``: cells with a corner below this
    fraction of its undeformed Jacobian count as invalid.
    """

    min_jacobian: float = 0.0

    @cached_property
    def original(self) -> Original:
        """The undeformed cells, against which every result is judged."""
        return Original(self.grid, self.topology, self.min_jacobian)

    @cached_property
    def _crossing_test(self) -> CrossingTest:
        return CrossingTest(self.grid, self.topology, self.boundary)

    def crossings(self, displacement: FloatArray) -> tuple[Crossing, ...]:
        """Where the boundary crosses itself after a displacement (n_unique, 3), see :class:`.CrossingTest`."""
        return self._crossing_test.crossings(displacement)

    def contact(self, path: BoundaryMotion) -> Contact | None:
        """The first contact of the boundary with itself on a path, see :meth:`.CrossingTest.contact`."""
        return self._crossing_test.contact(path)

    @cached_property
    def repairs(self) -> Basis:
        """Data that all repairs share."""
        # Imported late, as its loops take time to load, which most motions do not need.
        from .repair.region import Basis

        return Basis(self.original, self.boundary)

    def prepare(self, options: Options) -> PreparedMethod:
        """The method that ``options`` describe, bound to the grid."""
        return prepare_method(options, self)


@dataclass(eq=False, repr=False)
class Setup:
    """A grid with everything that is known before the boundary moves; ``--dry-run`` shows it.

    ``problem``, the input of a method's ``prepare``, is the ``undeformed`` grid, whose are ``grid``, ``topology``,
    ``boundary`` and ``memory``.
    """

    undeformed: Undeformed
    case: Case
    warnings: tuple[str, ...]

    def __post_init__(self) -> None:
        self.grid, self.topology = self.undeformed.grid, self.undeformed.topology
        self.boundary, self.memory = self.undeformed.boundary, self.undeformed.memory
        self.problem: Problem = self.undeformed

    def __repr__(self) -> str:
        return f"Setup({self.grid!r}, {self.case.method.name})"

    @property
    def original(self) -> Original:
        """The undeformed cells, against which every result is judged."""
        return self.undeformed.original

    def prepare(self) -> PreparedMethod:
        """The method of the case, bound to the grid."""
        return self.undeformed.prepare(self.case.method)

    def with_repair(self, mode: Mode) -> Setup:
        """The set-up with another repair mode."""
        repair = dataclasses.replace(self.case.repair, mode=mode)
        return dataclasses.replace(self, case=dataclasses.replace(self.case, repair=repair))

    def displacement(self, time: float, fraction: float = 1.0) -> FloatArray:
        """Prescribed displacement of all unique face nodes (n_unique, 3)."""
        return prescribed_displacement(self.grid, self.topology, self.boundary, time, fraction)

    def motion(self, time: float) -> BoundaryMotion:
        """The case's motion at ``time``."""
        return partial(self.displacement, time)


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


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A deformed grid, how it was made and how good it is.

    ``reached`` is the fraction of the motion that was imposed: below 1 only when marching stopped before a step that
    would have made cells invalid; the invalid cells of the assessment are then those of that step. ``displacement``
    (n_unique, 3) is that of the boundary at the end of the motion. ``attempts`` lists the steps that were tried, in
    order; ``repair`` summarises the repairs of the steps that led to the grid, or is ``None``. Each of the named
    ``components`` of an overset grid has a result of its own.
    """

    setup: Setup
    grid: Grid
    assessment: Assessment
    account: Account
    steps: int
    reached: float
    displacement: FloatArray
    timing: Timing
    warnings: tuple[str, ...]
    motion: tuple[PatchMotion, ...] = ()
    attempts: tuple[Attempt, ...] = ()
    repair: Repair | None = None
    components: tuple[tuple[str, Result], ...] = ()

    def __repr__(self) -> str:
        return f"Result(valid={self.valid}, steps={self.steps}, reached={self.reached:g})"

    @property
    def max_displacement(self) -> float:
        """Largest displacement of the boundary."""
        return largest_displacement(self.displacement)

    @property
    def valid(self) -> bool:
        """Whether the whole motion was imposed and no cell became invalid."""
        return self.reached == 1.0 and self.assessment.valid
