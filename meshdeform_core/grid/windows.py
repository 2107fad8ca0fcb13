"""Block sides: sets of their face quads as rectangles of nodes, and the end planes of a grid that is one cell thick."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..numerics.arrays import IntArray, batches, spans
from .blocks import Grid
from .parts import Shape, Side, Window
from .topology import FaceQuads, Topology, side_nodes


def windows_of_quads(shape: Shape, block: int, side: Side, quads: NDArray[np.bool_]) -> list[Window]:
    """Rectangles that cover exactly the marked ``quads`` of a face of a block of this ``shape`` in nodes.

    The quads are cells along ``side.tangential``, one across the plane of a 2-D grid. Rows of marked quads are cut into
    runs, and equal runs of successive rows become one rectangle.
    """
    u, v = np.nonzero(quads)
    row, label = u * quads.shape[1] + v, np.zeros(len(u), dtype=np.int64)
    found = Rectangles(*_divided(row, np.full(len(u), 6 * block + side), u, v, label))
    # In a 2-D grid a face has one node, not two, across the single plane.
    return replace(found, high=found.high + np.array([int(shape[axis] > 1) for axis in side.tangential])).windows()


@dataclass(frozen=True)
class Rectangles:
    """Rectangles of face quads on block sides, one per row.

    Attributes
    ----------
    side : (n,) ``6 * block + side``
    label : (n,) the common label of its quads
    low, high : (n, 2) first and last node along ``side.tangential``
    quads : the face quads, rectangle after rectangle, ascending in each
    sizes : (n,) number of quads of each rectangle
    """

    side: IntArray
    label: IntArray
    low: IntArray
    high: IntArray
    quads: IntArray
    sizes: IntArray

    @cached_property
    def start(self) -> IntArray:
        """Offset of each rectangle in ``quads`` (n + 1,)."""
        return np.append(0, np.cumsum(self.sizes))

    def __len__(self) -> int:
        return len(self.side)

    def windows(self) -> list[Window]:
        """The rectangles as windows of nodes."""
        rows = zip(self.side.tolist(), self.low.tolist(), self.high.tolist(), strict=True)
        return [Window(side // 6, Side(side % 6), (a, b), (c, d)) for side, (a, b), (c, d) in rows]

    def quads_of(self, number: int) -> IntArray:
        """The face quads of one rectangle."""
        return self.quads[self.start[number] : self.start[number + 1]]

    def chosen(self, some: IntArray) -> Rectangles:
        """The rectangles with the numbers ``some``, in this order."""
        run, place = spans(self.sizes[some])
        quads = self.quads[self.start[some][run] + place]
        side, label, low, high, sizes = (a[some] for a in (self.side, self.label, self.low, self.high, self.sizes))
        return Rectangles(side, label, low, high, quads, sizes)


_TOGETHER = 200_000
"""Face quads divided at a time, which bounds the memory."""


def rectangles(grid: Grid, faces: FaceQuads, label: IntArray) -> Rectangles:
    """Rectangles of face quads with equal labels (n_quads,) on all block sides, divided as by
    :func:`windows_of_quads`; quads with a negative label are left out.

    Ordered by side, label, first node along the second axis, last one, first node along the first axis.
    """
    some = np.flatnonzero(label >= 0)
    ends = np.searchsorted(some, np.append(faces.start.ravel(), len(label)))
    found = [
        _divided(part, *faces.places(part), label[part])
        for part in (some[ends[lo] : ends[hi]] for lo, hi in batches(np.diff(ends), _TOGETHER))
    ]
    whole = Rectangles(*map(np.concatenate, zip(*found, strict=True)))
    return replace(whole, high=whole.high + grid.sides.corner_steps[whole.side])


def _divided(some: IntArray, side: IntArray, u: IntArray, v: IntArray, label: IntArray) -> tuple[IntArray, ...]:
    """The arrays of :class:`Rectangles` of the face quads ``some`` (n,), ascending, at (u, v) on their sides; ``high``
    are the last quads."""
    # First runs of quads within one row of a side, then equal runs of successive rows.
    new = np.ones(len(some), dtype=bool)
    new[1:] = (np.diff(some) != 1) | (v[1:] == 0) | (label[1:] != label[:-1])
    first = np.flatnonzero(new)
    last = np.append(first[1:], len(some))[: len(first)] - 1
    order = np.lexsort((u[first], v[last], v[first], label[first], side[first]))
    first, last = first[order], last[order]
    keys = side[first], label[first], v[first], v[last], u[first]
    begins = np.ones(len(first), dtype=bool)
    begins[1:] = np.any([key[1:] != key[:-1] for key in keys[:4]], axis=0) | (np.diff(keys[4]) != 1)
    top = np.flatnonzero(begins)
    bottom = np.append(top[1:], len(first))[: len(top)] - 1
    number = np.empty(len(first), dtype=np.int64)
    number[order] = np.cumsum(begins) - 1
    number = number[np.cumsum(new) - 1]
    return (
        keys[0][top],
        keys[1][top],
        np.stack([keys[4][top], keys[2][top]], axis=1),
        np.stack([keys[4][bottom], keys[3][top]], axis=1),
        some[np.argsort(number, kind="stable")],
        np.bincount(number, minlength=len(top)),
    )


def side_numbers(grid: Grid, topology: Topology, block: int, side: Side) -> IntArray:
    """Unique node numbers of a block side, shaped along ``side.tangential``."""
    u, v = np.indices([grid.shapes[block][axis] for axis in side.tangential])
    return topology.quads.numbers_at(np.full(u.shape, 6 * block + side), u, v)


def end_planes(grid: Grid, topology: Topology) -> list[int]:
    """Block sides (``6 * block + side``) between which the whole grid is one cell thick; empty if it is not.

    A block that is one cell thick between outside faces in two directions counts as thin in the direction in which its
    neighbours are; if these leave it open, there are no end planes.
    """
    thin, external, quads = list[list[int]](), topology.external, topology.quads
    for block, shape in enumerate(grid.shapes):
        # With only outside faces at both ends.
        ends = ((axis, [quads.of_side(block, Side(2 * axis + end)) for end in (0, 1)]) for axis in range(3))
        thin.append([axis for axis, of in ends if shape[axis] == 2 and all(external[some].all() for some in of)])
        if not thin[-1]:
            return []

    def edges_across(block: int, axis: int) -> IntArray:
        """A number for each edge that crosses the block along the axis."""
        ends = [topology.numbers_of(side_nodes(grid, block, Side(2 * axis + end)).ravel()) for end in (0, 1)]
        edges: IntArray = np.minimum(*ends) * topology.n_unique + np.maximum(*ends)
        return edges

    left, known = list(range(grid.n_blocks)), np.empty(0, dtype=np.int64)
    while any(len(axes) > 1 for axes in thin):
        decided = [block for block in left if len(thin[block]) == 1]
        if not decided:
            return []
        left = [block for block in left if block not in decided]
        known = np.concatenate([known, *(edges_across(block, thin[block][0]) for block in decided)])
        for block in left:
            # Blocks whose neighbours are not decided yet wait for these.
            some = [axis for axis in thin[block] if np.isin(edges_across(block, axis), known).any()]
            thin[block] = some or thin[block]
    return [6 * block + side for block, axes in enumerate(thin) for axis in axes for side in (2 * axis, 2 * axis + 1)]
