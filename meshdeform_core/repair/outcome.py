"""What a repair has done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ..grid import FloatArray
from ..quality import Original
from ..quality.validity import Comparison, Tally, Verdict


@dataclass(frozen=True)
class Repair:
    """Summary of repairs.

    ``invalid`` and ``weak``: numbers of cells that were invalid, and of others beyond the onset of repairs; ``nodes``:
    number of nodes moved; ``max_movement``: largest movement (grid length unit). ``converged``: the grid is the minimum
    of the energy over all nodes, a smooth function of the displacement of the boundary; otherwise it depends on the
    path of the search, and may change abruptly with the displacement. ``before``: measures of the method's grid, of a
    single step. ``left_out``: the reason why nothing was done.
    """

    invalid: int
    weak: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float
    converged: bool = False
    before: dict[str, Any] | None = None
    left_out: str | None = None

    def __add__(self, other: Repair) -> Repair:
        return Repair(
            self.invalid + other.invalid,
            self.weak + other.weak,
            max(self.nodes, other.nodes),
            max(self.max_movement, other.max_movement),
            self.newton_steps + other.newton_steps,
            self.seconds + other.seconds,
            other.converged,
            left_out=other.left_out,
        )

    def again(self, other: Repair) -> Repair:
        """Joint summary of two repairs of the same grid."""
        return replace(self + other, invalid=self.invalid, weak=self.weak)

    def beside(self, other: Repair) -> Repair:
        """Joint summary of repairs in two different parts of a grid."""
        nodes, converged = self.nodes + other.nodes, self.converged and other.converged
        return replace(self + other, nodes=nodes, converged=converged, left_out=self.left_out or other.left_out)


@dataclass(frozen=True, eq=False)
class Judged:
    """Coordinates (n_nodes, 3), the verdict on them, and their quality measures if already computed."""

    points: FloatArray
    verdict: Verdict
    cells: Comparison | None = None

    @property
    def count(self) -> int:
        """Number of invalid cells."""
        return len(self.verdict.invalid)

    def smallest_scaled_jacobian(self, original: Original, rounded: Callable[[FloatArray], FloatArray]) -> float:
        """The smallest scaled Jacobian, of coordinates ``rounded`` to those that will be written."""
        tally = self.cells.after if self.cells else Tally(original, rounded(self.points))
        return tally.smallest_scaled[1]


@dataclass(frozen=True, eq=False)
class Outcome(Judged):
    """A grid after a repair, and what was done."""

    repair: Repair = field(kw_only=True)
