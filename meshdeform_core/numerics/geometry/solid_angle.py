"""Winding number of a closed surface, or of a closed line in a plane, about a point."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray

_TOGETHER = 1 << 14
Vectors = FloatArray | tuple[FloatArray, FloatArray, FloatArray]
"""Vectors as a list of their x, y and z components."""


def winding(points: FloatArray, triangles: IntArray, places: FloatArray) -> FloatArray:
    """Winding number of a closed surface about points: 1 inside, 0 outside, -1 inside if its orientation is reversed.

    Parameters
    ----------
    points : (n, 3)
    triangles : (m, 3) int64, counter-clockwise seen from outside
    places : (k, 3), not on the triangles

    Returns
    -------
    winding : (k,) solid angle (Van Oosterom & Strackee 1983) of the triangles divided by 4 pi; an integer if the
        surface is closed
    """
    result = np.empty(len(places))
    # Component by component, in chunks of places that fit into the cache.
    corners = [np.ascontiguousarray(points[triangles[:, k]].T) for k in range(3)]
    together = max(1, _TOGETHER // max(len(triangles), 1))
    for first in range(0, len(places), together):
        place = places[first : first + together].T[:, :, None]
        a, b, c = (corner[:, None] - place for corner in corners)
        la, lb, lc = (np.sqrt(_dot(x, x)) for x in (a, b, c))
        base = la * lb * lc
        for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            base += _dot(one, two) * length
        result[first : first + together] = np.arctan2(_dot(a, _cross(b, c)), base).sum(axis=1) / (2.0 * np.pi)
    return result


def _dot(a: Vectors, b: Vectors) -> FloatArray:
    """Scalar products of vectors (3, ...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Vectors, b: Vectors) -> Vectors:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def plane_winding(one: FloatArray, two: FloatArray, normal: FloatArray, places: FloatArray) -> FloatArray:
    """Winding number (k,), about ``places`` (k, 3), of the edges from ``one`` (m, 3) to ``two`` (m, 3) in a plane.

    Positive if counter-clockwise for a viewer towards whom ``normal`` (3,) points; an integer if the edges close.
    """
    a, b = one[None] - places[:, None], two[None] - places[:, None]
    angle = np.arctan2(np.cross(a, b) @ normal, np.einsum("kmi,kmi->km", a, b))
    return np.asarray(angle.sum(axis=1) / (2.0 * np.pi))
