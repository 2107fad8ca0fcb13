"""Topology: which block nodes coincide, which face quads are shared, and which are outside faces of the grid.

Everything follows from the coordinates of the nodes on block faces. The 1-to-1 connections declared in the file are
checked against it in :mod:`meshdeform_core.grid.connectivity`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numerics.geometry.coincidence import coincident_groups, distinct, equal_rows
from .blocks import FloatArray, Grid, IntArray, Shape, Side

RELATIVE_TOLERANCE = 1e-3
"""Coincident means closer than this fraction of the shortest edge at either node."""

_ALL, _LATER, _EARLIER = slice(None), slice(1, None), slice(None, -1)
COLLAPSED = -2
EXTERNAL = -1


@dataclass(frozen=True)
class FaceQuads:
    """All cell faces on all block faces; in a 2-D grid the cell edges on all block edges.

    Attributes
    ----------
    start : (n_blocks, 6) first quad of each block side; quads of a side are C-ordered in ``counts``
    counts : (n_blocks, 6, 2) quads along ``side.tangential``
    corners : (n_quads, 4) unique node numbers, counter-clockwise as seen from outside the block; (n_quads, 2) in 2-D
    """

    start: IntArray
    counts: IntArray
    corners: IntArray

    def of_side(self, block: int, side: Side) -> slice:
        """The quads of one block side."""
        first = int(self.start[block, side])
        return slice(first, first + int(np.prod(self.counts[block, side])))

    @cached_property
    def block_side(self) -> IntArray:
        """``6 * block + side`` of every quad, (n_quads,)."""
        sizes = self.counts.prod(axis=2).ravel()
        return np.repeat(np.arange(sizes.size), sizes)


@dataclass(frozen=True, eq=False, repr=False)
class Topology:
    """Nodes and faces of a grid with coincident nodes identified.

    Only nodes on block faces can coincide with others. They carry *unique node numbers* ``0 ... n_unique - 1``.

    Attributes
    ----------
    face_nodes : (n_face,) flat indices of all block nodes on block faces, ascending
    number : (n_face,) unique node number of each
    first : (n_unique,) flat index of the first block node with that number
    edge : (n_unique,) shortest non-zero edge at the node (grid length unit)
    quads : the cell faces on block faces
    partner : (n_quads,) the quad on the other side of an interface, ``EXTERNAL`` or ``COLLAPSED``
    handedness : (n_blocks,) +1 for right-handed blocks, -1 for left-handed ones
    crowded : quads that more than two blocks share (their partners form a ring)
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
        return self.number[np.searchsorted(self.face_nodes, flat)]

    def opened(self, quads: IntArray) -> Topology:
        """The same topology with shared ``quads`` and their partners declared external (two-sided walls)."""
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
    sides = [(b, side) for b in range(grid.n_blocks) for side in Side if _has_quads(grid.shapes[b], side)]
    on_side = {key: side_nodes(grid, *key) for key in sides}
    face_nodes = distinct(np.concatenate([nodes.ravel() for nodes in on_side.values()]), grid.n_nodes)
    at = {key: np.searchsorted(face_nodes, nodes) for key, nodes in on_side.items()}
    edge = _shortest_edges(grid, at, face_nodes)
    number = coincident_groups(grid.points[face_nodes], tolerance * edge)
    n_unique = int(number.max()) + 1
    first = np.empty(n_unique, dtype=np.int64)
    first[number[::-1]] = face_nodes[::-1]
    unique_edge = np.full(n_unique, np.inf)
    np.minimum.at(unique_edge, number, edge)
    handedness = block_handedness(grid)
    quads = _face_quads(grid, {key: number[rows] for key, rows in at.items()}, handedness)
    partner, crowded = _partners(quads.corners, np.bincount(number) > 1)
    return Topology(face_nodes, number, first, unique_edge, quads, partner, handedness, crowded)


def side_nodes(grid: Grid, block: int, side: Side) -> IntArray:
    """Flat indices of the nodes of one block face, shaped along ``side.tangential``."""
    shape = grid.shapes[block]
    strides = (shape[1] * shape[2], shape[2], 1)
    a, b = side.tangential
    at = (shape[side.axis] - 1) * (side % 2)
    origin = int(grid.offsets[block]) + at * strides[side.axis]
    return origin + np.arange(shape[a])[:, None] * strides[a] + np.arange(shape[b]) * strides[b]


