"""The outer surfaces of a grid: one per family, per patch without family, and per unnamed face."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..numerics.arrays import extent
from .blocks import FloatArray, Grid, IntArray
from .faces import Face, Role, RoleGuess, clusters, declared_role, find_faces
from .parts import Side
from .planes import plane_normal, plane_of
from .topology import Topology, side_nodes

_MOST = 0.6
"""Walls longer than this fraction of the grid in two directions are floors or side walls, not bodies."""


@dataclass(frozen=True)
class Surface:
    """The faces of one family or patch, or a single unnamed face.

    Attributes
    ----------
    name : of the family or patch; the label of the face if the file has no name for it
    named : whether the file has a name for it
    role : of the faces with the largest total area
    declared : whether the file declares the role; otherwise it is a guess
    faces : its pieces
    """

    name: str
    named: bool
    role: Role
    declared: bool
    faces: tuple[Face, ...]

    @property
    def quads(self) -> IntArray:
        """Face quads (n,) of the surface."""
        return np.concatenate([face.quads for face in self.faces])

    @property
    def area(self) -> float:
        return sum(face.area for face in self.faces)

    @property
    def box(self) -> FloatArray:
        """Lowest and highest coordinates (2, 3)."""
        low, high = (np.array([face.box[end] for face in self.faces]) for end in (0, 1))
        return np.stack([low.min(axis=0), high.max(axis=0)])

    @property
    def first_height(self) -> float:
        """Smallest height of its first cells (grid length unit)."""
        return min(face.first_height for face in self.faces)

    @property
    def median_height(self) -> float:
        """Median height of its first cells; pieces are weighted by their number of cells."""
        heights = np.repeat([face.median_height for face in self.faces], [len(face.quads) for face in self.faces])
        return float(np.median(heights))

    @property
    def patches(self) -> tuple[str, ...]:
        """Names of its patches in the file."""
        return tuple(dict.fromkeys(face.patch.name for face in self.faces if face.patch))


@dataclass(frozen=True)
class Outside:
    """All faces of a grid with their roles, its surfaces, and its ``extent`` (3,)."""

    faces: tuple[Face, ...]
    roles: tuple[Role, ...]
    surfaces: tuple[Surface, ...]
    extent: FloatArray

    def of_role(self, *roles: Role) -> tuple[Surface, ...]:
        return tuple(surface for surface in self.surfaces if surface.role in roles)

    @property
    def bodies(self) -> tuple[Surface, ...]:
        """Walls of bodies in the grid, not the floor, ceiling and side walls of a channel or box.

        The latter extend over most of the grid in two directions, alone or together with other walls in the same plane.
        """
        found, walls = [], self.of_role(Role.WALL)
        levels = [_level(wall, self.extent) or (number,) for number, wall in enumerate(walls)]
        for wall, level in zip(walls, levels, strict=True):
            box = np.array([other.box for other, its in zip(walls, levels, strict=True) if its == level])
            size = box[:, 1].max(axis=0) - box[:, 0].min(axis=0)
            if int((size > _MOST * self.extent).sum()) < 2:
                found.append(wall)
        return tuple(found)


def _level(surface: Surface, extent: FloatArray) -> tuple[int, float] | None:
    """Axis and coordinate of a surface that lies in a plane normal to a coordinate axis, else ``None``."""
    thin = np.flatnonzero(np.ptp(surface.box, axis=0) <= 1e-6 * extent)
    return (int(thin[0]), round(float(surface.box[0, thin[0]] / extent.max()), 6)) if len(thin) == 1 else None


def find_outside(grid: Grid, topology: Topology) -> Outside:
    """Faces, roles and surfaces of a grid; thin plates declared in the file count as outside."""
    faces = find_faces(grid, topology)
    roles = RoleGuess(grid, topology, faces).roles()
    groups: dict[tuple[str, bool], list[int]] = {}
    for number, (face, role) in enumerate(zip(faces, roles, strict=True)):
        if role is not Role.INTERFACE:
            name = (face.patch.family or face.patch.name) if face.patch else ""
            groups.setdefault((name or face.label(grid), bool(name)), []).append(number)
    surfaces = []
    for (name, named), members in groups.items():
        weight: dict[Role, float] = {}
        for n in members:
            weight[roles[n]] = weight.get(roles[n], 0.0) + faces[n].area
        role = max(weight, key=lambda each: weight[each])
        declared = any(declared_role(faces[n]) is role for n in members)
        surfaces.append(Surface(name, named, role, declared, tuple(faces[n] for n in members)))
    low, high = extent(grid.points)
    return Outside(tuple(faces), tuple(roles), tuple(surfaces), high - low)


def clustered_interfaces(topology: Topology, outside: Outside) -> list[Face]:
    """Faces between blocks towards which cells cluster from both sides: wakes and thin plates."""
    shared = [
        face
        for face, role in zip(outside.faces, outside.roles, strict=True)
        if role is Role.INTERFACE and clusters(face)
    ]
    fine = np.zeros(len(topology.partner), dtype=bool)
    for face in shared:
        fine[face.quads] = True
    return [face for face in shared if fine[topology.partner[face.quads]].all()]


def thin_direction(grid: Grid) -> FloatArray | None:
    """Unit normal of the plane of a 2-D grid, or of one layer of cells between two parallel planes; else ``None``."""
    if grid.dimension == 2:
        return plane_normal(grid)
    first: FloatArray | None = None
    for block, shape in enumerate(grid.shapes):
        if 2 not in shape:
            return None
        layer = plane_of(grid.points[side_nodes(grid, block, Side(2 * shape.index(2))).ravel()], None)
        if layer is None or (first is not None and abs(float(layer.normal @ first)) <= 1 - 1e-6):
            return None
        first = layer.normal if first is None else first
    return first
