"""Closest points on a triangulated surface: a tree of boxes, searched nearest box first."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray
from ..jit import inlined, kernel
from .boxes import LEAF, depth_of, halves, levels_of


class TriangleTree:
    """Bounding-box tree over at least one triangle (m, 3) of the points (n, 3); triangles may be degenerate."""

    def __init__(self, points: FloatArray, triangles: IntArray) -> None:
        self.triangles = triangles
        corners = points[triangles]
        low, high = corners.min(axis=1), corners.max(axis=1)
        self._order = halves(0.5 * (low + high))
        self._leaf = min(LEAF, 1 << depth_of(len(triangles)))
        levels = levels_of(low[self._order], high[self._order])
        levels = levels[: len(levels) - depth_of(self._leaf)]
        # Box n of a level follows all boxes of the levels before: the children of box b are 2 b + 1 and 2 b + 2.
        self._box = np.concatenate([np.concatenate(boxes).T for boxes in levels]).copy()
        self._corners = corners[self._order]

    def closest(self, targets: FloatArray, within: FloatArray | None = None) -> tuple[IntArray, FloatArray, FloatArray]:
        """Closest surface points of ``targets`` (k, 3), or only those ``within`` a distance (k,), which is much faster:
        triangle (k,), barycentric coordinates (k, 3), in [0, 1] and summing to 1, and distance (k,), infinite where no
        triangle is within the limit."""
        count = len(targets)
        distance = np.full(count, np.inf) if within is None else np.array(within, dtype=np.float64)
        found, weights = np.zeros(count, dtype=np.int64), np.zeros((count, 3))
        places, waiting = np.ascontiguousarray(targets, dtype=np.float64), np.empty(64, dtype=np.int64)
        _search(places, self._corners, self._box, self._leaf, waiting, found, weights, distance)
        return self._order[found], weights, distance


@kernel("f8[:, ::1], f8[:, :, ::1], f8[:, ::1], i8, i8[::1], i8[::1], f8[:, ::1], f8[::1]")
def _search(targets, corners, box, leaf, waiting, found, weights, distance):
    """``distance`` holds the limits; ``waiting`` is room for the boxes still to be searched."""
    trial, bound = np.empty(3), np.empty(64)
    first_leaf = box.shape[0] // 2
    for t in range(targets.shape[0]):
        x, y, z = targets[t, 0], targets[t, 1], targets[t, 2]
        limit = best = distance[t] * distance[t]
        waiting[0], bound[0], depth = 0, 0.0, 1
        while depth:
            depth -= 1
            if bound[depth] >= best:
                continue
            current = waiting[depth]
            if current < first_leaf:
                for child in range(2 * current + 1, 2 * current + 3):
                    d2 = 0.0
                    for axis in range(3):
                        away = max(box[child, axis] - targets[t, axis], targets[t, axis] - box[child, 3 + axis])
                        if away > 0.0:
                            d2 += away * away
                    waiting[depth], bound[depth] = child, d2
                    depth += 1
                if bound[depth - 1] > bound[depth - 2]:
                    waiting[depth - 1], waiting[depth - 2] = waiting[depth - 2], waiting[depth - 1]
                    bound[depth - 1], bound[depth - 2] = bound[depth - 2], bound[depth - 1]
                continue
            start = (current - first_leaf) * leaf
            for m in range(start, min(start + leaf, corners.shape[0])):
                d2 = _triangle_distance2(x, y, z, corners, m, trial)
                if d2 < best:
                    best, found[t] = d2, m
                    for c in range(3):
                        weights[t, c] = trial[c]
        distance[t] = np.sqrt(best) if best < limit else np.inf


@inlined
def _triangle_distance2(x, y, z, corners, m, weights):
    """Squared distance to triangle ``m``; fills the barycentric coordinates of the closest point.

    Voronoi regions of corners, edges and face (Ericson, Real-Time Collision Detection, section 5.1.5). On scalars, as
    views of points cost atomic reference counts, and vector sums allocate memory.
    """
    a0, a1, a2 = corners[m, 0, 0], corners[m, 0, 1], corners[m, 0, 2]
    u0, u1, u2 = corners[m, 1, 0] - a0, corners[m, 1, 1] - a1, corners[m, 1, 2] - a2
    v0, v1, v2 = corners[m, 2, 0] - a0, corners[m, 2, 1] - a1, corners[m, 2, 2] - a2
    p0, p1, p2 = x - a0, y - a1, z - a2
    uv = u0 * v0 + u1 * v1 + u2 * v2
    # Products of the edges u and v with the vectors from all three corners.
    d1, d2 = u0 * p0 + u1 * p1 + u2 * p2, v0 * p0 + v1 * p1 + v2 * p2
    d3, d4 = d1 - (u0 * u0 + u1 * u1 + u2 * u2), d2 - uv
    d5, d6 = d1 - uv, d2 - (v0 * v0 + v1 * v1 + v2 * v2)
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
