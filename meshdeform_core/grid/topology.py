"""The topology of a grid: which block nodes coincide, which face quads are shared, and which are outside faces.

Everything follows from the coordinates of the nodes on block faces, of which every rank has copies if a grid is in
parts, and from declared patches: thin plates are walls on both sides of one place; other examples are the two sides of
a sliding interface. Where patches are declared on both sides, the faces are outside faces. Their nodes move together,
as a plate has no thickness, unless they belong to different components; in a file, they are nodes of their own on each
side (:func:`separated`). The 1-to-1 connections declared in the file are checked against the topology in
:mod:`meshdeform_core.grid.connections`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numerics.arrays import BoolArray, batches, runs, spans
from ..numerics.geometry.coincidence import (
    ascending,
    coincident_copies,
    connected_components,
    equal_rows,
    integers,
    numbered_by_first,
)
from ..parallel import current_sharing, empty
from .blocks import FloatArray, Grid, IntArray
from .parts import Patch, Side, Window
from .planes import block_handedness

RELATIVE_TOLERANCE = 1e-3
"""Coincident means closer than this fraction of the shortest edge at either node."""
COLLAPSED, EXTERNAL = -2, -1
"""Partners of face quads without an area, and of those that no other block shares."""
_TOGETHER = 100_000
"""Nodes processed at a time: few enough for the processor's cache."""
_MATCHED, _PASSES = 1_000_000, 16
"""Unique nodes whose quads are compared at a time, which bounds the memory; more of them in large grids, so that all
quads are searched for those to be compared at most so often."""


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
        return _kept_in_file(np.repeat(np.arange(sizes.size, dtype=integers(sizes.size)), sizes))


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
        """Unique node numbers of flat indices, -1 inside blocks."""
        place = np.minimum(np.searchsorted(self.face_nodes, flat), len(self.face_nodes) - 1)
        return np.where(self.face_nodes[place] == flat, self.number[place], -1).astype(np.int64)

    def opened(self, quads: IntArray) -> Topology:
        """The topology with shared ``quads`` and their partners declared external (two-sided walls)."""
        partner = self.partner.copy()
        partner[self.partner[quads]] = EXTERNAL
        partner[quads] = EXTERNAL
        return dataclasses.replace(self, partner=partner)


def find_topology(grid: Grid, tolerance: float = RELATIVE_TOLERANCE) -> Topology:
    """Identify coincident nodes and shared faces of ``grid``; see :func:`coincident_topology`.

    Coincident faces with patches on both sides are outside faces. A declared 1-to-1 connection decides otherwise, but
    not against walls on both sides.
    """
    topology = coincident_topology(grid, tolerance)
    quads, number = quads_of_patches(topology.quads, grid.patches)
    shared = topology.partner[quads] >= 0
    if not shared.any():
        return topology
    patch = np.full(len(topology.partner), -1)
    patch[quads[shared]] = number[shared]
    own = np.flatnonzero(patch >= 0)
    own = own[patch[topology.partner[own]] >= 0]
    wall = np.array([is_wall(each) for each in grid.patches])
    walls = wall[patch[own]] & wall[patch[topology.partner[own]]]
    if not walls.all():
        connected = np.zeros(len(patch), dtype=bool)
        connected[quads_of_windows(topology.quads, list(_connected_windows(grid)))[0]] = True
        own = own[walls | ~connected[own]]
    return topology.opened(own) if own.size else topology


def coincident_topology(grid: Grid, tolerance: float = RELATIVE_TOLERANCE) -> Topology:
    """Identify coincident nodes, those within ``tolerance`` times the shortest edge at either, and shared faces.

    Full and partial faces, O-grid seams, C-grid cuts, collapsed edges, poles and all relative orientations need no
    special treatment: quads are shared when they have the same unique corner nodes. Nodes of different components are
    never identified.
    """
    handedness, sides = block_handedness(grid), np.flatnonzero(grid.sides.has_quads)
    nodes, places = _face_nodes(grid, sides)
    # Shortest edge at all face ``nodes``, ignoring edges within the round-off of the file's precision.
    shortest = np.full(len(nodes), np.inf)
    epsilon = 4 * float(np.finfo(grid.precision).eps)
    done = 0
    for lo, hi in batches(grid.sides.nodes[sides].prod(axis=1), _TOGETHER):
        square = _edges_of_sides(grid, sides[lo:hi], epsilon)
        np.minimum.at(shortest, places[done : done + len(square)], square)
        done += len(square)
    endless = np.flatnonzero(np.isinf(shortest))
    shortest[endless] = (epsilon * np.abs(grid.points[nodes[endless]]).max(axis=1, initial=0.0)) ** 2
    edge, part = np.asarray(np.sqrt(shortest)), grid.component_numbers
    first = np.empty(len(nodes), integers(len(nodes)))
    for component in range(int(part.max()) + 1):
        own = np.flatnonzero(np.repeat(part == component, np.diff(np.searchsorted(nodes, grid.offsets))))
        found, edge[own] = coincident_copies(grid.nodes.at(nodes[own]), edge[own], tolerance)
        first[own] = own[found]
    number, leads = numbered_by_first(first)
    shared = np.zeros(int(leads.sum()), dtype=bool)
    shared[number[~leads]] = True
    quads = _face_quads(grid, handedness, sides, number[places])
    partner, crowded = partners(quads.corners, shared)
    nodes, number, lead, edge, partner = map(_kept_in_file, (nodes, number, nodes[leads], edge[leads], partner))
    return Topology(nodes, number, lead, edge, quads, partner, handedness, crowded)


