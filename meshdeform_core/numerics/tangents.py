"""Derivatives of the loops of :mod:`.rigid`: of the displacement of a node with respect to its weighted sums.

For each kind of rotation, one function returns the change of a node's displacement for a change of its sums; the
transpose applies the same function to every unit change.
"""

from __future__ import annotations

import math

import numpy as np

from .arrays import FloatArray
from .jit import inlined, kernel
from .rigid import Transition

_KINDS = {"none": 0, "quaternion": 1, "division": 1, "blend": 2, "lie": 3}


@inlined
def _mean(sums, change, n, c, inverse):
    """Change of ``sums[n, c] / sums[n, 0]``."""
    return (change[c] - sums[n, c] * inverse * change[0]) * inverse


@inlined
def _of_quaternion(sums, n, points, change, steps, out):
    q0, q1, q2, q3 = sums[n, 1], sums[n, 2], sums[n, 3], sums[n, 4]
    scale = 1.0 / math.sqrt(q0 * q0 + q1 * q1 + q2 * q2 + q3 * q3)
    q0, q1, q2, q3 = q0 * scale, q1 * scale, q2 * scale, q3 * scale
    a0, a1, a2, a3 = change[1] * scale, change[2] * scale, change[3] * scale, change[4] * scale
    along = q0 * a0 + q1 * a1 + q2 * a2 + q3 * a3
    a0, a1, a2, a3 = a0 - along * q0, a1 - along * q1, a2 - along * q2, a3 - along * q3
    inverse = 1.0 / sums[n, 0]
    t0, t1, t2 = sums[n, 5] * inverse, sums[n, 6] * inverse, sums[n, 7] * inverse
    s0, s1, s2 = (
        _mean(sums, change, n, 5, inverse), _mean(sums, change, n, 6, inverse), _mean(sums, change, n, 7, inverse)
    )  # fmt: skip
    d0 = d1 = d2 = e0 = e1 = e2 = 0.0
    for _ in range(steps):
        x, y, z = points[n, 0] + d0, points[n, 1] + d1, points[n, 2] + d2
        c0, c1, c2 = q2 * z - q3 * y, q3 * x - q1 * z, q1 * y - q2 * x
        b0 = a2 * z - a3 * y + q2 * e2 - q3 * e1
        b1 = a3 * x - a1 * z + q3 * e0 - q1 * e2
        b2 = a1 * y - a2 * x + q1 * e1 - q2 * e0
        d0 += 2.0 * (q0 * c0 + q2 * c2 - q3 * c1) + t0
        d1 += 2.0 * (q0 * c1 + q3 * c0 - q1 * c2) + t1
        d2 += 2.0 * (q0 * c2 + q1 * c1 - q2 * c0) + t2
        e0 += 2.0 * (a0 * c0 + a2 * c2 - a3 * c1 + q0 * b0 + q2 * b2 - q3 * b1) + s0
        e1 += 2.0 * (a0 * c1 + a3 * c0 - a1 * c2 + q0 * b1 + q3 * b0 - q1 * b2) + s1
        e2 += 2.0 * (a0 * c2 + a1 * c1 - a2 * c0 + q0 * b2 + q1 * b1 - q2 * b0) + s2
    out[0], out[1], out[2] = e0, e1, e2


@inlined
def _of_affine(sums, n, points, change, out):
    inverse = 1.0 / sums[n, 0]
    for d in range(3):
        total = _mean(sums, change, n, 10 + d, inverse)
        for e in range(3):
            total += _mean(sums, change, n, 1 + 3 * d + e, inverse) * points[n, e]
        out[d] = total


@inlined
def _closeness(weight, power, near, crossing):
    """:func:`.rigid._closeness` and its relative change for a relative change of the weight."""
    ratio = weight / crossing
    bend = math.sqrt(1.0 + ratio * ratio) if ratio < 1e100 else ratio
    value = weight ** (1.0 / power) * bend ** (1.0 / near - 1.0 / power)
    part = ratio * ratio / (1.0 + ratio * ratio) if ratio < 1e100 else 1.0
    return value, 1.0 / power + (1.0 / near - 1.0 / power) * part


