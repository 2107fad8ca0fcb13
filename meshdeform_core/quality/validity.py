"""The quick question: which cells became invalid?"""

from __future__ import annotations

import numpy as np

from ..grid import BoolArray, FloatArray, IntArray
from ..parallel import empty
from .cells import CellMeasures, Slab, measure_cells
from .original import Original


def newly_bad(old: np.ndarray, new: np.ndarray) -> BoolArray:
    """Cells with a corner Jacobian that was positive and is not any more, from bit masks of bad corners."""
    return np.asarray((new & ~old) != 0)


def newly_invalid(original: Original, after: FloatArray) -> IntArray:
    """Cells with a corner Jacobian that was positive and is <= 0 with coordinates ``after`` (n_nodes, 3).

    Returns their numbers, counted block after block, C-ordered within each block.
    """
    broken = empty([original.grid.n_cells], bool)

    def use(_: int, slab: Slab, new: CellMeasures) -> None:
        broken[slab.cells] = newly_bad(original.bad[slab.cells], new.bad.ravel())

    measure_cells(original.grid, original.topology, after, use, [broken])
    return np.flatnonzero(broken)
