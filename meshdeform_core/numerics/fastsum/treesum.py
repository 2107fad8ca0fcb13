"""Fast sums of functions of distance: clusters of sources seen from bricks of target nodes.

:mod:`.walk` lists which clusters act on the interpolation points of a region of bricks, on those of a brick and on its
nodes. Here the lists are summed; results are interpolated from the region to its bricks and from these to their nodes.

In a weighted mean (eq. 14) numerator and denominator use the same approximate weights, so its error is the error of the
weights times the *difference* of a cluster's displacement from the mean: a common motion is exact.

Source: barycentric cluster-cluster treecodes (Wang, Krasny, Tlupova 2020), with two levels of targets and the
acceptance of a weighted mean.
"""

import math
from typing import NamedTuple

import numpy as np

from ..exact.direct import sum_block
from ..exact.single import sum_block_single
from ..jit import inlined, kernel
from .acceptance import distance2, square, weight
from .boxes import box_points, chebyshev
from .tree import SourceTree, gather_charges
from .walk import Reach, few_nodes

_STACK = 256


class Charges(NamedTuple):
    """Charges (columns: strength, strength times values) of sources in tree order and of interpolation points.

    ``active`` (m,): whether a cluster has a source with any charge at all; the others are passed over.
    """

    source: np.ndarray
    proxy: np.ndarray
    active: np.ndarray


def gather(tree: SourceTree, source) -> Charges:
    """:class:`Charges` from those of the sources in tree order (n, columns)."""
    charged = np.append(0, np.cumsum(source.any(axis=1)))
    active = charged[tree.span[:, 1]] > charged[tree.span[:, 0]]
    proxy = np.empty((len(tree.proxies), source.shape[1]))
    gather_charges(tree, source, proxy, active)
    return Charges(source, proxy, active)


def cluster_reach(tree: SourceTree, strength, shift, turn):
    """:class:`Reach` of every cluster from the sources' strength, displacement and rotation (n,)."""
    m = len(tree.span)
    reach = Reach(np.empty(m), np.empty(m), np.empty(m))
    _reduce(tree.span, strength[tree.order], shift[tree.order], turn[tree.order], *reach)
    return reach


@kernel
def _reduce(span, strength, shift, turn, total, largest_shift, largest_turn):
    for c in range(span.shape[0]):
        total[c] = largest_shift[c] = largest_turn[c] = 0.0
        for s in range(span[c, 0], span[c, 1]):
            total[c] += strength[s]
            largest_shift[c] = max(largest_shift[c], shift[s])
            largest_turn[c] = max(largest_turn[c], turn[s])


@kernel
def add_totals(samples, tree, reach, function, total, moved):
    """Total weight and weighted displacement bound at sample points (n, 3), added to ``total`` and ``moved`` (n,)."""
    stack = np.empty(_STACK, np.int64)
    for s in range(samples.shape[0]):
        stack[0] = 0
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            d2 = distance2(samples, s, tree.center, c)
            extent2 = square(tree.half, c)
            if d2 > 2.0 * extent2 or tree.child[c] < 0:
                # A leaf around the sample: its weight as if at the rim, which is less than it is.
                w = reach.strength[c] * weight(max(d2, 0.25 * extent2), function)
                total[s] += w
                moved[s] += w * (reach.shift[c] + reach.turn[c] * math.sqrt(d2))
            else:
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2


@kernel
def sum_weights(first, last, points, bricks, regions, tree, charges, lists, function, out):
    """Weighted sums (n, 8) at the targets of regions ``first`` to ``last``, added to ``out`` (bricks' order).

    ``points`` (n_nodes, 3); ``lists`` from :func:`.walk.list_clusters`.
    """
    columns = charges.source.shape[1]
    packed = np.empty((3 + columns, _longest(lists, tree)))
    # Not plain zeros, for which the functions that take them would be compiled apart.
    start = item = row = np.int64(0)
    for g in range(first, last):
        n = _pack(lists, start, item, tree, charges, packed)
        local = regions.per_side[g, 0] * regions.per_side[g, 1] * regions.per_side[g, 2] if n else 0
        place, values = np.empty((local, 3)), _zeros(local, columns)
        if n:
            box_points(regions.center, regions.axes, regions.half, regions.per_side, g, place)
            _weights(place, packed, n, function, values)
        start = lists.stop[item]
        item += 1
        for b in range(regions.first[g], regions.first[g + 1]):
            x = _gather(points, bricks, b)
            sums = out[row : row + x.shape[0]]
            row += x.shape[0]
            middle = lists.stop[item]
            n = _pack(lists, middle, item + 1, tree, charges, packed)
            _weights(x, packed, n, function, sums)
            if not few_nodes(bricks, b):
                spots = bricks.proxies[bricks.proxy[b] : bricks.proxy[b + 1]]
                inner = _zeros(spots.shape[0], columns)
                n = _pack(lists, start, item, tree, charges, packed)
                _weights(spots, packed, n, function, inner)
                _interpolate(regions.center, regions.axes, regions.half, regions.per_side, g, values, spots, inner)
                _interpolate(bricks.center, bricks.axes, bricks.half, bricks.per_side, b, inner, x, sums)
            else:
                _interpolate(regions.center, regions.axes, regions.half, regions.per_side, g, values, x, sums)
            start = lists.stop[item + 1]
            item += 2


