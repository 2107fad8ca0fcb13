"""Trees of source clusters, built once per undeformed grid; :mod:`.bricks` does the same for targets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ...jit import kernel
from ...partition import partition
from ..tuned import LEAF
from .boxes import Boxes, box_coordinate, chebyshev, fit_boxes, lagrange, make_boxes, place_points

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
    place, span, child, (center, axes, half) = _split(points, leaf)
    boxes = make_boxes(center, axes, half, order, fewest=span[:, 1] - span[:, 0])
    return SourceTree(place, points[place].copy(), span, child, boxes)


def interpolation_points(tree: SourceTree, start: IntArray) -> FloatArray:
    """Interpolation points of the clusters, those of cluster c in the rows ``start[c]`` to ``start[c + 1]``.

    Those of some clusters only, if the others have no rows. They are computed when needed, as no other array of a tree
    takes as much memory.
    """
    boxes = tree.boxes
    return place_points(boxes.center, boxes.axes, boxes.half, boxes.per_side, start)


def _split(points: FloatArray, leaf: int) -> tuple[IntArray, IntArray, IntArray, list[FloatArray]]:
    """Order, spans, first children and boxes of clusters, which are halved along their longest sides level by level."""
    place: IntArray = np.arange(len(points), dtype=np.int64)
    spans: list[IntArray] = []
    children: list[IntArray] = []
    boxes: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    level, used = np.array([[0, len(points)]]), 1
    while len(level):
        box = fit_boxes(points, place, level)
        large = level[:, 1] - level[:, 0] > leaf
        _halve(points, place, level[large], *(part[large] for part in box))
        child = np.full(len(level), -1)
        child[large] = used + 2 * np.arange(large.sum())
        spans.append(level)
        children.append(child)
        boxes.append(box)
        lo, hi = level[large].T
        level = np.stack([lo, (lo + hi) // 2, (lo + hi) // 2, hi], axis=1).reshape(-1, 2)
        used += len(level)
    together = [np.concatenate(parts) for parts in zip(*boxes, strict=True)]
    return place, np.concatenate(spans), np.concatenate(children), together


@kernel
def _halve(points, place, span, center, axes, half):
    """Reorder ``place[lo:hi]`` of every cluster so that its halves are separated along its longest axis."""
    along = np.empty(points.shape[0])
    for b in range(span.shape[0]):
        longest = 0
        for d in range(1, 3):
            if half[b, d] > half[b, longest]:
                longest = d
        u, v, w = axes[b, longest, 0], axes[b, longest, 1], axes[b, longest, 2]
        lo, hi = span[b, 0], span[b, 1]
        for i in range(lo, hi):
            n = place[i]
            along[i] = u * points[n, 0] + v * points[n, 1] + w * points[n, 2]
        partition(place, along, lo, hi - 1, (lo + hi) // 2)


@kernel
def gather_charges(tree, rows, start, active, first_cluster, last_cluster):
    """Charges of the interpolation points of some clusters from those of the sources, in ``rows`` (n + k, 11):
    coordinates and charges of the sources in tree order, then of the interpolation points.

    The Lagrange polynomials of each cluster distribute the charges of its sources among its interpolation points, the
    rows from ``start[cluster]`` to ``start[cluster + 1]``. Clusters not ``active`` (m,) have no charged sources.
    """
    node, weight, value = np.empty((3, 32)), np.empty((3, 32)), np.empty((3, 32))
    for n in range(start[first_cluster], start[last_cluster]):
        for c in range(CHARGES):
            rows[n, 3 + c] = 0.0
    for cluster in range(first_cluster, last_cluster):
        first = start[cluster]
        if start[cluster + 1] == first or not active[cluster]:
            continue
        count = tree.boxes.per_side[cluster]
        for d in range(3):
            chebyshev(count[d], node[d], weight[d])
        for s in range(tree.span[cluster, 0], tree.span[cluster, 1]):
            c0, c1, c2, c3 = rows[s, 3], rows[s, 4], rows[s, 5], rows[s, 6]
            c4, c5, c6, c7 = rows[s, 7], rows[s, 8], rows[s, 9], rows[s, 10]
            if c0 == c1 == c2 == c3 == c4 == c5 == c6 == c7 == 0.0:
                continue
            for d in range(3):
                t = box_coordinate(tree.points, s, tree.boxes.center, tree.boxes.axes, tree.boxes.half, cluster, d)
                lagrange(count[d], node[d], weight[d], t, value[d])
            n = first
            for i in range(count[0]):
                for j in range(count[1]):
                    product = value[0, i] * value[1, j]
                    for k in range(count[2]):
                        # Consecutive entries, which the compiler vectorises.
                        w = product * value[2, k]
                        rows[n, 3] += w * c0
                        rows[n, 4] += w * c1
                        rows[n, 5] += w * c2
                        rows[n, 6] += w * c3
                        rows[n, 7] += w * c4
                        rows[n, 8] += w * c5
                        rows[n, 9] += w * c6
                        rows[n, 10] += w * c7
                        n += 1
