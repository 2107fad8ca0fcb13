"""Distances of points to the faces of a surface."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray

_NEAREST = 8


def distance_to_faces(x: FloatArray, faces: FloatArray) -> FloatArray:
    """Distance (k,) of points (k, 3) to the nearest of quads (m, 4, 3), or of edges (m, 2, 3).

    Only the faces whose centres are nearest to a point are tried.
    """
    # Component by component, as sums over an axis of length three are slow.
    centers = np.ascontiguousarray(faces.mean(axis=1).T)
    count = min(_NEAREST, len(faces))
    nearest = np.empty((len(x), count), dtype=np.int64)
    for row, point in enumerate(x):
        away = centers - point[:, None]
        away *= away
        nearest[row] = np.argpartition(away[0] + away[1] + away[2], count - 1)[:count]
    some = faces[nearest]
    point = x[:, None]
    corners = [some[:, :, n] for n in range(some.shape[2])]
    found = [_to_segments(point, a, b) for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)]
    if len(corners) == 4:
        a, b, c, d = corners
        found += [_to_triangles(point, a, b, c), _to_triangles(point, a, c, d)]
    return np.asarray(np.min(found, axis=(0, 2)))


def _to_segments(x: FloatArray, a: FloatArray, b: FloatArray) -> FloatArray:
    along = b - a
    size = (along**2).sum(axis=-1)
    part = np.clip(((x - a) * along).sum(axis=-1) / np.where(size > 0, size, 1.0), 0.0, 1.0)
    return np.asarray(np.linalg.norm(x - a - part[..., None] * along, axis=-1))


def _to_triangles(x: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Distance to triangles whose interior contains the projection of the point; inf for others."""
    normal = np.cross(b - a, c - a)
    size = (normal**2).sum(axis=-1)
    inside = size > 0
    height = np.abs(((x - a) * normal).sum(axis=-1)) / np.sqrt(np.where(inside, size, 1.0))
    for p, q in ((a, b), (b, c), (c, a)):
        inside &= (np.cross(q - p, x - p) * normal).sum(axis=-1) >= 0
    return np.where(inside, height, np.inf)
