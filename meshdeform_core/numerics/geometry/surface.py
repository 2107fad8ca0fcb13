"""Closest points on a triangulated surface: a tree of boxes, searched nearest box first."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray
from ..jit import inlined, kernel
from ..partition import partition

_LEAF = 8
_DEPTH = 64


class TriangleTree:
    """Bounding-box tree over triangles.

    Parameters
    ----------
    points : (n, 3) float64
    triangles : (m, 3) int64, m >= 1; degenerate triangles are allowed
    """

    def __init__(self, points: FloatArray, triangles: IntArray) -> None:
        self.triangles, points = triangles, np.ascontiguousarray(points)
        self._order = np.arange(len(triangles))
        # Boxes that are halved hold more than a leaf, so that leaves hold at least half of it.
        most = max(4 * len(triangles) // _LEAF, 1)
        node, box = np.empty((most, 3), dtype=np.int64), np.empty((most, 6))
        used = _build(*_bounds(points, triangles), self._order, node, box)
        self._node, self._box = node[:used], box[:used]
        # Made only after the bounds are freed, to limit peak memory.
        self._corners = points[triangles[self._order]]

    def closest(self, targets: FloatArray, within: FloatArray | None = None) -> tuple[IntArray, FloatArray, FloatArray]:
        """Closest surface points of ``targets`` (k, 3), or only those ``within`` a distance (k,), which is much faster.

        Returns
        -------
        triangle : (k,) int64
        weights : (k, 3) barycentric coordinates, in [0, 1] and summing to 1
        distance : (k,), infinite where no triangle is within the limit
        """
        limit = np.full(len(targets), np.inf) if within is None else np.ascontiguousarray(within)
        found, weights, distance = _search(
            np.ascontiguousarray(targets, dtype=np.float64), limit, self._corners, self._node, self._box
        )
        return self._order[found], weights, distance


def _bounds(points: FloatArray, triangles: IntArray) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest coordinates (m, 3) of every triangle."""
    low = points[triangles[:, 0]]
    high = low.copy()
    for n in (1, 2):
        corner = points[triangles[:, n]]
        np.minimum(low, corner, out=low)
        np.maximum(high, corner, out=high)
    return low, high


@kernel
def _build(low, high, order, node, box):
    """Halve boxes along their longest axis until they hold few triangles; return the number of boxes.

    ``node[n] = (first, count, child)``; the children of a box are ``child`` and ``child + 1``, or -1 for leaves.
    """
    along = np.empty(order.shape[0])
    node[0, 0], node[0, 1], node[0, 2] = 0, order.shape[0], -1
    used, current = 1, 0
    while current < used:
        first, count = node[current, 0], node[current, 1]
        longest = 0
        for axis in range(3):
            box[current, axis], box[current, 3 + axis] = np.inf, -np.inf
            for place in range(first, first + count):
                box[current, axis] = min(box[current, axis], low[order[place], axis])
                box[current, 3 + axis] = max(box[current, 3 + axis], high[order[place], axis])
            if box[current, 3 + axis] - box[current, axis] > box[current, 3 + longest] - box[current, longest]:
                longest = axis
        if count > _LEAF:
            for place in range(first, first + count):
                along[place] = low[order[place], longest] + high[order[place], longest]
            half = count // 2
            partition(order, along, first, first + count - 1, first + half)
            node[current, 2] = used
            node[used, 0], node[used, 1], node[used, 2] = first, half, -1
            node[used + 1, 0], node[used + 1, 1], node[used + 1, 2] = first + half, count - half, -1
            used += 2
        current += 1
    return used


@kernel
def _search(targets, limit, corners, node, box):
    n = targets.shape[0]
    found = np.zeros(n, dtype=np.int64)
    weights = np.zeros((n, 3))
    distance = np.empty(n)
    stack, trial = np.empty(_DEPTH, dtype=np.int64), np.empty(3)
    for t in range(n):
        x, y, z = targets[t, 0], targets[t, 1], targets[t, 2]
        best = limit[t] * limit[t]
        first = best
        stack[0] = 0
        depth = 1
        while depth:
            depth -= 1
            current = stack[depth]
            if _box_distance2(x, y, z, box, current) >= best:
                continue
            child = node[current, 2]
            if child < 0:
                for m in range(node[current, 0], node[current, 0] + node[current, 1]):
                    d2 = _triangle_distance2(x, y, z, corners, m, trial)
                    if d2 < best:
                        best = d2
                        found[t] = m
                        for c in range(3):
                            weights[t, c] = trial[c]
            else:
                near, far = child, child + 1
                if _box_distance2(x, y, z, box, far) < _box_distance2(x, y, z, box, near):
                    near, far = far, near
                stack[depth] = far
                stack[depth + 1] = near
                depth += 2
        distance[t] = np.sqrt(best) if best < first else np.inf
    return found, weights, distance


# The loops below work on scalars: views of points cost atomic reference counts, and vector sums allocate memory.


@inlined
def _box_distance2(x, y, z, box, n):
    a = max(box[n, 0] - x, 0.0, x - box[n, 3])
    b = max(box[n, 1] - y, 0.0, y - box[n, 4])
    c = max(box[n, 2] - z, 0.0, z - box[n, 5])
    return a * a + b * b + c * c


@inlined
def _triangle_distance2(x, y, z, corners, m, weights):
    """Squared distance to triangle ``m``; fills the barycentric coordinates of the closest point.

    Voronoi regions of corners, edges and face (Ericson, Real-Time Collision Detection, section 5.1.5).
    """
    a0, a1, a2 = corners[m, 0, 0], corners[m, 0, 1], corners[m, 0, 2]
    b0, b1, b2 = corners[m, 1, 0], corners[m, 1, 1], corners[m, 1, 2]
    c0, c1, c2 = corners[m, 2, 0], corners[m, 2, 1], corners[m, 2, 2]
    u0, u1, u2, v0, v1, v2 = b0 - a0, b1 - a1, b2 - a2, c0 - a0, c1 - a1, c2 - a2
    p0, p1, p2 = x - a0, y - a1, z - a2
    d1, d2 = _dot(u0, u1, u2, p0, p1, p2), _dot(v0, v1, v2, p0, p1, p2)
    d3, d4 = _dot(u0, u1, u2, x - b0, y - b1, z - b2), _dot(v0, v1, v2, x - b0, y - b1, z - b2)
    d5, d6 = _dot(u0, u1, u2, x - c0, y - c1, z - c2), _dot(v0, v1, v2, x - c0, y - c1, z - c2)
    va, vb, vc = d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2
    v = w = 0.0
    if d1 <= 0.0 and d2 <= 0.0:
        pass
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
    elif va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        total = va + vb + vc
        v, w = vb / total, vc / total
    weights[0], weights[1], weights[2] = 1.0 - v - w, v, w
    g0, g1, g2 = p0 - v * u0 - w * v0, p1 - v * u1 - w * v1, p2 - v * u2 - w * v2
    return g0 * g0 + g1 * g1 + g2 * g2


@inlined
def _dot(a, b, c, x, y, z):
    return a * x + b * y + c * z
