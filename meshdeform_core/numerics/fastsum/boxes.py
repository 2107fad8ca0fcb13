"""Boxes along principal axes with interpolation points inside: the clusters of fast summation."""

import math

import numpy as np

from ..jit import inlined, kernel

# Ratio of distance to half width for which the number of points along a box's longest side is meant.
_REFERENCE_RATIO = 5.0


@inlined
def _principal_axes(points, members, lo, hi, center, axes, b, a, v):
    """Mean and principal axes (rows, longest first) of ``points[members[lo:hi]]``, by Jacobi rotations.

    Into row ``b`` of ``center`` and ``axes``; ``a`` and ``v`` (3, 3) are used for the covariance and its axes.
    """
    for d in range(3):
        center[b, d] = 0.0
        for e in range(3):
            a[d, e], v[d, e] = 0.0, 1.0 if d == e else 0.0
    for i in range(lo, hi):
        for d in range(3):
            center[b, d] += points[members[i], d] / (hi - lo)
    for i in range(lo, hi):
        for d in range(3):
            for e in range(d, 3):
                a[d, e] += (points[members[i], d] - center[b, d]) * (points[members[i], e] - center[b, e])
    for turn in range(36):
        # Pairs 0 1, 0 2, 1 2 in turn.
        p, q = turn % 3 // 2, 1 + (turn % 3 + 1) // 2
        if abs(a[p, q]) > 1e-15 * (abs(a[p, p]) + abs(a[q, q])):
            _rotate_pair(a, v, p, q)
    first = 0 if a[0, 0] >= a[1, 1] and a[0, 0] >= a[2, 2] else 1 if a[1, 1] >= a[2, 2] else 2
    last = 2 if a[2, 2] <= a[0, 0] and a[2, 2] <= a[1, 1] else 1 if a[1, 1] <= a[0, 0] else 0
    if first == last:
        first, last = 0, 2
    for d in range(3):
        axes[b, 0, d], axes[b, 1, d], axes[b, 2, d] = v[d, first], v[d, 3 - first - last], v[d, last]


@inlined
def _rotate_pair(a, v, p, q):
    """One Jacobi rotation of the upper triangle ``a`` (3, 3), accumulated in ``v``."""
    theta = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
    t = (1.0 if theta >= 0.0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    a[p, p], a[q, q], a[p, q] = a[p, p] - t * a[p, q], a[q, q] + t * a[p, q], 0.0
    r = 3 - p - q
    pr, rp, qr, rq = min(p, r), max(p, r), min(q, r), max(q, r)
    x, y = a[pr, rp], a[qr, rq]
    a[pr, rp], a[qr, rq] = c * x - s * y, s * x + c * y
    for d in range(3):
        x, y = v[d, p], v[d, q]
        v[d, p], v[d, q] = c * x - s * y, s * x + c * y


@kernel
def fit_box(points, members, lo, hi, center, axes, half, b):
    """Smallest box along the principal axes of ``points[members[lo:hi]]``: row ``b`` of middles, axes, half widths."""
    _principal_axes(points, members, lo, hi, center, axes, b, np.empty((3, 3)), np.empty((3, 3)))
    for row in range(3):
        low, high = np.inf, -np.inf
        for i in range(lo, hi):
            at = 0.0
            for d in range(3):
                at += axes[b, row, d] * (points[members[i], d] - center[b, d])
            low, high = min(low, at), max(high, at)
        half[b, row] = 0.5 * (high - low)
        middle = 0.5 * (high + low)
        for d in range(3):
            center[b, d] += middle * axes[b, row, d]


@kernel
def points_per_side(half, order, count):
    """Interpolation points along each side of boxes: fewer where flat, for the same error in all directions.

    ``half`` (m, 3) half widths, ``count`` (m, 3) out.
    """
    for b in range(half.shape[0]):
        longest = max(half[b, 0], half[b, 1], half[b, 2])
        for d in range(3):
            count[b, d] = 1
            if half[b, d] > 1e-12 * longest:
                ratio = _REFERENCE_RATIO * longest / half[b, d]
                wanted = math.ceil(order * math.log(_REFERENCE_RATIO) / math.log(ratio) - 1e-9)
                count[b, d] = max(1, int(wanted))


@kernel
def place_points(center, axes, half, count, start, out):
    """Interpolation points of all boxes; those of box b begin at ``start[b]``, boxes without any are left out."""
    for b in range(center.shape[0]):
        if start[b + 1] > start[b]:
            box_points(center, axes, half, count, b, out[start[b] : start[b + 1]])


@inlined
def chebyshev(n, node, weight):
    """Chebyshev points of the first kind in [-1, 1] and their barycentric weights."""
    for i in range(n):
        angle = (2 * i + 1) * math.pi / (2 * n)
        node[i] = math.cos(angle)
        weight[i] = (math.sin(angle) if i % 2 == 0 else -math.sin(angle)) * 2.0 ** (n - 1) / n


@inlined
def lagrange(n, node, weight, t, value):
    """Values of the n Lagrange polynomials at ``t``: products of the distances from the other points."""
    product = 1.0
    for i in range(n):
        value[i] = weight[i] * product
        product *= t - node[i]
    product = 1.0
    for i in range(n - 1, -1, -1):
        value[i] *= product
        product *= t - node[i]


@kernel
def box_points(center, axes, half, count, b, out):
    """Interpolation points (count[0] * count[1] * count[2], 3) of box ``b``, into ``out``."""
    node, weight = np.empty((3, 32)), np.empty(32)
    for d in range(3):
        chebyshev(count[b, d], node[d], weight)
    n = 0
    for i in range(count[b, 0]):
        for j in range(count[b, 1]):
            for k in range(count[b, 2]):
                for d in range(3):
                    out[n, d] = (
                        center[b, d]
                        + half[b, 0] * node[0, i] * axes[b, 0, d]
                        + half[b, 1] * node[1, j] * axes[b, 1, d]
                        + half[b, 2] * node[2, k] * axes[b, 2, d]
                    )
                n += 1


@inlined
def box_coordinate(points, s, center, axes, half, b, row):
    """Coordinate of point ``s`` along one side of box ``b``, -1 to 1 inside."""
    at = 0.0
    if half[b, row] > 0.0:
        for d in range(3):
            at += axes[b, row, d] * (points[s, d] - center[b, d])
        at /= half[b, row]
    return at
