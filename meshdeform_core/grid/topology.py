"""The topology of a grid: which block nodes coincide, which face quads are shared, and which are outside faces.

Thin plates are walls on both sides of one place; other examples are the two sides of a sliding interface. Where patches
are declared on both sides, the faces are outside faces. Their nodes move together, as a plate has no thickness, unless
they belong to different components; in a file, they are nodes of their own on each side (:func:`separated`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np

from ..numerics.arrays import spans
from ..numerics.geometry.coincidence import connected_components, equal_rows
from ..numerics.geometry.copies import numbered_by_first
from .blocks import Grid, IntArray
from .coincident import (
    RELATIVE_TOLERANCE,
    FaceQuads,
    Topology,
    block_handedness,
    cells_behind,
    coincident_topology,
    inward_step,
    side_nodes,
)
from .parts import Patch, Side, Window

__all__ = [
    "RELATIVE_TOLERANCE",
    "FaceQuads",
    "Topology",
    "block_handedness",
    "cells_behind",
    "find_topology",
    "inward_step",
    "is_wall",
    "quads_of_patches",
    "quads_of_windows",
    "separated",
    "side_nodes",
]


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


def is_wall(patch: Patch) -> bool:
    """Whether the type of a patch is that of a wall."""
    return any(word in patch.bc_type.lower() for word in ("wall", "solid"))


def _connected_windows(grid: Grid) -> Iterator[Window]:
    """The windows of the declared connections other than periodic ones, on both sides, as far as they exist."""

    def window(block: int, begin: Sequence[int], end: Sequence[int]) -> Iterator[Window]:
        low, high = np.minimum(begin, end), np.maximum(begin, end)
        for side in Side:
            shape = grid.shapes[block]
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
    number, flat = corners[quads].astype(np.int64), _corner_nodes(grid, topology.quads, quads)
    row = np.where(between[number], np.searchsorted(topology.face_nodes[rows], flat), -1)
    label = connected_components(len(rows), _joined_pairs(topology, quads, number, row))
    declared = np.zeros(len(corners), dtype=bool)
    declared[quads_of_patches(topology.quads, grid.patches)[0]] = True
    plate = external[quads] & between[number].all(axis=1)
    plate[plate] = equal_rows(np.sort(number[plate], axis=1))[0] >= 0
    found = []
    for some in (plate, external[quads], external[quads] & ~declared[quads]):
        found.append(np.zeros(len(rows), dtype=bool))
        found[-1][label[row[some][row[some] >= 0]]] = True
    at_plate, outside, undeclared = found
    apart = (at_plate | outside & ~undeclared)[label]
    first = np.searchsorted(topology.face_nodes, topology.first)[topology.number].astype(topology.number.dtype)
    first[rows[apart]] = rows[label[apart]]
    return _numbered(topology, first, quads, np.where(row >= 0, rows[row], -1))


def _joined_pairs(topology: Topology, quads: IntArray, number: IntArray, row: IntArray) -> IntArray:
    """Pairs (n, 2) of ``row`` (m, c), the corners of ``quads`` (m,) with these unique ``number``, that are one node: of
    quads that two blocks share, and of edges without length."""
    pairs, count = [], number.shape[1]
    for a in range(count):
        for b in range(a):
            same = np.flatnonzero((number[:, a] == number[:, b]) & (row[:, a] >= 0))
            pairs.append(np.stack([row[same, a], row[same, b]], axis=1))
    own = np.flatnonzero(topology.partner[quads] >= 0)
    other = np.searchsorted(quads, topology.partner[quads[own]])
    for a in range(count):
        for b in range(count):
            same = np.flatnonzero((number[own, a] == number[other, b]) & (row[own, a] >= 0))
            pairs.append(np.stack([row[own[same], a], row[other[same], b]], axis=1))
    return np.concatenate(pairs)


def _corner_nodes(grid: Grid, faces: FaceQuads, quads: IntArray) -> IntArray:
    """Flat indices (n, 2 or 4) of the corners of face quads, in the order of ``faces.corners``."""
    side, u, v = faces.places(quads)
    flat = grid.sides.corners(side, u, v)[:, :: 4 // faces.corners.shape[1]]
    return np.where(faces.in_order.ravel()[side][:, None], flat, flat[:, ::-1])


def _numbered(topology: Topology, first: IntArray, quads: IntArray, rows: IntArray) -> Topology:
    """The topology in which ``first`` (n_face,) is the first of the face nodes that are one with each.

    ``rows`` (n, c) are the face nodes at the corners of ``quads`` (n,), -1 for those whose number is that of all nodes
    at the place.
    """
    number, leads = numbered_by_first(first)
    lead = np.flatnonzero(leads)
    # Places of which all nodes are still one.
    renamed = number[np.searchsorted(topology.face_nodes, topology.first)]
    corners = renamed[topology.quads.corners]
    corners[quads] = np.where(rows >= 0, number[rows], corners[quads])
    return dataclasses.replace(
        topology,
        number=number,
        first=topology.face_nodes[lead],
        edge=topology.edge[topology.number[lead]],
        quads=dataclasses.replace(topology.quads, corners=corners),
    )
