"""Block-to-block connections: those that the file declares, checked against coordinates, and interfaces found."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import GridError
from ..numerics.arrays import BoolArray, runs
from ..numerics.geometry.coincidence import distinct
from ..wording import listed
from .blocks import FloatArray, Grid, IntArray
from .parts import Connection, Periodicity, Shape, Side
from .topology import RELATIVE_TOLERANCE, Topology
from .windows import Rectangles, rectangles

_MAPPED = 1 << 16
"""Quads mapped at a time, which bounds the memory."""


def connected_nodes(grid: Grid, connection: Connection) -> tuple[IntArray, IntArray]:
    """Flat indices of the nodes of a declared connection and of their donors, both (n,). Raises GridError when a range
    exceeds its block, or the two differ in size."""
    begin, end, donor_begin = map(np.array, (connection.begin, connection.end, connection.donor_begin))
    turn = np.zeros((3, 3), dtype=np.int64)
    for axis, along in enumerate(connection.transform):
        if along:
            turn[abs(along) - 1, axis] = np.sign(along)
    own = connection.block, "range", begin, np.eye(3, dtype=np.int64)
    both = own, (connection.donor_block, "donor range", donor_begin, turn)
    for block, role, first, steps in both:
        for reached in (first, first + steps @ (end - begin)):
            if (reached < 0).any() or (reached >= grid.shapes[block]).any():
                raise GridError(
                    f"connection {connection.name!r} of {grid.names[connection.block]}: its {role} reaches node "
                    f"{(reached + 1).tolist()}, but {grid.names[block]} has {list(grid.shapes[block])} nodes"
                )
    places = np.indices(np.abs(end - begin) + 1).reshape(3, -1) * np.where(end >= begin, 1, -1)[:, None]
    one, two = (
        grid.offsets[block] + np.ravel_multi_index(first[:, None] + steps @ places, grid.shapes[block])
        for block, _, first, steps in both
    )
    return one, two


def periodic_rotation(periodic: Periodicity) -> FloatArray:
    """Rotation matrix (3, 3) of a periodic connection: about x, then y, then z."""
    # Imported where it is needed, as `info` rarely needs it.
    import scipy

    return np.asarray(
        scipy.spatial.transform.Rotation.from_euler("xyz", periodic.rotation_angle, degrees=True).as_matrix()
    )


def periodic_image(points: FloatArray, periodic: Periodicity) -> FloatArray:
    """Points (n, 3) moved by the motion of a periodic connection."""
    center = np.array(periodic.rotation_center)
    return np.asarray((points - center) @ periodic_rotation(periodic).T + center + np.array(periodic.translation))


def check_connections(grid: Grid, topology: Topology) -> list[str]:
    """Disagreements between the declared connections and the coordinates, one message each."""
    declared = np.zeros(topology.n_unique, dtype=bool)
    messages = [text for connection in grid.connections for text in _remark(grid, topology, connection, declared)]
    # A file that declares only periodic connections leaves the interfaces to be found from the coordinates.
    if any(connection.periodic is None for connection in grid.connections):
        quads = (topology.partner >= 0) & ~declared[topology.quads.corners].all(axis=1)
        sides = distinct(topology.quads.block_side[quads], 6 * grid.n_blocks)
        if sides.size:
            names = listed(dict.fromkeys(grid.names[side // 6] for side in sides))
            messages.append(
                f"{int(quads.sum())} face quads coincide but no connection declares them (blocks {names}); they are "
                f"joined; name one side of a thin plate between them in [grid] plates"
            )
    return messages


def _remark(grid: Grid, topology: Topology, connection: Connection, declared: BoolArray) -> list[str]:
    """A message that says what is wrong with a connection, if anything; its nodes are marked as ``declared``
    (n_unique,)."""
    try:
        own, donor = connected_nodes(grid, connection)
    except GridError as error:
        return [str(error)]
    names = grid.names[connection.block], grid.names[connection.donor_block]
    where = f"connection {connection.name!r} of {names[0]} with {names[1]}"
    a, b = topology.numbers_of(own), topology.numbers_of(donor)
    declared[a] = declared[b] = True
    edge = np.minimum(topology.edge[a], topology.edge[b])
    if connection.periodic is not None:
        gap = np.linalg.norm(periodic_image(grid.points[own], connection.periodic) - grid.points[donor], axis=1)
        far = int((gap > 10 * RELATIVE_TOLERANCE * edge).sum())
        return [f"{where}: {far} of {len(own)} periodic node pairs differ, by up to {gap.max():.3g}"] if far else []
    if (own == donor).all():
        return [f"{where}: it joins the nodes of one face with themselves and has no effect"]
    apart = a != b
    if not apart.any():
        return []
    gap = np.linalg.norm(grid.points[own] - grid.points[donor], axis=1)[apart]
    return [
        f"{where}: {int(apart.sum())} of {len(own)} node pairs do not coincide (largest gap {gap.max():.3g}, "
        f"{(gap / edge[apart]).max():.3g} of the local edge); the coordinates decide, the faces count as outside; "
        f"if the gaps are round-off, raise grid.tolerance"
    ]


def find_interfaces(grid: Grid, topology: Topology) -> tuple[Connection, ...]:
    """One connection per rectangle of shared quads; each interface once, from the block side with the lower number."""
    faces, partner = topology.quads, topology.partner
    quads = np.flatnonzero(partner >= 0)
    own, other = faces.block_side[quads], faces.block_side[partner[quads]]
    # A face folded onto itself (C-grid cut): each pair once.
    once = (own < other) | ((own == other) & (quads < partner[quads]))
    if not once.any():
        return ()
    quads = quads[once]
    pair = own[once].astype(np.int64) * len(grid.sides.depth) + other[once]
    fits, maps = _index_maps(grid, topology, quads, pair)
    label = np.full(len(partner), -1)
    label[quads] = fits
    pieces = rectangles(grid, faces, label)
    order = np.lexsort((np.arange(len(pieces)), pieces.label, maps.pair[pieces.label]))
    return tuple(_described(grid, pieces.chosen(order), maps))


@dataclass(frozen=True)
class _Maps:
    """Index transformations from the quads of one side to those of another: (p, q) = matrix (u, v) + offset.

    ``pair`` (m,) numbers the pairs of sides, ``matrix`` (m, 2, 2), ``offset`` (m, 2), ``donor`` (m,) the other side.
    """

    pair: IntArray
    matrix: IntArray
    offset: IntArray
    donor: IntArray


def _index_maps(grid: Grid, topology: Topology, quads: IntArray, pair: IntArray) -> tuple[IntArray, _Maps]:
    """The transformations between all pairs of sides, and the number of the one that maps each quad (n,), or -1.

    ``pair`` (n,) is the pair of sides of each of the ``quads``. Each round finds one transformation per pair from one
    of its quads, and removes the quads that it maps. Quads with a collapsed edge fit several transformations, so
    that the others come first.
    """
    faces, partner = topology.quads, topology.partner[quads]
    corners = np.sort(faces.corners[quads], axis=1)
    collapsed = (np.diff(corners, axis=1) == 0).any(axis=1)
    local = np.stack(faces.places(quads)[1:], axis=1)
    donor_local = np.stack(faces.places(partner)[1:], axis=1)
    donor, fits = faces.block_side[partner], np.full(len(quads), -1)
    waiting = np.lexsort((quads, collapsed, pair))
    found: list[_Maps] = []
    count = 0
    while waiting.size:
        seed = waiting[runs(pair[waiting])[0]]
        # Unique numbers (n, 2, 2) along u and v of the nodes of a quad and of its partner; in 2-D equal along one of
        # them. The first orientation that maps the ones to the others counts.
        own, other = (
            topology.numbers_of(grid.sides.corners(*faces.places(some)))[:, [[0, 3], [1, 2]]]
            for some in (quads[seed], partner[seed])
        )
        turn = np.full(len(seed), -1)
        for orientation, (rows, columns) in reversed(list(enumerate(_ORIENTATIONS.sum(axis=2).tolist()))):
            # In the donor's index order.
            swapped = own.transpose(0, 2, 1) if _ORIENTATIONS[orientation, 0, 0] == 0 else own
            turn[(swapped[:, ::rows, ::columns] == other).all(axis=(1, 2))] = orientation
        # A quad that determines no transformation may still be mapped by that of another quad.
        hopeless = np.isin(waiting, seed[turn < 0])
        seed, turn = seed[turn >= 0], turn[turn >= 0]
        matrix = _ORIENTATIONS[turn]
        offset = donor_local[seed] - np.einsum("nij,nj->ni", matrix, local[seed])
        found.append(_Maps(pair[seed], matrix, offset, donor[seed]))
        left = np.flatnonzero(fits < 0)
        for lo in range(0, len(left), _MAPPED):
            some = left[lo : lo + _MAPPED]
            number = np.searchsorted(pair[seed], pair[some])
            known = np.append(pair[seed], -1)[number] == pair[some]
            some, number = some[known], number[known]
            image = np.einsum("nij,nj->ni", matrix[number], local[some]) + offset[number]
            same = (image == donor_local[some]).all(axis=1)
            fits[some[same]] = count + number[same]
        count += len(seed)
        waiting = waiting[~hopeless & (fits[waiting] < 0)]
    parts = [[getattr(each, name) for each in found] for name in ("pair", "matrix", "offset", "donor")]
    return fits, _Maps(*map(np.concatenate, parts))


# The eight ways to map one rectangle onto another: donor (p, q) = M (u, v) up to an offset.
_ORIENTATIONS = np.array([
    np.array(m).reshape(2, 2)
    for s in (1, -1)
    for t in (1, -1)
    for m in ((s, 0, 0, t), (0, s, t, 0))
])  # fmt: skip


def _described(grid: Grid, pieces: Rectangles, maps: _Maps) -> Iterator[Connection]:
    matrix, offset, donors = (values[pieces.label] for values in (maps.matrix, maps.offset, maps.donor))
    # Quad offsets become node offsets: a reversed axis counts from the quad's far node.
    shift = offset + (matrix.sum(axis=2) < 0)
    ends = [np.einsum("nij,nj->ni", matrix, corner) + shift for corner in (pieces.low, pieces.high)]
    # The CGNS short form.
    tangential = np.array([side.tangential for side in Side])
    row, transforms = np.arange(len(donors)), np.zeros((len(donors), 3), dtype=np.int64)
    for axis in (0, 1):
        along = np.argmax(matrix[:, :, axis] != 0, axis=1)
        steps = matrix[row, along, axis] * (tangential[donors % 6, along] + 1)
        transforms[row, tangential[pieces.side % 6, axis]] = steps
    # A step out of this block is a step into the donor.
    outward, inward = np.where(pieces.side % 2, 1, -1), np.where(donors % 2, -1, 1)
    transforms[row, pieces.side % 6 // 2] = outward * inward * (donors % 6 // 2 + 1)
    # Block indices of the nodes at these places along ``side.tangential``.
    order, corners = np.array([[*side.tangential, side.axis] for side in Side]), []
    for sides, places in zip([pieces.side] * 2 + [donors] * 2, [pieces.low, pieces.high, *ends], strict=True):
        far = np.where(sides % 2, grid.sides.depth[sides] - 1, 0)
        nodes = np.empty((len(sides), 3), dtype=np.int64)
        np.put_along_axis(nodes, order[sides % 6], np.column_stack([places, far]), axis=1)
        corners.append([_triple(node) for node in nodes.tolist()])
    labels = [side.label for side in Side]
    rows = zip(pieces.side.tolist(), donors.tolist(), transforms.tolist(), *corners, strict=True)
    for own, other, transform, begin, end, donor_begin, donor_end in rows:
        (block, side), (donor, donor_side) = divmod(own, 6), divmod(other, 6)
        name = f"{grid.names[block]}.{labels[side]}-{grid.names[donor]}.{labels[donor_side]}"
        yield Connection(name, block, begin, end, donor, donor_begin, donor_end, _triple(transform))


def _triple(values: Sequence[int]) -> Shape:
    a, b, c = values
    return a, b, c
