"""The nodes and quads on block faces that a rank sets up."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...numerics.arrays import BoolArray, batches, spans
from ...numerics.geometry.coincidence import ascending, integers
from ..blocks import FloatArray, Grid, IntArray
from ..lattice import SideLattice

_TOGETHER = 100_000
"""Nodes processed at a time: few enough for the processor's cache."""


@dataclass(frozen=True)
class FaceStrips:
    """Rows u of block sides with all face nodes of a range of flat indices, and all nodes next to them on the sides.

    The nodes in the range belong to the rank, and the quads of rows whose first node is in it. Of a grid that is not in
    parts, strips are whole sides.

    Attributes
    ----------
    side, first : (n,) the side and the first row of each strip
    lattice : the strips as sides
    quad_rows : (n, 2) first and one past the last row with quads of this rank, counted from the first of the strip
    nodes : (m,) flat indices of all nodes of the strips, ascending
    rows : the place among them of every node of the strips, strip after strip
    own : those of the ``nodes`` that belong to this rank
    """

    side: IntArray
    first: IntArray
    lattice: SideLattice
    quad_rows: IntArray
    nodes: IntArray
    rows: IntArray
    own: slice

    @classmethod
    def of(cls, grid: Grid, low: int, high: int) -> FaceStrips:
        """The strips of the face nodes with flat indices low <= n < high."""
        sides = grid.sides
        begin, end = sides.rows_before(low), sides.rows_before(high)
        # The row before those that begin in the range may end in it.
        last = sides.origin + (begin - 1) * sides.stride[:, 0] + (sides.nodes[:, 1] - 1) * sides.stride[:, 1]
        side = np.flatnonzero(sides.has_quads & ((end > begin) | (last >= low) & (begin > 0)))
        begin, end = begin[side], end[side]
        first = np.maximum(begin - 2, 0)
        lattice = sides.strips(side, first, np.minimum(end + 1, sides.nodes[side, 0]))
        quad_rows = np.stack([begin, np.maximum(np.minimum(end, sides.cells[side, 0]), begin)], axis=1) - first[:, None]
        nodes, rows = _nodes_of(lattice, np.searchsorted(side, 6 * np.arange(grid.n_blocks + 1)))
        return cls(side, first, lattice, quad_rows, nodes, rows, slice(*np.searchsorted(nodes, [low, high]).tolist()))

    @property
    def own_nodes(self) -> IntArray:
        """Flat indices of the nodes that belong to this rank, ascending."""
        return self.nodes[self.own]

    def among(self, face_nodes: IntArray, values: IntArray) -> IntArray:
        """The ``values`` (n,), one for each of all ``face_nodes`` (n,), of the nodes of the strips."""
        return values if len(face_nodes) == len(self.nodes) else values[np.searchsorted(face_nodes, self.nodes)]

    def fill_corners(
        self, sides: SideLattice, number: IntArray, in_order: BoolArray, start: IntArray, corners: IntArray
    ) -> None:
        """Fill the rows of ``corners`` (n_quads, 2 or 4) of this rank's quads, counter-clockwise as seen from outside.

        Parameters
        ----------
        number : (m,) unique numbers of the nodes of the strips
        in_order, start : (6 n_blocks,) whether that is the index order of each side, and the number of its first quad
        """
        base = self.lattice.nodes.prod(axis=1)
        base = np.cumsum(base) - base
        columns = sides.cells[self.side, 1]
        sizes = (self.quad_rows[:, 1] - self.quad_rows[:, 0]) * columns
        for lo, hi in batches(sizes, _TOGETHER):
            strip, local = spans(sizes[lo:hi])
            strip += lo
            u, v = np.divmod(local, columns[strip])
            u += self.quad_rows[strip, 0]
            width, side = self.lattice.nodes[strip, 1], self.side[strip]
            at = base[strip] + u * width + v
            if corners.shape[1] == 2:
                ends = [at, at + np.where(sides.nodes[side, 0] > 1, width, 1)]
            else:
                ends = [at, at + width, at + width + 1, at + 1]
            ordered = in_order[side]
            own = np.empty((len(at), len(ends)), dtype=corners.dtype)
            for column, other in zip(range(len(ends)), reversed(range(len(ends))), strict=True):
                own[:, column] = number[self.rows[np.where(ordered, ends[column], ends[other])]]
            corners[start[side] + (self.first[strip] + u) * columns[strip] + v] = own


