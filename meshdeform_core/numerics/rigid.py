"""From interpolated rigid motions to the displacement of nodes.

Plain array operations, as derivatives record them (:mod:`.tape`). They take the weighted sums column by column, weight
first, and the coordinates of nodes relative to the origin that the translations refer to.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from .arrays import FloatArray
from .tape import plain

Columns = Sequence[FloatArray] | FloatArray
Triple = tuple[FloatArray, ...]
"""The three components (n,) of vectors, apart: short rows would take most of the time."""
_SMALL = 1e-2
"""Squared angle (radians) below which trigonometric functions are replaced by series."""


class Transition(NamedTuple):
    """Transition, in kind ``lie``, between the moving sources and all others, which share the twist ``rest`` (6,).

    Total weights decay like distance^-power far from the sources, and like distance^-near closer than the breadth of
    the surface, where they exceed ``crossing``. ``width`` is the length of the parabolic ends of the share relative to
    the gap, 0 without a transition; see :func:`_share`.
    """

    rest: FloatArray
    power: float
    near: float
    crossing: float
    width: float


NO_TRANSITION = Transition(np.zeros(6), 1.0, 1.0, 1.0, 0.0)
"""No transition: every source counts by its weight."""

WIDTHS = {"none": 3, "quaternion": 7, "division": 7, "blend": 12, "lie": 6}
"""Number of values per source that :func:`finish` needs for each kind."""


def finish(
    kind: str,
    sums: Columns,
    points: FloatArray,
    steps: int = 1,
    transition: Transition = NO_TRANSITION,
) -> FloatArray:
    """Displacements (n, 3) of points (n, 3) for one of the kinds of :data:`WIDTHS`.

    ``sums`` are 1 + k columns (n,), the total weight first, then the weighted sums of the values; with a transition,
    the last one is the total weight of the moving sources, and twists are relative to that of all others. A mean
    quaternion and translation are applied ``steps`` times.
    """
    x = tuple(np.ascontiguousarray(points.T))
    found: tuple[FloatArray, ...]
    # Weights of any size: what is no number is found by whoever judges the grid.
    with np.errstate(all="ignore"):
        if kind in ("quaternion", "division"):
            # Mean quaternion, normalised, and mean translation (eqs. 19, 20), applied ``steps`` times (eqs. 26-28).
            q0, q1, q2, q3 = sums[1:5]
            norm, inverse = 1.0 / np.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3), 1.0 / sums[0]
            scalar, axis, shift = q0 * norm, (q1 * norm, q2 * norm, q3 * norm), [part * inverse for part in sums[5:8]]
            d0, d1, d2 = np.zeros((3, len(x[0])))
            for _ in range(steps):
                once = _cross(axis, (x[0] + d0, x[1] + d1, x[2] + d2))
                twice = _cross(axis, once)
                d0, d1, d2 = (
                    d + 2.0 * (scalar * c + e) + t for d, c, e, t in zip((d0, d1, d2), once, twice, shift, strict=True)
                )
            found = d0, d1, d2
        elif kind == "lie":
            found = _by_twist(sums, x, transition)
        else:
            inverse, found = 1.0 / sums[0], (sums[1], sums[2], sums[3])
            if kind == "blend":
                # Mean of the predicted positions R_i (x - x_i) + y_i (Luke et al. 2012): an affine map of x.
                found = tuple(sums[d] * x[0] + sums[d + 1] * x[1] + sums[d + 2] * x[2] for d in (1, 4, 7))
                found = tuple(part + sums[10 + d] for d, part in enumerate(found))
            # Or, for ``none``, the mean displacement (eq. 14).
            found = tuple(part * inverse for part in found)
    return np.stack(found, axis=1)


def _cross(a: Triple, b: Triple) -> Triple:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def _by_twist(sums: Columns, x: Triple, transition: Transition) -> Triple:
    """Exponential of the mean twist: (R - 1) x + V v with R = exp w."""
    if transition.width > 0.0:
        moving = sums[7]
        acts = plain(moving) > 0.0
        others = np.maximum(sums[0] - moving, 0.0)
        divisor = np.where(acts, moving, 1.0)
        inverse = np.where(acts, _share(divisor, others, transition), 0.0) / divisor
    else:
        inverse = 1.0 / sums[0]
    w0, w1, w2, v0, v1, v2 = (part * inverse + transition.rest[d] for d, part in enumerate(sums[1:7]))
    w = w0, w1, w2
    angle2 = w0 * w0 + w1 * w1 + w2 * w2
    small = plain(angle2) < _SMALL
    # (1 - cos a) / a^2 and (a - sin a) / a^3.
    square = np.where(small, 1.0, angle2)
    angle = np.sqrt(square)
    half = np.sin(0.5 * angle)
    b = 2.0 * half * half / square
    c = (angle - np.sin(angle)) / (square * angle)
    if small.any():
        series = 1 / 24 - angle2 * (1 / 720 - angle2 * (1 / 40320 - angle2 * (1 / 3628800)))
        b = np.where(small, 0.5 - angle2 * series, b)
        series = 1 / 120 - angle2 * (1 / 5040 - angle2 * (1 / 362880 - angle2 * (1 / 39916800)))
        c = np.where(small, 1 / 6 - angle2 * series, c)
    # exp of a twist displaces x by V(w) (w cross x + v): the velocity at x, integrated along the screw motion.
    u0, u1, u2 = _cross(w, x)
    u = u0 + v0, u1 + v1, u2 + v2
    once = _cross(w, u)
    d0, d1, d2 = (a + b * e + c * f for a, e, f in zip(u, once, _cross(w, once), strict=True))
    return d0, d1, d2


def _share(moving: FloatArray, rest: FloatArray, transition: Transition) -> FloatArray:
    """Share (n,) of the moving sources in the motion, from their total weight and that of all other sources.

    The ratio of the distances gives the position in the gap, 0 at the moving boundary and 1 at the resting one. The
    share falls linearly across the gap, with parabolic ends of length ``width``, so that nodes at walls move rigidly.
    """
    width, felt = transition.width, plain(rest) > 0.0
    # The logarithm of the ratio of the distances: less work than powers of both weights.
    ratio = _log_closeness(np.where(felt, rest, 1.0), transition) - _log_closeness(moving, transition)
    near = (plain(ratio) < 0.0) | ~felt
    smaller = np.where(felt, np.exp(np.where(near, ratio, -ratio)), 0.0)
    end = smaller / (1.0 + smaller)
    part = np.where(plain(end) < width, end * end * (0.5 / width), end - 0.5 * width) * (1.0 / (1.0 - width))
    return np.where(near, 1.0 - part, part)


def _log_closeness(weight: FloatArray, transition: Transition) -> FloatArray:
    """Logarithm of the inverse distance, but for a constant, that corresponds to a positive total weight; see
    :class:`Transition`."""
    far: FloatArray = np.log(weight) * (1.0 / transition.power)
    if transition.near == transition.power:
        return far
    bend: FloatArray = np.log(np.hypot(1.0, weight * (1.0 / transition.crossing)))
    return far + bend * (1.0 / transition.near - 1.0 / transition.power)
