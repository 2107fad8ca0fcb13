"""The program: a grid, its boundary and a method give a deformed grid and a verdict."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .attempts import adaptively, in_equal_steps, until_valid
from .boundary.crossing import Crossing, find_crossings
from .errors import CaseError
from .grid import Grid
from .march import Attempt, March
from .memory import UNLIMITED, MemoryLimit
from .methods import Account, Progress
from .methods.limits import PatchMotion, patch_motions
from .notices import Notice
from .parallel import Task
from .quality import Assessment, assess
from .repair.repair import COLLAPSING, Repair
from .setup import BoundaryMotion, Case, Setup, Start, Timing, set_up

# Larger by this factor than those tested before, a displacement is tested for a boundary that crosses itself.
_GROWTH = 1.25

__all__ = [
    "Attempt",
    "BoundaryMotion",
    "Case",
    "Repair",
    "Result",
    "Setup",
    "Start",
    "Timing",
    "deform",
    "impose",
    "set_up",
]


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A deformed grid, how it was made and how good it is.

    ``reached`` is the fraction of the motion that was imposed: below 1 only when marching stopped before a step that
    would have made cells invalid; the invalid cells of the assessment are then those of that step. ``attempts`` lists
    the steps that were tried, in order; ``repair`` summarises the repairs made, or is ``None``.
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
    attempts: tuple[Attempt, ...] = ()
    repair: Repair | None = None

    def __repr__(self) -> str:
        return f"Result(valid={self.valid}, steps={self.steps}, reached={self.reached:g})"

    @property
    def valid(self) -> bool:
        """Whether the whole motion was imposed and no cell became invalid."""
        return self.reached == 1.0 and self.assessment.valid


def deform(
    grid: Grid,
    case: Case,
    *,
    time: float = 0.0,
    steps: int | str | None = None,
    precision: str | None = None,
    memory: MemoryLimit = UNLIMITED,
    progress: Progress | None = None,
    warn: Callable[[Sequence[str]], object] | None = None,
) -> Result:
    """Deform ``grid`` according to ``case`` and judge the result.

    Parameters
    ----------
    time : at which motions are evaluated
    steps : number of increments, each from the last grid; ``"auto"``: as many as it takes. ``None`` is one step if
        ``case.repair`` is off and ``"auto"`` otherwise
    precision : ``float32`` or ``float64`` of the file that will be written (default: the grid's own); the verdict
        applies to the coordinates as written
    memory : limit for the method, in addition to the grid
    warn : called with the warnings of the set-up (also part of the result) before anything is computed

    Raises
    ------
    MeshDeformError
        For any fault of the input.
    """
    timing = Timing(progress=progress)
    setup = set_up(grid, case, timing, memory)
    if warn:
        warn(setup.warnings)
    return impose(setup, setup.motion(time), steps, precision or grid.precision, timing, progress)


def impose(
    setup: Setup,
    motion: BoundaryMotion,
    steps: int | str | None,
    precision: str,
    timing: Timing,
    progress: Progress | None = None,
    start: Start | None = None,
) -> Result:
    """Impose a motion of the boundary, from the undeformed grid or from ``start``; see :func:`deform`."""
    march = March(setup, motion, precision, timing, progress, start)
    beside = _Beside.begun(march)
    repairs = setup.case.repair.mode != "off"
    if steps is None:
        steps = "auto" if repairs else 1
    if steps == "auto":
        until_valid(march) if repairs else adaptively(march)
    elif isinstance(steps, int) and steps > 0:
        in_equal_steps(march, steps)
    else:
        raise CaseError(f'steps = {steps!r}; expected a whole number >= 1 or "auto"')
    return _result(march, beside)


def _result(march: March, beside: _Beside) -> Result:
    setup, last = march.setup, march.last
    final = march.rounded(march.points)
    with march.timing.stage("quality"):
        assessment = assess(setup.original, final, setup.boundary, last.cells if last else None)
        if march.failed is not None:
            # The kept grid is valid; the user needs to know which cells the next step would break.
            broken = assess(setup.original, march.rounded(march.failed.points), setup.boundary, march.failed.cells)
            assessment = dataclasses.replace(assessment, invalid=broken.invalid, groups=broken.groups)
        assessment = assessment.with_steps(setup.grid, march.first_bad, march.steps + (march.failed is not None))
    return Result(
        setup,
        setup.grid.moved(final),
        assessment,
        march.account,
        march.steps,
        march.fraction,
        march.max_displacement,
        march.timing,
        (
            *march.warnings,
            *march.notices.values(),
            *_nearly_collapsed(assessment),
            *_overlaps(march, assessment, beside),
        ),
        beside.motions.result(),
        tuple(march.attempts),
        sum(march.repairs[1:], march.repairs[0]) if march.repairs else None,
    )


@dataclass(frozen=True)
class _Beside:
    """What is found of the moving boundary alone, beside the deformation of the grid.

    ``crossings`` are where it crosses itself. Of the levels of a series, those are examined whose displacement is
    larger than at the levels before; ``None`` for the others.
    """

    motions: Task[tuple[PatchMotion, ...]]
    crossings: Task[tuple[Crossing, ...]] | None

    @classmethod
    def begun(cls, march: March) -> _Beside:
        setup, total = march.setup, march.total
        # The method asks for the rotations that this finds.
        motions = Task(lambda: patch_motions(setup.problem, total))
        if march.max_displacement <= _GROWTH * max(setup.examined, default=0.0):
            return cls(motions, None)
        where = setup.grid, setup.topology, setup.boundary
        return cls(motions, Task(lambda: find_crossings(*where, total), after=motions))


def _overlaps(march: March, assessment: Assessment, beside: _Beside) -> list[str]:
    """A warning if valid cells overlap others: a wall may pass through itself where no cells lie between its sides.

    Other boundaries cannot meet while all cells are valid.
    """
    if not assessment.valid or march.fraction < 1.0 or beside.crossings is None:
        return []
    with march.timing.stage("quality"):
        crossings = beside.crossings.result()
    if crossings:
        text = (
            f"the moved boundary crosses itself: {crossings[0]}. The cells are valid one by one, but the grid overlaps "
            f"itself there"
        )
        return [Notice(text, f"crossing of {' and '.join(crossings[0].patches)}")]
    march.setup.examined.append(march.max_displacement)
    return []


def _nearly_collapsed(assessment: Assessment) -> list[str]:
    worst = assessment.after.worst["min_relative_jacobian"]
    if not assessment.valid or worst.value >= COLLAPSING:
        return []
    x, y, z = worst.center
    text = (
        f"cell {worst.block} {worst.ijk} at ({x:.6g}, {y:.6g}, {z:.6g}) is valid but nearly collapsed: a Jacobian is "
        f"{worst.value:.2g} of its original value"
    )
    return [Notice(text, "nearly collapsed cell")]
