"""Trees of source clusters: one half of what fast summation sorts once per undeformed grid."""

from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel
from .boxes import box_coordinate, chebyshev, fit_box, lagrange, place_points, points_per_side

LEAF = 24


class SourceTree(NamedTuple):
    """Binary tree over sources, every cluster a box along its principal axes.

    Attributes
    ----------
    order : (n,) source at each place of the tree's order
    points : (n, 3) sources in that order
    span : (m, 2) first and one past the last place of each cluster
    child : (m,) first child (the second follows it), -1 for leaves
    center, axes, half : (m, 3), (m, 3, 3), (m, 3) boxes
    per_side : (m, 3) interpolation points per side
    proxy : (m + 1,) where each cluster's interpolation points begin
    proxies : (total, 3) interpolation points
    """

    order: np.ndarray
    points: np.ndarray
    span: np.ndarray
    child: np.ndarray
    center: np.ndarray
    axes: np.ndarray
    half: np.ndarray
    per_side: np.ndarray
    proxy: np.ndarray
    proxies: np.ndarray


def build_tree(points, order, leaf=LEAF):
    """Tree over sources (n, 3) whose clusters have up to ``order`` interpolation points per side.

    Clusters of more than ``leaf`` sources are split.
    """
    points = np.ascontiguousarray(points)
    n = len(points)
    limit = 4 * (n // leaf + 1) + 3
    place, span, child = np.arange(n), np.empty((limit, 2), dtype=np.int64), np.full(limit, -1)
    boxes = np.empty((limit, 3)), np.empty((limit, 3, 3)), np.empty((limit, 3))
    m = _split_sources(points, leaf, place, span, child, *boxes)
    span, child, center, axes, half = (array[:m].copy() for array in (span, child, *boxes))
    count = np.empty((m, 3), dtype=np.int64)
    points_per_side(half, order, count)
    sizes = count.prod(axis=1)
    # A cluster with fewer sources than interpolation points is its sources.
    sizes[sizes >= span[:, 1] - span[:, 0]] = 0
    proxy = np.concatenate([[0], np.cumsum(sizes)])
    proxies = np.empty((proxy[-1], 3))
    place_points(center, axes, half, count, proxy, proxies)
    return SourceTree(place, points[place].copy(), span, child, center, axes, half, count, proxy, proxies)


@kernel
def _split_sources(points, leaf, place, span, child, center, axes, half):
    """Halve clusters of more than ``leaf`` sources along their longest side; returns their number."""
    span[0, 0], span[0, 1] = 0, points.shape[0]
    # Not plain numbers, for which the functions that take them would be compiled apart.
    used, current = np.int64(1), np.int64(0)
    along = np.empty(points.shape[0])
    while current < used:
        lo, hi = span[current, 0], span[current, 1]
        fit_box(points, place, lo, hi, center, axes, half, current)
        if hi - lo > leaf:
            longest = 0
            for d in range(1, 3):
                if half[current, d] > half[current, longest]:
                    longest = d
            for i in range(lo, hi):
                along[i] = box_coordinate(points, place[i], center, axes, half, current, longest)
            middle = (lo + hi) // 2
            _partition(place, along, lo, hi - 1, middle)
            child[current] = used
            span[used, 0], span[used, 1] = lo, middle
            span[used + 1, 0], span[used + 1, 1] = middle, hi
            used += 2
        current += 1
    return used


@inlined
def _partition(members, key, first, last, middle):
    """Reorder ``first`` to ``last`` so that the smallest keys come before ``middle`` (quickselect)."""
    lo, hi = first, last
    while lo < hi:
        pivot = key[(lo + hi) // 2]
        i, j = lo, hi
        while i <= j:
            while key[i] < pivot:
                i += 1
            while key[j] > pivot:
                j -= 1
            if i <= j:
                key[i], key[j] = key[j], key[i]
                members[i], members[j] = members[j], members[i]
                i += 1
                j -= 1
        if middle <= j:
            hi = j
        elif middle >= i:
            lo = i
        else:
            lo = hi


@kernel
def gather_charges(tree, charges, out, active):
    """Charges (m, c) of all interpolation points from the charges (n, c) of the sources in tree order.

    A source's charge is shared among the points of each cluster it belongs to by their Lagrange polynomials.
    ``active`` (m,) clusters have sources with charges.
    """
    node, weight, value = np.empty((3, 32)), np.empty((3, 32)), np.empty((3, 32))
    columns = charges.shape[1]
    for n in range(out.shape[0]):
        for c in range(columns):
            out[n, c] = 0.0
    for cluster in range(tree.span.shape[0]):
        first = tree.proxy[cluster]
        if tree.proxy[cluster + 1] == first or not active[cluster]:
            continue
        count = tree.per_side[cluster]
        for d in range(3):
            chebyshev(count[d], node[d], weight[d])
        for s in range(tree.span[cluster, 0], tree.span[cluster, 1]):
            charged = False
            for c in range(columns):
                charged = charged or charges[s, c] != 0.0
            if not charged:
                continue
            for d in range(3):
                t = box_coordinate(tree.points, s, tree.center, tree.axes, tree.half, cluster, d)
                lagrange(count[d], node[d], weight[d], t, value[d])
            n = first
            for i in range(count[0]):
                for j in range(count[1]):
                    product = value[0, i] * value[1, j]
                    for k in range(count[2]):
                        factor = product * value[2, k]
                        for c in range(columns):
                            out[n, c] += factor * charges[s, c]
                        n += 1