def inward_step(shape: Shape, side: Side) -> int:
    """Difference in flat index from a node of the face to the next node inside the block."""
    stride = (shape[1] * shape[2], shape[2], 1)[side.axis]
    return -stride if side % 2 else stride


def block_handedness(grid: Grid) -> IntArray:
    """+1 or -1 per block, from the majority of a regular sample of at most 8 cells per direction."""
    return np.array([_handedness(grid.block(b)) for b in range(grid.n_blocks)], dtype=np.int64)


def _handedness(x: FloatArray) -> int:
    # A 2-D block is treated as one layer of cells extruded along +x, +y or +z, whichever is normal to its plane.
    if 1 in x.shape[:3]:
        flat = x.shape.index(1)
        a, b = (axis for axis in range(3) if axis != flat)
        plane = x.squeeze(axis=flat)
        first, second = _mean_edges(plane, 2)
        normal = np.cross(first, second)
        signs = np.sign(normal[..., int(np.argmax(np.abs(normal).sum(axis=0)))])
        # Index order (a, b) is cyclic for a flat i or k axis and reversed for a flat j axis.
        return -1 if (signs.sum() < 0) != ((b - a) == 2) else 1
    edges = _mean_edges(x, 3)
    signs = np.sign(np.einsum("...i,...i->...", edges[0], np.cross(edges[1], edges[2])))
    return -1 if signs.sum() < 0 else 1


def _mean_edges(x: FloatArray, dimension: int) -> list[FloatArray]:
    """Mean edge vectors of every sampled cell along each of its directions."""
    samples = [np.unique(np.linspace(0, n - 2, min(n - 1, 8)).astype(int)) for n in x.shape[:dimension]]
    picked = np.stack(
        [x[np.ix_(*(s + c for s, c in zip(samples, corner, strict=True)))] for corner in np.ndindex(*(2,) * dimension)]
    ).reshape(*(2,) * dimension, -1, 3)
    means = [picked.mean(axis=tuple(a for a in range(dimension) if a != axis)) for axis in range(dimension)]
    return [mean[1] - mean[0] for mean in means]


def _has_quads(shape: Shape, side: Side) -> bool:
    return shape[side.axis] > 1


def _shortest_edges(grid: Grid, at: dict[tuple[int, Side], IntArray], face_nodes: IntArray) -> FloatArray:
    """Shortest edge at every face node that is longer than the round-off of the file's precision."""
    shortest = np.full(len(face_nodes), np.inf)
    epsilon = 4 * float(np.finfo(grid.precision).eps)
    for (block, side), rows in at.items():
        p, q = (_layer(grid.block(block), side, depth) for depth in (0, 1))
        size = _largest(p), _largest(q)
        local = _sound_square(p - q, epsilon, *size)
        for one, two in (((_LATER,), (_EARLIER,)), ((_ALL, _LATER), (_ALL, _EARLIER))):
            square = _sound_square(p[(_ALL, *one)] - p[(_ALL, *two)], epsilon, size[0][one], size[0][two])
            np.minimum(local[one], square, out=local[one])
            np.minimum(local[two], square, out=local[two])
        shortest[rows] = np.minimum(shortest[rows], local)
    endless = np.flatnonzero(np.isinf(shortest))
    shortest[endless] = (epsilon * np.abs(grid.points[face_nodes[endless]]).max(axis=1, initial=0.0)) ** 2
    return np.asarray(np.sqrt(shortest))


def _layer(x: FloatArray, side: Side, depth: int) -> FloatArray:
    """Coordinates (3, na, nb) of the nodes of a block side, or ``depth`` layers inside, component by component."""
    at = -1 - depth if side % 2 else depth
    return np.ascontiguousarray(np.moveaxis(x, (3, side.axis), (0, 1))[:, at])


def _largest(x: FloatArray) -> FloatArray:
    """Largest absolute coordinate of points (3, ...)."""
    return np.asarray(np.maximum(np.maximum(np.abs(x[0]), np.abs(x[1])), np.abs(x[2])))


