"""Fast sums of functions of distance: clusters of sources seen from bricks of target nodes.

For every region of bricks the tree of sources is walked from the top. A cluster that is far away, for the accuracy that
its part of the sum needs, gives its interpolation points as sources, which act on the region's interpolation points.
What is too near for that is walked for every brick: clusters act on the brick's interpolation points, or on its nodes,
and the rest is summed exactly. Results are interpolated from the region to its bricks and from these to their nodes.

In a weighted mean (eq. 14) numerator and denominator use the same approximate weights, so its error is the error of the
weights times the *difference* of a cluster's displacement from the mean: a common motion is exact.

Source: barycentric cluster-cluster treecodes (Wang, Krasny, Tlupova 2020), with two levels of targets and the
acceptance of a weighted mean.
"""

import math
from typing import NamedTuple

import numpy as np

from ..direct import sum_block
from ..jit import kernel
from ..radial import radial_block
from .acceptance import distance2, error_on_box, error_on_nodes, out_of_reach, square, weight
from .boxes import box_points, chebyshev
from .tree import SourceTree

_STACK = 256


class Reach(NamedTuple):
    """How much a cluster can do, for error bounds: strength times (shift + turn * distance + mean of the brick).

    Attributes
    ----------
    strength : (m,) total strength of each cluster
    shift, turn : (m,) largest displacement and rotation angle (radians) of its sources; 1 and 0 for plain sums
    """

    strength: np.ndarray
    shift: np.ndarray
    turn: np.ndarray


class Charges(NamedTuple):
    """Charges (columns: strength, strength times values) of sources in tree order and of interpolation points."""

    source: np.ndarray
    proxy: np.ndarray


def cluster_reach(tree: SourceTree, strength, shift, turn):
    """:class:`Reach` of every cluster from the sources' strength, displacement and rotation (n,)."""
    m = len(tree.span)
    reach = Reach(np.empty(m), np.empty(m), np.empty(m))
    _reduce(tree.span, strength[tree.order], shift[tree.order], turn[tree.order], *reach)
    return reach


@kernel
def _reduce(span, strength, shift, turn, total, largest_shift, largest_turn):
    for c in range(span.shape[0]):
        lo, hi = span[c]
        total[c] = strength[lo:hi].sum()
        largest_shift[c] = shift[lo:hi].max()
        largest_turn[c] = turn[lo:hi].max()


@kernel
def add_totals(samples, tree, reach, function, total, moved):
    """Total weight and weighted displacement bound at sample points (n, 3), added to ``total`` and ``moved`` (n,)."""
    stack = np.empty(_STACK, dtype=np.int64)
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
def sum_regions(first, last, points, bricks, regions, tree, reach, charges, function, allowed, mean, out, risk):
    """Sums (n, columns) at the targets of regions ``first`` to ``last``, added to ``out`` (bricks' order).

    Parameters
    ----------
    points : (n_nodes, 3)
    allowed : (b,) error of the sums that one cluster may cause in a brick
    mean : (b,) bound of the mean displacement there
    out : (targets of these regions, columns of the charges)
    risk : (b,) the sum of the error bounds of all clusters, relative to ``allowed``, is added
    """
    n = tree.points.shape[0] + tree.proxies.shape[0]
    columns = charges.source.shape[1]
    far, near = np.empty((3 + columns, n)), np.empty((3 + columns, n))
    left = np.empty(tree.span.shape[0], dtype=np.int64)
    row = 0
    for g in range(first, last):
        own = slice(regions.first[g], regions.first[g + 1])
        n_far, n_left, bound = _look_from_region(
            g, regions, tree, reach, charges, function, allowed[own].min(), mean[own].max(), far, left
        )
        values = _at_region(g, regions, far, n_far, columns, function)
        for b in range(own.start, own.stop):
            x = points[bricks.targets[bricks.start[b] : bricks.start[b + 1]]]
            sums = out[row : row + x.shape[0]]
            row += x.shape[0]
            # Few targets need no interpolation points of their own.
            few = x.shape[0] <= 2 * (bricks.proxy[b + 1] - bricks.proxy[b])
            n_far_brick, n_near, more = _look_from_brick(
                b, bricks, left[:n_left], tree, reach, charges, function, allowed[b], mean[b], few, far, near
            )
            risk[b] += bound + more
            _sum(x, near, n_near, function, sums)
            if few:
                _interpolate(g, regions, values, x, sums)
                continue
            place = bricks.proxies[bricks.proxy[b] : bricks.proxy[b + 1]]
            inner = np.zeros((place.shape[0], columns))
            _sum(place, far, n_far_brick, function, inner)
            _interpolate(g, regions, values, place, inner)
            _interpolate(b, bricks, inner, x, sums)


@kernel
def _pull(c, reach, distance, mean, allowed):
    """What a cluster does to the mean if its weights are wrong by one, relative to what it may do."""
    return reach.strength[c] * (reach.shift[c] + reach.turn[c] * distance + mean) / allowed


