"""Topology: which block nodes coincide, which face quads are shared, and which are outside faces of the grid.

Everything follows from the coordinates of the nodes on block faces. The 1-to-1 connections declared in the file are
checked against it in :mod:`meshdeform_core.grid.connectivity.declared`.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...numerics.arrays import BoolArray, runs
from ...numerics.geometry.coincidence import integers
from ...numerics.geometry.copies import coincident_copies, numbered_by_first
from ...parallel import Ranks, collected, empty
from ...parallel.scratch import current_scratch
from ..blocks import FloatArray, Grid, IntArray
from ..dealing import face_bounds
from ..parts import Shape, Side
from .handedness import block_handedness, index_order
from .partners import EXTERNAL, partners
from .strips import FaceStrips, quads_between, shortest_edges

RELATIVE_TOLERANCE = 1e-3
"""Coincident means closer than this fraction of the shortest edge at either node."""


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


def coincident_topology(grid: Grid, tolerance: float = RELATIVE_TOLERANCE) -> Topology:
    """Identify coincident nodes and shared faces of ``grid``.

    Full and partial faces, O-grid seams, C-grid cuts, collapsed edges, poles and all relative orientations need no
    special treatment: quads are shared when they have the same unique corner nodes. Of a grid in parts every rank does
    its share; all ranks get the whole topology.

    Parameters
    ----------
    tolerance : largest distance between coincident nodes relative to the shortest edge at either of them
    """
    ranks, handedness = grid.nodes.ranks, block_handedness(grid)
    bounds = face_bounds(grid.shapes, ranks.count)
    strips = FaceStrips.of(grid, *bounds[ranks.number : ranks.number + 2].tolist())
    face_nodes = _kept(collected(ranks, strips.own_nodes))
    index, first, edge = _coincident(ranks, grid, strips, tolerance)
    edge = _kept(collected(ranks, edge[first == index]))
    number, leads = numbered_by_first(collected(ranks, first))
    del index, first
    number, first = _kept(number), _kept(face_nodes[leads])
    shared = np.zeros(len(first), dtype=bool)
    shared[number[~leads]] = True
    del leads
    quads = _face_quads(ranks, grid, handedness, bounds, strips, strips.among(face_nodes, number))
    del strips
    partner, crowded = partners(ranks, quads.corners, shared)
    return Topology(face_nodes, number, first, edge, quads, _kept(partner), handedness, crowded)


def _kept(array: np.ndarray) -> np.ndarray:
    """The array, in a file where large arrays are stored in files."""
    scratch = current_scratch()
    if not (scratch and scratch.takes(array.nbytes)):
        return array
    found = empty(array.shape, array.dtype)
    found[...] = array
    return np.asarray(found)


def _coincident(
    ranks: Ranks, grid: Grid, strips: FaceStrips, tolerance: float
) -> tuple[IntArray, IntArray, FloatArray]:
    """Of every node of this rank's strips that belongs to it: its number among the face nodes of all ranks, the first
    of those that coincide with it, and the shortest edge at any of them.

    Nodes of different components are never identified.
    """
    nodes, edge = strips.own_nodes, shortest_edges(grid, strips)
    sizes = ranks.gather([len(nodes)])
    index = sum(sizes[: ranks.number]) + np.arange(len(nodes), dtype=integers(sum(sizes)))
    own: list[slice | IntArray] = [slice(None)]
    if grid.component_numbers.any():
        part = np.repeat(grid.component_numbers, np.diff(np.searchsorted(nodes, grid.offsets)))
        own = [np.flatnonzero(part == number) for number in range(int(grid.component_numbers.max()) + 1)]
    first, least = np.empty_like(index), np.empty_like(edge)
    for some in own:
        found = coincident_copies(ranks, index[some], grid.nodes.at(nodes[some]), edge[some], tolerance)
        first[some], least[some] = found
    return index, first, least


def _face_quads(
    ranks: Ranks, grid: Grid, handedness: IntArray, bounds: IntArray, strips: FaceStrips, number: IntArray
) -> FaceQuads:
    """The quads of all sides; ``number`` are the unique numbers of the nodes of this rank's ``strips``."""
    lattice = grid.sides
    counts = np.where(lattice.has_quads[:, None], lattice.cells, 0)
    sizes = counts.prod(axis=1)
    start = np.cumsum(sizes) - sizes
    in_order = index_order(grid, handedness)
    corners = empty((int(sizes.sum()), 2 if grid.dimension == 2 else 4), number.dtype)
    strips.fill_corners(lattice, number, in_order.ravel(), start, corners)
    if ranks.count > 1:
        every = [quads_between(lattice, start, *bounds[n : n + 2].tolist()) for n in range(ranks.count)]
        corners[np.concatenate(every)] = ranks.collect(corners[every[ranks.number]], [len(each) for each in every])
    return FaceQuads(start.reshape(-1, 6), counts.reshape(-1, 6, 2), corners, in_order)


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
    number = 6 * block + side
    na, nb = grid.sides.nodes[number]
    return grid.sides.at(number, np.arange(na)[:, None], np.arange(nb))


def inward_step(shape: Shape, side: Side) -> int:
    """Difference in flat index from a node of the face to the next node inside the block."""
    stride = (shape[1] * shape[2], shape[2], 1)[side.axis]
    return -stride if side % 2 else stride
