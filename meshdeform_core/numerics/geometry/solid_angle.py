"""Winding number of a closed surface, or of a closed line in a plane, about a point."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray

_TOGETHER = 1 << 14
Vectors = FloatArray | tuple[FloatArray, FloatArray, FloatArray]
"""Component by component."""


def winding(points: FloatArray, triangles: IntArray, places: FloatArray) -> FloatArray:
    """Winding number of a closed surface about points: 1 inside, 0 outside, -1 inside if its orientation is reversed.

    Parameters
    ----------
    points : (n, 3); ``triangles`` (m, 3) int64, counter-clockwise seen from outside; ``places`` (k, 3), not on them

    Returns
    -------
    winding : (k,) the solid angle (Van Oosterom & Strackee 1983) of the triangles as a part of the whole sphere; a
        whole number if the surface is closed
    """
    result = np.empty(len(places))
    # Component by component, and for as many places at a time as stay in the cache.
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
    """Products of vectors (3, ...)."""
    return np.asarray(a[0] * b[0] + a[1] * b[1] + a[2] * b[2])


def _cross(a: Vectors, b: Vectors) -> Vectors:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def plane_winding(one: FloatArray, two: FloatArray, normal: FloatArray, places: FloatArray) -> FloatArray:
    """How often the edges from ``one`` (m, 3) to ``two`` (m, 3) of a plane go round ``places`` (k, 3).

    Counter-clockwise seen against ``normal`` (3,); a whole number if they close.
    """
    a, b = one[None] - places[:, None], two[None] - places[:, None]
    angle = np.arctan2(np.cross(a, b) @ normal, np.einsum("kmi,kmi->km", a, b))
    return np.asarray(angle.sum(axis=1) / (2.0 * np.pi))
