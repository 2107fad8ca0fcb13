"""Nodes that slide: in planes, on curved surfaces, and in symmetry planes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CaseError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.planes import FLATNESS, Plane, plane_normal, plane_of
from ..grid.topology import Topology
from ..numerics.arrays import lengths
from ..parallel import Nodes
from ..wording import counted, vector

if TYPE_CHECKING:
    from ..numerics.geometry.surface import TriangleTree

_ON_EDGE = 1e-12
"""Barycentric weights below this are zero but for round-off."""
_CREASE = np.cos(np.deg2rad(30.0))
"""Where triangles meet at a larger angle, sliding would cut off the edge of the surface."""


@dataclass(frozen=True, eq=False)
class CurvedSurface:
    """A curved slip surface: triangles of its undeformed face quads, and the nodes that slide on it.

    Attributes
    ----------
    name : of the boundary
    nodes : (n,) unique numbers of the nodes that slide
    corners, points : (m,) unique numbers and (m, 3) undeformed coordinates of all nodes of the surface
    triangles : (k, 3) rows of ``points``; in a plane grid those of edges, without width
    rim : (m,) points at edges with moving walls, beyond which the surface continues as the planes of its triangles
    normal : (3,) of a plane grid, zero in space
    """

    name: str
    nodes: IntArray
    corners: IntArray
    points: FloatArray
    triangles: IntArray
    rim: BoolArray
    normal: FloatArray

    def closest(self, targets: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Numbers (k,) of the triangles with the points closest to ``targets`` (k, 3), the weights (k, 3) of their
        corners at these points, some of them negative beyond a moving rim, and the distances (k,) from the triangles.
        """
        triangle, weights, distance = self._tree.closest(targets)
        corners = self.triangles[triangle]
        beyond = np.flatnonzero((self.rim[corners] | (weights < _ON_EDGE)).all(axis=1))
        x = self.points[corners[beyond]]
        along = np.linalg.pinv((x[:, 1:] - x[:, :1]).transpose(0, 2, 1))
        weights[beyond, 1:] = np.einsum("nij,nj->ni", along, targets[beyond] - x[:, 0])
        weights[beyond, 0] = 1.0 - weights[beyond, 1:].sum(axis=1)
        return triangle, weights, distance

    def project(self, targets: FloatArray) -> FloatArray:
        """The points (k, 3) of the surface closest to ``targets`` (k, 3)."""
        triangle, weights, _ = self.closest(targets)
        return np.asarray(np.einsum("nc,ncd->nd", weights, self.points[self.triangles[triangle]]))

    def normals(self, targets: FloatArray) -> FloatArray:
        """Unit normals (k, 3) of the surface at its points closest to ``targets`` (k, 3)."""
        mean = self._mean_normals(targets)[0]
        return np.asarray(mean / np.maximum(lengths(mean), 1e-300)[:, None])

    def slopes(self, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k, 3, 3) of :meth:`project` and :meth:`normals` at ``targets`` (k, 3), within their
        triangles."""
        mean, normals, triangle = self._mean_normals(targets)
        corners = self.points[self.triangles[triangle]]
        sides = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        # Derivatives of the weights of the second and third corner; that of the first is minus their sum.
        weights, size = np.linalg.pinv(sides), np.maximum(lengths(mean), 1e-300)[:, None, None]
        change = (normals[:, 1:] - normals[:, :1]).transpose(0, 2, 1) @ weights / size
        normal = mean[:, :, None] / size
        return sides @ weights, change - normal @ (normal.transpose(0, 2, 1) @ change)

    @cached_property
    def creased(self) -> BoolArray:
        """Whether triangles meet at more than 30 degrees at each of the points (m,)."""
        length = lengths(self._triangle_normals)
        unit = self._triangle_normals / np.maximum(length, 1e-300)[:, None]
        lowest = np.ones(len(self.points))
        for at in self.triangles.T:
            cosine = np.abs(np.einsum("nd,nd->n", unit, self._vertex_normals[at]))
            np.minimum.at(lowest, at, np.where(length > 0.0, cosine, 1.0))
        return np.asarray(lowest <= _CREASE)

    def _mean_normals(self, targets: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Mean (k, 3) of the unit normals at the corners of the triangles closest to ``targets`` (k, 3), with
        barycentric weights; these normals (k, 3, 3); and the numbers (k,) of the triangles."""
        triangle, weights, _ = self.closest(targets)
        corners = self._vertex_normals[self.triangles[triangle]]
        # Triangles of different blocks may be oriented in opposite senses.
        sense = np.sign(np.einsum("ncd,nd->nc", corners, self._triangle_normals[triangle]))
        normals = sense[:, :, None] * corners
        return np.einsum("nc,ncd->nd", weights, normals), normals, triangle

    @cached_property
    def _triangle_normals(self) -> FloatArray:
        """Normals (k, 3) whose length is the area of each triangle, or the length of each segment of a plane curve, up
        to a factor."""
        a, b, c = (self.points[at] for at in self.triangles.T)
        return np.asarray(np.cross(b - a, self.normal if self.normal.any() else c - a))

    @cached_property
    def _vertex_normals(self) -> FloatArray:
        """Mean directions (m, 3), of either sign, of the normals of the triangles at each point."""
        total, normal = np.zeros((len(self.points), 3, 3)), self._triangle_normals
        square = normal[:, :, None] * normal[:, None, :] / np.maximum(lengths(normal), 1e-300)[:, None, None]
        for at in self.triangles.T:
            np.add.at(total, at, square)
        return np.asarray(np.linalg.eigh(total)[1][:, :, -1])

    @cached_property
    def _tree(self) -> TriangleTree:
        from ..numerics.geometry.surface import TriangleTree

        return TriangleTree(self.points, self.triangles)


