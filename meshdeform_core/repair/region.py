"""The nodes that a repair moves, the cells around them, and how the nodes depend on the unknowns.

A region is either all nodes that may move or those within some layers of cells. Its cells have weights: with equal
ones, the minimum of the energy concentrates shear at a rotating wall (in a ring, like 1 / r^2), where first cells would
lose nine tenths of their height. Weights that decay with a high power of distance reverse that. Where a grid is
squeezed, the largest distortion is smallest if all cells share it, boundary layers included. Thin cells therefore have
larger weights, also at fixed walls; this costs little, as they take up little space.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from ..boundary import Boundary
from ..grid import BoolArray, FloatArray, IntArray
from ..grid.planes import plane_axes
from ..numerics.cell.foldover.loops import Unknowns
from ..numerics.cell.foldover.samples import cell_edges, sound_samples
from ..numerics.cell.measures import cell_corners
from ..parallel import Nodes
from ..quality import Original
from ..quality.cells import corner_nodes, places
from .constraints import Constraints, Extrusion, find_extrusion
from .energy import Energy, Region, Slide, components
from .newton import NewtonSystem
from .outcome import cells_where
from .tuned import COLLAPSED, CRAMPED, FALL, FIRST, GROWTH, HEAVIEST, REACH, ROOM, SHARE, STEEP, THIN

FARTHEST = math.ceil(REACH / SHARE)
"""Distances beyond this many cells from walls need not be distinguished."""


@dataclass(frozen=True, eq=False)
class Plot:
    """A region of a grid.

    ``moved`` (k,): block nodes, ascending, that follow the region's nodes ``at`` (k,). ``nodes`` (n,): one block node
    for each node of the region, whose coordinates are the components along ``axes`` (d, 3) of the vectors from
    ``origin`` (3,), near the grid, so that they are as accurate far from the origin of space as at it. ``whole``: these
    are all nodes that may move.
    """

    region: Region
    moved: IntArray
    at: IntArray
    nodes: IntArray
    axes: FloatArray
    origin: FloatArray
    whole: bool

    @cached_property
    def edges(self) -> FloatArray:
        """The shortest undeformed edges (n,) at the nodes; those of zero length do not count."""
        energy = self.region.energy
        result = np.full(len(energy.start), np.inf)
        ends, length = cell_edges(energy.start, energy.nodes)
        np.minimum.at(result, ends, np.where(length > 0.0, length, np.inf)[..., None])
        return result

    @cached_property
    def system(self) -> NewtonSystem:
        """The linear system of Newton's method; its sparsity pattern is found once."""
        return NewtonSystem(self.region)

    def inside(self, points: FloatArray) -> FloatArray:
        """Coordinates (n, d) of the region's nodes; all ranks that hold parts of ``points`` call this together."""
        return components(Nodes.of(points).at(self.nodes) - self.origin, self.axes)

    def shift(self, change: FloatArray) -> FloatArray:
        """Shift (k, 3) of the block nodes ``moved`` for a change (n, d) of the region's coordinates."""
        return components(change[self.at], self.axes.T)


def distances_in_cells(constraints: Constraints, seeds: IntArray, most: int) -> tuple[Any, int]:
    """Distance (n_nodes,) int16, in cells, of every block node from the block nodes ``seeds``, ``most + 1`` where it
    exceeds ``most``, in parts if the grid is; and the largest distance up to ``most``.

    Coincident nodes and periodic images count as one node. All ranks that hold parts of the grid call this together.
    """
    grid, on_faces = constraints.grid, constraints.topology.face_nodes
    classes = constraints.root[constraints.topology.number]
    found = grid.nodes.like(dtype=np.int16)
    nodes = Nodes.of(found)
    own = nodes.own
    own[...] = most + 1
    own[seeds[(seeds >= nodes.low) & (seeds < nodes.high)] - nodes.low] = 0
    nearest = np.full(len(on_faces), most + 1, dtype=np.int16)
    nearest[classes[np.isin(on_faces, seeds)]] = 0
    changed, first = True, True
    while changed:
        grid.hold_neighbours(found)
        changed, before = False, nearest.copy()
        for block, shape in enumerate(grid.shapes):
            planes, size = grid.planes(block), shape[1] * shape[2]
            if planes.start == planes.stop:
                continue
            # With the planes of the neighbours, from which distances come in, too.
            ends = max(planes.start - 1, 0), min(planes.stop + 1, shape[0])
            rows = slice(*(int(grid.offsets[block]) + end * size for end in ends))
            faces = slice(*np.searchsorted(on_faces, [rows.start, rows.stop]).tolist())
            layers, at, kind = nodes.rows[rows], on_faces[faces] - rows.start, classes[faces]
            if not (first or nodes.divided or (nearest[kind] < layers[at]).any()):
                continue
            layers[at] = np.minimum(layers[at], nearest[kind])
            box = _spread(layers.reshape(-1, *shape[1:])).ravel()
            changed |= bool((box < layers).any())
            layers[...] = box
            np.minimum.at(nearest, kind, layers[at])
        nearest = np.minimum.reduce(nodes.gather(nearest))
        changed, first = any(nodes.gather(changed or bool((nearest < before).any()))), False
    return found, max(nodes.gather(int(own[own <= most].max(initial=0))))