def _nodes_of(lattice: SideLattice, blocks: IntArray) -> tuple[IntArray, IntArray]:
    """Flat indices of all nodes of strips, ascending, and the place among them of every node of each strip.

    A few blocks at a time, as their nodes follow each other in the grid; the strips of block b are those from
    ``blocks[b]`` to ``blocks[b + 1]``.
    """
    ends = np.append(0, np.cumsum(lattice.nodes.prod(axis=1)))[blocks]
    rows = np.empty((int(ends[-1]),), integers(int(ends[-1])))
    found, count = [np.empty(0, dtype=np.int64)], 0
    for lo, hi in batches(np.diff(ends), _TOGETHER):
        flat = lattice.all_nodes(np.arange(blocks[lo], blocks[hi]))[3]
        nodes = ascending(flat)
        rows[ends[lo] : ends[hi]] = count + np.searchsorted(nodes, flat)
        found.append(nodes)
        count += len(nodes)
    return np.concatenate(found), rows


def quads_between(sides: SideLattice, start: IntArray, low: int, high: int) -> IntArray:
    """Numbers of the quads that belong to the rank with the flat indices low <= n < high; ``start`` (6 n_blocks,) is
    the number of the first quad of each side."""
    begin, end = (np.minimum(sides.rows_before(row), sides.cells[:, 0]) for row in (low, high))
    run, local = spans(np.where(sides.has_quads, (end - begin) * sides.cells[:, 1], 0))
    return np.asarray(start[run] + begin[run] * sides.cells[run, 1] + local)


def shortest_edges(grid: Grid, strips: FaceStrips) -> FloatArray:
    """Shortest edge at every node of its own on a rank's ``strips``, ignoring edges within the round-off of the file's
    precision."""
    shortest = np.full(len(strips.nodes), np.inf)
    epsilon = 4 * float(np.finfo(grid.precision).eps)
    sizes, done = strips.lattice.nodes.prod(axis=1), 0
    for lo, hi in batches(sizes, _TOGETHER):
        square = _edges_of_strips(grid, strips.lattice, np.arange(lo, hi), epsilon)
        np.minimum.at(shortest, strips.rows[done : done + len(square)], square)
        done += len(square)
    shortest = shortest[strips.own]
    endless = np.flatnonzero(np.isinf(shortest))
    shortest[endless] = (epsilon * np.abs(grid.points[strips.own_nodes[endless]]).max(axis=1, initial=0.0)) ** 2
    return np.asarray(np.sqrt(shortest))


def _edges_of_strips(grid: Grid, lattice: SideLattice, strips: IntArray, epsilon: float) -> FloatArray:
    """Square of the shortest edge at every node of ``strips``, along the side or into the block."""
    side, u, v, flat = lattice.all_nodes(strips)
    here = grid.points[flat].T.copy()
    size = _largest(here)
    inside = grid.points[flat + lattice.inward[side]].T.copy()
    shortest = _sound_square(here - inside, epsilon, size, _largest(inside))
    for step, number in ((lattice.nodes[side, 1], u), (np.ones_like(v), v)):
        two = np.flatnonzero(number)
        one = two - step[two]
        square = _sound_square(here[:, two] - here[:, one], epsilon, size[two], size[one])
        for end in (one, two):
            shortest[end] = np.minimum(shortest[end], square)
    return shortest


def _largest(x: FloatArray) -> FloatArray:
    """Largest absolute coordinate of points (3, ...)."""
    return np.asarray(np.maximum(np.maximum(np.abs(x[0]), np.abs(x[1])), np.abs(x[2])))


def _sound_square(edge: FloatArray, epsilon: float, one: FloatArray, two: FloatArray) -> FloatArray:
    """Squared length of edges (3, n); infinite where it is within the round-off of coordinates of this size."""
    square = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2]
    square[square <= (epsilon * np.maximum(one, two)) ** 2] = np.inf
    return np.asarray(square)
