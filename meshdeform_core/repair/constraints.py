"""Constraints of a repair: nodes that are held, that slide in planes or on surfaces, or that are periodic images; and
the plane grid that a constrained grid is extruded from, on which its plane motions are repaired."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from ..boundary import Boundary, Kind
from ..boundary.constraints import CurvedSurface
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.planes import plane_normal
from ..grid.topology import Topology, find_topology, side_nodes
from ..numerics.arrays import extent
from ..parallel import Nodes
from ..quality import Original

_STRAIGHT = 1e-10
"""Round-off of coordinates, relative to the extent of the grid."""


@dataclass(frozen=True, eq=False)
class Constraints:
    """Constraints on the unique nodes of a grid.

    Attributes
    ----------
    grid, topology : undeformed
    held : (n_unique,) nodes that repairs do not move: moving, fixed, and those at edges of curved slip surfaces
    walls : (n_unique,) nodes of moving and fixed faces that are likely to be walls, not far field
    removed : (n_unique, 3, 3) projectors onto the directions in which a node must not move
    root : (n_unique,) the periodic image of a node with the smallest number, whose unknown all images share
    turn : node -> rotation (3, 3) from its root, unless that is the identity
    sliding : curved surfaces with the nodes that are not held
    """

    grid: Grid
    topology: Topology
    held: BoolArray
    walls: BoolArray
    removed: FloatArray
    root: IntArray
    turn: dict[int, FloatArray] = field(default_factory=dict)
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
        grid, topology = original.grid, original.topology
        held = boundary.kind >= Kind.FIXED
        root, turn = np.arange(topology.n_unique), {}
        # A node may slide if it is on a single curved surface and on no plane or periodic boundary.
        count = np.zeros(topology.n_unique, dtype=np.int64)
        for surface in boundary.slip.curved:
            count[surface.nodes] += 1
        for nodes, _ in boundary.slip.groups:
            count[nodes] += 2
        periodic = boundary.periodic
        if periodic.nodes.size:
            root[periodic.nodes] = periodic.root
            turn = dict(zip(periodic.nodes.tolist(), periodic.turn, strict=True))
            count[periodic.nodes] += 2
        sliding = []
        for surface in boundary.slip.curved:
            held[surface.nodes] |= count[surface.nodes] > 1
            held[surface.corners[surface.creased]] = True
            sliding.append(replace(surface, nodes=surface.nodes[~held[surface.nodes]]))
        removed = np.zeros((topology.n_unique, 3, 3))
        for nodes, projector in boundary.slip.groups:
            removed[nodes] += projector
        for node, rotation in turn.items():
            if root[node] != node:
                removed[root[node]] += rotation.T @ removed[node] @ rotation
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        # Projectors (n, 3, 3) onto the ranges of sums of projectors; exact if these are along coordinate axes.
        sums = removed[several]
        values, vectors = np.linalg.eigh(sums)
        kept = np.where(values[:, None, :] > 1e-9, vectors, 0.0)
        exact = np.abs(sums - np.round(sums)).max(axis=(1, 2), initial=0.0) < 1e-12
        spans = np.asarray(kept @ kept.transpose(0, 2, 1))
        spans[exact] = np.round(spans[exact])
        removed[several] = spans
        quads = original.moving_wall_quads(boundary) | original.fixed_wall_quads(boundary)
        walls = np.zeros(topology.n_unique, dtype=bool)
        walls[topology.quads.corners[quads]] = True
        return cls(grid, topology, held, walls, removed, root, turn, tuple(sliding))


@dataclass(frozen=True, eq=False)
class Extrusion:
    """A grid that consists of copies of a plane grid.

    Attributes
    ----------
    direction : (3,) unit vector, normal to the plane
    plane : the plane grid, blocks with one node along one index
    line : plane node that each block node (of this rank) is a copy of; block nodes with the same one form a *line*
    axes : (n_blocks,) index along which each block is extruded
    grid : of the blocks
    constraints : of the plane grid
    scale : extent of the grid
    """

    direction: FloatArray
    plane: Grid
    line: IntArray
    axes: tuple[int, ...]
    grid: Grid
    constraints: Constraints
    scale: float

    @cached_property
    def _count(self) -> IntArray:
        layers = [shape[axis] for shape, axis in zip(self.grid.shapes, self.axes, strict=True)]
        return np.repeat(layers, np.diff(self.plane.offsets))

    @cached_property
    def held(self) -> BoolArray:
        """Whether the nodes (n_plane,) of the plane grid are held."""
        topology, held = self.constraints.topology, np.zeros(self.plane.n_nodes, dtype=bool)
        held[topology.face_nodes] = self.constraints.held[topology.number]
        return held

    def mean(self, change: FloatArray) -> FloatArray:
        """The mean along lines (n_plane, 3) of a displacement (n_nodes, 3), projected onto the plane."""
        return self._in_plane(self.summed(change) / self._count[:, None])

    def of_mean(self, gradient: FloatArray) -> FloatArray:
        """The transpose of :meth:`mean`."""
        return np.asarray((self._in_plane(gradient) / self._count[:, None])[self.line])

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
        mean, most = self.mean(change), _STRAIGHT * self.scale
        own, there = Nodes.of(change).own, self.held[self.line]
        normal = np.abs(own @ self.direction).max(initial=0.0)
        apart = np.abs(own[there] - mean[self.line[there]]).max(initial=0.0)
        if max(Nodes.of(change).gather(float(max(normal, apart)))) > most:
            return None
        return mean

    def spread(
        self, points: FloatArray, start: FloatArray, mean: FloatArray, shift: FloatArray, kept: float
    ) -> FloatArray:
        """Coordinates ``points`` (n_nodes, 3) after a ``shift`` (n_plane, 3) of all lines, with the part ``kept`` of
        what differs along them from the ``mean`` (n_plane, 3) of the displacement from ``start`` (n_nodes, 3)."""
        result, (low, _) = Nodes.of(points).like(3), Nodes.of(points).ends

        def fill(rows: slice) -> None:
            line = self.line[rows.start - low : rows.stop - low]
            apart = np.where(self.held[line][:, None], 0.0, points[rows] - start[rows] - mean[line])
            result[rows][:] = points[rows] + shift[line] - (1.0 - kept) * apart

        Nodes.of(result).each(fill)
        return result

    def along_lines(self, change: FloatArray, mean: FloatArray) -> FloatArray:
        """What differs from the ``mean`` (n_plane, 3) along lines in a displacement (n_nodes, 3), 0 on held lines."""
        return np.where(self.held[self.line][:, None], 0.0, change - mean[self.line])


def find_extrusion(constraints: Constraints) -> Extrusion | None:
    """The plane grid that a grid and its constraints are extruded from, or ``None``."""
    grid = constraints.grid
    if grid.dimension == 2:
        return None
    constraints = constraints.without_sliding()
    low, high = extent(grid.points)
    scale = float((high - low).max())
    for height in _heights(grid, scale):
        axes = [axis for b in range(grid.n_blocks) if (axis := _axis(grid, b, height, scale))]
        unit = height / np.linalg.norm(height)
        found = _extruded(constraints, axes, unit, scale) if len(axes) == grid.n_blocks else None
        if found is not None:
            return found
    return None


def _heights(grid: Grid, scale: float) -> list[FloatArray]:
    """Vectors between opposite faces of the first block, where they are the same at all nodes and not zero."""
    found = []
    for axis in range(3):
        low, high = (grid.points[side_nodes(grid, 0, Side(2 * axis + end))] for end in range(2))
        height = high - low
        mean = height.reshape(-1, 3).mean(axis=0)
        straight = np.ptp(height.reshape(-1, 3), axis=0).max() <= _STRAIGHT * scale
        if straight and np.linalg.norm(mean) > _STRAIGHT * scale:
            found.append(mean)
    return found


def _axis(grid: Grid, block: int, height: FloatArray, scale: float) -> tuple[int, int] | None:
    """Index axis along which a block is extruded by ``height``, and which of its ends is the lower one (0 or 1)."""
    unit = height / np.linalg.norm(height)
    for axis in range(3):
        first, last = (grid.points[side_nodes(grid, block, Side(2 * axis + end))] for end in range(2))
        whole = (last - first).reshape(-1, 3)
        sign = 1.0 if whole[0] @ height > 0.0 else -1.0
        if np.abs(whole - sign * height).max() > _STRAIGHT * scale:
            continue
        # Largest deviation of the layers of a block along ``axis`` from copies of the ``first`` one moved along
        # ``unit``.
        own, count = grid.planes(block), grid.shapes[block][axis]
        steps = grid.in_planes(block) - np.expand_dims(first if axis == 0 else first[own], axis)
        along = steps @ unit
        across = np.abs(steps - along[..., None] * unit).max(initial=0.0)
        others = tuple(other for other in range(3) if other != axis)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        layers = own if axis == 0 else slice(None)
        low[layers] = along.min(axis=others, initial=np.inf)
        high[layers] = along.max(axis=others, initial=-np.inf)
        lows, highs, acrosses = zip(*grid.nodes.gather((low, high, across)), strict=True)
        if float(max(*acrosses, (np.max(highs, axis=0) - np.min(lows, axis=0)).max())) <= _STRAIGHT * scale:
            return axis, 0 if sign > 0.0 else 1
    return None


def _extruded(
    constraints: Constraints, axes: list[tuple[int, int]], unit: FloatArray, scale: float
) -> Extrusion | None:
    grid = constraints.grid
    nodes = [np.expand_dims(side_nodes(grid, b, Side(2 * axis + end)), axis) for b, (axis, end) in enumerate(axes)]
    base = [grid.points[each] for each in nodes]
    level = np.concatenate([(b @ unit).ravel() for b in base])
    if np.ptp(level) > _STRAIGHT * scale:
        return None
    points, along = np.concatenate([each.reshape(-1, 3) for each in base]), tuple(axis for axis, _ in axes)
    # The same on all ranks, even if they hold parts of the grid.
    plane = Grid(points, tuple(each.shape[:3] for each in base), grid.names)
    if abs(abs(unit @ plane_normal(plane)) - 1.0) > 1e-9:  # type: ignore[operator]
        return None
    bottom = np.concatenate([each.ravel() for each in nodes])
    ends = _lines_of(grid, plane, along, constraints.topology.face_nodes)
    flat = _in_plane(constraints, find_topology(plane), plane, ends, bottom, unit)
    if flat is None:
        return None
    line = _lines_of(grid, plane, along, np.arange(*grid.nodes.ends))
    return Extrusion(unit, plane, line, along, grid, flat, scale)


def _lines_of(grid: Grid, plane: Grid, axes: tuple[int, ...], nodes: IntArray) -> IntArray:
    """The nodes (n,) of the plane grid of which block nodes (n,), ascending, are copies."""
    result, ends = np.empty(len(nodes), dtype=np.int64), np.searchsorted(nodes, grid.offsets)
    for block, axis in enumerate(axes):
        rows = slice(ends[block], ends[block + 1])
        ijk = list(np.unravel_index(nodes[rows] - grid.offsets[block], grid.shapes[block]))
        ijk[axis] = np.zeros_like(ijk[axis])
        result[rows] = plane.offsets[block] + np.ravel_multi_index(ijk, plane.shapes[block])
    return result


def _in_plane(
    constraints: Constraints, topology: Topology, plane: Grid, ends: IntArray, bottom: IntArray, unit: FloatArray
) -> Constraints | None:
    """The constraints of the plane grid, or ``None`` if those of the grid vary along a line.

    ``ends`` are the lines of all nodes on block faces, ``bottom`` the first node of each line.
    On lines through the interior of the plane grid's blocks, only the end nodes may be constrained, and only to the end
    planes.
    """
    space, flat = constraints.topology, np.eye(3) - np.outer(unit, unit)
    removed = flat @ constraints.removed @ flat
    number = np.full(plane.n_nodes, -1)
    number[topology.face_nodes] = topology.number
    of = number[ends]
    on_edge = of >= 0
    inside = space.number[~on_edge]
    if constraints.held[inside].any() or np.abs(removed[inside]).max(initial=0.0) > 1e-12:
        return None
    one = np.searchsorted(space.face_nodes, bottom[topology.first])
    chosen = space.number[one]
    for values in (constraints.held, constraints.walls, removed):
        difference = np.abs(values[space.number[on_edge]].astype(float) - values[chosen][of[on_edge]].astype(float))
        if difference.max(initial=0.0) > 1e-12:
            return None
    # The periodic image of a line is a line, possibly the same one with its ends exchanged.
    plane_of = np.full(space.n_unique, -1)
    plane_of[space.number] = of
    root = plane_of[constraints.root[chosen]]
    turn = {n: constraints.turn[c] for n, c in enumerate(chosen.tolist()) if c in constraints.turn}
    if (root < 0).any() or any(np.abs(t @ unit - unit).max() > 1e-12 for t in turn.values()):
        return None
    images = np.flatnonzero(constraints.root != np.arange(space.n_unique))
    images = images[plane_of[images] >= 0]
    if (root[plane_of[images]] != plane_of[constraints.root[images]]).any():
        return None
    return Constraints(
        plane, topology, constraints.held[chosen], constraints.walls[chosen], removed[chosen], root, turn
    )
