"""Measures of undeformed cells that are stored for the assessment of further deformed grids."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from ...grid import FloatArray, Grid
from ...numerics.cell.inspection import kept_numbers
from .cells import Slab, slabs

NOTHING: FloatArray = np.empty(0, np.float32)


class KeptCells:
    """Corner Jacobians and volumes of undeformed hexahedra, slab by slab: a little over 36 bytes per cell.

    Nothing is stored before :meth:`begin`, and copies start empty. Results do not depend on what is stored.
    """

    def __init__(self, grid: Grid):
        self._grid = grid
        self.begun = False
        self._parts: dict[int, FloatArray] = {}

    @cached_property
    def bytes(self) -> int:
        """Memory in bytes for all cells."""
        if self._grid.dimension == 2:
            return 0
        return sum(self._size(slab) for slab in slabs(self._grid)) * NOTHING.itemsize

    def begin(self) -> None:
        """Store the measures computed from the next pass on."""
        self.begun = True

    def of(self, slab: Slab, both: bool) -> tuple[FloatArray, bool]:
        """The array of a slab, and whether it holds its values or is to be filled; empty where a pass cannot use it."""
        if slab.start in self._parts:
            return (NOTHING, False) if both else (self._parts[slab.start], True)
        return np.empty(self._size(slab) if self.begun else 0, np.float32), False

    def put(self, slab: Slab, part: FloatArray) -> None:
        """Store the filled array of a slab."""
        if part.size:
            self._parts[slab.start] = part

    def _size(self, slab: Slab) -> int:
        return kept_numbers(self._grid.shapes[slab.block], slab.last - slab.first)

    def __reduce__(self) -> tuple[type[KeptCells], tuple[Grid]]:
        return KeptCells, (self._grid,)
