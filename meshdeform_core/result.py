"""What a deformation returns."""

from __future__ import annotations

from dataclasses import dataclass

from .boundary.prescribed import largest_displacement
from .grid import FloatArray, Grid
from .methods import Account
from .methods.limits import PatchMotion
from .quality import Assessment
from .repair.outcome import Repair
from .setup import Setup, Timing
from .stepping import Attempt


@dataclass(frozen=True, eq=False, repr=False)
class Result:
    """A deformed grid, how it was made and how good it is.

    ``reached`` is the fraction of the motion that was imposed: below 1 only when marching stopped before a step that
    would have made cells invalid; the invalid cells of the assessment are then those of that step. ``displacement``
    (n_unique, 3) is that of the boundary at the end of the motion. ``attempts`` lists the steps that were tried, in
    order; ``repair`` summarises the repairs of the steps that led to the grid, or is ``None``. Each of the named
    ``components`` of an overset grid has a result of its own. ``plain`` (n_nodes, 3) is the grid before the repair, if
    there was one step with a repair.
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
    plain: FloatArray | None = None

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
