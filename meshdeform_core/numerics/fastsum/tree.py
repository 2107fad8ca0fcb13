"""Trees of source clusters: one half of what fast summation sorts once per undeformed grid."""

from typing import NamedTuple

import numpy as np

from ..jit import kernel
from .boxes import box_coordinate, box_points, chebyshev, fit_box, lagrange, points_per_side

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
    place, span, child, center, axes, half = _split_sources(np.ascontiguousarray(points), leaf)
    count = np.empty((len(span), 3), dtype=np.int64)
    for node in range(len(span)):
        points_per_side(half[node], order, count[node])
    sizes = count.prod(axis=1)
    # A cluster with fewer sources than interpolation points is its sources.
    sizes[sizes >= span[:, 1] - span[:, 0]] = 0
    proxy = np.concatenate([[0], np.cumsum(sizes)])
    proxies = np.empty((proxy[-1], 3))
    _place_proxies(center, axes, half, count, proxy, proxies)
    return SourceTree(place, points[place].copy(), span, child, center, axes, half, count, proxy, proxies)


@kernel
def _split_sources(points, leaf):
    n = points.shape[0]
    limit = 4 * (n // leaf + 1) + 3
    place = np.arange(n)
    span = np.empty((limit, 2), dtype=np.int64)
    child = np.full(limit, -1)
    center, axes, half = np.empty((limit, 3)), np.empty((limit, 3, 3)), np.empty((limit, 3))
    span[0, 0], span[0, 1] = 0, n
    used, current = 1, 0
    along = np.empty(n)
    while current < used:
        lo, hi = span[current]
        members = place[lo:hi]
        fit_box(points, members, center[current], axes[current], half[current])
        if hi - lo > leaf:
            longest = 0
            for d in range(1, 3):
                if half[current, d] > half[current, longest]:
                    longest = d
            for i in range(hi - lo):
                along[i] = box_coordinate(points[members[i]], center[current], axes[current], half[current], longest)
            middle = (hi - lo) // 2
            _partition(members, along[: hi - lo], middle)
            child[current] = used
            span[used, 0], span[used, 1] = lo, lo + middle
            span[used + 1, 0], span[used + 1, 1] = lo + middle, hi
            used += 2
        current += 1
    return place, span[:used].copy(), child[:used].copy(), center[:used].copy(), axes[:used].copy(), half[:used].copy()


@kernel
def _partition(members, key, middle):
    """Reorder so that the ``middle`` smallest keys come first (quickselect)."""
    lo, hi = 0, members.size - 1
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
            return


@kernel
def _place_proxies(center, axes, half, count, proxy, proxies):
    for node in range(center.shape[0]):
        if proxy[node + 1] > proxy[node]:
            box_points(center[node], axes[node], half[node], count[node], proxies[proxy[node] : proxy[node + 1]])


@kernel
def gather_charges(tree, charges, out):
    """Charges (m, c) of all interpolation points from the charges (n, c) of the sources in tree order.

    A source's charge is shared among the points of each cluster it belongs to by their Lagrange polynomials.
    """
    node, weight, value = np.empty((3, 32)), np.empty((3, 32)), np.empty((3, 32))
    columns = charges.shape[1]
    out[:] = 0.0
    for cluster in range(tree.span.shape[0]):
        first = tree.proxy[cluster]
        if tree.proxy[cluster + 1] == first:
            continue
        count = tree.per_side[cluster]
        for d in range(3):
            chebyshev(count[d], node[d], weight[d])
        for s in range(tree.span[cluster, 0], tree.span[cluster, 1]):
            for d in range(3):
                t = box_coordinate(tree.points[s], tree.center[cluster], tree.axes[cluster], tree.half[cluster], d)
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
