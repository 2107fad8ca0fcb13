"""From interpolated rigid motions to the displacement of nodes, one loop per kind of rotation.

Every loop takes weighted sums (n, 1 + k), weight first, divides by the weight and writes displacements ``out`` (n, 3);
``points`` (n, 3) are relative to the origin that the translations refer to.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .arrays import FloatArray
from .jit import inlined, kernel


@kernel("f8[:, ::1], f8[:, ::1]")
def finish_displacement(sums, out):
    """Mean displacement (eq. 14)."""
    for n in range(sums.shape[0]):
        for d in range(3):
            out[n, d] = sums[n, 1 + d] / sums[n, 0]


@kernel("f8[:, ::1], f8[:, ::1], f8[:, ::1], i8")
def finish_quaternion(sums, points, out, steps):
    """Mean quaternion, normalised, and mean translation (eqs. 19, 20), applied ``steps`` times (eqs. 26-28)."""
    for n in range(sums.shape[0]):
        q0, q1, q2, q3 = sums[n, 1], sums[n, 2], sums[n, 3], sums[n, 4]
        norm = 1.0 / math.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
        q0, q1, q2, q3 = q0 * norm, q1 * norm, q2 * norm, q3 * norm
        t0, t1, t2 = sums[n, 5] / sums[n, 0], sums[n, 6] / sums[n, 0], sums[n, 7] / sums[n, 0]
        d0 = d1 = d2 = 0.0
        for _ in range(steps):
            x, y, z = points[n, 0] + d0, points[n, 1] + d1, points[n, 2] + d2
            c0, c1, c2 = q2 * z - q3 * y, q3 * x - q1 * z, q1 * y - q2 * x
            d0 += 2.0 * (q0 * c0 + q2 * c2 - q3 * c1) + t0
            d1 += 2.0 * (q0 * c1 + q3 * c0 - q1 * c2) + t1
            d2 += 2.0 * (q0 * c2 + q1 * c1 - q2 * c0) + t2
        out[n, 0], out[n, 1], out[n, 2] = d0, d1, d2


@kernel("f8[:, ::1], f8[:, ::1], f8[:, ::1]")
def finish_affine(sums, points, out):
    """Mean of the predicted positions R_i (x - x_i) + y_i (Luke et al. 2012): an affine map of x."""
    for n in range(sums.shape[0]):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        for d in range(3):
            linear = sums[n, 1 + 3 * d] * x + sums[n, 2 + 3 * d] * y + sums[n, 3 + 3 * d] * z
            out[n, d] = (linear + sums[n, 10 + d]) / sums[n, 0]


@inlined
def _closeness(weight, power, near, crossing):
    """Inverse distance, up to a factor, that corresponds to a total weight; see :class:`Transition`."""
    ratio = weight / crossing
    # The square of a large weight would overflow.
    bend = np.sqrt(1.0 + ratio * ratio) if ratio < 1e100 else ratio
    return weight ** (1.0 / power) * bend ** (1.0 / near - 1.0 / power)


@inlined
def _share(moving, rest, power, near, crossing, width):
    """Share of the moving sources in the motion, from their total weight and that of all other sources.

    The ratio of the distances gives the position in the gap, 0 at the moving boundary and 1 at the resting one. The
    share falls linearly across the gap, with parabolic ends of length ``width``, so that nodes at walls move rigidly.
    """
    to_rest, to_moving = _closeness(rest, power, near, crossing), _closeness(moving, power, near, crossing)
    end = min(to_rest, to_moving) / (to_rest + to_moving)
    part = (end * end / (2.0 * width) if end < width else end - 0.5 * width) / (1.0 - width)
    return 1.0 - part if to_rest < to_moving else part


@kernel("f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8, f8, f8, f8")
def finish_twist(sums, points, out, rest, power, near, crossing, width):
    """Exponential of the mean twist: (R - 1) x + V v with R = exp w.

    If ``width`` is not zero, the last column of ``sums`` is the total weight of the moving sources, and twists are
    relative to ``rest`` (6,), the twist of all other sources; see :class:`Transition`.
    """
    for n in range(sums.shape[0]):
        inverse = 1.0 / sums[n, 0]
        if width > 0.0:
            moving = sums[n, 7]
            others = max(sums[n, 0] - moving, 0.0)
            inverse = _share(moving, others, power, near, crossing, width) / moving if moving > 0.0 else 0.0
        w0, w1, w2 = sums[n, 1] * inverse + rest[0], sums[n, 2] * inverse + rest[1], sums[n, 3] * inverse + rest[2]
        v0, v1, v2 = sums[n, 4] * inverse + rest[3], sums[n, 5] * inverse + rest[4], sums[n, 6] * inverse + rest[5]
        angle2 = w0 * w0 + w1 * w1 + w2 * w2
        if angle2 < 1e-3:
            b = 0.5 - angle2 / 24.0 + angle2 * angle2 / 720.0 - angle2 * angle2 * angle2 / 40320.0
            c = 1.0 / 6.0 - angle2 / 120.0 + angle2 * angle2 / 5040.0 - angle2 * angle2 * angle2 / 362880.0
        else:
            angle = math.sqrt(angle2)
            half = math.sin(0.5 * angle)
            b = 2.0 * half * half / angle2
            c = (angle - math.sin(angle)) / (angle2 * angle)
        # exp of a twist displaces x by V(w) (w cross x + v): the velocity at x, integrated along the screw motion.
        u0 = w1 * points[n, 2] - w2 * points[n, 1] + v0
        u1 = w2 * points[n, 0] - w0 * points[n, 2] + v1
        u2 = w0 * points[n, 1] - w1 * points[n, 0] + v2
        e0, e1, e2 = w1 * u2 - w2 * u1, w2 * u0 - w0 * u2, w0 * u1 - w1 * u0
        out[n, 0] = u0 + b * e0 + c * (w1 * e2 - w2 * e1)
        out[n, 1] = u1 + b * e1 + c * (w2 * e0 - w0 * e2)
        out[n, 2] = u2 + b * e2 + c * (w0 * e1 - w1 * e0)


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


def finish(
    kind: str,
    sums: FloatArray,
    points: FloatArray,
    out: FloatArray,
    steps: int = 1,
    transition: Transition = NO_TRANSITION,
) -> None:
    """Write the displacement (n, 3) into ``out``, for one of the kinds ``none quaternion division blend lie``."""
    if kind == "none":
        finish_displacement(sums, out)
    elif kind in ("quaternion", "division"):
        finish_quaternion(sums, points, out, steps)
    elif kind == "blend":
        finish_affine(sums, points, out)
    else:
        finish_twist(sums, points, out, *transition)


def finish_width(kind: str) -> int:
    """Number of values per source that :func:`finish` needs for a kind."""
    return {"none": 3, "quaternion": 7, "division": 7, "blend": 12, "lie": 6}[kind]
