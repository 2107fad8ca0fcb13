"""The nodes near block faces, of which all ranks keep copies if a grid is in parts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import FloatArray, IntArray, Shapes
from ..parallel import empty

_LAYERS = 2


@dataclass(frozen=True, repr=False)
class NearNodes:
    """The nodes of all block sides that have quads, and their neighbours inside, in the order of their flat indices.

    Their places in this order follow from the block shapes, so that no table of them is kept.

    Attributes
    ----------
    shapes : (n_blocks, 3) of the blocks
    offsets : (n_blocks + 1,) flat index of the first node of each
    inside : (n_blocks, 3, 2) first and one past the last index, along each direction, of the nodes that are not near
    start : (n_blocks + 1,) number of near nodes of the blocks before
    """

    shapes: IntArray
    offsets: IntArray
    inside: IntArray
    start: IntArray

    @classmethod
    def of(cls, shapes: Shapes, offsets: IntArray) -> NearNodes:
        """Near nodes of blocks of these shapes whose first nodes have the flat indices ``offsets`` (n_blocks + 1,)."""
        size = np.array(shapes, dtype=np.int64)
        # Across the plane of a 2-D block there are no sides.
        low, high = np.where(size > 1, _LAYERS, 0), np.where(size > 1, size - _LAYERS, size)
        thin = (high <= low).any(axis=1)
        low[thin] = high[thin] = 0
        near = size.prod(axis=1) - (high - low).prod(axis=1)
        return cls(size, offsets, np.stack([low, high], axis=2), np.append(0, np.cumsum(near)))

    @property
    def rows(self) -> IntArray:
        """Flat indices (n,) of the near nodes, ascending."""
        # Imported late, as below: `meshdeform info` imports no numba.
        from ..numerics.near import near_rows

        found = empty([int(self.start[-1])], np.int64)
        near_rows(self.shapes, self.offsets, self.inside, found)
        return np.asarray(found)

    def taken(self, values: FloatArray, rows: IntArray) -> FloatArray | None:
        """The ``values`` (m, 3), one row per near node, of flat indices (n,); ``None`` if any is not near."""
        from ..numerics.near import near_values

        found = empty((len(rows), 3))
        all_near = near_values(np.ascontiguousarray(rows, dtype=np.int64), *self._table, values, found)
        return found if all_near else None

    @property
    def _table(self) -> tuple[IntArray, ...]:
        return self.shapes, self.offsets, self.inside, self.start