def _spread(layers: np.ndarray) -> np.ndarray:
    """The least sums (ni, nj, nk) of a value in a box and the number of cells between."""
    lower = True
    while lower:
        near = layers.copy()
        for axis in range(3):
            along = np.moveaxis(near, axis, 0)
            np.minimum(along[1:], along[:-1], out=along[1:])
            np.minimum(along[:-1], along[1:], out=along[:-1])
        near = np.minimum(layers, near + 1)
        lower, layers = bool((near < layers).any()), near
    return layers


class Basis:
    """Data common to all repairs of one undeformed grid; ``axes`` (d, 3): directions of the coordinates of regions."""

    def __init__(self, original: Original, boundary: Boundary | Constraints):
        self.original, self.grid, self.topology = original, original.grid, original.topology
        self.constraints = boundary if isinstance(boundary, Constraints) else Constraints.of(original, boundary)
        self.axes = np.eye(3) if original.normal is None else plane_axes(original.normal)

    @cached_property
    def extrusion(self) -> tuple[Extrusion, Basis] | None:
        """The plane grid that this one is extruded from, with its own basis; ``None`` if it is no extrusion."""
        found = find_extrusion(self.constraints)
        if found is None:
            return None
        original = Original(found.plane, found.constraints.topology, self.original.min_jacobian)
        return found, Basis(original, found.constraints)

    @cached_property
    def whole(self) -> Plot | None:
        """The region of all nodes that may move, or ``None`` if no node may."""
        return self.plot()

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns of all nodes that may move."""
        on_faces = len(np.unique(self.constraints.root[~self.constraints.held]))
        return self.grid.n_nodes - len(self.topology.face_nodes) + on_faces

    @cached_property
    def _from_walls(self) -> tuple[Any, int]:
        """Distance of every block node (n_nodes,) from walls, in cells, and the largest one."""
        walls = self.topology.face_nodes[self.constraints.walls[self.topology.number]]
        return distances_in_cells(self.constraints, walls, FARTHEST)

    def near(self, cells: IntArray, most: int) -> Any:
        """Distance of every block node from the nodes of ``cells``, of which each rank gives those in its part, as from
        :func:`distances_in_cells`."""
        corners = corner_nodes(self.grid, *places(self.grid, cells))
        seeds = np.unique(np.concatenate(self.grid.nodes.gather(np.unique(corners))))
        return distances_in_cells(self.constraints, seeds, most)[0]

    def plot(self, layers: Any = None, most: int = 0) -> Plot | None:
        """The region of the nodes that may move and whose ``layers`` (n_nodes,), if given, are at most ``most``, or
        ``None`` if there are none. All ranks that hold parts of the grid call this together."""
        rows = Nodes.of(self.grid.nodes.like(dtype=bool))
        rows.own[...] = True if layers is None else Nodes.of(layers).own <= most
        faces = self._own_faces(rows)
        rows.rows[self.topology.face_nodes[faces][self.constraints.held[self.topology.number[faces]]]] = False
        moved = np.concatenate(rows.gather(rows.low + np.flatnonzero(rows.own)))
        if not moved.size:
            return None
        cells = cells_where(lambda moves: cell_corners(moves).any(axis=1), self.grid, rows)
        block, ijk = places(self.grid, cells)
        corners, owners = corner_nodes(self.grid, block, ijk), self._owners(moved)
        nodes, local = np.unique(self._owners(corners.ravel()), return_inverse=True)
        number = self.topology.numbers_of(nodes)
        moves = (number < 0) | ~self.constraints.held[number]
        if layers is not None:
            moves &= Nodes.of(layers).at(nodes) <= most
        unknowns, freedom = self._unknowns(nodes, moves)
        origin = self.grid.nodes.at(np.array([0]))[0]
        start = components(self.grid.nodes.at(nodes) - origin, self.axes)
        cell_nodes = local.reshape(corners.shape)
        from_walls, largest = self._from_walls
        share, first = nearness(Nodes.of(from_walls).at(nodes), largest)
        weight = weigh(share[cell_nodes], first, start, cell_nodes)
        side = self.original.sides(block)
        if self.original.normal is not None:
            side = side @ self.original.normal
        # Samples that depend on no node that moves are constant.
        mask = sound_samples(start, cell_nodes, side, COLLAPSED, moves)
        energy = Energy(start, cell_nodes, weight, np.ones(len(cells)), mask)
        surfaces = [
            (each, np.isin(nodes, self.topology.first[each.nodes]) & moves) for each in self.constraints.sliding
        ]
        slides = [Slide(np.flatnonzero(on), each, self.axes, origin) for each, on in surfaces if on.any()]
        region = Region(energy, unknowns, freedom, tuple(slides))
        return Plot(region, moved, np.searchsorted(nodes, owners), nodes, self.axes, origin, layers is None)

    def back_to_surfaces(self, points: FloatArray) -> None:
        """Project the nodes that slide on curved surfaces back onto them, in place."""
        nodes = Nodes.of(points)
        own = self._own_faces(nodes)
        for each in self.constraints.sliding:
            rows = self.topology.face_nodes[own][np.isin(self.topology.number[own], each.nodes)]
            if rows.size:
                nodes.rows[rows] = each.project(nodes.rows[rows])

    def _own_faces(self, nodes: Nodes) -> slice:
        """Which of the nodes on block faces are among this rank's ``nodes``."""
        return slice(*np.searchsorted(self.topology.face_nodes, nodes.ends).tolist())

    def _owners(self, nodes: IntArray) -> IntArray:
        """The block node that represents each of ``nodes``."""
        number = self.topology.numbers_of(nodes)
        return np.where(number >= 0, self.topology.first[number], nodes)

    def _unknowns(self, nodes: IntArray, moves: BoolArray) -> tuple[Unknowns, FloatArray]:
        """The dependence of a region's ``nodes`` on its unknowns, and the directions of these; see :class:`Region`."""
        number, one = self.topology.numbers_of(nodes), np.eye(len(self.axes))
        owners = np.where(number >= 0, self.topology.first[self.constraints.root[number]], nodes)
        roots, of_node = np.unique(owners[moves], return_inverse=True)
        unknown = np.full(len(nodes), -1, dtype=np.int64)
        unknown[moves] = of_node

        def frames(number: IntArray) -> FloatArray:
            result, on_faces = np.tile(one, (len(number), 1, 1)), number >= 0
            result[on_faces] -= self.axes @ (np.eye(3) - self.constraints.frame[number[on_faces]]) @ self.axes.T
            return result

        frame = frames(number)
        return Unknowns(unknown, frame, (frame == one).all(axis=(1, 2))), frames(self.topology.numbers_of(roots))