@inlined
def _inverse(sums, n, change, power, near, crossing, width):
    """The factor by which sums are multiplied to give mean twists, and its change."""
    if width == 0.0:
        inverse = 1.0 / sums[n, 0]
        return inverse, -inverse * inverse * change[0]
    moving = sums[n, 7]
    rest = max(sums[n, 0] - moving, 0.0)
    if moving <= 0.0:
        return 0.0, 0.0
    if rest == 0.0:
        return 1.0 / moving, -change[7] / (moving * moving)
    a, slope_a = _closeness(rest, power, near, crossing)
    b, slope_b = _closeness(moving, power, near, crossing)
    da, db = a * slope_a * (change[0] - change[7]) / rest, b * slope_b * change[7] / moving
    end = min(a, b) / (a + b)
    if a < b:
        d_end = (da * b - a * db) / ((a + b) * (a + b))
    else:
        d_end = (db * a - b * da) / ((a + b) * (a + b))
    if end < width:
        part, d_part = end * end / (2.0 * width) / (1.0 - width), end / width * d_end / (1.0 - width)
    else:
        part, d_part = (end - 0.5 * width) / (1.0 - width), d_end / (1.0 - width)
    share, d_share = (1.0 - part, -d_part) if a < b else (part, d_part)
    return share / moving, (d_share - share * change[7] / moving) / moving


@inlined
def _twist(sums, n, inverse, rest, twist):
    """Store the mean ``twist`` (6,) of a node; with x the length of its rotation vector, return (1 - cos x) / x^2,
    (x - sin x) / x^3 and their derivatives with respect to x^2."""
    for d in range(6):
        twist[d] = sums[n, 1 + d] * inverse + rest[d]
    angle2 = twist[0] * twist[0] + twist[1] * twist[1] + twist[2] * twist[2]
    if angle2 < 1e-2:
        b = 0.5 - angle2 * (1.0 / 24.0 - angle2 * (1.0 / 720.0 - angle2 * (1.0 / 40320.0 - angle2 / 3628800.0)))
        c = 1.0 / 6.0 - angle2 * (
            1.0 / 120.0 - angle2 * (1.0 / 5040.0 - angle2 * (1.0 / 362880.0 - angle2 / 39916800.0))
        )
        db = -1.0 / 24.0 + angle2 * (1.0 / 360.0 - angle2 * (1.0 / 13440.0 - angle2 / 907200.0))
        dc = -1.0 / 120.0 + angle2 * (1.0 / 2520.0 - angle2 * (1.0 / 120960.0 - angle2 / 9979200.0))
    else:
        angle = math.sqrt(angle2)
        half = math.sin(0.5 * angle)
        b = 2.0 * half * half / angle2
        c = (angle - math.sin(angle)) / (angle2 * angle)
        db = (math.sin(angle) / angle - 2.0 * b) / (2.0 * angle2)
        dc = (b - 3.0 * c) / (2.0 * angle2)
    return b, c, db, dc


@inlined
def _along_twist(twist, d_twist, points, n, b, c, db, dc, out):
    """Change of the displacement of a node for a change ``d_twist`` (6,) of its mean twist."""
    w0, w1, w2, v0, v1, v2 = twist[0], twist[1], twist[2], twist[3], twist[4], twist[5]
    a0, a1, a2, b0, b1, b2 = d_twist[0], d_twist[1], d_twist[2], d_twist[3], d_twist[4], d_twist[5]
    turn = 2.0 * (w0 * a0 + w1 * a1 + w2 * a2)
    db, dc = db * turn, dc * turn
    x, y, z = points[n, 0], points[n, 1], points[n, 2]
    u0, u1, u2 = w1 * z - w2 * y + v0, w2 * x - w0 * z + v1, w0 * y - w1 * x + v2
    p0, p1, p2 = a1 * z - a2 * y + b0, a2 * x - a0 * z + b1, a0 * y - a1 * x + b2
    e0, e1, e2 = w1 * u2 - w2 * u1, w2 * u0 - w0 * u2, w0 * u1 - w1 * u0
    f0 = a1 * u2 - a2 * u1 + w1 * p2 - w2 * p1
    f1 = a2 * u0 - a0 * u2 + w2 * p0 - w0 * p2
    f2 = a0 * u1 - a1 * u0 + w0 * p1 - w1 * p0
    out[0] = p0 + db * e0 + b * f0 + dc * (w1 * e2 - w2 * e1) + c * (a1 * e2 - a2 * e1 + w1 * f2 - w2 * f1)
    out[1] = p1 + db * e1 + b * f1 + dc * (w2 * e0 - w0 * e2) + c * (a2 * e0 - a0 * e2 + w2 * f0 - w0 * f2)
    out[2] = p2 + db * e2 + b * f2 + dc * (w0 * e1 - w1 * e0) + c * (a0 * e1 - a1 * e0 + w0 * f1 - w1 * f0)