def _sound_square(edge: FloatArray, epsilon: float, one: FloatArray, two: FloatArray) -> FloatArray:
    """Squared length of edges (3, ...), infinite where it is nothing but noise at ends of this size."""
    square = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2]
    if square.size and square.min() <= (epsilon * max(one.max(), two.max())) ** 2:
        square[square <= (epsilon * np.maximum(one, two)) ** 2] = np.inf
    return np.asarray(square)


def _face_quads(
    grid: Grid,
    numbers: dict[tuple[int, Side], IntArray],
    handedness: IntArray,
) -> FaceQuads:
    """The quads of all sides from the unique numbers of their nodes."""
    start = np.zeros((grid.n_blocks, 6), dtype=np.int64)
    counts = np.zeros((grid.n_blocks, 6, 2), dtype=np.int64)
    parts: list[IntArray] = []
    total = 0
    for block in range(grid.n_blocks):
        for side in Side:
            start[block, side] = total
            if (block, side) not in numbers:
                continue
            own = numbers[block, side]
            corners = _side_corners(own, side, grid.dimension, int(handedness[block]))
            counts[block, side] = [max(n - 1, 1) for n in own.shape]
            parts.append(corners)
            total += len(corners)
    return FaceQuads(start, counts, np.concatenate(parts))


def _side_corners(nodes: IntArray, side: Side, dimension: int, handedness: int) -> IntArray:
    """Corners of a side's quads as values of ``nodes``, counter-clockwise as seen from outside; in 2-D both ends.

    In 2-D the direction is such that the outside lies to the right, looking against the plane's positive normal.
    """
    if dimension == 2:
        line = nodes.ravel()
        corners = [line[:-1], line[1:]]
    else:
        corners = [c.ravel() for c in (nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:])]
    return np.stack(corners if in_index_order(side, nodes.shape, dimension, handedness) else corners[::-1], axis=1)


def in_index_order(side: Side, shape: tuple[int, ...], dimension: int, handedness: int) -> bool:
    """Whether the corners of a side's quads go round in the order of its indices, not in the opposite one.

    ``shape``: nodes along ``side.tangential``.
    """
    outward = (1 if side % 2 else -1) * handedness
    if dimension == 2:
        # (i, j), (j, k) planes are cyclic, the (i, k) plane is not: the same rule as for the normals in 3-D.
        first_axis = side.axis < min(a for a, n in zip(side.tangential, shape, strict=True) if n > 1)
        return outward > 0 if first_axis else outward < 0
    # e_b x e_c points along +a for a = i and k, along -a for a = j.
    return outward > 0 if side.axis != 1 else outward < 0


def _partners(corners: IntArray, shared: np.ndarray) -> tuple[IntArray, int]:
    """Partner of every quad, and how many more than two blocks share; ``shared`` (n_unique,): nodes of several blocks.

    Shared quads have shared corners, collapsed ones at most one that is not; the others need not be sorted.
    """
    count = np.zeros(len(corners), dtype=np.int8)
    for column in corners.T:
        count += shared[column]
    some = np.flatnonzero(count >= (3 if corners.shape[1] == 4 else 2))
    partner = np.full(len(corners), EXTERNAL, dtype=np.int64)
    found, crowded = _partners_of(corners[some])
    partner[some] = np.where(found >= 0, some[np.maximum(found, 0)], found)
    return partner, crowded


def _partners_of(corners: IntArray) -> tuple[IntArray, int]:
    rows = np.sort(corners, axis=1)
    distinct = 1 + np.count_nonzero(np.diff(rows, axis=1), axis=1)
    collapsed = distinct < (3 if rows.shape[1] == 4 else 2)
    triangles = (distinct == 3) & (rows.shape[1] == 4)
    if triangles.any():
        # The same triangle may repeat another corner on the other side: keep three corners and pad.
        repeated = np.argmax(np.diff(rows[triangles], axis=1) == 0, axis=1)
        some = rows[triangles]
        some[np.arange(len(some)), repeated] = rows.max() + 1
        rows[triangles] = np.sort(some, axis=1)
    live = np.flatnonzero(~collapsed)
    partner = np.full(len(rows), COLLAPSED, dtype=np.int64)
    matched, count = equal_rows(rows[live])
    partner[live] = np.where(matched >= 0, live[matched], EXTERNAL)
    return partner, int(np.count_nonzero(count > 2))
