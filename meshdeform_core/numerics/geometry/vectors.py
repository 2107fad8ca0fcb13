"""Vectors in space: products, unit vectors, areas of faces, distances to faces, winding numbers of surfaces."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..arrays import FloatArray, IntArray

_NEAREST = 8
"""Faces with the nearest centres, to which the distance of a point is taken."""
_TOGETHER = 1 << 14
Vectors = FloatArray | Sequence[FloatArray]
"""Vectors as a list of their x, y and z components, or an array (3, ...): numpy is slow on axes of length 3."""


def dot(a: Vectors, b: Vectors) -> FloatArray:
    """Scalar products of vectors by components."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def cross(a: Vectors, b: Vectors) -> FloatArray:
    """Cross products (3, ...) of vectors by components."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors (..., m) scaled to length 1; zero ones stay."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(size > 0.0, size, 1.0))


def doubled_areas(corners: FloatArray) -> FloatArray:
    """Twice the area vectors (n, 3) of quads (n, 4, 3): the products of their diagonals."""
    found: FloatArray = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return found


def face_sizes(corners: FloatArray) -> FloatArray:
    """Areas (n,) of quads (n, 4, 3), or lengths of edges (n, 2, 3)."""
    if corners.shape[1] == 2:
        length: FloatArray = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        return length
    area: FloatArray = 0.5 * np.linalg.norm(doubled_areas(corners), axis=1)
    return area


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
    return np.asarray(distances(x[:, None], np.moveaxis(faces[nearest], 2, 0)).min(axis=1))


def distances(x: FloatArray, corners: FloatArray) -> FloatArray:
    """Distances (...) of points (..., 3) from quads, each divided into two triangles, or edges with ``corners``
    (4 or 2, ..., 3)."""
    found = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        along = b - a
        size = (along**2).sum(axis=-1)
        part = np.clip(((x - a) * along).sum(axis=-1) / np.where(size > 0, size, 1.0), 0.0, 1.0)
        found.append(np.linalg.norm(x - a - part[..., None] * along, axis=-1))
    if len(corners) == 4:
        a, b, c, d = corners
        found += [_to_triangles(x, a, b, c), _to_triangles(x, a, c, d)]
    return np.asarray(np.min(found, axis=0))


def _to_triangles(x: FloatArray, a: FloatArray, b: FloatArray, c: FloatArray) -> FloatArray:
    """Distance to triangles whose interior contains the projection of the point; inf for others."""
    normal = np.cross(b - a, c - a)
    size = (normal**2).sum(axis=-1)
    inside = size > 0
    height = np.abs(((x - a) * normal).sum(axis=-1)) / np.sqrt(np.where(inside, size, 1.0))
    for p, q in ((a, b), (b, c), (c, a)):
        inside = inside & ((np.cross(q - p, x - p) * normal).sum(axis=-1) >= 0)
    return np.where(inside, height, np.inf)


def winding(points: FloatArray, triangles: IntArray, places: FloatArray) -> FloatArray:
    """Winding number (k,) of a closed surface about ``places`` (k, 3) that are not on it: 1 inside, 0 outside, -1
    inside if its orientation is reversed.

    The solid angle (Van Oosterom & Strackee 1983) of the triangles (m, 3) of ``points`` (n, 3), counter-clockwise seen
    from outside, divided by 4 pi: an integer if the surface is closed.
    """
    result = np.empty(len(places))
    # Component by component, in chunks of places that fit into the cache.
    corners = [np.ascontiguousarray(points[triangles[:, k]].T) for k in range(3)]
    together = max(1, _TOGETHER // max(len(triangles), 1))
    for first in range(0, len(places), together):
        place = places[first : first + together].T[:, :, None]
        a, b, c = (corner[:, None] - place for corner in corners)
        la, lb, lc = (np.sqrt(dot(x, x)) for x in (a, b, c))
        base = la * lb * lc
        for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            base += dot(one, two) * length
        result[first : first + together] = np.arctan2(dot(a, cross(b, c)), base).sum(axis=1) / (2.0 * np.pi)
    return result


def plane_winding(one: FloatArray, two: FloatArray, normal: FloatArray, places: FloatArray) -> FloatArray:
    """Winding number (k,), about ``places`` (k, 3), of the edges from ``one`` (m, 3) to ``two`` (m, 3) in a plane.

    Positive if counter-clockwise for a viewer towards whom ``normal`` (3,) points; an integer if the edges close.
    """
    a, b = one[None] - places[:, None], two[None] - places[:, None]
    angle = np.arctan2(np.cross(a, b) @ normal, np.einsum("kmi,kmi->km", a, b))
    return np.asarray(angle.sum(axis=1) / (2.0 * np.pi))