@kernel
def _weights(targets, packed, n, function, out):
    if function.single:
        sum_block_single(targets, packed, n, function.kappa, out)
    else:
        sum_block(targets, packed, n, function.a, function.b, function.kappa, out)


@inlined
def _longest(lists, tree):
    """Sources and interpolation points in the longest list."""
    longest = at = 0
    for item in range(lists.stop.size):
        total = 0
        for n in range(at, lists.stop[item]):
            c = lists.codes[n] >> 1
            total += tree.span[c, 1] - tree.span[c, 0] if lists.codes[n] & 1 else tree.proxy[c + 1] - tree.proxy[c]
        longest, at = max(longest, total), lists.stop[item]
    return longest


@kernel
def _pack(lists, start, item, tree, charges, packed):
    """Coordinates and charges of what a list names, in the rows of ``packed``; returns how many."""
    n = 0
    for at in range(start, lists.stop[item]):
        c = lists.codes[at] >> 1
        if not charges.active[c]:
            continue
        if lists.codes[at] & 1:
            n = _append(tree.points, charges.source, tree.span[c, 0], tree.span[c, 1], packed, n)
        else:
            n = _append(tree.proxies, charges.proxy, tree.proxy[c], tree.proxy[c + 1], packed, n)
    return n


@inlined
def _append(points, charges, first, last, packed, n):
    for s in range(first, last):
        for d in range(3):
            packed[d, n] = points[s, d]
        charged = False
        for k in range(charges.shape[1]):
            packed[3 + k, n] = charges[s, k]
            charged = charged or charges[s, k] != 0.0
        # One without charge is overwritten by the next.
        n += 1 if charged else 0
    return n


@inlined
def _zeros(rows, columns):
    values = np.empty((rows, columns))
    for n in range(rows):
        for k in range(columns):
            values[n, k] = 0.0
    return values


@inlined
def _gather(points, bricks, b):
    first = bricks.start[b]
    x = np.empty((bricks.start[b + 1] - first, 3))
    for n in range(x.shape[0]):
        for d in range(3):
            x[n, d] = points[bricks.targets[first + n], d]
    return x


@kernel
def _interpolate(center, axes, half, per_side, b, values, x, sums):
    """Add to ``sums`` (n, columns) at points ``x`` (n, 3) what ``values`` at the box's interpolation points give."""
    columns, n = values.shape[1], x.shape[0]
    if values.shape[0] == 0:
        return
    most = max(per_side[b, 0], per_side[b, 1], per_side[b, 2])
    share, total, product = np.empty((3 * most, n)), np.empty((columns, n)), np.empty(n)
    node, weights, at = np.empty(most), np.empty(most), np.empty(n)
    for d in range(3):
        _shares(center, axes, half, per_side[b, d], b, x, d, node, weights, at, product, share, d * most)
    for c in range(columns):
        for t in range(n):
            total[c, t] = 0.0
    m = 0
    for i in range(per_side[b, 0]):
        for j in range(per_side[b, 1]):
            for k in range(per_side[b, 2]):
                one, two, three = share[i], share[most + j], share[2 * most + k]
                for t in range(n):
                    product[t] = one[t] * two[t] * three[t]
                for c in range(columns):
                    value, line = values[m, c], total[c]
                    for t in range(n):
                        line[t] += value * product[t]
                m += 1
    for t in range(n):
        for c in range(columns):
            sums[t, c] += total[c, t]


@inlined
def _shares(center, axes, half, count, b, x, d, node, weights, at, product, share, first):
    """Lagrange polynomials along one side of a box at ``x`` (n, 3), in rows of ``share``: vector loops over points."""
    n = x.shape[0]
    chebyshev(count, node, weights)
    for t in range(n):
        at[t], product[t] = 0.0, 1.0
    if half[b, d] > 0.0:
        for e in range(3):
            factor, origin = axes[b, d, e] / half[b, d], center[b, e]
            for t in range(n):
                at[t] += factor * (x[t, e] - origin)
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