@dataclass(frozen=True)
class Slip:
    """Nodes that slide: in planes (up to three at a node), on curved surfaces, or both.

    Attributes
    ----------
    planes : slip and symmetry planes with all unique nodes that lie on them, sources included
    groups : (node numbers (n,), removed directions (3, 3)) for each set of planes that meet at a node; the displacement
        loses its components along the removed directions: ``d - d @ removed``
    sides : (unit normal (3,), face quads) of plane slip sides, those with the same normal together; none of symmetries
    curved : curved slip surfaces
    """

    planes: tuple[tuple[Plane, IntArray], ...] = ()
    groups: tuple[tuple[IntArray, FloatArray], ...] = ()
    sides: tuple[tuple[FloatArray, IntArray], ...] = ()
    curved: tuple[CurvedSurface, ...] = ()

    def constrain(self, displacement: FloatArray, points: FloatArray, first: IntArray) -> None:
        """Make ``displacement`` (n_unique, 3) obey the constraints, in place.

        The nodes are the rows ``first`` (n_unique,) of the undeformed ``points`` (n_nodes, 3).
        """
        for surface in self.curved:
            moving = surface.nodes[(displacement[surface.nodes] != 0.0).any(axis=1)]
            if moving.size:
                start = Nodes.of(points).at(first[moving])
                displacement[moving] = surface.project(start + displacement[moving]) - start
        for nodes, removed in self.groups:
            given = displacement.take(nodes, axis=0)
            # Not a product of matrices: threads of a BLAS take longer to begin.
            displacement[nodes] = given - np.einsum("nd,de->ne", given, removed)

    def departure(self, displacement: FloatArray) -> float:
        """Largest displacement of a node out of a plane that it lies on (grid length unit)."""
        return max((float(np.abs(displacement[nodes] @ p.normal).max()) for p, nodes in self.planes), default=0.0)


def find_sliding(
    grid: Grid, topology: Topology, slipping: Sequence[tuple[str, IntArray, bool]], free: BoolArray, moving: BoolArray
) -> tuple[Slip, tuple[Plane, ...]]:
    """Slip constraints and symmetry planes. Raises CaseError when a symmetry boundary is not plane.

    ``slipping`` has name, face quads and "is a symmetry" of every slip or symmetry boundary; ``free`` and ``moving``
    (n_unique,) are the nodes that belong to no stronger boundary, and those of moving ones.
    """
    planes: list[tuple[Plane, IntArray]] = []
    curved: list[CurvedSurface] = []
    mirrors: list[Plane] = []
    sides: list[tuple[Plane, IntArray]] = []
    normal = plane_normal(grid)
    for name, quads, symmetry in slipping:
        bent = []
        for _, part in topology.quads.by_side(quads):
            nodes = np.unique(topology.quads.corners[part])
            plane = plane_of(grid.nodes.at(topology.first[nodes]), normal)
            if plane is None:
                bent.append(part)
                continue
            planes.append((plane, nodes))
            if symmetry:
                mirrors.append(plane)
            else:
                sides.append((plane, part))
        if bent and symmetry:
            raise CaseError(
                f"boundary {name!r} is a symmetry but not plane: {_farthest(grid, topology, bent, normal)}; "
                f'use kind = "slip" for curved surfaces'
            )
        if bent:
            curved.append(_curved_surface(name, grid, topology, np.concatenate(bent), free, moving))
    normals, which = _directions([plane for plane, _ in sides])
    parts = [
        np.concatenate([part for (_, part), w in zip(sides, which, strict=True) if w == n]) for n in range(len(normals))
    ]
    slip = Slip(tuple(planes), _slip_groups(planes, free), tuple(zip(normals, parts, strict=True)), tuple(curved))
    kept: list[Plane] = []
    for mirror in mirrors:
        near = 1e-6 * max(float(np.abs(mirror.point).max()), 1e-300)
        parallel = [p for p in kept if abs(p.normal @ mirror.normal) > 1 - 1e-9]
        if not any(abs(p.normal @ (p.point - mirror.point)) < near for p in parallel):
            kept.append(mirror)
    return slip, tuple(kept)


