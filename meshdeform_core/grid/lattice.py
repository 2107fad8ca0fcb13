"""Where the nodes of all block sides, and those near them, lie in the grid's arrays: arithmetic instead of loops."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import BoolArray, IntArray, Shapes, spans
from .parts import strides_of

_LAYERS = 2
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

    def corners(self, side: IntArray, u: IntArray, v: IntArray) -> IntArray:
        """Flat indices (n, 4) of the corners of quads (u, v) of sides (n,), around each; in 2-D each end twice."""
        du, dv = self.corner_steps[side].T
        return np.stack([self.at(side, *at) for at in ((u, v), (u + du, v), (u + du, v + dv), (u, v + dv))], axis=1)

    def all_nodes(self, sides: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """All nodes of ``sides``, side after side: the side, u, v and flat index of each."""
        side, local = spans(self.nodes[sides].prod(axis=1))
        side = sides[side]
        u, v = np.divmod(local, self.nodes[side, 1])
        return side, u, v, self.at(side, u, v)


def near_sides(shapes: Shapes, offsets: IntArray) -> IntArray:
    """Flat indices (n,), ascending, of the nodes of all block sides that have quads, and of their neighbours inside.

    The first nodes of the blocks have the flat indices ``offsets``.
    """
    found = []
    for shape, offset in zip(np.asarray(shapes).tolist(), np.asarray(offsets).tolist(), strict=False):
        # Across the plane of a 2-D block there are no sides.
        steps = [np.arange(n) for n in shape]
        i, j, k = (np.minimum(step, step[::-1]) < _LAYERS * (len(step) > 1) for step in steps)
        whole, rim = np.arange(len(j) * len(k)), np.flatnonzero(j[:, None] | k)
        found += [offset + plane * len(whole) + (whole if near else rim) for plane, near in enumerate(i)]
    return np.concatenate(found)
