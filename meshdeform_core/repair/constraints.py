"""Constraints of a repair: nodes that are held, that slide in planes or on surfaces, or that are periodic images; and
the plane grid that a constrained grid is extruded from, on which its plane motions are repaired."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..boundary import Boundary, Kind
from ..boundary.constraints import CurvedSurface
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.parts import strides_of
from ..grid.planes import plane_normal
from ..grid.topology import Topology, find_topology, side_nodes
from ..numerics.arrays import extent
from ..parallel import Nodes
from ..quality import Original

_STRAIGHT = 1e-10
"""Round-off of coordinates, relative to the extent of the grid."""


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the unique nodes of a grid: the displacement of a node is its frame times that of its root.

    Attributes
    ----------
    grid, topology : undeformed
    held : (n_unique,) nodes that repairs do not move: moving, fixed, and those at edges of curved slip surfaces
    walls : (n_unique,) nodes of moving and fixed faces that are likely to be walls, not far field
    root : (n_unique,) the periodic image of a node with the smallest number, whose unknown all images share
    frame : (n_unique, 3, 3) of a root, the projector onto the directions in which it may move; of its images, that
        turned
    sliding : curved surfaces with the nodes that are not held
    """

    grid: Grid
    topology: Topology
    held: BoolArray
    walls: BoolArray
    root: IntArray
    frame: FloatArray
    sliding: tuple[CurvedSurface, ...] = ()

    def without_sliding(self) -> Constraints:
        """The constraints with the nodes that slide on curved surfaces held instead."""
        held = self.held.copy()
        for each in self.sliding:
            held[each.nodes] = True
        return replace(self, held=held, sliding=())

    @classmethod
    def of(cls, original: Original, boundary: Boundary) -> Constraints:
        """The constraints of a classified boundary."""
        grid, topology, slip = original.grid, original.topology, boundary.slip
        held, n = boundary.kind >= Kind.FIXED, topology.n_unique
        periodic, root, removed = boundary.periodic, np.arange(n), np.zeros((n, 3, 3))
        root[periodic.nodes] = periodic.root
        # A node may slide if it is on a single curved surface and on no plane or periodic boundary.
        count = np.bincount(np.concatenate([*[periodic.nodes] * 2, *(each.nodes for each in slip.curved)]), minlength=n)
        for nodes, projector in slip.groups:
            removed[nodes] += projector
            count[nodes] += 2
        sliding = []
        for surface in slip.curved:
            held[surface.nodes] |= count[surface.nodes] > 1
            held[surface.corners[surface.creased]] = True
            sliding.append(replace(surface, nodes=surface.nodes[~held[surface.nodes]]))
        turned = periodic.root != periodic.nodes
        images, turn = periodic.nodes[turned], periodic.turn[turned]
        np.add.at(removed, root[images], turn.transpose(0, 2, 1) @ removed[images] @ turn)
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        # Projectors onto the ranges of sums of projectors; exact if these are along coordinate axes.
        sums = removed[several]
        spans = sums @ np.linalg.pinv(sums, 1e-9, hermitian=True)
        exact = np.abs(sums - np.round(sums)).max(axis=(1, 2), initial=0.0) < 1e-12
        removed[several] = np.where(exact[:, None, None], np.round(spans), spans)
        walls = np.zeros(n, dtype=bool)
        walls[topology.quads.corners[original.moving_wall_quads(boundary) | original.fixed_wall_quads(boundary)]] = True
        frame = np.subtract(np.eye(3), removed, out=removed)
        frame[images] = turn @ frame[root[images]]
        return cls(grid, topology, held, walls, root, frame, tuple(sliding))


