"""Measures of grid lines: at block interfaces (kink, spacing jump) and at walls (direction, first cells)."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.topology import Topology, inward_step, side_nodes
from ..numerics.geometry.coincidence import distinct
from ..numerics.geometry.vectors import unit
from ..parallel import Nodes

_TOGETHER = 100_000
"""Quads and lines measured at a time, which bounds the memory."""
LAYERS = 8
"""First cells of a grid line at a wall whose total thickness is measured; at most half of the cells of the line."""


@dataclass(frozen=True)
class InterfaceLines:
    """Grid lines that cross block interfaces: flat indices (...) of the interface node in each block and its neighbour.

    The line runs ``before -> here | there -> beyond``; ``here`` and ``there`` coincide.
    """

    before: IntArray
    here: IntArray
    there: IntArray
    beyond: IntArray


def interface_lines(grid: Grid, topology: Topology) -> InterfaceLines:
    """All grid lines across shared faces, each once."""
    quads = np.flatnonzero(topology.partner > np.arange(len(topology.partner)))
    found = [_distinct_lines(grid, topology, quads[lo : lo + _TOGETHER]) for lo in range(0, len(quads), _TOGETHER)]
    if not found:
        return InterfaceLines(*(np.empty(0, dtype=np.int64) for _ in range(4)))
    once = _distinct(np.concatenate([keys for keys, _ in found], axis=1))
    names = [field.name for field in dataclasses.fields(InterfaceLines)]
    # A direction at a time is dropped from the portions once it is joined.
    parts = [{name: getattr(lines, name) for name in names} for _, lines in found]
    del found
    return InterfaceLines(*(np.concatenate([part.pop(name) for part in parts])[once] for name in names))


def _distinct_lines(grid: Grid, topology: Topology, quads: IntArray) -> tuple[IntArray, InterfaceLines]:
    """The grid lines across ``quads``, each once, and two numbers (2, n) for each of them, of both its ends."""
    lines, sides = lines_across(grid, topology, quads)
    keys = np.stack([
        nodes.ravel() * 6 + np.repeat(side % 6, nodes.shape[1])
        for nodes, side in zip((lines.here, lines.there), sides, strict=True)
    ])  # fmt: skip
    once = _distinct(keys)
    return keys[:, once], InterfaceLines(*(getattr(lines, f.name).ravel()[once] for f in dataclasses.fields(lines)))


def _distinct(pairs: IntArray) -> IntArray:
    """Where each pair of ``pairs`` (2, n) occurs first, in ascending order.

    One number per pair would not fit into 64 bits in a grid of more than 5e8 nodes.
    """
    order = np.lexsort(pairs[::-1])
    new = np.ones(len(order), dtype=bool)
    new[1:] = False
    for values in pairs:
        ordered = values[order]
        new[1:] |= ordered[1:] != ordered[:-1]
    return order[new]


def lines_across(grid: Grid, topology: Topology, quads: IntArray) -> tuple[InterfaceLines, tuple[IntArray, IntArray]]:
    """The grid lines across shared face ``quads`` (n,): four (in 2-D two) per quad, as arrays (n, 4).

    Returns the lines and the block sides of the quads and of their partners.
    """
    here, number, side = _corners(grid, topology, quads)
    other, partner_number, other_side = _corners(grid, topology, topology.partner[quads])
    match = np.argmax(partner_number[:, None, :] == number[:, :, None], axis=2)
    there, steps = np.take_along_axis(other, match, axis=1), grid.sides.inward
    before, beyond = here + steps[side][:, None], there + steps[other_side][:, None]
    return InterfaceLines(before, here, there, beyond), (side, other_side)


def _corners(grid: Grid, topology: Topology, quads: IntArray) -> tuple[IntArray, IntArray, IntArray]:
    """Corners (n, 4) (in 2-D (n, 2)) of face quads, as flat nodes and as unique nodes, and the block side of each."""
    side, u, v = topology.quads.places(quads)
    du, dv = grid.sides.corner_steps[side].T
    around = [(u, v), (u + du, v), (u + du, v + dv), (u, v + dv)] if grid.dimension == 3 else [(u, v), (u + du, v + dv)]
    corners = np.stack([grid.sides.at(side, *corner) for corner in around], axis=1)
    numbers = topology.quads.corners[quads]
    ordered = topology.quads.in_order.ravel()[side]
    return corners, np.where(ordered[:, None], numbers, numbers[:, ::-1]), side


def kink_and_jump(lines: InterfaceLines, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Angle (degrees) between the two segments that meet at an interface, and ln of the ratio of their lengths."""
    nodes, (angle, jump) = Nodes.of(points), np.empty((2, *lines.here.shape))
    for lo in range(0, len(angle), _TOGETHER):
        some = slice(lo, lo + _TOGETHER)
        # Component by component, as numpy is slow on axes of length 3.
        u = list(np.moveaxis(nodes.at(lines.here[some]) - nodes.at(lines.before[some]), -1, 0).copy())
        v = list(np.moveaxis(nodes.at(lines.beyond[some]) - nodes.at(lines.there[some]), -1, 0).copy())
        normal = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
        angle[some] = np.rad2deg(np.arctan2(np.sqrt(_dot(normal, normal)), _dot(u, v)))
        with np.errstate(divide="ignore", invalid="ignore"):
            own = 0.5 * np.log(_dot(v, v) / _dot(u, u))
        jump[some] = np.where(np.isfinite(own), own, 0.0)
    return angle, jump


