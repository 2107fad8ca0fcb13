"""Block-to-block connections: the file's declarations, checked against the coordinates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import GridError
from ...numerics.arrays import BoolArray, batches, spans
from ...numerics.geometry.coincidence import distinct
from ...wording import listed
from ..blocks import FloatArray, Grid, IntArray
from ..parts import Connection, Periodicity
from ..sizes import strides_of
from ..topology import RELATIVE_TOLERANCE, Topology

_TOGETHER = 300_000
"""Pairs of nodes compared at a time, which bounds the memory."""


def connected_nodes(grid: Grid, connection: Connection) -> tuple[IntArray, IntArray]:
    """Flat indices of the nodes of a declared connection and of their donors, both (n,).

    Raises
    ------
    GridError
        When a range exceeds its block, or the two differ in size.
    """
    table = _Table.of(grid, [connection])
    reached = table.ends()[:, 0]
    sides = (connection.block, "range"), (connection.donor_block, "donor range")
    for nodes, (block, role) in zip(np.moveaxis(reached, 1, 0), sides, strict=True):
        shape = grid.shapes[block]
        if (nodes < 0).any() or (nodes >= shape).any():
            raise GridError(
                f"connection {connection.name!r} of {grid.names[connection.block]}: its {role} reaches node "
                f"{(nodes.max(axis=0) + 1).tolist()}, but {grid.names[block]} has {list(shape)} nodes"
            )
    _, own, donor = table.nodes(np.array([0]))
    return own, donor


def periodic_rotation(periodic: Periodicity) -> FloatArray:
    """Rotation matrix (3, 3) of a periodic connection: about x, then y, then z."""
    rotation = np.eye(3)
    for axis, angle in enumerate(np.deg2rad(periodic.rotation_angle)):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        turn = np.eye(3)
        turn[[a, a, b, b], [a, b, a, b]] = [np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)]
        rotation = turn @ rotation
    return rotation


def periodic_image(points: FloatArray, periodic: Periodicity) -> FloatArray:
    """Points (n, 3) moved by the motion of a periodic connection."""
    center = np.array(periodic.rotation_center)
    return np.asarray((points - center) @ periodic_rotation(periodic).T + center + np.array(periodic.translation))


def check_connections(grid: Grid, topology: Topology) -> list[str]:
    """Disagreements between the declared connections and the coordinates, one message each."""
    declared = np.zeros(topology.n_unique, dtype=bool)
    messages: list[str] = []
    doubtful = np.ones(len(grid.connections), dtype=bool)
    if grid.connections:
        table = _Table.of(grid, grid.connections)
        sound = np.flatnonzero(table.within())
        for lo, hi in batches(table.counts[sound].prod(axis=1), _TOGETHER):
            some = sound[lo:hi]
            run, own, donor = table.nodes(some)
            a, b = topology.numbers_of(own), topology.numbers_of(donor)
            declared[a] = declared[b] = True
            # A connection of nodes with themselves has no effect.
            idle = np.bincount(run[own != donor], minlength=len(some)) == 0
            doubtful[some] = (np.bincount(run[a != b], minlength=len(some)) > 0) | idle
        doubtful |= [each.periodic is not None for each in grid.connections]
    for number in np.flatnonzero(doubtful):
        messages += _remark(grid, topology, grid.connections[number])
    # A file that declares only periodic connections leaves the interfaces to be found from the coordinates.
    if any(connection.periodic is None for connection in grid.connections):
        messages += _undeclared(grid, topology, declared)
    return messages


@dataclass(frozen=True)
class _Table:
    """All declared connections, one per row, between blocks with these ``shapes`` and ``offsets``.

    ``blocks`` (n, 2) and first nodes ``begin`` (n, 2, 3) of both sides, number of nodes ``counts`` (n, 3), and the
    ``steps`` (n, 2, 3, 3) of the indices of both sides along each axis of the first.
    """

    shapes: IntArray
    offsets: IntArray
    blocks: IntArray
    begin: IntArray
    counts: IntArray
    steps: IntArray

    @classmethod
    def of(cls, grid: Grid, every: Sequence[Connection]) -> _Table:
        """Connections of a grid."""
        begin, end, donor, transform = (
            np.array([getattr(each, name) for each in every], dtype=np.int64)
            for name in ("begin", "end", "donor_begin", "transform")
        )
        sign = np.where(end >= begin, 1, -1)
        steps = np.zeros((len(every), 2, 3, 3), dtype=np.int64)
        row = np.arange(len(every))
        for axis in range(3):
            steps[:, 0, axis, axis] = sign[:, axis]
            used = np.flatnonzero(transform[:, axis])
            steps[row[used], 1, abs(transform[used, axis]) - 1, axis] = (np.sign(transform) * sign)[used, axis]
        blocks = np.array([(each.block, each.donor_block) for each in every], dtype=np.int64)
        return cls(
            np.array(grid.shapes),
            grid.offsets,
            blocks,
            np.stack([begin, donor], axis=1),
            np.abs(end - begin) + 1,
            steps,
        )

    def ends(self) -> IntArray:
        """First and last nodes (2, n, 2, 3) of both sides: the steps are whole multiples of index axes."""
        return np.stack([self.begin, self.begin + np.einsum("nsij,nj->nsi", self.steps, self.counts - 1)])

    def within(self) -> BoolArray:
        """Whether both ranges lie within their blocks."""
        both = self.ends()
        return np.asarray(((both >= 0) & (both < self.shapes[self.blocks])).all(axis=(0, 2, 3)))

    def nodes(self, some: IntArray) -> tuple[IntArray, IntArray, IntArray]:
        """All node pairs of the connections ``some``: the connection of each, and the flat indices on both sides."""
        counts = self.counts[some]
        run, place = spans(counts.prod(axis=1))
        i, rest = np.divmod(place, (counts[:, 1] * counts[:, 2])[run])
        j, k = np.divmod(rest, counts[run, 2])
        flat = []
        for side in (0, 1):
            block = self.blocks[some, side]
            strides = strides_of(self.shapes[block])
            first = self.offsets[block] + (self.begin[some, side] * strides).sum(axis=1)
            along = np.einsum("nij,ni->nj", self.steps[some, side], strides)[run]
            flat.append(first[run] + i * along[:, 0] + j * along[:, 1] + k * along[:, 2])
        return run, flat[0], flat[1]


def _remark(grid: Grid, topology: Topology, connection: Connection) -> list[str]:
    """A message that says what is wrong with a connection, if anything."""
    try:
        own, donor = connected_nodes(grid, connection)
    except GridError as error:
        return [str(error)]
    problem = _mismatch(grid, topology, connection, own, donor)
    where = (
        f"connection {connection.name!r} of {grid.names[connection.block]} with {grid.names[connection.donor_block]}"
    )
    return [f"{where}: {problem}"] if problem else []


def _mismatch(grid: Grid, topology: Topology, connection: Connection, own: IntArray, donor: IntArray) -> str:
    a, b = topology.numbers_of(own), topology.numbers_of(donor)
    if connection.periodic is None:
        if (own == donor).all():
            return "it joins the nodes of one face with themselves and has no effect"
        apart = a != b
        if not apart.any():
            return ""
        gap = np.linalg.norm(grid.points[own] - grid.points[donor], axis=1)[apart]
        relative = gap / np.minimum(topology.edge[a], topology.edge[b])[apart]
        return (
            f"{int(apart.sum())} of {len(own)} node pairs do not coincide (largest gap {gap.max():.3g}, "
            f"{relative.max():.3g} of the local edge); the coordinates decide, the faces count as outside"
        )
    gap = np.linalg.norm(periodic_image(grid.points[own], connection.periodic) - grid.points[donor], axis=1)
    far = gap > 10 * RELATIVE_TOLERANCE * np.minimum(topology.edge[a], topology.edge[b])
    if far.any():
        return f"{int(far.sum())} of {len(own)} periodic node pairs differ, by up to {gap.max():.3g}"
    return ""


def _undeclared(grid: Grid, topology: Topology, declared: np.ndarray) -> list[str]:
    shared = topology.partner >= 0
    quads = shared & ~declared[topology.quads.corners].all(axis=1)
    sides = distinct(topology.quads.block_side[quads], 6 * grid.n_blocks)
    if sides.size == 0:
        return []
    names = listed(dict.fromkeys(grid.names[side // 6] for side in sides))
    return [f"{int(quads.sum())} face quads coincide but no connection declares them (blocks {names}); they are joined"]