def nearness(layers: np.ndarray, largest: int) -> tuple[FloatArray, float]:
    """Distance (n,) of nodes from walls relative to the reach of walls, at most 1, and that of walls themselves.

    ``layers`` (n,) are the distances in cells, more than FARTHEST where no wall is that near, ``largest`` the largest
    distance in the grid up to that.
    """
    reach = max(1.0, min(REACH, SHARE * largest))
    return np.minimum((layers + 1.0) / reach, 1.0), 1.0 / reach


def weigh(share: FloatArray, first: float, start: FloatArray, cells: IntArray) -> FloatArray:
    """Weights (m,) of ``cells`` (m, k) with undeformed node coordinates ``start`` (n, d); ``share`` (m, k) is the
    :func:`nearness` of their nodes, ``first`` that of nodes on walls."""
    near = share.min(axis=1)
    _, length = cell_edges(start, cells)
    # Longest over shortest edge of cells (m,); collapsed edges do not count.
    aspect = length.max(axis=1) / np.where(length > 0.0, length, np.inf).min(axis=1)
    thin = np.clip((aspect / THIN) ** GROWTH, 1.0, HEAVIEST)
    # The layer, from 1 at walls.
    layer, reach = np.where(near < 1.0, near / first, np.inf), 1.0 / first
    rigid = FIRST * reach * min(1.0, reach / ROOM) ** CRAMPED
    return np.asarray(np.maximum.reduce([near**-FALL, rigid / layer**STEEP, thin]))
