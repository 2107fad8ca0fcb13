"""The plane that represents a whole grid: a plane grid itself, or an end of an extruded one."""

from __future__ import annotations

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.faces.pieces import Face
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface

from ..view import View, facing
from .facets import Facets, block_outlines, plane_facets, plane_outlines, surface_facets
from .subject import Subject


def plane_of_grid(subject: Subject, metric: str) -> tuple[Facets, FloatArray, View] | None:
    """Polygons, block outlines and view of a plane that represents the whole grid."""
    grid = subject.grid
    if grid.dimension == 2:
        assert subject.thin is not None
        return plane_facets(subject, 2, None, metric), plane_outlines(subject, 2, None), facing(subject.thin)
    sides = _end_plane(subject)
    if sides is None:
        return None
    quads, normal = sides
    facets = surface_facets(subject, quads, metric)
    return facets, block_outlines(grid, subject.topology, quads), facing(normal)


def is_flat(subject: Subject) -> bool:
    """Whether a plane represents the whole grid."""
    return subject.grid.dimension == 2 or _end_plane(subject) is not None


def _end_plane(subject: Subject) -> tuple[IntArray, FloatArray] | None:
    """Face quads and normal of one of the two end planes of an extruded grid."""
    found = subject.outside
    ends = [face for face, role in zip(found.faces, found.roles, strict=True) if role is Role.END]
    thin = subject.thin
    if not ends and thin is not None:
        ends = [f for f in found.faces if f.outside and f.plane is not None and abs(f.plane.normal @ thin) > 1 - 1e-6]
    if not ends or ends[0].plane is None:
        ends = _declared_ends(subject)
    if not ends or ends[0].plane is None:
        return None
    normal = ends[0].plane.normal
    if not all(_upright(subject, plate, normal) for plate in subject.outside.plates):
        return None
    height = [float(face.plane.point @ normal) if face.plane is not None else np.inf for face in ends]
    low = min(height)
    chosen = [f for f, h in zip(ends, height, strict=True) if h - low <= 1e-6 * subject.size]
    return np.concatenate([face.quads for face in chosen]), normal


def _declared_ends(subject: Subject) -> list[Face]:
    """Faces in two parallel symmetry planes between which all walls stand upright."""
    found = subject.outside
    planes = [f for f, role in zip(found.faces, found.roles, strict=True) if role is Role.SYMMETRY and f.plane]
    normals: list[FloatArray] = []
    for face in planes:
        assert face.plane is not None
        normal = face.plane.normal
        # The faces of many blocks lie in the same few planes.
        if any(abs(tried @ normal) > 1 - 1e-12 for tried in normals):
            continue
        normals.append(normal)
        same = [f for f in planes if f.plane is not None and abs(f.plane.normal @ normal) > 1 - 1e-6]
        heights = [float(f.plane.point @ normal) for f in same if f.plane is not None]
        low, high = subject.reach(normal)
        reach = 1e-6 * subject.size
        both = min(heights) <= low + reach and max(heights) >= high - reach
        walls = [f for f, role in zip(found.faces, found.roles, strict=True) if role is Role.WALL]
        upright = all(_upright(subject, face, normal) for face in walls)
        if both and upright and walls and np.ptp(heights) > reach:
            return same
    return []


def _upright(subject: Subject, wall: Face | Surface, normal: FloatArray) -> bool:
    """Whether a wall reaches through the whole grid along a direction."""
    low, high = subject.reach(normal)
    return bool(np.ptp(wall.box, axis=0) @ np.abs(normal) >= 0.99 * (high - low))