@inlined
def _of_twist(sums, n, points, change, d_rest, rest, power, near, crossing, width, twist, d_twist, out):
    inverse, d_inverse = _inverse(sums, n, change, power, near, crossing, width)
    b, c, db, dc = _twist(sums, n, inverse, rest, twist)
    for d in range(6):
        d_twist[d] = change[1 + d] * inverse + sums[n, 1 + d] * d_inverse + d_rest[d]
    _along_twist(twist, d_twist, points, n, b, c, db, dc, out)


@inlined
def _of_node(kind, sums, n, points, change, steps, out):
    if kind == 0:
        inverse = 1.0 / sums[n, 0]
        for d in range(3):
            out[d] = _mean(sums, change, n, 1 + d, inverse)
    elif kind == 1:
        _of_quaternion(sums, n, points, change, steps, out)
    else:
        _of_affine(sums, n, points, change, out)


@kernel("i8, f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8[::1], f8[::1], f8, f8, f8, f8, f8[:, ::1]")
def _tangents(kind, sums, points, changes, steps, d_rest, rest, power, near, crossing, width, out):
    twist, d_twist = np.empty(6), np.empty(6)
    for n in range(sums.shape[0]):
        if kind == 3:
            _of_twist(
                sums, n, points, changes[n], d_rest, rest, power, near, crossing, width, twist, d_twist, out[n]
            )  # fmt: skip
        else:
            _of_node(kind, sums, n, points, changes[n], steps, out[n])


@kernel("i8, f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, f8[:, ::1]")
def _gradients(kind, sums, points, gradient, steps, out):
    columns = sums.shape[1]
    change, moved = np.zeros(columns), np.empty(3)
    for n in range(sums.shape[0]):
        for c in range(columns):
            change[c] = 1.0
            _of_node(kind, sums, n, points, change, steps, moved)
            out[n, c] = moved[0] * gradient[n, 0] + moved[1] * gradient[n, 1] + moved[2] * gradient[n, 2]
            change[c] = 0.0


@kernel("f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], f8, f8, f8, f8, f8[:, ::1], f8[::1]")
def _twist_gradients(sums, points, gradient, rest, power, near, crossing, width, out, g_rest):
    columns = sums.shape[1]
    change, twist, unit, moved = np.zeros(columns), np.empty(6), np.zeros(6), np.empty(3)
    for n in range(sums.shape[0]):
        change[0] = 1.0
        inverse, of_total = _inverse(sums, n, change, power, near, crossing, width)
        b, c, db, dc = _twist(sums, n, inverse, rest, twist)
        along = 0.0
        for d in range(6):
            unit[d] = 1.0
            _along_twist(twist, unit, points, n, b, c, db, dc, moved)
            unit[d] = 0.0
            found = moved[0] * gradient[n, 0] + moved[1] * gradient[n, 1] + moved[2] * gradient[n, 2]
            out[n, 1 + d] = found * inverse
            g_rest[d] += found
            along += found * sums[n, 1 + d]
        out[n, 0] = along * of_total
        change[0] = 0.0
        if columns == 8:
            change[7] = 1.0
            _, of_moving = _inverse(sums, n, change, power, near, crossing, width)
            out[n, 7] = along * of_moving
            change[7] = 0.0


def finish_tangents(
    kind: str,
    sums: FloatArray,
    points: FloatArray,
    changes: FloatArray,
    steps: int,
    transition: Transition,
    rest_change: FloatArray,
) -> FloatArray:
    """Change (n, 3) of the result of :func:`.rigid.finish`, for ``changes`` (n, 1 + k) of the sums and ``rest_change``
    (6,) of the twist at rest."""
    out = np.empty((len(sums), 3))
    _tangents(_KINDS[kind], sums, points, changes, steps, rest_change, *transition, out)
    return out


def finish_gradients(
    kind: str, sums: FloatArray, points: FloatArray, gradient: FloatArray, steps: int, transition: Transition
) -> tuple[FloatArray, FloatArray]:
    """Transpose of :func:`finish_tangents`: gradients (n, 1 + k) of the sums and (6,) of the twist at rest, from the
    ``gradient`` (n, 3) of the displacement."""
    out, rest = np.empty_like(sums), np.zeros(6)
    if kind == "lie":
        _twist_gradients(sums, points, np.ascontiguousarray(gradient), *transition, out, rest)
    else:
        _gradients(_KINDS[kind], sums, points, np.ascontiguousarray(gradient), steps, out)
    return out, rest
