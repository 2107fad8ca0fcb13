"""How often a closed surface, or a closed line in a plane, goes round a point."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray


def winding(points: FloatArray, triangles: IntArray, places: FloatArray) -> FloatArray:
    """How often a closed surface goes round points: 1 inside, 0 outside; turned round it counts negative.

    Parameters
    ----------
    points : (n, 3); ``triangles`` (m, 3) int64, counter-clockwise seen from outside; ``places`` (k, 3), not on them

    Returns
    -------
    winding : (k,) the solid angle (Van Oosterom & Strackee 1983) of the triangles as a part of the whole sphere; a
        whole number if the surface is closed
    """
    result = np.empty(len(places))
    for index, place in enumerate(places):
        a, b, c = (points[triangles[:, k]] - place for k in range(3))
        la, lb, lc = (np.sqrt(np.einsum("ki,ki->k", x, x)) for x in (a, b, c))
        volume = np.einsum("ki,ki->k", a, np.cross(b, c))
        base = la * lb * lc
        for one, two, length in ((a, b, lc), (b, c, la), (c, a, lb)):
            base += np.einsum("ki,ki->k", one, two) * length
        result[index] = np.arctan2(volume, base).sum() / (2.0 * np.pi)
    return result


def plane_winding(one: FloatArray, two: FloatArray, normal: FloatArray, places: FloatArray) -> FloatArray:
    """How often the edges from ``one`` (m, 3) to ``two`` (m, 3) of a plane go round ``places`` (k, 3).

    Counter-clockwise seen against ``normal`` (3,); a whole number if they close.
    """
    a, b = one[None] - places[:, None], two[None] - places[:, None]
    angle = np.arctan2(np.cross(a, b) @ normal, np.einsum("kmi,kmi->km", a, b))
    return np.asarray(angle.sum(axis=1) / (2.0 * np.pi))
