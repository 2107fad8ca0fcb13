"""Trees of source clusters, built once per undeformed grid: boxes along principal axes with interpolation points
inside; :mod:`.targets` does the same for targets."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray
from ..arrays import spans as runs_of
from ..jit import fast_kernel, inlined, kernel, record
from .tuned import LEAF, REFERENCE_RATIO

# Points that are interpolated at a time, and the most interpolation points per side.
_LENGTH, _MOST = 128, 32


@record("f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8[:, ::1], i8[::1], f8[:, ::1]")
class Boxes(NamedTuple):
    """Boxes along principal axes.

    Attributes
    ----------
    center, half : (m, 3) middles and half widths
    axes : (m, 3, 3) unit vectors in rows, along the longest side first
    per_side : (m, 3) interpolation points per side
    proxy : (m + 1,) start of each box's rows in ``proxies``
    proxies : (total, 3) interpolation points; none are kept of source trees, of which no other array takes as much
        memory: :func:`place_points`
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
    boxes = Boxes(center, axes, half, per_side, np.append(0, np.cumsum(sizes)), np.empty((0, 3)))
    return boxes if fewest is not None else boxes._replace(proxies=place_points(boxes, boxes.proxy))


def fit_boxes(points: FloatArray, members: IntArray, span: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Smallest boxes along the principal axes of ``points[members[lo:hi]]`` for each row lo, hi of ``span`` (m, 2).

    Returns middles (m, 3), axes (m, 3, 3) in rows, longest first, and half widths (m, 3); middles and half widths are
    zero for boxes without members.
    """
    center, scatter = np.empty((len(span), 3)), np.empty((len(span), 3, 3))
    _moments(points, members, span, center, scatter)
    axes = np.ascontiguousarray(np.linalg.eigh(scatter)[1].transpose(0, 2, 1)[:, ::-1])
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


@kernel("f8[:, ::1], i8[::1], i8[:, ::1], f8[:, ::1], f8[:, :, ::1]")
def _moments(points, members, span, center, scatter):
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
                scatter[b, d, e] = total


@kernel("f8[:, ::1], i8[::1], i8[:, ::1], f8[:, ::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1]")
def _extents(points, members, span, center, axes, low, high):
    """As :func:`extents`, into ``low`` and ``high`` (m, 3)."""
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


def place_points(boxes: Boxes, start: IntArray) -> FloatArray:
    """Interpolation points of boxes, tensor products of Chebyshev points along their sides: those of box b are the rows
    from ``start[b]`` to ``start[b + 1]``; some boxes may have none."""
    box, place = runs_of(np.diff(start))
    count = boxes.per_side[box]
    number = np.stack(
        [place // (count[:, 1] * count[:, 2]), place // count[:, 2] % count[:, 1], place % count[:, 2]], 1
    )
    along = boxes.half[box] * np.cos((2 * number + 1) * math.pi / (2 * count))
    points = boxes.center[box]
    for row in range(3):
        points += along[:, row, None] * boxes.axes[box, row]
    return points


@fast_kernel("Boxes, i8[:, ::1], f8[:, ::1], f8[:, ::1], i8, i8, b1", Boxes)
def interpolate(boxes, tasks, points, values, low, high, transposed):
    """Add to ``values`` (n, 8) of some points those interpolated from the interpolation points of a box around them.

    ``transposed``: add to the values of the interpolation points those of the points, shared out by the same weights.
    Each of the ``tasks`` (t, 4) is a box, the row of its first interpolation point, of the first point, and one past
    the last. Only the coordinates of ``points`` (n, 3) inside boxes are used, and the columns low <= c < high.
    """
    share, line = np.empty((3 * _MOST, _LENGTH)), np.empty((8, _LENGTH))
    at, product = np.empty(_LENGTH), np.empty(_LENGTH)
    for task in range(tasks.shape[0]):
        b = tasks[task, 0]
        for first in range(tasks[task, 2], tasks[task, 3], _LENGTH):
            n, m = min(_LENGTH, tasks[task, 3] - first), tasks[task, 1]
            for d in range(3):
                _shares(boxes, b, points, first, n, d, at, product, share)
            for c in range(low, high):
                for t in range(n):
                    line[c, t] = values[first + t, c] if transposed else 0.0
            for i in range(boxes.per_side[b, 0]):
                for j in range(boxes.per_side[b, 1]):
                    for k in range(boxes.per_side[b, 2]):
                        one, two, three = share[i], share[_MOST + j], share[2 * _MOST + k]
                        for t in range(n):
                            product[t] = one[t] * two[t] * three[t]
                        for c in range(low, high):
                            if transposed:
                                total = 0.0
                                for t in range(n):
                                    total += line[c, t] * product[t]
                                values[m, c] += total
                            else:
                                value = values[m, c]
                                for t in range(n):
                                    line[c, t] += value * product[t]
                        m += 1
            if not transposed:
                for c in range(low, high):
                    for t in range(n):
                        values[first + t, c] += line[c, t]


@inlined
def _shares(boxes, b, points, first, n, d, at, product, share):
    """Lagrange polynomials along side ``d`` of a box at ``n`` points, in rows of ``share`` from d * _MOST on.

    The nodes are Chebyshev points of the first kind, with barycentric weights.
    """
    count = boxes.per_side[b, d]
    for t in range(n):
        at[t], product[t] = 0.0, 1.0
    if boxes.half[b, d] > 0.0:
        for e in range(3):
            factor, origin = boxes.axes[b, d, e] / boxes.half[b, d], boxes.center[b, e]
            for t in range(n):
                at[t] += factor * (points[first + t, e] - origin)
    for i in range(count):
        angle = (2 * i + 1) * math.pi / (2 * count)
        node, weight = math.cos(angle), math.sin(angle) * (1.0 - 2.0 * (i % 2)) * 2.0 ** (count - 1) / count
        row = share[d * _MOST + i]
        for t in range(n):
            row[t] = weight * product[t]
            product[t] *= at[t] - node
    for t in range(n):
        product[t] = 1.0
    for i in range(count - 1, -1, -1):
        node = math.cos((2 * i + 1) * math.pi / (2 * count))
        row = share[d * _MOST + i]
        for t in range(n):
            row[t] *= product[t]
            product[t] *= at[t] - node


CHARGES = 8
"""Number of charges of a source: its strength and seven values."""


class SourceTree(NamedTuple):
    """Binary tree over sources, every cluster a box along its principal axes.

    Attributes
    ----------
    order : (n,) source at each position of the tree's order
    points : (n, 3) sources in that order
    span : (m, 2) first and one past the last position of each cluster
    child : (m,) first child (the second follows it), -1 for leaves
    boxes : around the sources of each cluster; without interpolation points where that would take as many as it has
        sources
    """

    order: np.ndarray
    points: np.ndarray
    span: np.ndarray
    child: np.ndarray
    boxes: Boxes


def build_tree(points: FloatArray, order: int, leaf: int = LEAF) -> SourceTree:
    """Tree over sources (n, 3) whose clusters have up to ``order`` interpolation points per side.

    Clusters of more than ``leaf`` sources are split.
    """
    points = np.ascontiguousarray(points)
    place: IntArray = np.arange(len(points), dtype=np.int64)
    spans, children, boxes = list[IntArray](), list[IntArray](), list[tuple[FloatArray, FloatArray, FloatArray]]()
    # Level by level, clusters are halved along their longest sides.
    level, used = np.array([[0, len(points)]]), 1
    while len(level):
        _, axes, half = box = fit_boxes(points, place, level)
        large = np.flatnonzero(level[:, 1] - level[:, 0] > leaf)
        for b in large:
            lo, hi = level[b]
            some = place[lo:hi]
            x, axis = points[some], axes[b, np.argmax(half[b])]
            # Not a matrix product, whose last bits depend on the number of threads.
            along = x[:, 0] * axis[0] + x[:, 1] * axis[1] + x[:, 2] * axis[2]
            place[lo:hi] = some[np.argpartition(along, (hi - lo) // 2)]
        child = np.full(len(level), -1)
        child[large] = used + 2 * np.arange(len(large))
        spans.append(level)
        children.append(child)
        boxes.append(box)
        lo, hi = level[large].T
        level = np.stack([lo, (lo + hi) // 2, (lo + hi) // 2, hi], axis=1).reshape(-1, 2)
        used += len(level)
    span, (center, axes, half) = np.concatenate(spans), (np.concatenate(parts) for parts in zip(*boxes, strict=True))
    found = make_boxes(center, axes, half, order, fewest=span[:, 1] - span[:, 0])
    return SourceTree(place, points[place].copy(), span, np.concatenate(children), found)