@dataclass(frozen=True, eq=False)
class Extrusion:
    """A grid that consists of copies of a plane grid.

    Attributes
    ----------
    direction : (3,) unit vector, normal to the plane
    plane, constraints : the plane grid, blocks with one node along one index, and its constraints
    held : (n_plane,) whether its nodes are held
    count : (n_plane,) number of copies of each
    line : plane node that each block node (of this rank) is a copy of; block nodes with the same one form a *line*
    grid : of the copies
    round_off : of its coordinates
    """

    direction: FloatArray
    plane: Grid
    constraints: Constraints
    held: BoolArray
    count: IntArray
    line: IntArray
    grid: Grid
    round_off: float

    def mean(self, change: FloatArray) -> FloatArray:
        """The mean along lines (n_plane, 3) of a displacement (n_nodes, 3), projected onto the plane."""
        return self._in_plane(self.summed(change) / self.count[:, None])

    def of_mean(self, gradient: FloatArray) -> FloatArray:
        """The transpose of :meth:`mean`."""
        return np.asarray((self._in_plane(gradient) / self.count[:, None])[self.line])

    def summed(self, gradient: FloatArray) -> FloatArray:
        """Sums along lines (n_plane, 3) of values (n_nodes, 3): the transpose of copying to all nodes of a line."""
        result, (low, _) = np.zeros((self.plane.n_nodes, 3)), Nodes.of(gradient).ends
        sums = []
        for rows in self.grid.own_pieces():
            line = self.line[rows.start - low : rows.stop - low]
            first, last = int(line.min()), int(line.max()) + 1
            columns = [np.bincount(line - first, column, last - first) for column in gradient[rows].T]
            sums.append((first, np.stack(columns, axis=1)))
        for first, each in (one for found in Nodes.of(gradient).gather(sums) for one in found):
            result[first : first + len(each)] += each
        return result

    def _in_plane(self, vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - (vectors @ self.direction)[:, None] * self.direction)

    def flattened(self, change: FloatArray) -> FloatArray | None:
        """The displacement (n_plane, 3) of the plane grid: the mean along lines of ``change`` (n_nodes, 3).

        ``None`` if held nodes move out of the plane, or differently along a line.
        """
        mean, own, there = self.mean(change), Nodes.of(change).own, self.held[self.line]
        normal = np.abs(own @ self.direction).max(initial=0.0)
        apart = np.abs(own[there] - mean[self.line[there]]).max(initial=0.0)
        return None if max(Nodes.of(change).gather(float(max(normal, apart)))) > self.round_off else mean

    def along_lines(self, change: FloatArray, mean: FloatArray, own: slice = slice(None)) -> FloatArray:
        """What differs from the ``mean`` (n_plane, 3) along lines in a displacement (n, 3) of nodes, 0 on held lines;
        ``own``: which of this rank's."""
        line = self.line[own]
        return np.where(self.held[line][:, None], 0.0, change - mean[line])

    def spread(
        self, points: FloatArray, start: FloatArray, mean: FloatArray, shift: FloatArray, kept: float
    ) -> FloatArray:
        """Coordinates ``points`` (n_nodes, 3) after a ``shift`` (n_plane, 3) of all lines, with the part ``kept`` of
        what differs along them from the ``mean`` (n_plane, 3) of the displacement from ``start`` (n_nodes, 3)."""
        result, (low, _) = Nodes.of(points).like(3), Nodes.of(points).ends

        def fill(rows: slice) -> None:
            own = slice(rows.start - low, rows.stop - low)
            apart = self.along_lines(points[rows] - start[rows], mean, own)
            result[rows][:] = points[rows] + shift[self.line[own]] - (1.0 - kept) * apart

        Nodes.of(result).each(fill)
        return result


def find_extrusion(constraints: Constraints) -> Extrusion | None:
    """The plane grid that a grid and its constraints are extruded from, or ``None``."""
    grid = constraints.grid
    if grid.dimension == 2:
        return None
    # The edges from the first node of each block along its three index axes.
    shapes = np.array(grid.shapes)
    corners = grid.nodes.at(grid.offsets[:-1, None] + np.pad((shapes - 1) * strides_of(shapes), ((0, 0), (1, 0))))
    edges, constraints = corners[:, 1:] - corners[:, :1], constraints.without_sliding()
    return next((found for height in edges[0] if (found := _extruded(constraints, edges, height))), None)


