"""Views and cuts of the walls of a grid for pictures."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.grid.faces.roles import Role
from meshdeform_core.grid.faces.surfaces import Surface
from meshdeform_core.grid.planes import Plane
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.numerics.geometry.vectors import doubled_areas

from ..view import View, towards
from .subject import Subject


def body_walls(subject: Subject) -> tuple[Surface, ...]:
    """Walls of bodies in the grid, and likely thin plates."""
    return subject.outside.bodies + subject.outside.plates


def all_walls(subject: Subject) -> tuple[Surface, ...]:
    """All walls, and likely thin plates."""
    return subject.outside.of_role(Role.WALL) + subject.outside.plates


def quads_of(surfaces: Iterable[Surface]) -> IntArray:
    """The face quads (n,) of surfaces."""
    return np.concatenate([np.empty(0, dtype=np.int64), *(surface.quads for surface in surfaces)])


def corners_of(subject: Subject, surfaces: Iterable[Surface]) -> FloatArray:
    """The corners (n, m, 3) of the face quads of surfaces; in 2-D the ends (n, 2, 3) of edges."""
    nodes = subject.topology.quads.corners[quads_of(surfaces)]
    return np.asarray(subject.grid.points[subject.topology.first[nodes]])


def nodes_of(subject: Subject, surfaces: Iterable[Surface]) -> FloatArray:
    """The nodes (n, 3) of surfaces, each once."""
    nodes = np.unique(subject.topology.quads.corners[quads_of(surfaces)])
    return np.asarray(subject.grid.points[subject.topology.first[nodes]])


def onto_walls(subject: Subject) -> View:
    """An isometric view onto the walls, with symmetry planes behind them."""
    direction = np.array([0.8, -1.0, 0.7])
    walls = body_walls(subject)
    middle = _box_of(walls).mean(axis=0) if walls else None
    for surface in subject.outside.of_role(Role.SYMMETRY, Role.END, Role.WALL):
        if surface in walls:
            continue
        outward = _outward(subject, surface)
        beyond = middle is not None and (middle - surface.box.mean(axis=0)) @ outward > 0
        if (direction @ outward > 0) != beyond:
            direction = direction - 2 * (direction @ outward) * outward
    return towards(direction)


def _outward(subject: Subject, surface: Surface) -> FloatArray:
    """Mean unit normal out of the grid."""
    total = doubled_areas(corners_of(subject, [surface])).sum(axis=0)
    length = float(np.linalg.norm(total))
    return np.asarray(total / length) if length > 0 else np.zeros(3)


def _box_of(walls: Sequence[Surface]) -> FloatArray:
    boxes = np.array([wall.box for wall in walls])
    return np.stack([boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)])


def cut_plane(subject: Subject, walls: Sequence[Surface]) -> Plane:
    """A plane through the middle of the walls, parallel to a symmetry plane or else across their longest extent."""
    box = _box_of(walls)
    normal = np.zeros(3)
    mirrors = subject.outside.of_role(Role.SYMMETRY)
    if mirrors:
        normal[int(np.argmax(np.abs(_outward(subject, mirrors[0]))))] = 1.0
    else:
        normal[int(np.argmax(box[1] - box[0]))] = 1.0
    return Plane(box.mean(axis=0), normal)


def middle_plane(subject: Subject) -> Plane:
    """A plane through the middle of the bodies, or else of the grid, across the shortest extent."""
    walls = body_walls(subject)
    if walls:
        return cut_plane(subject, walls)
    low, high = extent(subject.grid.points)
    return Plane(0.5 * (low + high), np.eye(3)[int(np.argmin(high - low))])
