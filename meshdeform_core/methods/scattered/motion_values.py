"""The quantities that IDW averages: rigid motions of the sources, represented as in :mod:`..numerics.rigid`."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray
from ...numerics.geometry import quaternions as rot
from ...numerics.tape import Tracked

_TOGETHER = 100_000
"""Sources whose motions are computed at a time, which bounds the memory."""


def motion_values(
    rotation: str, divisions: int, x: FloatArray, d: FloatArray, q: FloatArray, w: FloatArray
) -> FloatArray:
    """The quantities to average, (k, n), for sources at ``x`` with displacements ``d``.

    ``q`` (n, 4) and ``w`` (n, 3) are their rotations as quaternions and as vectors.
    """
    if rotation == "none":
        return d.T.copy()
    if isinstance(d, Tracked) or len(x) <= _TOGETHER:
        return _values(rotation, divisions, x, d, q, w)
    some = [slice(lo, lo + _TOGETHER) for lo in range(0, len(x), _TOGETHER)]
    first = _values(rotation, divisions, x[some[0]], d[some[0]], q[some[0]], w[some[0]])
    found = np.empty((len(first), len(x)))
    found[:, some[0]] = first
    for rows in some[1:]:
        found[:, rows] = _values(rotation, divisions, x[rows], d[rows], q[rows], w[rows])
    return found


def _values(rotation: str, divisions: int, x: FloatArray, d: FloatArray, q: FloatArray, w: FloatArray) -> FloatArray:
    turned = rot.rotate(q, x) - x
    translation = d - turned
    if rotation == "lie":
        return np.concatenate([w.T, rot.twist_velocity(w, translation).T])
    if rotation == "blend":
        columns = [rot.rotate(q, np.tile(e, (len(x), 1))) - e for e in np.eye(3)]
        return np.concatenate([np.stack(columns, axis=2).reshape(len(x), 9).T, translation.T])
    if rotation == "division":
        part = rot.quaternion_of(w / divisions)
        return np.concatenate([part.T, _divided_translation(w, translation, divisions).T])
    return np.concatenate([q.T, translation.T])


def _divided_translation(w: FloatArray, translation: FloatArray, m: int) -> FloatArray:
    """T_m = M^-1 T of eq. 27; each of ``m`` equal steps of a screw motion has the twist (w, v) / m."""
    v = rot.twist_velocity(w, translation)
    return rot.translation_of_twist(w / m, v / m)
