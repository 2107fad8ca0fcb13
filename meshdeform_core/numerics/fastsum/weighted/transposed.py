"""Transposes of the loops of fast sums: from gradients at nodes to gradients of the charges of sources.

:func:`sum_groups` serves both directions, as clusters and weights are the same: here its targets are the sources and
the interpolation points of clusters, and its sources are the nodes and the interpolation points of bricks.
"""

from __future__ import annotations

import numpy as np

from ...arrays import BoolArray, FloatArray, IntArray
from ...exact.direct import sum_groups
from ...exact.mixed import Scale, sum_groups_mixed
from ...jit import fast_kernel, inlined, kernel
from ..clusters.acceptance import Kernel
from ..clusters.boxes import box_coordinate, chebyshev, lagrange
from ..clusters.bricks import spans
from ..clusters.tree import CHARGES, SourceTree
from .treesum import shares_of_box
from .walk import Lists, few_nodes


@fast_kernel
def collect_sums(first, last, bricks, regions, places, filled, all_charges, gradient):
    """Transpose of :func:`.treesum.interpolate_sums`: add to ``gradient`` (n, 8), at the interpolation points of bricks
    and regions, that at their nodes.

    ``filled`` (items,): which lists hold any cluster. Without ``all_charges`` the first and the last column are taken
    as zero.
    """
    low, high = (0, gradient.shape[1]) if all_charges else (1, gradient.shape[1] - 1)
    item = 0
    for g in range(first, last):
        region = item
        for b in range(regions.first[g], regions.first[g + 1]):
            few = few_nodes(bricks, b)
            for step in range(2):
                source, target = (item + 1, item + 2) if step == 0 else (region, item + 1 + few)
                if (step == 0 and (few or not (filled[source] or filled[region]))) or (
                    step == 1 and not filled[region]
                ):
                    continue
                boxes, box = (regions.boxes, g) if step == 1 else (bricks.boxes, b)
                _collect(
                    boxes, box, places.span[source, 0], low, high, places.points,
                    places.span[target, 0], places.span[target, 1], gradient,
                )  # fmt: skip
            item += 2
        item += 1


@inlined
def _collect(boxes, b, m, low, high, points, first, last, gradient):
    """Add to the rows of ``gradient`` from ``m`` on, the interpolation points of a box, those of first <= t < last."""
    per_side = boxes.per_side
    n, most = last - first, max(per_side[b, 0], per_side[b, 1], per_side[b, 2])
    share, given, product = np.empty((3 * most, n)), np.empty((high, n)), np.empty(n)
    shares_of_box(boxes, b, points, first, n, most, product, share)
    for c in range(low, high):
        for t in range(n):
            given[c, t] = gradient[first + t, c]
    for i in range(per_side[b, 0]):
        for j in range(per_side[b, 1]):
            for k in range(per_side[b, 2]):
                one, two, three = share[i], share[most + j], share[2 * most + k]
                for t in range(n):
                    product[t] = one[t] * two[t] * three[t]
                for c in range(low, high):
                    total, line = 0.0, given[c]
                    for t in range(n):
                        total += line[t] * product[t]
                    gradient[m, c] += total
                m += 1


def spread_lists(
    place: IntArray,
    charged: FloatArray,
    tree: SourceTree,
    points: FloatArray,
    lists: Lists,
    function: Kernel,
    acting: BoolArray,
    scale: Scale | None,
    all_charges: bool,
    out: FloatArray,
) -> None:
    """Transpose of :func:`.treesum.sum_lists`: add to ``out`` (n + m, 8) the gradients of sources and interpolation
    points.

    ``points`` (n + m, 3) are those of the ``tree``; ``charged`` (places, 11) holds coordinates and gradients of the
    places, of which the first and the last gradient are taken as zero without ``all_charges``; ``place`` is
    :attr:`.treesum.Places.span`.
    """
    number, raw = lists.codes >> 1, lists.codes & 1 == 1
    active = acting[number]
    item = np.repeat(np.arange(len(lists.stop)), np.diff(lists.stop, prepend=0))[active]
    codes = lists.codes[active]
    order = np.argsort(codes, kind="stable")
    found, start = np.unique(codes[order], return_index=True)
    if not len(found):
        return
    number, raw = found >> 1, found & 1 == 1
    first = len(tree.order) + np.stack([tree.boxes.proxy[number], tree.boxes.proxy[number + 1]])
    rows = np.ascontiguousarray(np.where(raw, tree.span[number].T, first).T)
    pieces = np.ascontiguousarray(place[item[order]])
    span = np.ascontiguousarray(spans(np.append(start, len(order))))
    a, b, kappa, _ = function
    if scale:
        sum_groups_mixed(points, rows, charged, pieces, span, scale, a, kappa, all_charges, out)
    else:
        sum_groups(points, rows, charged, pieces, span, a, b, kappa, all_charges, out)


def filled_by(lists: Lists, acting: BoolArray) -> BoolArray:
    """Which lists (items,) hold any of the ``acting`` (m,) clusters, as returned by :func:`.treesum.sum_lists`."""
    count = np.append(0, np.cumsum(acting[lists.codes >> 1]))
    return np.asarray(np.diff(count[np.append(0, lists.stop)]) > 0)


@kernel
def spread_charges(tree, proxy, used, first, last, out):
    """Transpose of :func:`..clusters.tree.gather_charges`, for the sources first <= s < last in tree order.

    Adds to their gradients, rows of ``out`` (n, 8), those of the interpolation points ``proxy`` (total, 8) of all
    clusters that are ``used`` (m,).
    """
    node, weight, value = np.empty((3, 32)), np.empty((3, 32)), np.empty((3, 32))
    total = np.empty(CHARGES)
    for cluster in range(tree.child.size):
        low, high = max(tree.span[cluster, 0], first), min(tree.span[cluster, 1], last)
        if low >= high or not used[cluster]:
            continue
        count = tree.boxes.per_side[cluster]
        for d in range(3):
            chebyshev(count[d], node[d], weight[d])
        for s in range(low, high):
            for d in range(3):
                t = box_coordinate(tree.points, s, tree.boxes.center, tree.boxes.axes, tree.boxes.half, cluster, d)
                lagrange(count[d], node[d], weight[d], t, value[d])
            for c in range(CHARGES):
                total[c] = 0.0
            n = tree.boxes.proxy[cluster]
            for i in range(count[0]):
                for j in range(count[1]):
                    product = value[0, i] * value[1, j]
                    for k in range(count[2]):
                        w = product * value[2, k]
                        for c in range(CHARGES):
                            total[c] += w * proxy[n, c]
                        n += 1
            for c in range(CHARGES):
                out[s, c] += total[c]


def used_clusters(tree: SourceTree, proxy: FloatArray) -> BoolArray:
    """Which clusters (m,) have an interpolation point with a nonzero gradient ``proxy`` (total, 8)."""
    count: IntArray = np.append(0, np.cumsum(proxy.any(axis=1)))
    return np.asarray(count[tree.boxes.proxy[1:]] > count[tree.boxes.proxy[:-1]])
