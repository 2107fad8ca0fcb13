"""Constraints of a repair: nodes that are held, that slide in planes or on surfaces, or that are periodic images."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..boundary import Boundary, Kind
from ..boundary.slip import CurvedSurface
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..parallel import rows_at
from ..quality import Original

_CREASE = np.cos(np.deg2rad(30.0))
"""Nodes where triangles meet at a larger angle are held, as sliding would cut off the edge of the surface."""


@dataclass(frozen=True, eq=False)
class Sliding:
    """A curved surface and the unique nodes (n,) that may slide on it; ``normal`` (3,) is that of a plane grid, zero in
    3-D."""

    surface: CurvedSurface
    nodes: IntArray
    normal: FloatArray

    @classmethod
    def on(cls, surface: CurvedSurface, free: BoolArray, starts: FloatArray, normal: FloatArray | None) -> Sliding:
        """The ``free`` (n_unique,) nodes that have neighbours all around; their initial coordinates are ``starts``."""
        plane = np.zeros(3) if normal is None else normal
        everything = cls(surface, surface.nodes, plane)
        smooth = everything._smoothness(starts[surface.nodes]) > _CREASE
        return cls(surface, surface.nodes[free[surface.nodes] & smooth], plane)

    def normals(self, points: FloatArray) -> FloatArray:
        """Unit normals (k, 3) of the surface at its points nearest to ``points`` (k, 3)."""
        mean = self._mean_normals(points)[0]
        return np.asarray(mean / np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None])

    def slopes(self, points: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k, 3, 3) of :meth:`project` and :meth:`normals` at ``points`` (k, 3), within their triangles."""
        mean, normals, triangle = self._mean_normals(points)
        corners = self.surface.points[self.surface.triangles[triangle]]
        sides = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        # Derivatives of the weights of the second and third corner; that of the first is minus their sum.
        weights, size = np.linalg.pinv(sides), np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None, None]
        change = (normals[:, 1:] - normals[:, :1]).transpose(0, 2, 1) @ weights / size
        normal = mean[:, :, None] / size
        return sides @ weights, change - normal @ (normal.transpose(0, 2, 1) @ change)

    def _mean_normals(self, points: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Mean (k, 3) of the unit normals at the corners of the triangles nearest to ``points`` (k, 3), with
        barycentric weights; these normals (k, 3, 3); and the numbers (k,) of the triangles."""
        triangle, weights, _ = self.surface.tree.closest(points)
        corners = self._vertex_normals[self.surface.triangles[triangle]]
        # Triangles of different blocks may be oriented in opposite senses.
        sense = np.sign(np.einsum("ncd,nd->nc", corners, self._triangle_normals[triangle]))
        normals = sense[:, :, None] * corners
        return np.einsum("nc,ncd->nd", weights, normals), normals, triangle

    def project(self, points: FloatArray) -> FloatArray:
        """The points (k, 3) of the surface closest to ``points`` (k, 3)."""
        triangle, weights, _ = self.surface.tree.closest(points)
        corners = self.surface.points[self.surface.triangles[triangle]]
        return np.asarray(np.einsum("nc,ncd->nd", weights, corners))

    @cached_property
    def _triangle_normals(self) -> FloatArray:
        """Normals (m, 3) whose length is the area of each triangle, or the length of each segment of a plane curve, up
        to a factor."""
        a, b, c = (self.surface.points[self.surface.triangles[:, n]] for n in range(3))
        return np.asarray(np.cross(b - a, self.normal) if self.normal.any() else np.cross(b - a, c - a))

    @cached_property
    def _vertex_normals(self) -> FloatArray:
        """Mean directions (n, 3), of either sign, of the normals of the triangles at each node."""
        total = np.zeros((len(self.surface.points), 3, 3))
        normal = self._triangle_normals
        square = (
            normal[:, :, None] * normal[:, None, :] / np.maximum(np.linalg.norm(normal, axis=1), 1e-300)[:, None, None]
        )
        for corner in range(3):
            np.add.at(total, self.surface.triangles[:, corner], square)
        return np.asarray(np.linalg.eigh(total)[1][:, :, -1])

    def _smoothness(self, points: FloatArray) -> FloatArray:
        """Smallest cosine (k,) between the normals at surface points and those of the triangles around them."""
        length = np.linalg.norm(self._triangle_normals, axis=1)
        unit = self._triangle_normals / np.maximum(length, 1e-300)[:, None]
        lowest = np.ones(len(self.surface.points))
        for corner in range(3):
            at = self.surface.triangles[:, corner]
            cosine = np.abs(np.einsum("nd,nd->n", unit, self._vertex_normals[at]))
            np.minimum.at(lowest, at, np.where(length > 0.0, cosine, 1.0))
        triangle, weights, _ = self.surface.tree.closest(points)
        return np.asarray(lowest[self.surface.triangles[triangle, weights.argmax(axis=1)]])


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
    sliding : the nodes that slide on curved surfaces
    """

    grid: Grid
    topology: Topology
    held: BoolArray
    walls: BoolArray
    removed: FloatArray
    root: IntArray
    turn: dict[int, FloatArray] = field(default_factory=dict)
    sliding: tuple[Sliding, ...] = ()

    def without_sliding(self) -> Constraints:
        """The constraints with the nodes that slide on curved surfaces held instead."""
        held = self.held.copy()
        for each in self.sliding:
            held[each.nodes] = True
        return dataclasses.replace(self, held=held, sliding=())

    @classmethod
    def of(cls, original: Original, boundary: Boundary) -> Constraints:
        """The constraints of a classified boundary."""
        grid, topology = original.grid, original.topology
        held = boundary.kind >= Kind.FIXED
        single = _on_one_surface(topology, boundary)
        starts, normal = rows_at(grid.points, topology.first), plane_normal(grid)
        sliding = tuple(Sliding.on(surface, single, starts, normal) for surface in boundary.slip.curved)
        for surface, each in zip(boundary.slip.curved, sliding, strict=True):
            held[np.setdiff1d(surface.nodes, each.nodes)] = True
        root, turn = np.arange(topology.n_unique), {}
        if boundary.periodic.one.size:
            nodes, roots, turns = boundary.periodic.frames(topology.n_unique)
            root[nodes] = roots
            turn = dict(zip(nodes.tolist(), turns, strict=True))
        removed = np.zeros((topology.n_unique, 3, 3))
        for nodes, projector in boundary.slip.groups:
            removed[nodes] += projector
        for node, rotation in turn.items():
            if root[node] != node:
                removed[root[node]] += rotation.T @ removed[node] @ rotation
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        removed[several] = _spans(removed[several])
        quads = original.moving_wall_quads(boundary) | original.fixed_wall_quads(boundary)
        walls = np.zeros(topology.n_unique, dtype=bool)
        walls[topology.quads.corners[quads]] = True
        return cls(grid, topology, held, walls, removed, root, turn, sliding)


def _on_one_surface(topology: Topology, boundary: Boundary) -> BoolArray:
    """(n_unique,) whether a node is on at most one curved slip surface and on no plane or periodic boundary."""
    count = np.zeros(topology.n_unique, dtype=np.int64)
    for surface in boundary.slip.curved:
        count[surface.nodes] += 1
    for nodes, _ in boundary.slip.groups:
        count[nodes] += 2
    if boundary.periodic.one.size:
        count[boundary.periodic.frames(topology.n_unique)[0]] += 2
    return count < 2


def _spans(sums: FloatArray) -> FloatArray:
    """Projectors (n, 3, 3) onto the ranges of sums of projectors; exact if these are along coordinate axes."""
    values, vectors = np.linalg.eigh(sums)
    kept = np.where(values[:, None, :] > 1e-9, vectors, 0.0)
    exact = np.abs(sums - np.round(sums)).max(axis=(1, 2), initial=0.0) < 1e-12
    spans = np.asarray(kept @ kept.transpose(0, 2, 1))
    spans[exact] = np.round(spans[exact])
    return spans
