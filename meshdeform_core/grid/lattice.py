"""Where the nodes of all block sides, and those near them, lie in the grid's arrays: arithmetic instead of loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import BoolArray, FloatArray, IntArray, Shapes, spans
from ..parallel import empty
from .parts import strides_of

_LAYERS = 2
_TOGETHER = 100_000
"""Rows whose places are computed at a time, which bounds the memory."""

_AXES = np.repeat(np.arange(3), 2)
_TANGENTIAL = np.array([[1, 2], [1, 2], [0, 2], [0, 2], [0, 1], [0, 1]])


@dataclass(frozen=True)
class SideLattice:
    """The sides of all blocks, numbered ``6 * block + side``.

    Node (u, v) of a side, counted along ``side.tangential``, is ``origin + u * stride[0] + v * stride[1]``.

    Attributes
    ----------
    origin : (6 n_blocks,) flat index of the first node
    stride : (6 n_blocks, 2)
    nodes : (6 n_blocks, 2) number of nodes along both axes
    depth : (6 n_blocks,) number of nodes from the side to the opposite one
    inward : (6 n_blocks,) step from a node of the side to the next one inside the block
    """

    origin: IntArray
    stride: IntArray
    nodes: IntArray
    depth: IntArray
    inward: IntArray

    @classmethod
    def of(cls, shapes: Sequence[tuple[int, int, int]], offsets: IntArray) -> SideLattice:
        """The sides of blocks of these shapes whose first nodes have the flat indices ``offsets``."""
        size = np.array(shapes, dtype=np.int64)
        strides = strides_of(size)
        far = np.arange(6) % 2
        across, along = strides[:, _AXES], size[:, _AXES]
        return cls(
            (np.asarray(offsets)[: len(size), None] + far * (along - 1) * across).ravel(),
            strides[:, _TANGENTIAL].reshape(-1, 2),
            size[:, _TANGENTIAL].reshape(-1, 2),
            along.ravel(),
            (np.where(far == 1, -1, 1) * across).ravel(),
        )

    @property
    def has_quads(self) -> BoolArray:
        """False (6 n_blocks,) for the two sides that are the plane of a 2-D block."""
        return self.depth > 1

    @property
    def cells(self) -> IntArray:
        """Cells (6 n_blocks, 2) along both axes; one across the plane of a 2-D block."""
        return np.maximum(self.nodes - 1, 1)

    @property
    def corner_steps(self) -> IntArray:
        """Steps (6 n_blocks, 2) in u and v from the first to the last corner of a quad: 0 along a single node."""
        return np.minimum(self.nodes - 1, 1)

    def at(self, side: IntArray | int, u: IntArray, v: IntArray) -> IntArray:
        """Flat indices of nodes (u, v) of sides, arrays of any common shape."""
        return np.asarray(self.origin[side] + u * self.stride[side, 0] + v * self.stride[side, 1])

    def all_nodes(self, sides: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """All nodes of ``sides``, side after side: the side, u, v and flat index of each."""
        side, local = spans(self.nodes[sides].prod(axis=1))
        side = sides[side]
        u, v = np.divmod(local, self.nodes[side, 1])
        return side, u, v, self.at(side, u, v)


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
        found, at = empty([int(self.start[-1])], np.int64), 0
        for (ni, nj, nk), offset, ((i0, i1), (j0, j1), (k0, k1)) in zip(
            self.shapes.tolist(), self.offsets.tolist(), self.inside.tolist(), strict=False
        ):
            every, across = np.arange(nj * nk), np.ones((nj, nk), dtype=bool)
            across[j0:j1, k0:k1] = False
            for first, last, near in ((0, i0, every), (i0, i1, np.flatnonzero(across)), (i1, ni, every)):
                part = offset + nj * nk * np.arange(first, last)[:, None] + near
                found[at : at + part.size] = part.ravel()
                at += part.size
        return np.asarray(found)

    def taken(self, values: FloatArray, rows: IntArray) -> FloatArray | None:
        """The ``values`` (m, 3), one row per near node, of flat indices (n,); ``None`` if any is not near."""
        found = empty((len(rows), 3))
        for lo in range(0, len(rows), _TOGETHER):
            place = self._places(np.asarray(rows[lo : lo + _TOGETHER], dtype=np.int64))
            if (place < 0).any():
                return None
            found[lo : lo + _TOGETHER] = values[place]
        return np.asarray(found)

    def _places(self, rows: IntArray) -> IntArray:
        """Position (n,) of each flat index among the near nodes, -1 if it is not near."""
        block = np.searchsorted(self.offsets, rows, side="right") - 1
        local, (_, nj, nk) = rows - self.offsets[block], self.shapes[block].T
        low, high = self.inside[block].transpose(2, 1, 0)
        at = np.stack([local // (nj * nk), local // nk % nj, local % nk])
        within, before, width = (at >= low) & (at < high), np.clip(at, low, high) - low, high - low
        # The nodes inside that come before: of whole planes, of lines in the same plane, and in the same line.
        inside = before[0] * width[1] * width[2]
        inside += within[0] * (before[1] * width[2] + within[1] * before[2])
        return np.where(within.all(axis=0), -1, self.start[block] + local - inside)