def _dot(u: Sequence[FloatArray], v: Sequence[FloatArray]) -> FloatArray:
    return np.asarray(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


@dataclass(frozen=True)
class WallFace:
    """The part of one face of a block that is a wall.

    ``nodes`` (na, nb): flat indices of the whole face; ``wall`` (qa, qb): which of its quads are wall; ``step``:
    difference in flat index to the first node off the wall; ``layers``: cells whose total thickness is measured
    (:data:`LAYERS`); ``inward``: +1 if the index order of the face gives normals into the block, -1 if out of it.
    """

    nodes: IntArray
    wall: np.ndarray
    step: int
    layers: int
    inward: float
    block: int
    side: Side

    @property
    def touched(self) -> BoolArray:
        """Nodes (na, nb) of its wall quads."""
        touched = np.zeros(self.nodes.shape, dtype=bool)
        for window in self.corners:
            touched[window] |= self.wall
        return touched

    @property
    def corners(self) -> list[tuple[slice, slice]]:
        """The windows of ``nodes`` that hold the first, second, ... corner of every quad."""
        (na, nb), (qa, qb) = self.nodes.shape, self.wall.shape
        return [(slice(a, a + qa), slice(b, b + qb)) for a in range(min(2, na)) for b in range(min(2, nb))]


def wall_faces(grid: Grid, topology: Topology, chosen: BoolArray) -> list[WallFace]:
    """All block faces with quads that are ``chosen`` (n_quads,) as walls."""
    faces = []
    for block_side in distinct(topology.quads.block_side[chosen], 6 * grid.n_blocks):
        block, side = int(block_side) // 6, Side(int(block_side) % 6)
        counts = topology.quads.counts[block, side]
        wall = chosen[topology.quads.of_side(block, side)].reshape(counts)
        nodes = side_nodes(grid, block, side)
        inward = _inward_sign(topology, block, side, nodes)
        step, layers = (
            inward_step(grid.shapes[block], side),
            max(1, min(LAYERS, grid.cell_shapes[block][side.axis] // 2)),
        )
        faces.append(WallFace(nodes, wall, step, layers, inward, block, side))
    return faces


def _inward_sign(topology: Topology, block: int, side: Side, nodes: IntArray) -> float:
    """+1 if the normal by the face's index order (in 2-D: plane normal cross tangent) points into the block, or -1."""
    if topology.quads.corners.shape[1] == 2:
        first = topology.quads.corners[topology.quads.of_side(block, side)][0, 0]
        # The outside lies to the right of the corner order.
        return 1.0 if first == topology.numbers_of(nodes.ravel()[:1])[0] else -1.0
    # e_b x e_c of the tangential axes points along +a for i and k faces, along -a for j faces.
    index_normal = (-1.0 if side.axis == 1 else 1.0) * float(topology.handedness[block])
    return index_normal if side % 2 == 0 else -index_normal


class WallLines(NamedTuple):
    """Angle (degrees) between grid lines and the wall normal, and along it the height of the first cell and the
    thickness of the first layers: one value per node of the wall quads of a face, in the order of ``WallFace.touched``.
    """

    angle: FloatArray
    height: FloatArray
    thickness: FloatArray

    @classmethod
    def joined(cls, lines: Sequence[WallLines]) -> WallLines:
        """The lines of several faces."""
        return cls(*(np.concatenate(values) for values in zip(*lines, strict=True)))


def wall_lines(face: WallFace, points: FloatArray, plane_normal: FloatArray | None) -> WallLines:
    """Measures of the grid lines off the wall quads of a face."""
    x = points[face.nodes]
    if plane_normal is None:
        diagonals = (x[1:, 1:] - x[:-1, :-1], x[:-1, 1:] - x[1:, :-1])
        quad_normal = face.inward * np.cross(*diagonals)
    else:
        tangent = np.diff(x.reshape(-1, 3), axis=0).reshape(*face.wall.shape, 3)
        quad_normal = face.inward * np.cross(plane_normal, tangent)
    outward = unit(quad_normal) * face.wall[..., None]
    normal = np.zeros_like(x)
    touched = face.touched
    for window in face.corners:
        normal[window] += outward
    n = unit(normal[touched])
    arm = points[face.nodes[touched] + face.step] - x[touched]
    height = np.einsum("ni,ni->n", n, arm)
    across = np.linalg.norm(np.cross(n, arm), axis=1)
    layers = points[face.nodes[touched] + face.layers * face.step] - x[touched]
    return WallLines(np.rad2deg(np.arctan2(across, height)), height, np.einsum("ni,ni->n", n, layers))