def _kept_in_file(array: np.ndarray) -> np.ndarray:
    """The array, in a file where large arrays are stored in files."""
    if current_sharing().scratch is None:
        return array
    found = empty(array.shape, array.dtype)
    found[...] = array
    return np.asarray(found)


def _face_nodes(grid: Grid, sides: IntArray) -> tuple[IntArray, IntArray]:
    """Flat indices of all nodes of ``sides``, ascending, and the place among them of every node of each side.

    A few blocks at a time, as their nodes follow each other in the grid.
    """
    blocks = np.searchsorted(sides, 6 * np.arange(grid.n_blocks + 1))
    ends = np.append(0, np.cumsum(grid.sides.nodes[sides].prod(axis=1)))[blocks]
    places = np.empty(int(ends[-1]), integers(int(ends[-1])))
    found, count = [np.empty(0, dtype=np.int64)], 0
    for lo, hi in batches(np.diff(ends), _TOGETHER):
        flat = grid.sides.all_nodes(sides[blocks[lo] : blocks[hi]])[3]
        nodes = ascending(flat)
        places[ends[lo] : ends[hi]] = count + np.searchsorted(nodes, flat)
        found.append(nodes)
        count += len(nodes)
    return np.concatenate(found), places


def _edges_of_sides(grid: Grid, sides: IntArray, epsilon: float) -> FloatArray:
    """Square of the shortest edge at every node of ``sides``, along the side or into the block."""
    lattice = grid.sides
    side, u, v, flat = lattice.all_nodes(sides)
    here = grid.points[flat].T.copy()
    size = np.abs(here).max(axis=0)
    inside = grid.points[flat + lattice.inward[side]].T.copy()
    shortest = _sound_square(here - inside, epsilon, size, np.abs(inside).max(axis=0))
    for step, number in ((lattice.nodes[side, 1], u), (np.ones_like(v), v)):
        two = np.flatnonzero(number)
        one = two - step[two]
        square = _sound_square(here[:, two] - here[:, one], epsilon, size[two], size[one])
        for end in (one, two):
            shortest[end] = np.minimum(shortest[end], square)
    return shortest


def _sound_square(edge: FloatArray, epsilon: float, one: FloatArray, two: FloatArray) -> FloatArray:
    """Squared length of edges (3, n); infinite where it is within the round-off of coordinates of this size."""
    square = edge[0] * edge[0] + edge[1] * edge[1] + edge[2] * edge[2]
    square[square <= (epsilon * np.maximum(one, two)) ** 2] = np.inf
    return np.asarray(square)


