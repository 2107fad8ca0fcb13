"""What the judgement of further grids needs of the undeformed cells, kept instead of computed again."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ..grid import FloatArray, Grid
from ..numerics.cell.inspection import kept_numbers
from .cells import Slab, slabs

NOTHING: FloatArray = np.empty(0, np.float32)


class KeptCells:
    """Corner Jacobians and volumes of undeformed hexahedra, slab by slab: 36 bytes per cell and a few per cent.

    Nothing is kept before :meth:`begin`; results are the same. Copies begin with nothing.
    """

    def __init__(self, grid: Grid):
        self._grid = grid
        self.begun = False
        self._parts: dict[int, FloatArray] = {}

    @cached_property
    def bytes(self) -> int:
        """The memory that all of them take; several ranks share it."""
        if self._grid.dimension == 2:
            return 0
        return sum(self._size(slab) for slab in slabs(self._grid)) * NOTHING.itemsize

    def begin(self) -> None:
        """Keep what the next pass computes."""
        self.begun = True

    def of(self, slab: Slab, both: bool) -> tuple[FloatArray, bool]:
        """The array of a slab, to be read if it is known, else to be filled; empty for a pass that needs more."""
        if slab.start in self._parts:
            return (NOTHING, False) if both else (self._parts[slab.start], True)
        return np.empty(self._size(slab) if self.begun else 0, np.float32), False

    def put(self, slab: Slab, part: FloatArray) -> None:
        """Keep the array of a slab that has been filled."""
        if part.size:
            self._parts[slab.start] = part

    def _size(self, slab: Slab) -> int:
        return kept_numbers(self._grid.shapes[slab.block], slab.last - slab.first)

    def __reduce__(self) -> tuple[type[KeptCells], tuple[Grid]]:
        return KeptCells, (self._grid,)
