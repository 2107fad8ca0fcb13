"""Fast sums of functions of distance between clusters of sources and bricks of target nodes.

:mod:`.walk` lists which clusters act on the interpolation points of a region of bricks, on those of a brick and on its
nodes. Here these lists are evaluated; results are interpolated from a region to its bricks and from these to the nodes.

Numerator and denominator of a weighted mean (eq. 14) use the same approximate weights, so its error is the error of the
weights times the *difference* of a cluster's displacement from the mean: a motion common to all sources is exact.

Source: barycentric cluster-cluster treecodes (Wang, Krasny, Tlupova 2020), with two levels of targets and the
acceptance of a weighted mean.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ....parallel import for_chunks
from ...arrays import BoolArray, FloatArray, IntArray
from ...exact.direct import sum_groups
from ...exact.mixed import Scale, sum_groups_mixed
from ...exact.single import sum_groups_single
from ...jit import inlined, kernel
from ..clusters.acceptance import Kernel, distance2, square, weight
from ..clusters.boxes import chebyshev
from ..clusters.bricks import Bricks, Regions, spans
from ..clusters.tree import CHARGES, SourceTree, gather_charges, interpolation_points
from .walk import Lists, Reach, few_nodes

_STACK = 256
# Portions into which the clusters of a tree are divided among threads.
_PORTIONS = 64


class Charges(NamedTuple):
    """Charges (strength, strength times values) of sources and of the interpolation points of clusters.

    Attributes
    ----------
    rows : (n + k, 11) coordinates and charges of the sources in tree order, then of the interpolation points
    start : (m + 1,) first row of the interpolation points of each cluster
    span : (m, 2) first row of the sources of each cluster, and one past the last
    all : whether the first or the last charge can be nonzero; the first, the strength, is omitted once the weights are
        known, and the last is needed by few kinds of rotation only
    """

    rows: np.ndarray
    start: np.ndarray
    span: np.ndarray
    all: bool

    def of_sources(self, tree: SourceTree, direct: BoolArray) -> Charges:
        """The same without the sources of clusters that are not ``direct`` (m,): where only interpolation points act.

        A rank that holds a part of the grid needs few sources by themselves.
        """
        n, ends = len(tree.order), np.zeros(len(tree.order) + 1, dtype=np.int32)
        np.add.at(ends, tree.span[direct, 0], 1)
        np.subtract.at(ends, tree.span[direct, 1], 1)
        kept = np.cumsum(ends[:n]) > 0
        place = np.append(0, np.cumsum(kept))
        if 2 * place[n] > n:
            return self
        rows = np.empty((place[n] + len(self.rows) - n, self.rows.shape[1]))
        np.compress(kept, self.rows[:n], axis=0, out=rows[: place[n]])
        rows[place[n] :] = self.rows[n:]
        return Charges(rows, self.start - (n - place[n]), place[tree.span], self.all)


def charge_rows(tree: SourceTree, used: BoolArray | None = None) -> tuple[FloatArray, IntArray]:
    """``rows`` of :class:`Charges` with coordinates and without charges, and their ``start``.

    There are none for clusters that are not ``used`` (m,).
    """
    n, start = len(tree.order), tree.boxes.proxy
    if used is not None:
        start = np.append(0, np.cumsum(np.where(used, np.diff(start), 0)))
    rows = np.zeros((n + start[-1], 3 + CHARGES))
    rows[:n, :3], rows[n:, :3] = tree.points, interpolation_points(tree, start)
    return rows, n + start


def gather(tree: SourceTree, rows: FloatArray, start: IntArray) -> Charges:
    """:class:`Charges` from ``rows`` and ``start`` of :func:`charge_rows`, with the charges of the sources."""
    source = rows[: len(tree.order), 3:]
    charged = np.append(0, np.cumsum(source.any(axis=1)))
    active = charged[tree.span[:, 1]] > charged[tree.span[:, 0]]
    cut = _portions(tree, start)
    for_chunks(lambda lo, hi: gather_charges(tree, rows, start, active, cut[lo], cut[hi]), len(cut) - 1, 1)
    return Charges(rows, start, tree.span, bool(source[:, [0, -1]].any()))


def _portions(tree: SourceTree, start: IntArray) -> IntArray:
    """First clusters of portions of about equal cost, and one past the last; clusters near the root cost most."""
    work = np.cumsum((tree.span[:, 1] - tree.span[:, 0]) * np.diff(start))
    inner = np.searchsorted(work, np.linspace(0.0, work[-1], _PORTIONS + 1)[1:-1], side="right")
    return np.unique(np.concatenate([[0], inner, [len(work)]]))


def cluster_reach(tree: SourceTree, strength: FloatArray, shift: FloatArray, turn: FloatArray) -> Reach:
    """:class:`Reach` of every cluster from the sources' strength, displacement and rotation (n,)."""
    # reduceat takes the spans as pairs of positions; the results between spans are discarded.
    places = tree.span.ravel()
    sums, most = np.append(strength[tree.order], 0.0), (np.append(each[tree.order], 0.0) for each in (shift, turn))
    spans = np.add.reduceat(sums, places), *(np.maximum.reduceat(each, places) for each in most)
    # Contiguous, as loops over slices with a step would be compiled once more.
    return Reach(*(np.ascontiguousarray(each[::2]) for each in spans))


