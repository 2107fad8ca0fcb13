"""Boxes along principal axes with interpolation points inside: the clusters of fast summation."""

import math

import numpy as np

from ..jit import kernel

# Ratio of distance to half width for which the number of points along a box's longest side is meant.
_REFERENCE_RATIO = 5.0


@kernel
def principal_axes(points, members, center, axes):
    """Mean and principal axes (rows, longest first) of ``points[members]``, by Jacobi rotations."""
    n = members.size
    center[:] = 0.0
    for i in range(n):
        for d in range(3):
            center[d] += points[members[i], d] / n
    a = np.zeros((3, 3))
    for i in range(n):
        for d in range(3):
            for e in range(d, 3):
                a[d, e] += (points[members[i], d] - center[d]) * (points[members[i], e] - center[e])
    v = np.zeros((3, 3))
    v[0, 0] = v[1, 1] = v[2, 2] = 1.0
    for _ in range(12):
        for p, q in ((0, 1), (0, 2), (1, 2)):
            if abs(a[p, q]) > 1e-15 * (abs(a[p, p]) + abs(a[q, q])):
                _rotate_pair(a, v, p, q)
    first = 0 if a[0, 0] >= a[1, 1] and a[0, 0] >= a[2, 2] else 1 if a[1, 1] >= a[2, 2] else 2
    last = 2 if a[2, 2] <= a[0, 0] and a[2, 2] <= a[1, 1] else 1 if a[1, 1] <= a[0, 0] else 0
    if first == last:
        first, last = 0, 2
    for d in range(3):
        axes[0, d], axes[1, d], axes[2, d] = v[d, first], v[d, 3 - first - last], v[d, last]


@kernel
def _rotate_pair(a, v, p, q):
    """One Jacobi rotation of the upper triangle ``a`` (3, 3), accumulated in ``v``."""
    theta = 0.5 * (a[q, q] - a[p, p]) / a[p, q]
    t = math.copysign(1.0, theta) / (abs(theta) + math.sqrt(theta * theta + 1.0))
    c = 1.0 / math.sqrt(t * t + 1.0)
    s = t * c
    a[p, p], a[q, q], a[p, q] = a[p, p] - t * a[p, q], a[q, q] + t * a[p, q], 0.0
    r = 3 - p - q
    x = a[min(p, r), max(p, r)]
    y = a[min(q, r), max(q, r)]
    a[min(p, r), max(p, r)] = c * x - s * y
    a[min(q, r), max(q, r)] = s * x + c * y
    for d in range(3):
        x, y = v[d, p], v[d, q]
        v[d, p], v[d, q] = c * x - s * y, s * x + c * y


@kernel
def fit_box(points, members, center, axes, half):
    """Smallest box along the principal axes; ``center`` becomes its middle, ``half`` (3,) its half widths."""
    principal_axes(points, members, center, axes)
    for row in range(3):
        low, high = np.inf, -np.inf
        for i in range(members.size):
            at = 0.0
            for d in range(3):
                at += axes[row, d] * (points[members[i], d] - center[d])
            low, high = min(low, at), max(high, at)
        half[row] = 0.5 * (high - low)
        middle = 0.5 * (high + low)
        for d in range(3):
            center[d] += middle * axes[row, d]


@kernel
def points_per_side(half, order, count):
    """Interpolation points along each side: fewer where the box is flat, for the same error in all directions."""
    longest = max(half[0], half[1], half[2])
    for d in range(3):
        if half[d] <= 1e-12 * longest:
            count[d] = 1
        else:
            ratio = _REFERENCE_RATIO * longest / half[d]
            count[d] = max(1, math.ceil(order * math.log(_REFERENCE_RATIO) / math.log(ratio) - 1e-9))


@kernel
def chebyshev(n, node, weight):
    """Chebyshev points of the first kind in [-1, 1] and their barycentric weights."""
    for i in range(n):
        angle = (2 * i + 1) * math.pi / (2 * n)
        node[i] = math.cos(angle)
        weight[i] = (math.sin(angle) if i % 2 == 0 else -math.sin(angle)) * 2.0 ** (n - 1) / n


@kernel
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
def box_points(center, axes, half, count, out):
    """Interpolation points (count[0] * count[1] * count[2], 3) of a box, into ``out``."""
    node, weight = np.empty((3, 32)), np.empty(32)
    for d in range(3):
        chebyshev(count[d], node[d], weight)
    n = 0
    for i in range(count[0]):
        for j in range(count[1]):
            for k in range(count[2]):
                for d in range(3):
                    out[n, d] = (
                        center[d]
                        + half[0] * node[0, i] * axes[0, d]
                        + half[1] * node[1, j] * axes[1, d]
                        + half[2] * node[2, k] * axes[2, d]
                    )
                n += 1


@kernel
def box_coordinate(point, center, axes, half, row):
    """Coordinate of a point along one side of a box, -1 to 1 inside."""
    if half[row] == 0.0:
        return 0.0
    at = 0.0
    for d in range(3):
        at += axes[row, d] * (point[d] - center[d])
    return at / half[row]
