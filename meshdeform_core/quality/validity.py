"""The quick question: which cells became invalid?"""

from __future__ import annotations

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..numerics.parallel import empty
from ..topology import Topology
from .cells import CellMeasures, Slab, compare_cells


def newly_bad(old: CellMeasures, new: CellMeasures) -> BoolArray:
    """Cells with a corner Jacobian that was positive and is not any more."""
    return np.asarray((new.bad & ~old.bad) != 0)


def newly_invalid(grid: Grid, after: FloatArray, topology: Topology) -> IntArray:
    """Cells with a corner Jacobian that is positive in ``grid`` and <= 0 with coordinates ``after`` (n_nodes, 3).

    Returns their numbers, counted block after block, C-ordered within each block.
    """
    broken = empty([grid.n_cells], bool)

    def use(_: int, slab: Slab, old: CellMeasures, new: CellMeasures) -> None:
        broken[slab.start : slab.stop] = newly_bad(old, new).ravel()

    compare_cells(grid, topology, grid.points, after, use, [broken])
    return np.flatnonzero(broken)