def _face_quads(grid: Grid, handedness: IntArray, sides: IntArray, number: IntArray) -> FaceQuads:
    """The quads of all sides; ``number`` are the unique numbers of the nodes of ``sides``, side after side."""
    lattice = grid.sides
    # One quad across the plane of a 2-D block.
    counts = np.where(lattice.has_quads[:, None], np.maximum(lattice.nodes - 1, 1), 0)
    sizes = counts.prod(axis=1)
    start = np.cumsum(sizes) - sizes
    # Whether the index order of a side winds its quads counter-clockwise as seen from outside the block. In 2-D the
    # outside lies to the right, looking against the plane's positive normal. (i, j), (j, k) planes are cyclic, the
    # (i, k) plane is not: the same rule as for normals in 3-D, where e_b x e_c points along +a for i and k, -a for j.
    axis, far = np.divmod(np.arange(6), 2)
    outward = (np.where(far == 1, 1, -1) * handedness[:, None]) > 0
    flat = np.argmin(grid.shapes, axis=1)[:, None]
    in_order = np.where(axis < 3 - axis - flat if grid.dimension == 2 else axis != 1, outward, ~outward)
    corners = empty((int(sizes.sum()), 2 if grid.dimension == 2 else 4), number.dtype)
    base = lattice.nodes[sides].prod(axis=1)
    base = np.cumsum(base) - base
    for lo, hi in batches(sizes[sides], _TOGETHER):
        run, local = spans(sizes[sides[lo:hi]])
        side = sides[lo + run]
        u, v = np.divmod(local, counts[side, 1])
        width = lattice.nodes[side, 1]
        at = base[lo + run] + u * width + v
        if corners.shape[1] == 2:
            ends = [at, at + np.where(lattice.nodes[side, 0] > 1, width, 1)]
        else:
            ends = [at, at + width, at + width + 1, at + 1]
        ordered, first = in_order.ravel()[side], int(start[sides[lo]])
        for column, (one, other) in enumerate(zip(ends, reversed(ends), strict=True)):
            corners[first : first + len(at), column] = number[np.where(ordered, one, other)]
    return FaceQuads(start.reshape(-1, 6), counts.reshape(-1, 6, 2), corners, in_order)


