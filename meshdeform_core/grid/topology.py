"""Topology: which block nodes coincide, which face quads are shared, and which are outside faces of the grid.

Everything follows from the coordinates of the nodes on block faces. The 1-to-1 connections declared in the file are
checked against it in :mod:`meshdeform_core.grid.connectivity.declared`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numerics.arrays import BoolArray, batches, runs, spans
from ..numerics.geometry.coincidence import ascending, coincident_groups, coincident_within, equal_rows, integers
from ..parallel import empty, rows_at
from .blocks import FloatArray, Grid, IntArray
from .handedness import block_handedness, index_order
from .parts import Shape, Side

RELATIVE_TOLERANCE = 1e-3
"""Coincident means closer than this fraction of the shortest edge at either node."""

_TOGETHER = 100_000
"""Nodes whose edges are measured at a time: few enough for the processor's cache."""
_MATCHED = 1_000_000
"""Unique nodes whose quads are compared at a time, which bounds the memory; more of them in large grids."""
_PASSES = 16
"""At most so many times are all quads searched for those to be compared."""
COLLAPSED = -2
EXTERNAL = -1


@dataclass(frozen=True)
class FaceQuads:
    """All cell faces on all block faces; in a 2-D grid the cell edges on all block edges.

    Arrays with a row per quad have 32-bit integers below 2^31 rows: cast them before multiplying.

    Attributes
    ----------
    start : (n_blocks, 6) first quad of each block side; quads of a side are C-ordered in ``counts``
    counts : (n_blocks, 6, 2) quads along ``side.tangential``
    corners : (n_quads, 4) unique node numbers, counter-clockwise as seen from outside the block; (n_quads, 2) in 2-D
    in_order : (n_blocks, 6) whether the corners are wound in the index order of the side, not in the opposite one
    """

    start: IntArray
    counts: IntArray
    corners: IntArray
    in_order: BoolArray

    def places(self, quads: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """Block side (n,) of face quads (n,), and their position along both axes of the side."""
        side = self.block_side[quads]
        u, v = np.divmod(quads - self.start.ravel()[side], self.counts[..., 1].ravel()[side])
        return side, u, v

    def numbers_at(self, side: IntArray, u: IntArray, v: IntArray) -> IntArray:
        """Unique numbers of nodes (u, v) of sides ``6 * block + side``, arrays of any common shape.

        They are taken from the corners of the quads, which is much faster than searching for every node.
        """
        counts = self.counts.reshape(-1, 2)[side]
        a, b = np.minimum(u, counts[..., 0] - 1), np.minimum(v, counts[..., 1] - 1)
        quad = self.start.ravel()[side] + a * counts[..., 1] + b
        last = self.corners.shape[1] - 1
        corner = np.where(u > a, 1 + (v > b), last * (v > b))
        found = self.corners[quad, np.where(self.in_order.ravel()[side], corner, last - corner)]
        return np.asarray(found, dtype=np.int64)

    def by_side(self, quads: IntArray) -> list[tuple[int, IntArray]]:
        """Quads grouped by block side: ``6 * block + side`` and the quads on it, in their order."""
        side = self.block_side[quads]
        if np.any(side[1:] < side[:-1]):
            order = np.argsort(side, kind="stable")
            side, quads = side[order], quads[order]
        return [(int(side[lo]), quads[lo:hi]) for lo, hi in zip(*runs(side), strict=True)]

    def of_side(self, block: int, side: Side) -> slice:
        """The quads of one block side."""
        first = int(self.start[block, side])
        return slice(first, first + int(np.prod(self.counts[block, side])))

    @cached_property
    def block_side(self) -> IntArray:
        """``6 * block + side`` of every quad, (n_quads,)."""
        sizes = self.counts.prod(axis=2).ravel()
        return _kept(np.repeat(np.arange(sizes.size, dtype=integers(sizes.size)), sizes))


@dataclass(frozen=True, eq=False, repr=False)
class Topology:
    """Nodes and faces of a grid with coincident nodes identified.

    Only nodes on block faces can coincide with others. They carry *unique node numbers* ``0 ... n_unique - 1``, in
    ``number``, ``partner`` and the corners of ``quads`` with 32 bits where these suffice: cast them before multiplying.

    Attributes
    ----------
    face_nodes : (n_face,) flat indices of all block nodes on block faces, ascending
    number : (n_face,) unique node number of each
    first : (n_unique,) flat index of the first block node with that number
    edge : (n_unique,) shortest non-zero edge at the node (grid length unit)
    quads : the cell faces on block faces
    partner : (n_quads,) the quad on the other side of an interface, ``EXTERNAL`` or ``COLLAPSED``
    handedness : (n_blocks,) +1 for right-handed blocks, -1 for left-handed ones
    crowded : number of quads that more than two blocks share (their partners form a ring)
    """

    face_nodes: IntArray
    number: IntArray
    first: IntArray
    edge: FloatArray
    quads: FaceQuads
    partner: IntArray
    handedness: IntArray
    crowded: int

    def __repr__(self) -> str:
        return f"Topology({len(self.face_nodes)} face nodes, {self.n_unique} unique)"

    @property
    def n_unique(self) -> int:
        return len(self.first)

    @property
    def external(self) -> np.ndarray:
        """(n_quads,) bool: faces that no other block shares."""
        return self.partner == EXTERNAL

    def numbers_of(self, flat: IntArray) -> IntArray:
        """Unique node numbers of flat indices, which must lie on block faces."""
        return self.number[np.searchsorted(self.face_nodes, flat)].astype(np.int64)

    def opened(self, quads: IntArray) -> Topology:
        """The topology with shared ``quads`` and their partners declared external (two-sided walls)."""
        partner = self.partner.copy()
        partner[self.partner[quads]] = EXTERNAL
        partner[quads] = EXTERNAL
        return dataclasses.replace(self, partner=partner)


def find_topology(grid: Grid, tolerance: float = RELATIVE_TOLERANCE) -> Topology:
    """Identify coincident nodes and shared faces of ``grid``.

    Full and partial faces, O-grid seams, C-grid cuts, collapsed edges, poles and all relative orientations need no
    special treatment: quads are shared when they have the same unique corner nodes.

    Parameters
    ----------
    tolerance : largest distance between coincident nodes relative to the shortest edge at either of them
    """
    sides = np.flatnonzero(grid.sides.has_quads)
    face_nodes, rows = _face_nodes(grid, sides)
    edge = _shortest_edges(grid, sides, rows, face_nodes)
    number = _kept(_coincident(grid, face_nodes, tolerance * edge))
    n_unique = int(number.max()) + 1
    first = empty((n_unique,), "int64")
    first[number[::-1]] = face_nodes[::-1]
    unique_edge = empty((n_unique,), "float64")
    unique_edge[:] = np.inf
    np.minimum.at(unique_edge, number, edge)
    del edge
    handedness = block_handedness(grid)
    quads = _face_quads(grid, sides, rows, number, handedness)
    del rows
    partner, crowded = _partners(quads.corners, np.bincount(number, minlength=n_unique) > 1)
    return Topology(face_nodes, number, first, unique_edge, quads, partner, handedness, crowded)


def _kept(array: np.ndarray) -> np.ndarray:
    """The array, in a file where large arrays are stored in files."""
    found = empty(array.shape, array.dtype)
    found[...] = array
    return np.asarray(found)


def _face_nodes(grid: Grid, sides: IntArray) -> tuple[IntArray, IntArray]:
    """Flat indices of all nodes on block faces, ascending, and the place among them of every node of the ``sides``.

    A few blocks at a time, as their nodes follow each other in the grid.
    """
    sizes = grid.sides.nodes[sides].prod(axis=1)
    blocks = np.searchsorted(sides, 6 * np.arange(grid.n_blocks + 1))
    ends = np.append(0, np.cumsum(sizes))[blocks]
    rows = empty((int(ends[-1]),), integers(int(ends[-1])))
    found, count = [], 0
    for lo, hi in batches(np.diff(ends), _TOGETHER):
        flat = grid.sides.all_nodes(sides[blocks[lo] : blocks[hi]])[3]
        nodes = ascending(flat)
        rows[ends[lo] : ends[hi]] = count + np.searchsorted(nodes, flat)
        found.append(nodes)
        count += len(nodes)
    face_nodes = empty((count,), "int64")
    np.concatenate(found, out=face_nodes)
    return face_nodes, rows


def _coincident(grid: Grid, face_nodes: IntArray, tolerance: FloatArray) -> IntArray:
    """Unique number of every face node; nodes of different components are never identified."""
    if not grid.component_numbers.any():
        return coincident_groups(rows_at(grid.points, face_nodes), tolerance)
    part = np.repeat(grid.component_numbers, np.diff(np.searchsorted(face_nodes, grid.offsets)))
    return coincident_within(part, rows_at(grid.points, face_nodes), tolerance)


def cells_behind(grid: Grid, topology: Topology, quads: IntArray) -> IntArray:
    """Numbers (n,) in the whole grid of the cells behind face quads (n,)."""
    side, u, v = topology.quads.places(quads)
    block, shapes = side // 6, np.array(grid.cell_shapes)[side // 6]
    axis, far = side % 6 // 2, side % 2
    # Indices along the side's axes; the first or the last layer along the third.
    row = np.arange(len(quads))
    at = np.stack([np.where(axis == 0, 0, u), np.where(axis == 0, u, v), v], axis=1)
    at[axis == 1, 1] = 0
    at[row, axis] = far * (shapes[row, axis] - 1)
    return np.asarray(grid.cell_offsets[block] + (at[:, 0] * shapes[:, 1] + at[:, 1]) * shapes[:, 2] + at[:, 2])


def side_nodes(grid: Grid, block: int, side: Side) -> IntArray:
    """Flat indices of the nodes of one block face, shaped along ``side.tangential``."""
    shape = grid.shapes[block]
    strides = (shape[1] * shape[2], shape[2], 1)
    a, b = side.tangential
    origin = int(grid.offsets[block]) + side.layer(shape) * strides[side.axis]
    return origin + np.arange(shape[a])[:, None] * strides[a] + np.arange(shape[b]) * strides[b]


def inward_step(shape: Shape, side: Side) -> int:
    """Difference in flat index from a node of the face to the next node inside the block."""
    stride = (shape[1] * shape[2], shape[2], 1)[side.axis]
    return -stride if side % 2 else stride


def _shortest_edges(grid: Grid, sides: IntArray, rows: IntArray, face_nodes: IntArray) -> FloatArray:
    """Shortest edge at every face node, ignoring edges within the round-off of the file's precision.

    ``rows`` are the positions in ``face_nodes`` of all nodes of the ``sides``.
    """
    shortest = np.full(len(face_nodes), np.inf)
    epsilon = 4 * float(np.finfo(grid.precision).eps)
    sizes, done = grid.sides.nodes[sides].prod(axis=1), 0
    for lo, hi in batches(sizes, _TOGETHER):
        square = _edges_of_sides(grid, sides[lo:hi], epsilon)
        np.minimum.at(shortest, rows[done : done + len(square)], square)
        done += len(square)
    endless = np.flatnonzero(np.isinf(shortest))
    shortest[endless] = (epsilon * np.abs(grid.points[face_nodes[endless]]).max(axis=1, initial=0.0)) ** 2
    return np.asarray(np.sqrt(shortest))


def _edges_of_sides(grid: Grid, sides: IntArray, epsilon: float) -> FloatArray:
    """Square of the shortest edge at every node of ``sides``, along the side or into the block."""
    side, u, v, flat = grid.sides.all_nodes(sides)
    here = grid.points[flat].T.copy()
    size = _largest(here)
    inside = grid.points[flat + grid.sides.inward[side]].T.copy()
    shortest = _sound_square(here - inside, epsilon, size, _largest(inside))
    for step, number in ((grid.sides.nodes[side, 1], u), (np.ones_like(v), v)):
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


def _face_quads(grid: Grid, sides: IntArray, rows: IntArray, number: IntArray, handedness: IntArray) -> FaceQuads:
    """The quads of all sides; ``rows`` are the places of the nodes of all ``sides`` that have quads, see
    :func:`_face_nodes`, and ``number`` their unique numbers."""
    lattice = grid.sides
    counts = np.where(lattice.has_quads[:, None], lattice.cells, 0)
    sizes = counts.prod(axis=1)
    start = np.cumsum(sizes) - sizes
    nodes = lattice.nodes[sides].prod(axis=1)
    first = np.zeros(len(sizes), dtype=np.int64)
    first[sides] = np.cumsum(nodes) - nodes
    in_order = index_order(grid, handedness)
    corners = empty((int(sizes.sum()), 2 if grid.dimension == 2 else 4), number.dtype)
    for lo, hi in batches(sizes, _TOGETHER):
        side, local = spans(sizes[lo:hi])
        side += lo
        u, v = np.divmod(local, counts[side, 1])
        width, ordered = lattice.nodes[side, 1], in_order.ravel()[side]
        at = first[side] + u * width + v
        if grid.dimension == 2:
            ends = [at, at + np.where(lattice.nodes[side, 0] > 1, width, 1)]
        else:
            ends = [at, at + width, at + width + 1, at + 1]
        own = corners[start[lo] : start[lo] + len(at)]
        for column, other in zip(range(len(ends)), reversed(range(len(ends))), strict=True):
            own[:, column] = number[rows[np.where(ordered, ends[column], ends[other])]]
    return FaceQuads(start.reshape(-1, 6), counts.reshape(-1, 6, 2), corners, in_order)


def _partners(corners: IntArray, shared: np.ndarray) -> tuple[IntArray, int]:
    """Partner of every quad, and the number of quads that more than two blocks share.

    ``shared`` (n_unique,): nodes that several blocks have in common. Only quads whose corners are shared, all but one
    for collapsed ones, need to be compared, and only with those that have the same smallest corner.
    """
    smallest = np.full(len(corners), len(shared), dtype=corners.dtype)
    count = np.zeros(len(corners), dtype=np.int8)
    for column in corners.T:
        count += shared[column]
        np.minimum(smallest, column, out=smallest)
    smallest[count < (3 if corners.shape[1] == 4 else 2)] = len(shared)
    partner = empty((len(corners),), integers(len(corners)))
    partner[:] = EXTERNAL
    crowded, step = 0, max(_MATCHED, -(-len(shared) // _PASSES))
    for low in range(0, len(shared), step):
        some = np.flatnonzero((smallest >= low) & (smallest < min(low + step, len(shared))))
        found, more = _partners_of(corners[some])
        partner[some] = np.where(found >= 0, some[np.maximum(found, 0)], found)
        crowded += more
    return partner, crowded


def _partners_of(corners: IntArray) -> tuple[IntArray, int]:
    rows = np.sort(corners, axis=1)
    distinct = 1 + np.count_nonzero(np.diff(rows, axis=1), axis=1)
    collapsed = distinct < (3 if rows.shape[1] == 4 else 2)
    triangles = (distinct == 3) & (rows.shape[1] == 4)
    if triangles.any():
        # On the other side, the same triangle may repeat another corner: keep three corners and pad.
        repeated = np.argmax(np.diff(rows[triangles], axis=1) == 0, axis=1)
        some = rows[triangles]
        some[np.arange(len(some)), repeated] = rows.max() + 1
        rows[triangles] = np.sort(some, axis=1)
    live = np.flatnonzero(~collapsed)
    partner = np.full(len(rows), COLLAPSED, dtype=np.int64)
    matched, count = equal_rows(rows[live])
    partner[live] = np.where(matched >= 0, live[matched], EXTERNAL)
    return partner, int(np.count_nonzero(count > 2))
