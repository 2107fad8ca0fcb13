"""Straight extrusions of plane grids; plane motions of such grids are repaired on the plane grid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..grid import FloatArray, Grid, IntArray, Side
from ..grid.planes import plane_normal
from ..grid.topology import Topology, find_topology, side_nodes
from ..numerics.arrays import extent
from ..parallel import empty, for_rows
from .constraints import Constraints

_STRAIGHT = 1e-10
"""Round-off of coordinates, relative to the extent of the grid."""


@dataclass(frozen=True, eq=False)
class Extrusion:
    """A grid that consists of copies of a plane grid.

    Attributes
    ----------
    direction : (3,) unit vector, normal to the plane
    plane : the plane grid, blocks with one node along one index
    line : (n_nodes,) plane node that each block node is a copy of; block nodes with the same one form a *line*
    constraints : of the plane grid
    scale : extent of the grid
    """

    direction: FloatArray
    plane: Grid
    line: IntArray
    constraints: Constraints
    scale: float

    @cached_property
    def _count(self) -> IntArray:
        return np.bincount(self.line, minlength=self.plane.n_nodes)

    def mean(self, change: FloatArray) -> FloatArray:
        """The mean along lines (n_plane, 3) of a displacement (n_nodes, 3), projected onto the plane."""
        return self._in_plane(self.summed(change) / self._count[:, None])

    def of_mean(self, gradient: FloatArray) -> FloatArray:
        """The transpose of :meth:`mean`."""
        return np.asarray((self._in_plane(gradient) / self._count[:, None])[self.line])

    def summed(self, gradient: FloatArray) -> FloatArray:
        """Sums along lines (n_plane, 3) of values (n_nodes, 3): the transpose of copying to all nodes of a line."""
        return np.stack([np.bincount(self.line, c, self.plane.n_nodes) for c in gradient.T], axis=1)

    def _in_plane(self, vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - (vectors @ self.direction)[:, None] * self.direction)

    def flattened(self, change: FloatArray) -> FloatArray | None:
        """The displacement (n_plane, 3) of the plane grid: the mean along lines of ``change`` (n_nodes, 3).

        ``None`` if held nodes move out of the plane, or differently along a line.
        """
        normal = change @ self.direction
        if np.abs(normal).max() > _STRAIGHT * self.scale:
            return None
        mean = self.mean(change)
        topology = self.constraints.topology
        held = np.zeros(self.plane.n_nodes, dtype=bool)
        held[topology.face_nodes] = self.constraints.held[topology.number]
        there = held[self.line]
        if np.abs(change[there] - mean[self.line[there]]).max(initial=0.0) > _STRAIGHT * self.scale:
            return None
        return mean

    def spread(self, start: FloatArray, points: FloatArray, change: FloatArray) -> FloatArray:
        """Coordinates (n_nodes, 3) for a displacement (n_plane, 3); held nodes keep their coordinates in ``points``.

        ``start`` (n_nodes, 3) are the undeformed coordinates.
        """
        topology = self.constraints.topology
        held = np.zeros(self.plane.n_nodes, dtype=bool)
        held[topology.face_nodes] = self.constraints.held[topology.number]
        result: FloatArray = empty(points.shape)

        def fill(rows: slice) -> None:
            line = self.line[rows]
            result[rows] = np.where(held[line][:, None], points[rows], start[rows] + change[line])

        for_rows(fill, result)
        return result


def find_extrusion(constraints: Constraints) -> Extrusion | None:
    """The plane grid that a grid and its constraints are extruded from, or ``None``."""
    grid = constraints.grid
    if grid.dimension == 2:
        return None
    constraints = constraints.without_sliding()
    scale = float(np.ptp(grid.points, axis=0).max())
    for height in _heights(grid, scale):
        axes = [axis for b in range(grid.n_blocks) if (axis := _axis(grid.block(b), height, scale))]
        unit = height / np.linalg.norm(height)
        found = _extruded(constraints, axes, unit, scale) if len(axes) == grid.n_blocks else None
        if found is not None:
            return found
    return None


def may_be_extruded(grid: Grid) -> bool:
    """Whether its first block has the same height everywhere."""
    low, high = extent(grid.points)
    return bool(_heights(grid, float((high - low).max())))


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


def _axis(block: FloatArray, height: FloatArray, scale: float) -> tuple[int, int] | None:
    """Index axis along which a block is extruded by ``height``, and the index of its lower end (0 or -1)."""
    unit = height / np.linalg.norm(height)
    for axis in range(3):
        whole = (block.take(-1, axis=axis) - block.take(0, axis=axis)).reshape(-1, 3)
        sign = 1.0 if whole[0] @ height > 0.0 else -1.0
        if np.abs(whole - sign * height).max() > _STRAIGHT * scale:
            continue
        layers = np.moveaxis(block, axis, 0)
        steps = layers - layers[:1]
        along = (steps @ unit).reshape(block.shape[axis], -1)
        across = np.abs(steps - (steps @ unit)[..., None] * unit).max()
        if max(across, np.ptp(along, axis=1).max()) <= _STRAIGHT * scale:
            return axis, 0 if sign > 0.0 else -1
    return None


def _extruded(
    constraints: Constraints, axes: list[tuple[int, int]], unit: FloatArray, scale: float
) -> Extrusion | None:
    grid = constraints.grid
    base = [np.take(grid.block(b), [end], axis=axis) for b, (axis, end) in enumerate(axes)]
    level = np.concatenate([(b @ unit).ravel() for b in base])
    if np.ptp(level) > _STRAIGHT * scale:
        return None
    plane = Grid.from_blocks(base, grid.names)
    if abs(abs(unit @ plane_normal(plane)) - 1.0) > 1e-9:  # type: ignore[operator]
        return None
    line, bottom = np.empty(grid.n_nodes, dtype=np.int64), np.empty(plane.n_nodes, dtype=np.int64)
    every = np.arange(grid.n_nodes)
    for b, (axis, end) in enumerate(axes):
        mine = np.arange(plane.offsets[b], plane.offsets[b + 1]).reshape(plane.shapes[b])
        rows = slice(grid.offsets[b], grid.offsets[b + 1])
        line[rows].reshape(grid.shapes[b])[...] = mine
        bottom[mine.ravel()] = np.take(every[rows].reshape(grid.shapes[b]), [end], axis=axis).ravel()
    flat = _in_plane(constraints, find_topology(plane), plane, line, bottom, unit)
    return None if flat is None else Extrusion(unit, plane, line, flat, scale)


def _in_plane(
    constraints: Constraints, topology: Topology, plane: Grid, line: IntArray, bottom: IntArray, unit: FloatArray
) -> Constraints | None:
    """The constraints of the plane grid, or ``None`` if those of the grid vary along a line.

    On lines through the interior of the plane grid's blocks, only the end nodes may be constrained, and only to the end
    planes.
    """
    space, flat = constraints.topology, np.eye(3) - np.outer(unit, unit)
    removed = flat @ constraints.removed @ flat
    number = np.full(plane.n_nodes, -1)
    number[topology.face_nodes] = topology.number
    of = number[line[space.face_nodes]]
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
