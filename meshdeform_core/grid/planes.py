"""Planes of 2-D grids and of slip and symmetry boundaries."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import GridError
from ..numerics.arrays import extent
from .blocks import FloatArray, Grid

FLATNESS = 1e-6
"""Nodes that deviate from their mean plane by less than this fraction of their extent lie in a plane."""


@dataclass(frozen=True)
class Plane:
    """A plane through ``point`` with unit ``normal``; normals along an axis are exact unit vectors."""

    point: FloatArray
    normal: FloatArray


def plane_of(points: FloatArray, plane_normal: FloatArray | None) -> Plane | None:
    """The plane that contains all ``points`` (n, 3), or ``None`` if there is none.

    In a 2-D grid (``plane_normal`` given) the "plane" is the straight line through the points.
    """
    return planes_of(points[None], plane_normal)[0]


def planes_of(points: FloatArray, plane_normal: FloatArray | None) -> list[Plane | None]:
    """:func:`plane_of` for each of several sets of equally many points (m, n, 3)."""
    center = points.mean(axis=1)
    arms = points - center[:, None]
    size = np.abs(arms).max(axis=(1, 2), initial=0.0)
    found: list[Plane | None] = [None] * len(points)
    some = np.flatnonzero(size)
    axes = _main_axes(arms[some])
    normal = axes[:, -1] if plane_normal is None else np.cross(plane_normal, axes[:, 0])
    normal = snapped(normal / np.linalg.norm(normal, axis=1, keepdims=True))
    flat = np.abs((arms[some] @ normal[..., None])[..., 0]).max(axis=1, initial=0.0) <= FLATNESS * size[some]
    for number, one in zip(some[flat].tolist(), normal[flat], strict=True):
        found[number] = Plane(center[number], one)
    return found


def _main_axes(arms: FloatArray) -> FloatArray:
    """Principal directions (m, 3, 3) of sets of points (m, n, 3), the longest extent first."""
    return np.asarray(np.linalg.svd(arms, full_matrices=False)[2])


def snapped(normal: FloatArray) -> FloatArray:
    """Unit normals (m, 3) with a positive largest component; those along an axis up to round-off become exact."""
    unit = np.eye(3)[np.argmax(np.abs(normal), axis=1)]
    positive = normal * np.sign((normal * unit).sum(axis=1, keepdims=True))
    near = np.linalg.norm(positive - unit, axis=1) < FLATNESS
    return np.asarray(np.where(near[:, None], unit, positive))


def plane_normal(grid: Grid) -> FloatArray | None:
    """Unit normal of the plane of a 2-D grid, ``None`` for a 3-D grid.

    Raises
    ------
    GridError
        When a 2-D grid is not flat.
    """
    if grid.dimension == 3:
        return None
    low, high = extent(grid.points)
    constant = np.flatnonzero(low == high)
    if constant.size == 1:
        # Nearly all 2-D grids: the singular value decomposition of all nodes takes much longer.
        return np.asarray(np.eye(3)[constant[0]])
    plane = plane_of(grid.points, None)
    if plane is None:
        raise GridError("the grid is one layer of nodes but not a plane; surface grids cannot be deformed")
    return plane.normal


def plane_axes(normal: FloatArray) -> FloatArray:
    """Two unit vectors (2, 3) that form a right-handed frame with the unit ``normal``; exact if it is an axis."""
    axis = int(np.argmax(np.abs(normal)))
    near = np.zeros(3)
    near[(axis + 1) % 3] = 1.0
    one = near - (near @ normal) * normal
    one /= np.linalg.norm(one)
    return np.stack([one, np.cross(normal, one)])