@kernel
def _look_from_region(g, regions, tree, reach, charges, function, allowed, mean, far, left):
    """Walk the tree for one region: what acts on its interpolation points, and the clusters left to its bricks."""
    stack = np.empty(_STACK, dtype=np.int64)
    stack[0] = 0
    depth = 1
    n_far = n_left = 0
    bound = 0.0
    while depth:
        depth -= 1
        c = stack[depth]
        if out_of_reach(regions, g, tree, c, function):
            continue
        raw = tree.proxy[c + 1] == tree.proxy[c]
        pull = _pull(c, reach, math.sqrt(distance2(regions.center, g, tree.center, c)), mean, allowed)
        error = error_on_box(regions, g, tree, c, raw, function)
        if pull * error < 0.5:
            bound += pull * error
            n_far = _append(tree, charges, c, raw, far, n_far)
        elif tree.child[c] >= 0 and not raw and square(tree.half, c) > square(regions.half, g):
            stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
            depth += 2
        else:
            left[n_left] = c
            n_left += 1
    return n_far, n_left, bound


@kernel
def _look_from_brick(b, bricks, left, tree, reach, charges, function, allowed, mean, few, far, near):
    """Walk what its region left: what acts on the brick's interpolation points (far) and on its nodes (near)."""
    stack = np.empty(_STACK, dtype=np.int64)
    n_far = n_near = 0
    bound = 0.0
    for top in left:
        stack[0] = top
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            if out_of_reach(bricks, b, tree, c, function):
                continue
            raw = tree.proxy[c + 1] == tree.proxy[c]
            pull = _pull(c, reach, math.sqrt(distance2(bricks.center, b, tree.center, c)), mean, allowed)
            if not few:
                error = error_on_box(bricks, b, tree, c, raw, function)
                if pull * error < 0.5:
                    bound += pull * error
                    n_far = _append(tree, charges, c, raw, far, n_far)
                    continue
            error = error_on_nodes(bricks, b, tree, c, raw, function)
            if pull * error < 0.5:
                bound += pull * error
                n_near = _append(tree, charges, c, raw, near, n_near)
            elif tree.child[c] >= 0 and not raw:
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2
            else:
                n_near = _append(tree, charges, c, True, near, n_near)
    return n_far, n_near, bound


@kernel
def _at_region(g, regions, far, n_far, columns, function):
    """Sums (points, columns) at the interpolation points of a region; none if nothing acts there."""
    count = regions.per_side[g]
    local = count[0] * count[1] * count[2] if n_far else 0
    place, values = np.empty((local, 3)), np.zeros((local, columns))
    if n_far:
        box_points(regions.center[g], regions.axes[g], regions.half[g], count, place)
        _sum(place, far, n_far, function, values)
    return values


@kernel
def _sum(targets, packed, n, function, out):
    if function.basis < 0:
        sum_block(targets, packed, n, function.a, function.b, function.kappa, out)
    else:
        radial_block(function.basis, targets, packed, n, out)


@kernel
def _append(tree, charges, c, raw, packed, n):
    """Append the sources or the interpolation points of a cluster to packed columns; returns the new length."""
    if raw:
        return _pack(tree.points, charges.source, tree.span[c, 0], tree.span[c, 1], packed, n)
    return _pack(tree.proxies, charges.proxy, tree.proxy[c], tree.proxy[c + 1], packed, n)


@kernel
def _pack(points, charges, first, last, packed, n):
    for s in range(first, last):
        for d in range(3):
            packed[d, n] = points[s, d]
        for k in range(charges.shape[1]):
            packed[3 + k, n] = charges[s, k]
        n += 1
    return n


@kernel
def _interpolate(b, boxes, values, x, sums):
    """Add to ``sums`` (n, columns) at points ``x`` (n, 3) what ``values`` at the box's interpolation points give."""
    columns, n = values.shape[1], x.shape[0]
    if values.shape[0] == 0:
        return
    count = boxes.per_side[b]
    share = np.empty((3, count.max(), n))
    for d in range(3):
        _shares(b, boxes, x, d, share[d])
    total, product = np.zeros((columns, n)), np.empty(n)
    m = 0
    for i in range(count[0]):
        for j in range(count[1]):
            for k in range(count[2]):
                for t in range(n):
                    product[t] = share[0, i, t] * share[1, j, t] * share[2, k, t]
                for c in range(columns):
                    value = values[m, c]
                    for t in range(n):
                        total[c, t] += value * product[t]
                m += 1
    for t in range(n):
        for c in range(columns):
            sums[t, c] += total[c, t]


@kernel
def _shares(b, boxes, x, d, share):
    """Lagrange polynomials (points, n) along one side of a box at ``x`` (n, 3): vector loops over the points."""
    n, n_points = boxes.per_side[b, d], x.shape[0]
    node, weights, at, product = np.empty(n), np.empty(n), np.zeros(n_points), np.ones(n_points)
    chebyshev(n, node, weights)
    if boxes.half[b, d] > 0.0:
        for e in range(3):
            factor, origin = boxes.axes[b, d, e] / boxes.half[b, d], boxes.center[b, e]
            for t in range(n_points):
                at[t] += factor * (x[t, e] - origin)
    for i in range(n):
        for t in range(n_points):
            share[i, t] = weights[i] * product[t]
            product[t] *= at[t] - node[i]
    product[:] = 1.0
    for i in range(n - 1, -1, -1):
        for t in range(n_points):
            share[i, t] *= product[t]
            product[t] *= at[t] - node[i]
