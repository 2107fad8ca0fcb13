"""Boxes along principal axes with interpolation points inside: the clusters of fast summation."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ...jit import inlined, kernel
from ..tuned import REFERENCE_RATIO


class Boxes(NamedTuple):
    """Boxes along principal axes.

    Attributes
    ----------
    center, half : (m, 3) middles and half widths
    axes : (m, 3, 3) unit vectors in rows, along the longest side first
    per_side : (m, 3) interpolation points per side
    proxy : (m + 1,) start of each box's rows in ``proxies``
    proxies : (total, 3) interpolation points; none are kept of source trees, see :func:`.tree.interpolation_points`
    """

    center: np.ndarray
    axes: np.ndarray
    half: np.ndarray
    per_side: np.ndarray
    proxy: np.ndarray
    proxies: np.ndarray


def make_boxes(
    center: FloatArray, axes: FloatArray, half: FloatArray, order: int, fewest: IntArray | None = None
) -> Boxes:
    """Boxes with up to ``order`` interpolation points per side.

    Those of source trees have none where that takes ``fewest`` (m,) or more, and no coordinates of the others.
    """
    per_side = points_per_side(half, order)
    sizes = per_side.prod(axis=1)
    if fewest is not None:
        sizes[sizes >= fewest] = 0
    proxy = np.append(0, np.cumsum(sizes))
    proxies = np.empty((0, 3)) if fewest is not None else place_points(center, axes, half, per_side, proxy)
    return Boxes(center, axes, half, per_side, proxy, proxies)


def fit_boxes(points: FloatArray, members: IntArray, span: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smallest boxes along the principal axes of ``points[members[lo:hi]]`` for each row lo, hi of ``span`` (m, 2).

    Returns middles (m, 3), axes (m, 3, 3) in rows, longest first, and half widths (m, 3).
    """
    m = len(span)
    center, covariance = np.empty((m, 3)), np.empty((m, 3, 3))
    _moments(points, members, span, center, covariance)
    axes = np.ascontiguousarray(np.linalg.eigh(covariance)[1].transpose(0, 2, 1)[:, ::-1])
    low, high = extents(points, members, span, center, axes)
    center += np.einsum("md,mde->me", 0.5 * (low + high), axes)
    return center, axes, 0.5 * (high - low)


def extents(
    points: FloatArray, members: IntArray, span: IntArray, center: FloatArray, axes: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates (m, 3) of the members along the axes of boxes, relative to their middles.

    Both are 0 for boxes without members.
    """
    low, high = np.zeros(center.shape), np.zeros(center.shape)
    _extents(points, members, span, center, axes, low, high)
    return low, high


@kernel
def _moments(points, members, span, center, covariance):
    """Means of the members, and the lower triangles of their scatter matrices (sums of products about the means)."""
    for b in range(span.shape[0]):
        lo, hi = span[b, 0], span[b, 1]
        share = 1.0 / max(hi - lo, 1)
        for d in range(3):
            mean = 0.0
            for i in range(lo, hi):
                mean += points[members[i], d]
            center[b, d] = mean * share
        for d in range(3):
            for e in range(d + 1):
                total = 0.0
                for i in range(lo, hi):
                    n = members[i]
                    total += (points[n, d] - center[b, d]) * (points[n, e] - center[b, e])
                covariance[b, d, e] = total


@kernel
def _extents(points, members, span, center, axes, low, high):
    for b in range(span.shape[0]):
        for row in range(3):
            u, v, w = axes[b, row, 0], axes[b, row, 1], axes[b, row, 2]
            x, y, z = center[b, 0], center[b, 1], center[b, 2]
            for i in range(span[b, 0], span[b, 1]):
                n = members[i]
                at = u * (points[n, 0] - x) + v * (points[n, 1] - y) + w * (points[n, 2] - z)
                if i == span[b, 0] or at < low[b, row]:
                    low[b, row] = at
                if i == span[b, 0] or at > high[b, row]:
                    high[b, row] = at


def points_per_side(half: FloatArray, order: int) -> IntArray:
    """Interpolation points (m, 3) along each side of boxes: fewer along short sides, for equal errors along all."""
    thick = half > 1e-12 * half.max(axis=1, keepdims=True)
    flatness = half.max(axis=1, keepdims=True) / np.where(thick, half, 1.0)
    wanted = np.ceil(order * math.log(REFERENCE_RATIO) / np.log(REFERENCE_RATIO * np.maximum(flatness, 1.0)) - 1e-9)
    return np.where(thick, np.maximum(wanted, 1.0), 1.0).astype(np.int64)


def place_points(
    center: FloatArray, axes: FloatArray, half: FloatArray, count: IntArray, start: IntArray
) -> FloatArray:
    """Interpolation points (total, 3) of all boxes; those of box b begin at ``start[b]``."""
    points = np.empty((start[-1], 3))
    _place_points(center, axes, half, count, start, points)
    return points


@kernel
def _place_points(center, axes, half, count, start, out):
    """Tensor products of Chebyshev points along the sides; boxes without any points are skipped."""
    node = np.empty((3, 32))
    for b in range(center.shape[0]):
        n = start[b]
        if start[b + 1] == n:
            continue
        for d in range(3):
            for i in range(count[b, d]):
                node[d, i] = half[b, d] * math.cos((2 * i + 1) * math.pi / (2 * count[b, d]))
        for i in range(count[b, 0]):
            for j in range(count[b, 1]):
                for k in range(count[b, 2]):
                    x, y, z = node[0, i], node[1, j], node[2, k]
                    for d in range(3):
                        out[n, d] = center[b, d] + x * axes[b, 0, d] + y * axes[b, 1, d] + z * axes[b, 2, d]
                    n += 1


@inlined
def chebyshev(n, node, weight):
    """Chebyshev points of the first kind in [-1, 1] and their barycentric weights."""
    for i in range(n):
        angle = (2 * i + 1) * math.pi / (2 * n)
        node[i] = math.cos(angle)
        weight[i] = (math.sin(angle) if i % 2 == 0 else -math.sin(angle)) * 2.0 ** (n - 1) / n


@inlined
def lagrange(n, node, weight, t, value):
    """Values of the n Lagrange polynomials at ``t``, as products of the distances from the other points."""
    product = 1.0
    for i in range(n):
        value[i] = weight[i] * product
        product *= t - node[i]
    product = 1.0
    for i in range(n - 1, -1, -1):
        value[i] *= product
        product *= t - node[i]


@inlined
def box_coordinate(points, s, center, axes, half, b, row):
    """Coordinate of point ``s`` along axis ``row`` of box ``b``, from -1 to 1 inside the box."""
    at = 0.0
    if half[b, row] > 0.0:
        for d in range(3):
            at += axes[b, row, d] * (points[s, d] - center[b, d])
        at /= half[b, row]
    return at