def _farthest(grid: Grid, topology: Topology, bent: Sequence[IntArray], normal: FloatArray | None) -> str:
    """The one of several sides whose nodes are farthest from a plane, and how far."""
    found = []
    for quads in bent:
        nodes = topology.first[np.unique(topology.quads.corners[quads])]
        x = grid.nodes.at(nodes)
        arms = x - x.mean(axis=0)
        axes = np.linalg.svd(arms, full_matrices=False)[2]
        off = np.abs(arms @ (axes[-1] if normal is None else np.cross(normal, axes[0])))
        block, side = divmod(int(topology.quads.block_side[quads[0]]), 6)
        found.append((float(off.max()), f"{grid.names[block]}.{Side(side).label}", vector(x[int(off.argmax())])))
    distance, face, place = max(found)
    return f"{face} lies up to {distance:.3g} off its mean plane, at {place}"


def crease_notes(grid: Grid, topology: Topology, slip: Slip) -> list[str]:
    """Warnings about creases of curved slip surfaces that begin at moving walls."""
    notes = []
    for surface in slip.curved:
        nodes = surface.corners[surface.rim & surface.creased] if surface.rim.any() else surface.nodes[:0]
        if nodes.size:
            first = int(topology.first[nodes[0]])
            notes.append(
                f"the slip boundary {surface.name!r} has creases of more than 30 degrees that begin at moving walls, "
                f"at {counted(nodes.size, 'node')}, first {grid.node_label(first)} = {vector(grid.points[first])}; "
                f"nodes on them may leave them and cut off the edge: give both sides boundary entries of their own"
            )
    return notes


def _curved_surface(
    name: str, grid: Grid, topology: Topology, quads: IntArray, free: BoolArray, moving: BoolArray
) -> CurvedSurface:
    corners = topology.quads.corners[quads]
    nodes, local = np.unique(corners, return_inverse=True)
    local = local.reshape(corners.shape)
    # Edges, in 2-D end nodes, of one quad only.
    edges = (
        np.stack([local, np.roll(local, 1, axis=1)], axis=-1).reshape(-1, 2)
        if grid.dimension == 3
        else local.reshape(-1, 1)
    )
    edges, count = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    edges = edges[(count == 1) & moving[nodes[edges]].all(axis=1)]
    rim = np.zeros(len(nodes), dtype=bool)
    rim[edges] = True
    points = grid.nodes.at(topology.first[nodes])
    normal = plane_normal(grid)
    plane = np.zeros(3) if normal is None else normal
    return CurvedSurface(name, nodes[free[nodes]], nodes, points, triangles_of(local), rim, plane)


def triangles_of(quads: IntArray) -> IntArray:
    """Two triangles (2 n, 3) for each of the quads (n, 4); of cell edges (n, 2) in 2-D, triangles without width."""
    split = ([0, 1, 2], [0, 2, 3]) if quads.shape[1] == 4 else ([0, 1, 1],)
    return np.concatenate([quads[:, which] for which in split])


def _slip_groups(planes: list[tuple[Plane, IntArray]], free: BoolArray) -> tuple[tuple[IntArray, FloatArray], ...]:
    """Free nodes grouped by the set of slip directions that meet at them."""
    normals, which = _directions([plane for plane, _ in planes])
    on = np.zeros((len(free), len(normals)), dtype=bool)
    for index, (_, nodes) in zip(which, planes, strict=True):
        on[nodes, index] = True
    touched = np.flatnonzero(on.any(axis=1) & free)
    if touched.size == 0:
        return ()
    sets, member = np.unique(on[touched], axis=0, return_inverse=True)
    groups = []
    for number, chosen in enumerate(sets):
        # Orthogonal projector on the span of the normals; those that nearly repeat others count as the same.
        basis: list[FloatArray] = []
        for normal in np.array(normals)[chosen]:
            rest = normal - sum((b * (b @ normal) for b in basis), np.zeros(3))
            if (length := float(np.linalg.norm(rest))) > 1e-6:
                basis.append(rest / length)
        groups.append((touched[member == number], np.sum([np.outer(b, b) for b in basis], axis=0)))
    return tuple(groups)


def _directions(planes: list[Plane]) -> tuple[list[FloatArray], list[int]]:
    """The different normals of planes, and which of them each plane has."""
    normals: list[FloatArray] = []
    which = []
    for plane in planes:
        same = [i for i, n in enumerate(normals) if abs(n @ plane.normal) > 1 - FLATNESS**2 * 8]
        if not same:
            normals.append(plane.normal)
            same = [len(normals) - 1]
        which.append(same[0])
    return normals, which
