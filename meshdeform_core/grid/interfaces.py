"""Block interfaces as windows with their orientation, found from shared face quads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import BoolArray
from .blocks import Connection, Grid, IntArray, Shape, Side, Window
from .topology import Topology, side_nodes
from .windows import windows_of_quads


def find_interfaces(grid: Grid, topology: Topology) -> tuple[Connection, ...]:
    """One connection per rectangle of shared faces, each interface once (from its lower block side)."""
    found: list[Connection] = []
    for block in range(grid.n_blocks):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            partner = topology.partner[quads]
            own = 6 * block + side
            opposite = np.where(partner >= 0, topology.quads.block_side[np.maximum(partner, 0)], -1)
            for other in np.unique(opposite[opposite >= own]):
                mine = opposite == other
                if other == own:
                    # A face folded onto itself (C-grid cut): each pair once.
                    mine &= partner > np.arange(quads.start, quads.stop)
                found += _connections(grid, topology, _Pair(block, side, int(other) // 6, Side(int(other) % 6)), mine)
    return tuple(found)


@dataclass(frozen=True)
class _Pair:
    block: int
    side: Side
    donor: int
    donor_side: Side


def _connections(grid: Grid, topology: Topology, pair: _Pair, mine: BoolArray) -> list[Connection]:
    """Rectangles of the quads ``mine`` of one side that map onto the donor side by one index transformation."""
    quads = topology.quads
    counts, donor_counts = quads.counts[pair.block, pair.side], quads.counts[pair.donor, pair.donor_side]
    local = np.stack(np.divmod(np.arange(len(mine)), counts[1]), axis=1)
    partner = topology.partner[quads.of_side(pair.block, pair.side)] - quads.start[pair.donor, pair.donor_side]
    donor_local = np.stack(np.divmod(np.where(mine, partner, 0), donor_counts[1]), axis=1)
    found: list[Connection] = []
    left = mine.copy()
    while left.any():
        # Faces with a collapsed edge fit several transformations: prefer that of a quad that is not collapsed.
        seed = _seed(grid, topology, pair, left, local, donor_local)
        if seed is None:
            break
        matrix, offset = seed
        image = local @ matrix.T + offset
        fits = left & (image == donor_local).all(axis=1)
        shape = (int(counts[0]), int(counts[1]))
        for window in windows_of_quads(grid.shapes[pair.block], pair.block, pair.side, fits.reshape(shape)):
            found.append(_connection(grid, pair, window, matrix, offset))
        left &= ~fits
    return found


def _seed(
    grid: Grid, topology: Topology, pair: _Pair, left: BoolArray, local: IntArray, donor_local: IntArray
) -> tuple[IntArray, IntArray] | None:
    """Index matrix (2, 2) and quad offset (2,) from a quad in ``left``, if possible one without collapsed edges."""
    own = _numbers(grid, topology, pair.block, pair.side)
    donor = _numbers(grid, topology, pair.donor, pair.donor_side)
    corners = np.sort(topology.quads.corners[topology.quads.of_side(pair.block, pair.side)], axis=1)
    sound = (np.diff(corners, axis=1) > 0).all(axis=1)
    for quad in np.r_[np.flatnonzero(left & sound), np.flatnonzero(left & ~sound)]:
        (u, v), (p, q) = local[quad], donor_local[quad]
        a, b = own[u : u + 2, v : v + 2], donor[p : p + 2, q : q + 2]
        if a.shape != b.shape and a.shape != b.T.shape:
            continue
        for matrix in _ORIENTATIONS:
            if np.array_equal(_oriented(a, matrix), b):
                return matrix, np.array([p, q]) - matrix @ np.array([u, v])
    return None


def _numbers(grid: Grid, topology: Topology, block: int, side: Side) -> IntArray:
    nodes = side_nodes(grid, block, side)
    return topology.numbers_of(nodes.ravel()).reshape(nodes.shape)


# The eight ways to map one rectangle onto another: donor (p, q) = M (u, v) up to an offset.
_ORIENTATIONS = [
    np.array(m).reshape(2, 2)
    for s in (1, -1)
    for t in (1, -1)
    for m in ((s, 0, 0, t), (0, s, t, 0))
]  # fmt: skip


def _oriented(corners: IntArray, matrix: IntArray) -> IntArray:
    """``corners`` (2, 2) of a quad in the donor's index order."""
    swapped = corners.T if matrix[0, 0] == 0 else corners
    rows, columns = matrix.sum(axis=1)
    return swapped[:: int(rows), :: int(columns)]


def _connection(grid: Grid, pair: _Pair, window: Window, matrix: IntArray, offset: IntArray) -> Connection:
    own_axes, donor_axes = pair.side.tangential, pair.donor_side.tangential
    # Quad offsets become node offsets: a reversed axis counts from the quad's far node.
    shift = offset + (matrix.sum(axis=1) < 0)
    ends = [matrix @ np.array(corner) + shift for corner in (window.low, window.high)]
    transform = [0, 0, 0]
    for own in (0, 1):
        along = int(np.flatnonzero(matrix[:, own])[0])
        transform[own_axes[own]] = int(matrix[along, own]) * (donor_axes[along] + 1)
    # Leaving this block across its far face is entering the donor across its near one.
    outward, inward = (1 if pair.side % 2 else -1), (-1 if pair.donor_side % 2 else 1)
    transform[pair.side.axis] = outward * inward * (pair.donor_side.axis + 1)
    if grid.dimension == 2:
        _complete_2d(transform)
    name = f"{grid.names[pair.block]}.{pair.side.label}-{grid.names[pair.donor]}.{pair.donor_side.label}"
    return Connection(
        name,
        pair.block,
        _node(grid.shapes[pair.block], pair.side, window.low),
        _node(grid.shapes[pair.block], pair.side, window.high),
        pair.donor,
        _node(grid.shapes[pair.donor], pair.donor_side, tuple(ends[0].tolist())),
        _node(grid.shapes[pair.donor], pair.donor_side, tuple(ends[1].tolist())),
        (transform[0], transform[1], transform[2]),
    )


def _complete_2d(transform: list[int]) -> None:
    """Normal to the plane of a 2-D grid both blocks have one node: assign the remaining donor axis to that axis."""
    used = {abs(t) for t in transform}
    for axis in range(3):
        if transform[axis] == 0:
            transform[axis] = next(d for d in (1, 2, 3) if d not in used)


def _node(shape: Shape, side: Side, tangential: tuple[int, ...]) -> Shape:
    node = [0, 0, 0]
    node[side.axis] = shape[side.axis] - 1 if side % 2 else 0
    for axis, at in zip(side.tangential, tangential, strict=True):
        node[axis] = int(at)
    return node[0], node[1], node[2]