@kernel
def add_totals(samples, tree, reach, function, total, moved):
    """Add to ``total`` (n,) the total weight at ``samples`` (n, 3), to ``moved`` (n,) a bound of the weighted
    displacement."""
    stack = np.empty(_STACK, np.int64)
    for s in range(samples.shape[0]):
        stack[0] = 0
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            d2 = distance2(samples, s, tree.boxes.center, c)
            extent2 = square(tree.boxes.half, c)
            if d2 > 2.0 * extent2 or tree.child[c] < 0:
                # A leaf that may contain the sample: the weight at its rim is a lower bound.
                w = reach.strength[c] * weight(max(d2, 0.25 * extent2), function)
                total[s] += w
                moved[s] += w * (reach.shift[c] + reach.turn[c] * math.sqrt(d2))
            else:
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2


class Places(NamedTuple):
    """Points at which the sums for some neighbouring regions are taken.

    Attributes
    ----------
    points : (n, 3) coordinates: the nodes of the bricks, then the interpolation points of regions and bricks
    span : (items, 2) int64, rows of ``points`` that belong to each list of :class:`.walk.Lists`
    """

    points: np.ndarray
    span: np.ndarray


def places_of(first: int, last: int, points: FloatArray, bricks: Bricks, regions: Regions) -> Places:
    """:class:`Places` of the regions first <= g < last; ``points`` (n_nodes, 3)."""
    ends = regions.first[first : last + 1]
    low, high = ends[0], ends[-1]
    start, proxy, region = (
        bricks.start[low : high + 1],
        bricks.boxes.proxy[low : high + 1],
        regions.boxes.proxy[first : last + 1],
    )
    x = np.concatenate(
        [points[bricks.targets[start[0] : start[-1]]], bricks.boxes.proxies[proxy[0] : proxy[-1]],
         regions.boxes.proxies[region[0] : region[-1]]]
    )  # fmt: skip
    start, proxy, region = start - start[0], proxy - proxy[0] + start[-1] - start[0], region - region[0]
    region = region + proxy[-1]
    # The list of a region precedes the two lists of each of its bricks.
    span = np.empty((last - first + 2 * (high - low), 2), dtype=np.int64)
    item = np.arange(last - first) + 2 * (ends[:-1] - low)
    span[item] = np.stack([region[:-1], region[1:]], axis=1)
    of_bricks = np.ones(len(span), dtype=bool)
    of_bricks[item] = False
    both = np.stack([proxy[:-1], proxy[1:], start[:-1], start[1:]], axis=1)
    span[of_bricks] = both.reshape(-1, 2)
    return Places(x, span)


def sum_lists(
    places: Places,
    tree: SourceTree,
    charges: Charges,
    lists: Lists,
    function: Kernel,
    acting: BoolArray,
    scale: Scale | None,
    out: FloatArray,
) -> BoolArray:
    """Weighted sums over the ``acting`` (m,) clusters of a tree at all places, added to ``out`` (n, 8).

    With a ``scale`` of all points, weights are in single precision and the same in both directions
    (:mod:`...exact.mixed`). Returns which lists (items,) hold any cluster.
    """
    number, raw = lists.codes >> 1, lists.codes & 1 == 1
    active = acting[number]
    number, raw = number[active], raw[active]
    # Rows of each list entry: those of a cluster's interpolation points, or of its sources.
    rows = np.where(raw, charges.span[number].T, np.stack([charges.start[number], charges.start[number + 1]])).T
    stop = np.append(0, np.cumsum(active))[np.append(0, lists.stop)]
    clusters = np.ascontiguousarray(rows), spans(stop)
    a, b, kappa, single = function
    if single:
        sum_groups_single(places.points, places.span, charges.rows, *clusters, a, kappa, charges.all, out)
    elif scale:
        sum_groups_mixed(places.points, places.span, charges.rows, *clusters, scale, a, kappa, charges.all, out)
    else:
        sum_groups(places.points, places.span, charges.rows, *clusters, a, b, kappa, charges.all, out)
    return stop[1:] > stop[:-1]