def _extruded(constraints: Constraints, edges: FloatArray, height: FloatArray) -> Extrusion | None:
    """The extrusion by ``height``, which is one of the ``edges`` (n_blocks, 3, 3) of every block, or its opposite."""
    grid, (least, largest) = constraints.grid, extent(constraints.grid.points)
    round_off, length = _STRAIGHT * float((largest - least).max()), float(np.linalg.norm(height))
    up, down = (np.abs(edges - each).max(axis=2) <= round_off for each in (height, -height))
    if length <= round_off or not (up | down).any(axis=1).all():
        return None
    blocks, axes, unit = np.arange(grid.n_blocks), (up | down).argmax(axis=1), height / length
    sides = [Side(2 * axis + int(down[block, axis])) for block, axis in enumerate(axes.tolist())]
    nodes = [np.expand_dims(side_nodes(grid, block, side), side.axis) for block, side in enumerate(sides)]
    bottom = np.concatenate([each.ravel() for each in nodes])
    # The same on all ranks, even if they hold parts of the grid.
    plane = Grid(grid.nodes.at(bottom), tuple(each.shape for each in nodes), grid.names)
    if np.ptp(plane.points @ unit) > round_off:
        return None
    counts, steps = (each[blocks, axes] for each in (np.array(grid.shapes), strides_of(np.array(grid.shapes))))
    first = np.cumsum(counts) - counts

    def copied(numbers: IntArray) -> tuple[IntArray, IntArray]:
        """The nodes of the plane grid of which block nodes are copies, and their layers, numbered block after block."""
        block = np.searchsorted(grid.offsets, numbers, side="right") - 1
        outer, inner = np.divmod(numbers - grid.offsets[block], steps[block])
        column, layer = np.divmod(outer, counts[block])
        return plane.offsets[block] + column * steps[block] + inner, first[block] + layer

    # All nodes are where the heights of the layers along one edge of their block say.
    along = [grid.nodes.at(grid.offsets[b] + steps[b] * np.arange(count)) for b, count in enumerate(counts.tolist())]
    heights = np.concatenate([(x - x[-(side % 2)]) @ unit for x, side in zip(along, sides, strict=True)])
    line, low, apart = np.empty(grid.nodes.high - grid.nodes.low, dtype=np.int64), grid.nodes.low, 0.0
    for rows in grid.own_pieces():
        own, layer = copied(np.arange(rows.start, rows.stop))
        line[rows.start - low : rows.stop - low] = own
        off = grid.points[rows] - plane.points[own] - heights[layer, None] * unit
        apart = max(apart, float(np.abs(off).max()))
    normal = plane_normal(plane)
    if max(grid.nodes.gather(apart)) > round_off or normal is None or abs(abs(unit @ normal) - 1.0) > 1e-9:
        return None
    flat = _in_plane(constraints, plane, copied(constraints.topology.face_nodes)[0], bottom, unit)
    if flat is None:
        return None
    held = np.zeros(plane.n_nodes, dtype=bool)
    held[flat.topology.face_nodes] = flat.held[flat.topology.number]
    count = np.repeat(counts, np.diff(plane.offsets))
    return Extrusion(unit, plane, flat, held, count, line, grid, round_off)


def _in_plane(
    constraints: Constraints, plane: Grid, ends: IntArray, bottom: IntArray, unit: FloatArray
) -> Constraints | None:
    """The constraints of the plane grid, or ``None`` if those of the grid vary along a line.

    ``ends`` are the lines of all nodes on block faces, ``bottom`` the first node of each line.
    On lines through the interior of the plane grid's blocks, only the end nodes may be constrained, and only to the end
    planes.
    """
    space, topology, flat = constraints.topology, find_topology(plane), np.eye(3) - np.outer(unit, unit)
    removed = flat @ (np.eye(3) - constraints.frame) @ flat
    chosen = space.number[np.searchsorted(space.face_nodes, bottom[topology.first])]
    of = topology.numbers_of(ends)
    for values in (constraints.held, constraints.walls, removed):
        # The last one, with the number -1, is that of lines through the interior.
        expected = np.concatenate([values[chosen], np.zeros_like(values[:1])]).astype(float)
        if np.abs(values[space.number] - expected[of]).max() > 1e-12:
            return None
    # The periodic image of a line is a line, possibly the same one with its ends exchanged.
    plane_of = np.full(space.n_unique, -1)
    plane_of[space.number] = of
    root = plane_of[constraints.root[chosen]]
    elsewhere = np.append(root, -1)[plane_of] != plane_of[constraints.root]
    if (root < 0).any() or elsewhere.any() or np.abs(unit @ constraints.frame[chosen] @ flat).max() > 1e-12:
        return None
    held, walls = constraints.held[chosen], constraints.walls[chosen]
    return Constraints(plane, topology, held, walls, root, np.eye(3) - removed[chosen])