def partners(corners: IntArray, shared: BoolArray) -> tuple[IntArray, int]:
    """Partner of every quad, ``EXTERNAL`` or ``COLLAPSED``, and the number of quads that more than two blocks share.

    Of ``corners`` (n_quads, 2 or 4) those of a quad that can have a partner are ``shared`` (n_unique,) by several
    blocks, all but one for collapsed quads; it is compared only with those that have the same smallest corner.
    """
    smallest = np.full(len(corners), len(shared), dtype=corners.dtype)
    count = np.zeros(len(corners), dtype=np.int8)
    for column in corners.T:
        count += shared[column]
        np.minimum(smallest, column, out=smallest)
    quads = np.flatnonzero(count >= (3 if corners.shape[1] == 4 else 2)).astype(integers(len(corners)))
    partner, crowded, smallest = np.full(len(corners), EXTERNAL, dtype=quads.dtype), 0, smallest[quads]
    first, last = int(smallest.min(initial=len(shared))), int(smallest.max(initial=-1)) + 1
    step = max(_MATCHED, -(-(last - first) // _PASSES))
    for low in range(first, last, step):
        some = quads[(smallest >= low) & (smallest < low + step)]
        rows = np.sort(corners[some], axis=1)
        different = 1 + np.count_nonzero(np.diff(rows, axis=1), axis=1)
        triangles = np.flatnonzero((different == 3) & (rows.shape[1] == 4))
        if triangles.size:
            # On the other side, the same triangle may repeat another corner: keep three corners and pad.
            repeated = np.argmax(np.diff(rows[triangles], axis=1) == 0, axis=1)
            rows[triangles, repeated] = rows.max() + 1
            rows[triangles] = np.sort(rows[triangles], axis=1)
        live = different >= (3 if rows.shape[1] == 4 else 2)
        partner[some[~live]], rows, some = COLLAPSED, rows[live], some[live]
        matched, numbers = equal_rows(rows)
        partner[some] = np.where(matched >= 0, some[matched], EXTERNAL)
        crowded += int(np.count_nonzero(numbers > 2))
    return partner, crowded


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


def is_wall(patch: Patch) -> bool:
    """Whether the type of a patch is that of a wall."""
    return any(word in patch.bc_type.lower() for word in ("wall", "solid"))


def _connected_windows(grid: Grid) -> Iterator[Window]:
    """The windows of the declared connections other than periodic ones, on both sides, as far as they exist."""

    def window(block: int, begin: Sequence[int], end: Sequence[int]) -> Iterator[Window]:
        shape, low, high = grid.shapes[block], np.minimum(begin, end), np.maximum(begin, end)
        for side in Side:
            across = low[side.axis] == high[side.axis] == side.layer(shape) and shape[side.axis] > 1
            if across and (low >= 0).all() and (high < shape).all():
                (a, b), (c, d) = (index[list(side.tangential)].tolist() for index in (low, high))
                yield Window(block, side, (a, b), (c, d))

    for each in grid.connections:
        if each.periodic is None:
            yield from window(each.block, each.begin, each.end)
            yield from window(each.donor_block, each.donor_begin, each.donor_end)


def quads_of_windows(quads: FaceQuads, windows: Sequence[Window]) -> tuple[IntArray, IntArray]:
    """Quads within windows, window after window, and the number of each quad's window; a line of nodes has no quads."""
    rows = [(6 * window.block + window.side, *window.low, *window.high) for window in windows]
    side, u0, v0, u1, v1 = np.array(rows, dtype=np.int64).reshape(-1, 5).T
    size = np.stack([u1 - u0, v1 - v0], axis=1)
    if quads.corners.shape[1] == 2:
        # In a 2-D grid a window has no extent across the single plane of nodes, but contains one cell edge.
        size[(size > 0).any(axis=1)] = np.maximum(size[(size > 0).any(axis=1)], 1)
    window, place = spans(size.prod(axis=1))
    u, v = np.divmod(place, size[window, 1])
    columns = quads.counts[..., 1].ravel()[side]
    first = quads.start.ravel()[side] + u0 * columns + v0
    return np.asarray(first[window] + u * columns[window] + v, dtype=np.int64), window


def quads_of_patches(quads: FaceQuads, patches: Sequence[Patch]) -> tuple[IntArray, IntArray]:
    """Quads of all windows of patches, patch after patch, and the number of the patch of each."""
    found, window = quads_of_windows(quads, [window for patch in patches for window in patch.windows])
    return found, np.repeat(np.arange(len(patches)), [len(patch.windows) for patch in patches])[window]


def separated(grid: Grid, topology: Topology) -> Topology:
    """The topology with nodes of their own wherever blocks touch without being joined, for files.

    Blocks around a node are joined by the faces that they share. Those that no face joins to the others have a node of
    their own at a plate, and where all their outside faces at the node belong to patches: blocks may touch at an edge
    only. Around the rim of a plate all blocks are joined.
    """
    corners, external = topology.quads.corners, topology.external
    between = np.zeros(topology.n_unique, dtype=bool)
    between[corners[external]] = True
    between &= np.bincount(topology.number, minlength=topology.n_unique) > 1
    if not grid.patches or not between.any():
        return topology
    # Several nodes of blocks lie at these places: which of them are one node?
    rows = np.flatnonzero(between[topology.number])
    quads = np.flatnonzero(between[corners].any(axis=1))
    number, (side, u, v) = corners[quads].astype(np.int64), topology.quads.places(quads)
    flat = grid.sides.corners(side, u, v)[:, :: 4 // corners.shape[1]]
    flat = np.where(topology.quads.in_order.ravel()[side][:, None], flat, flat[:, ::-1])
    row = np.where(between[number], np.searchsorted(topology.face_nodes[rows], flat), -1)
    # Corners are one node where they have the same number in a quad, as at an edge without length, and in its partner.
    partner = topology.partner[quads]
    beside = np.where(partner >= 0, np.searchsorted(quads, partner), np.arange(len(quads)))
    numbers, at = (np.concatenate([each, each[beside]], axis=1) for each in (number, row))
    same = (numbers[:, :, None] == numbers[:, None]) & (at >= 0)[:, None] & ~np.tri(numbers.shape[1], dtype=bool)
    quad, one, two = np.nonzero(same)
    label = connected_components(len(rows), np.stack([at[quad, one], at[quad, two]], axis=1))
    declared = np.zeros(len(corners), dtype=bool)
    declared[quads_of_patches(topology.quads, grid.patches)[0]] = True
    plate = external[quads] & between[number].all(axis=1)
    plate[plate] = equal_rows(np.sort(number[plate], axis=1))[0] >= 0
    found = np.zeros((3, len(rows)), dtype=bool)
    for marks, some in zip(found, (plate, external[quads], external[quads] & ~declared[quads]), strict=True):
        marks[label[row[some][row[some] >= 0]]] = True
    at_plate, outside, undeclared = found
    apart = (at_plate | outside & ~undeclared)[label]
    first = np.searchsorted(topology.face_nodes, topology.first)[topology.number].astype(topology.number.dtype)
    # What is not apart is one node, whichever group has the first.
    groups = np.where(apart, label, len(rows) + topology.number[rows])
    _, lead, group = np.unique(groups, return_index=True, return_inverse=True)
    first[rows] = rows[lead[group]]
    number, leads = numbered_by_first(first)
    # Quads have the numbers of their own nodes, elsewhere those of the places, of which all nodes are still one.
    renamed = number[np.searchsorted(topology.face_nodes, topology.first)][corners]
    renamed[quads] = np.where(row >= 0, number[rows[row]], renamed[quads])
    return dataclasses.replace(
        topology,
        number=number,
        first=topology.face_nodes[leads],
        edge=topology.edge[topology.number[leads]],
        quads=dataclasses.replace(topology.quads, corners=renamed),
    )
