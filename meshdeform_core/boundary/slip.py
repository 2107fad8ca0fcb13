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
from ..parallel import rows_at
from ..wording import vector

if TYPE_CHECKING:
    from ..numerics.geometry.surface import TriangleTree


@dataclass(frozen=True)
class CurvedSurface:
    """A curved slip surface: triangles of its undeformed face quads, and the nodes that slide on it.

    ``nodes`` (n,) are unique node numbers; ``points`` (m, 3) and ``triangles`` (k, 3) describe the surface.
    """

    nodes: IntArray
    points: FloatArray
    triangles: IntArray

    @cached_property
    def tree(self) -> TriangleTree:
        """Search tree for closest points of the surface."""
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
            self._slide(surface, displacement, points, first)
        for nodes, removed in self.groups:
            displacement[nodes] -= displacement[nodes] @ removed

    def departure(self, displacement: FloatArray) -> float:
        """Largest displacement of a node out of a plane that it lies on (grid length unit)."""
        return max((float(np.abs(displacement[nodes] @ p.normal).max()) for p, nodes in self.planes), default=0.0)

    @staticmethod
    def _slide(surface: CurvedSurface, displacement: FloatArray, points: FloatArray, first: IntArray) -> None:
        moving = surface.nodes[(displacement[surface.nodes] != 0.0).any(axis=1)]
        if moving.size:
            start = rows_at(points, first[moving])
            target = start + displacement[moving]
            triangle, weights, _ = surface.tree.closest(target)
            corners = surface.points[surface.triangles[triangle]]
            displacement[moving] = np.einsum("nc,ncd->nd", weights, corners) - start


def find_sliding(
    grid: Grid, topology: Topology, slipping: Sequence[tuple[str, IntArray, bool]], free: BoolArray
) -> tuple[Slip, tuple[Plane, ...]]:
    """Slip constraints and symmetry planes.

    Parameters
    ----------
    slipping : name, face quads and "is a symmetry" of every slip or symmetry boundary
    free : (n_unique,) nodes that belong to no stronger boundary

    Raises
    ------
    CaseError
        When a symmetry boundary is not plane.
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
            plane = plane_of(rows_at(grid.points, topology.first[nodes]), normal)
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
            curved.append(_curved_surface(grid, topology, np.concatenate(bent), free))
    normals, which = _directions([plane for plane, _ in sides])
    parts = [
        np.concatenate([part for (_, part), w in zip(sides, which, strict=True) if w == n]) for n in range(len(normals))
    ]
    slip = Slip(tuple(planes), _groups(planes, free), tuple(zip(normals, parts, strict=True)), tuple(curved))
    return slip, _distinct(mirrors)


def _farthest(grid: Grid, topology: Topology, bent: Sequence[IntArray], normal: FloatArray | None) -> str:
    """The one of several sides whose nodes are farthest from a plane, and how far."""
    found = []
    for quads in bent:
        nodes = topology.first[np.unique(topology.quads.corners[quads])]
        x = rows_at(grid.points, nodes)
        arms = x - x.mean(axis=0)
        axes = np.linalg.svd(arms, full_matrices=False)[2]
        off = np.abs(arms @ (axes[-1] if normal is None else np.cross(normal, axes[0])))
        block, side = divmod(int(topology.quads.block_side[quads[0]]), 6)
        found.append((float(off.max()), f"{grid.names[block]}.{Side(side).label}", vector(x[int(off.argmax())])))
    distance, face, place = max(found)
    return f"{face} lies up to {distance:.3g} off its mean plane, at {place}"


def _curved_surface(grid: Grid, topology: Topology, quads: IntArray, free: BoolArray) -> CurvedSurface:
    corners = topology.quads.corners[quads]
    nodes, local = np.unique(corners, return_inverse=True)
    local = local.reshape(corners.shape)
    return CurvedSurface(nodes[free[nodes]], rows_at(grid.points, topology.first[nodes]), triangles_of(local))


def triangles_of(quads: IntArray) -> IntArray:
    """Two triangles (2 n, 3) for each of the quads (n, 4); of cell edges (n, 2) in 2-D, triangles without width."""
    split = ([0, 1, 2], [0, 2, 3]) if quads.shape[1] == 4 else ([0, 1, 1],)
    return np.concatenate([quads[:, which] for which in split])


def _groups(planes: list[tuple[Plane, IntArray]], free: BoolArray) -> tuple[tuple[IntArray, FloatArray], ...]:
    """Free nodes grouped by the set of slip directions that meet at them."""
    normals, which = _directions([plane for plane, _ in planes])
    on = np.zeros((len(free), len(normals)), dtype=bool)
    for index, (_, nodes) in zip(which, planes, strict=True):
        on[nodes, index] = True
    touched = np.flatnonzero(on.any(axis=1) & free)
    if touched.size == 0:
        return ()
    sets, member = np.unique(on[touched], axis=0, return_inverse=True)
    return tuple((touched[member == s], _span_projector(np.array(normals)[chosen])) for s, chosen in enumerate(sets))


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


def _span_projector(normals: FloatArray) -> FloatArray:
    """Orthogonal projector (3, 3) on the span of the rows of ``normals``."""
    basis: list[FloatArray] = []
    for normal in normals:
        rest = normal - sum((b * (b @ normal) for b in basis), np.zeros(3))
        length = float(np.linalg.norm(rest))
        if length > 1e-6:
            basis.append(rest / length)
    return np.sum([np.outer(b, b) for b in basis], axis=0)


def _distinct(planes: list[Plane]) -> tuple[Plane, ...]:
    kept: list[Plane] = []
    for plane in planes:
        scale = max(float(np.abs(plane.point).max()), 1e-300)
        if not any(
            abs(p.normal @ plane.normal) > 1 - 1e-9 and abs(p.normal @ (p.point - plane.point)) < 1e-6 * scale
            for p in kept
        ):
            kept.append(plane)
    return tuple(kept)
