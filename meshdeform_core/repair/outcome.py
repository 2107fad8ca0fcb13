"""What a repair has done."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ..grid import FloatArray
from ..quality.verdict.validity import Verdict


@dataclass(frozen=True)
class Repair:
    """Summary of repairs.

    ``cells``: number of cells that were invalid or weak; ``nodes``: number of nodes moved; ``max_movement``: largest
    movement (grid length unit). ``converged``: the grid is the minimum of the energy over all nodes, a smooth function
    of the displacement of the boundary; otherwise it depends on the path of the search, and may change abruptly with
    the displacement.
    """

    cells: int
    nodes: int
    max_movement: float
    newton_steps: int
    seconds: float
    converged: bool = False

    def __add__(self, other: Repair) -> Repair:
        return Repair(
            self.cells + other.cells,
            max(self.nodes, other.nodes),
            max(self.max_movement, other.max_movement),
            self.newton_steps + other.newton_steps,
            self.seconds + other.seconds,
            other.converged,
        )

    def beside(self, other: Repair) -> Repair:
        """Joint summary of repairs in two different parts of a grid."""
        nodes, converged = self.nodes + other.nodes, self.converged and other.converged
        return replace(self + other, nodes=nodes, converged=converged)


@dataclass(frozen=True)
class Outcome:
    """Coordinates (n_nodes, 3) after a repair, their verdict, and what was done."""

    points: FloatArray
    verdict: Verdict
    repair: Repair


@dataclass(frozen=True)
class Judged:
    """Coordinates (n_nodes, 3) and the verdict on them."""

    points: FloatArray
    verdict: Verdict

    @property
    def count(self) -> int:
        """Number of invalid cells."""
        return len(self.verdict.invalid)