@kernel
def interpolate_sums(first, last, bricks, regions, places, filled, all_charges, sums):
    """Add to the sums at nodes those interpolated from the interpolation points of their region and brick.

    A region's sums are interpolated to the points of its bricks, and from there to the nodes; bricks of few nodes have
    no points. Without ``all_charges`` the first and the last column of ``sums`` are taken as zero.
    """
    low, high = (0, sums.shape[1]) if all_charges else (1, sums.shape[1] - 1)
    item = 0
    for g in range(first, last):
        region = item
        for b in range(regions.first[g], regions.first[g + 1]):
            few = few_nodes(bricks, b)
            filled[item + 1] = filled[item + 1] or (filled[region] and not few)
            # Both steps share one loop, so that the functions it calls are compiled once.
            for step in range(2):
                source, target = (region, item + 1 + few) if step == 0 else (item + 1, item + 2)
                if not filled[source] or (step == 1 and few):
                    continue
                boxes, box = (regions.boxes, g) if step == 0 else (bricks.boxes, b)
                _interpolate(
                    boxes, box, places.span[source, 0], low, high, places.points,
                    places.span[target, 0], places.span[target, 1], sums,
                )  # fmt: skip
            item += 2
        item += 1


@inlined
def _interpolate(boxes, b, m, low, high, points, first, last, sums):
    """Add to rows first <= t < last of ``sums`` those interpolated from the points of a box, the rows from ``m`` on."""
    per_side = boxes.per_side
    n, most = last - first, max(per_side[b, 0], per_side[b, 1], per_side[b, 2])
    share, total, product = np.empty((3 * most, n)), np.empty((high, n)), np.empty(n)
    shares_of_box(boxes, b, points, first, n, most, product, share)
    for c in range(low, high):
        for t in range(n):
            total[c, t] = 0.0
    for i in range(per_side[b, 0]):
        for j in range(per_side[b, 1]):
            for k in range(per_side[b, 2]):
                one, two, three = share[i], share[most + j], share[2 * most + k]
                for t in range(n):
                    product[t] = one[t] * two[t] * three[t]
                for c in range(low, high):
                    value, line = sums[m, c], total[c]
                    for t in range(n):
                        line[t] += value * product[t]
                m += 1
    for t in range(n):
        for c in range(low, high):
            sums[first + t, c] += total[c, t]


@inlined
def shares_of_box(boxes, b, points, start, n, most, product, share):
    """Lagrange polynomials along the three sides of a box at ``n`` points, into ``share`` (3 most, n).

    Those of side d begin at row d * most. ``product`` (n,) is overwritten.
    """
    node, weights, at = np.empty(most), np.empty(most), np.empty(n)
    for d in range(3):
        _shares(boxes, b, points, start, n, d, node, weights, at, product, share, d * most)


@inlined
def _shares(boxes, b, points, start, n, d, node, weights, at, product, share, first):
    """Lagrange polynomials along side ``d`` of a box at ``n`` points, in rows of ``share``, for vectorised loops."""
    center, axes, half, count = boxes.center, boxes.axes, boxes.half, boxes.per_side[b, d]
    chebyshev(count, node, weights)
    for t in range(n):
        at[t], product[t] = 0.0, 1.0
    if half[b, d] > 0.0:
        for e in range(3):
            factor, origin = axes[b, d, e] / half[b, d], center[b, e]
            for t in range(n):
                at[t] += factor * (points[start + t, e] - origin)
    for i in range(count):
        row = share[first + i]
        for t in range(n):
            row[t] = weights[i] * product[t]
            product[t] *= at[t] - node[i]
    for t in range(n):
        product[t] = 1.0
    for i in range(count - 1, -1, -1):
        row = share[first + i]
        for t in range(n):
            row[t] *= product[t]
            product[t] *= at[t] - node[i]
