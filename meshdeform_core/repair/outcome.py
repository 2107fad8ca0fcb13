"""Which cells need a repair, found without loading any loop of one, and what a repair has done."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..numerics.cell.health import mark_unhealthy
from ..parallel import Nodes
from ..quality import Original
from ..quality.cells import Slab, cells_alike, for_slabs, hold_cells
from ..quality.validity import Comparison, Verdict
from .tuned import COLLAPSED, HEALTHY, SOFT


def unhealthy_cells(original: Original, points: FloatArray, most: float = HEALTHY) -> IntArray:
    """Numbers (m,) of the cells of all ranks with a corner whose f is more than ``most``."""
    normal = np.zeros(3) if original.normal is None else original.normal

    def unhealthy(x: FloatArray, start: FloatArray) -> BoolArray:
        marks = np.empty([max(n - 1, 1) for n in x.shape[:3]], dtype=bool)
        mark_unhealthy(x, start, normal, most, SOFT, COLLAPSED, marks)
        return marks

    return cells_where(unhealthy, original.grid, points, original.grid.points)


def cells_where(test: Callable[..., Any], grid: Grid, *arrays: Any) -> IntArray:
    """Numbers (m,) of the cells of all ranks that pass a test; it gets some layers of a block's nodes, from each of the
    ``arrays`` (n_nodes, ...), and has a result for each of the cells between them."""
    marks = Nodes.of(cells_alike(grid, bool))
    hold_cells(grid, *arrays)

    def mark(_: int, slab: Slab) -> None:
        blocks = (grid.block(slab.block, Nodes.of(each).rows) for each in arrays)
        marks[slab.cells][:] = test(*(each[slab.first : slab.last + 1] for each in blocks)).ravel()

    for_slabs(grid, mark)
    return np.concatenate(grid.nodes.gather(marks.low + np.flatnonzero(marks.own)))


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
        counts = self.invalid + other.invalid, self.weak + other.weak, max(self.nodes, other.nodes)
        steps, seconds = self.newton_steps + other.newton_steps, self.seconds + other.seconds
        moved = max(self.max_movement, other.max_movement)
        return Repair(*counts, moved, steps, seconds, other.converged, left_out=other.left_out)

    def beside(self, other: Repair) -> Repair:
        """Joint summary of repairs in two different parts of a grid."""
        nodes, converged = self.nodes + other.nodes, self.converged and other.converged
        return replace(self + other, nodes=nodes, converged=converged, left_out=self.left_out or other.left_out)


@dataclass(frozen=True, eq=False)
class Judged:
    """Coordinates (n_nodes, 3), the verdict on them, their quality measures if already computed, and the repair, if
    any, that made them."""

    points: FloatArray
    verdict: Verdict
    cells: Comparison | None = None
    repair: Repair | None = None

    @property
    def count(self) -> int:
        """Number of invalid cells."""
        return len(self.verdict.invalid)

    def smallest_scaled_jacobian(self, original: Original, rounded: Callable[[FloatArray], FloatArray]) -> float:
        """The smallest scaled Jacobian, of coordinates ``rounded`` to those that will be written."""
        return (self.cells or Comparison(original, rounded(self.points))).extremes["min_scaled_jacobian"][1]
