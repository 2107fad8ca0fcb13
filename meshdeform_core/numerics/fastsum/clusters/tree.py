"""Trees of source clusters, built once per undeformed grid; :mod:`.target_tree` does the same for targets."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...arrays import FloatArray, IntArray
from ..tuned import LEAF
from .boxes import Boxes, fit_boxes, make_boxes, place_points

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
    return place_points(tree.boxes, start)


def _split(points: FloatArray, leaf: int) -> tuple[IntArray, IntArray, IntArray, list[FloatArray]]:
    """Order, spans, first children and boxes of clusters, which are halved along their longest sides level by level."""
    place: IntArray = np.arange(len(points), dtype=np.int64)
    spans: list[IntArray] = []
    children: list[IntArray] = []
    boxes: list[tuple[FloatArray, FloatArray, FloatArray]] = []
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
    together = [np.concatenate(parts) for parts in zip(*boxes, strict=True)]
    return place, np.concatenate(spans), np.concatenate(children), together
