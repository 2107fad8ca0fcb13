"""Measures of grid lines: at block interfaces (kink, spacing jump) and at walls (direction, first cells)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.topology import Topology
from ..numerics.geometry.vectors import cross, dot, unit
from ..parallel import Nodes

_TOGETHER = 100_000
"""Quads and lines measured at a time, which bounds the memory."""
LAYERS = 8
"""First cells of a grid line at a wall whose total thickness is measured; at most half of the cells of the line."""


class InterfaceLines(NamedTuple):
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
    keys, found = [np.empty((2, 0), dtype=np.int64)], [np.empty((4, 0), dtype=np.int64)]
    for lo in range(0, len(quads), _TOGETHER):
        lines, sides = lines_across(grid, topology, quads[lo : lo + _TOGETHER])
        # Two numbers for each line, of both its ends.
        ends = zip((lines.here, lines.there), sides, strict=True)
        key = np.stack([(nodes * 6 + side[:, None] % 6).ravel() for nodes, side in ends])
        once = _distinct(key)
        keys.append(key[:, once])
        found.append(np.stack([nodes.ravel()[once] for nodes in lines]))
    return InterfaceLines(*np.concatenate(found, axis=1)[:, _distinct(np.concatenate(keys, axis=1))])


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
    corners = grid.sides.corners(side, u, v)[:, :: 1 if grid.dimension == 3 else 2]
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
        normal = cross(u, v)
        angle[some] = np.rad2deg(np.arctan2(np.sqrt(dot(normal, normal)), dot(u, v)))
        with np.errstate(divide="ignore", invalid="ignore"):
            own = 0.5 * np.log(dot(v, v) / dot(u, u))
        jump[some] = np.where(np.isfinite(own), own, 0.0)
    return angle, jump


class WallMeasures(NamedTuple):
    """Angle (degrees) between grid lines off walls and the wall normal, and along it the height of the first cell and
    the thickness of the first layers: (n,) each."""

    angle: FloatArray
    height: FloatArray
    thickness: FloatArray


@dataclass(frozen=True)
class WallLines:
    """The grid lines off wall quads, one for every node of them and side of a block.

    ``quads`` (m,): their numbers; ``corners``, ``line`` (m, 4), in 2-D (m, 2): the flat nodes at their corners in index
    order, and the number of the line there; ``inward`` (m,): +1 if that order gives normals into the block, else -1;
    ``node``, ``step``, ``layers`` (n,): where each line begins, the difference in flat index to its next node, and the
    number of cells whose total thickness is measured (:data:`LAYERS`).
    """

    quads: IntArray
    corners: IntArray
    line: IntArray
    inward: FloatArray
    node: IntArray
    step: IntArray
    layers: IntArray

    @classmethod
    def off(cls, grid: Grid, topology: Topology, chosen: BoolArray) -> WallLines:
        """Those off the quads that are ``chosen`` (n_quads,)."""
        quads = np.flatnonzero(chosen)
        corners, _, side = _corners(grid, topology, quads)
        key = corners * 6 + side[:, None] % 6
        _, first, line = np.unique(key, return_index=True, return_inverse=True)
        axis, line_side = side % 6 // 2, np.repeat(side, corners.shape[1])[first]
        if grid.dimension == 3:
            # e_b x e_c of the tangential axes points along +a for i and k faces, along -a for j faces.
            inward: FloatArray = np.where(axis == 1, -1.0, 1.0) * topology.handedness[side // 6]
            inward *= np.where(side % 2, -1.0, 1.0)
        else:
            # The outside lies to the right of the corner order.
            inward = np.where(topology.quads.in_order.ravel()[side], 1.0, -1.0)
        cells = np.array(grid.cell_shapes)[line_side // 6, line_side % 6 // 2]
        layers = np.clip(cells // 2, 1, LAYERS)
        node, step = corners.ravel()[first], grid.sides.inward[line_side]
        return cls(quads, corners, line.reshape(corners.shape), inward, node, step, layers)

    def measure(self, points: FloatArray, plane_normal: FloatArray | None) -> WallMeasures:
        """Measures of all lines with coordinates ``points`` (n_nodes, 3)."""
        at = Nodes.of(points).at
        x = at(self.corners)
        if plane_normal is None:
            area = np.cross(x[:, 2] - x[:, 0], x[:, 3] - x[:, 1])
        else:
            area = np.cross(plane_normal, x[:, 1] - x[:, 0])
        outward = np.repeat(unit(self.inward[:, None] * area), x.shape[1], axis=0)
        line, count, start = self.line.ravel(), len(self.node), at(self.node)
        normal = unit(np.stack([np.bincount(line, outward[:, d], count) for d in range(3)], axis=1))
        arm, deep = (at(self.node + layers * self.step) - start for layers in (1, self.layers))
        height, thickness = (np.einsum("ni,ni->n", normal, each) for each in (arm, deep))
        across = np.linalg.norm(np.cross(normal, arm), axis=1)
        return WallMeasures(np.rad2deg(np.arctan2(across, height)), height, thickness)
