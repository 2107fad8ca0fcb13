"""Unit quaternions, rotation vectors, and logarithms of rigid motions in SE(3).

Rotation vectors are (n, 3) in radians, unit quaternions (n, 4) scalar first, translations (n, 3).
"""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


def multiply(p: FloatArray, q: FloatArray) -> FloatArray:
    """Quaternion product: rotation ``q`` followed by ``p``; the scalar part is made non-negative (angle at most pi)."""
    scalar = p[:, 0] * q[:, 0] - dot(p[:, 1:], q[:, 1:])
    vector = p[:, :1] * q[:, 1:] + q[:, :1] * p[:, 1:] + np.cross(p[:, 1:], q[:, 1:])
    return np.concatenate([scalar[:, None], vector], axis=1) * np.where(scalar < 0, -1.0, 1.0)[:, None]


def rotate(q: FloatArray, v: FloatArray) -> FloatArray:
    """Vectors (n, 3) turned by quaternions (n, 4)."""
    lift = np.cross(q[:, 1:], v)
    return v + 2 * (q[:, :1] * lift + np.cross(q[:, 1:], lift))


def rotation_vector(q: FloatArray) -> FloatArray:
    """Axis times angle (radians; at most pi where the scalar part is not negative) of unit quaternions (n, 4)."""
    sine2, scalar = dot(q[:, 1:], q[:, 1:]), q[:, 0]
    small = (sine2 < 1e-4) & (scalar > 0.0)
    sine = np.sqrt(np.where(small, 1.0, sine2))
    # angle / sine = 2 atan(t) / (t q0) for t = sine / q0, smooth at zero.
    safe = np.where(small, scalar, 1.0)
    t2 = np.where(small, sine2, 0.0) / (safe * safe)
    series = 2.0 * (1.0 - t2 * (1 / 3 - t2 * (1 / 5 - t2 * (1 / 7 - t2 / 9)))) / safe
    ratio = np.where(small, series, 2 * np.arctan2(sine, scalar) / sine)
    return q[:, 1:] * ratio[:, None]


def quaternion_of(w: FloatArray) -> FloatArray:
    """Unit quaternions of rotation vectors (n, 3)."""
    # (1 - cos x) / x^2 and sin(x) / x are smooth at zero, with x half the angle.
    half = 0.5 * w
    sinc, versine, _ = _coefficients(half)
    scalar = 1.0 - versine * dot(half, half)
    return np.concatenate([scalar[:, None], sinc[:, None] * half], axis=1)


def translation_of_twist(w: FloatArray, v: FloatArray) -> FloatArray:
    """V(w) v: the translation of the rigid motion exp(w, v)."""
    _, b, c = _coefficients(w)
    cross = np.cross(w, v)
    return v + b[:, None] * cross + c[:, None] * np.cross(w, cross)


def twist_velocity(w: FloatArray, t: FloatArray) -> FloatArray:
    """Inverse of V(w) applied to translations: the v of log (R, t)."""
    a, b, _ = _coefficients(w)
    angle2 = dot(w, w)
    # (1 - a / (2 b)) / angle^2 with a = sin(x)/x, b = (1 - cos x)/x^2; 1/12 in the limit.
    small = angle2 < 1e-3
    safe = np.where(small, 1.0, angle2)
    series = 1 / 12 + angle2 / 720 + angle2**2 / 30240
    factor = np.where(small, series, (1 - a / (2 * np.where(small, 0.5, b))) / safe)
    cross = np.cross(w, t)
    return t - 0.5 * cross + factor[:, None] * np.cross(w, cross)


def _coefficients(w: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """sin(x)/x, (1 - cos x)/x^2 and (x - sin x)/x^3 for x = |w|."""
    x2 = dot(w, w)
    x = np.sqrt(x2)
    small = x2 < 1e-3
    safe = np.where(small, 1.0, x)
    half = np.sin(safe / 2) / safe
    a = np.where(small, 1 - x2 / 6 + x2**2 / 120 - x2**3 / 5040, np.sin(safe) / safe)
    b = np.where(small, 0.5 - x2 / 24 + x2**2 / 720 - x2**3 / 40320, 2 * half**2)
    c = np.where(small, 1 / 6 - x2 / 120 + x2**2 / 5040 - x2**3 / 362880, (safe - np.sin(safe)) / safe**3)
    return a, b, c


def dot(u: FloatArray, v: FloatArray) -> FloatArray:
    """Scalar products (n,) of vectors (n, k)."""
    return np.einsum("ni,ni->n", u, v)
