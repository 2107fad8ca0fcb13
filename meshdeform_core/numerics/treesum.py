"""Fast sums of functions of distance: clusters of sources seen from bricks of target nodes.

For every brick the tree of sources is walked from the top. A cluster that is far away, for the accuracy that its part
of the sum needs, gives its interpolation points as sources; if the brick is small against the distance too, they act on
the brick's interpolation points and the result is interpolated to its nodes. The rest is summed exactly.

In a weighted mean (eq. 14) numerator and denominator use the same approximate weights, so its error is the error of the
weights times the *difference* of a cluster's displacement from the mean: a common motion is exact.

Source: barycentric cluster-cluster treecodes (Wang, Krasny, Tlupova 2020), with the acceptance of a weighted mean.
"""

import math
from typing import NamedTuple

import numpy as np

from .basis import BASES
from .boxes import box_coordinate, box_points, chebyshev, interpolation_error, lagrange, radial_error
from .direct import sum_block
from .jit import kernel
from .radial import radial_block
from .tree import SourceTree

_STACK = 256
# How a cluster acts: on the interpolation points of the brick, on its nodes, or only through its parts.
_FAR, _NEAR, _OPEN = 2, 1, 0


class Kernel(NamedTuple):
    """A function of distance: a radial basis function by its number, or r^-a + kappa r^-b for ``basis`` -1.

    Attributes
    ----------
    basis : see :data:`.basis.BASES`; distances are in units of the support radius
    compact : the basis function vanishes from distance 1 on
    """

    basis: int
    compact: bool
    a: float
    b: float
    kappa: float


def inverse_powers(a, b, kappa):
    """Kernel r^-a + kappa r^-b of inverse distance weighting."""
    return Kernel(-1, False, float(a), float(b), float(kappa))


def radial_basis(kind):
    """Kernel of a radial basis function by its number."""
    return Kernel(kind, kind != BASES["tps"], 0.0, 0.0, 0.0)


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
            d2 = _distance2(samples[s], tree.center[c])
            extent2 = _square(tree.half[c])
            if d2 > 2.0 * extent2 or tree.child[c] < 0:
                # A leaf around the sample: its weight as if at the rim, which is less than it is.
                w = reach.strength[c] * _weight(max(d2, 0.25 * extent2), function)
                total[s] += w
                moved[s] += w * (reach.shift[c] + reach.turn[c] * math.sqrt(d2))
            else:
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2


@kernel
def sum_bricks(first, last, points, bricks, tree, reach, charges, function, allowed, mean, out, risk):
    """Sums (n, columns) at the targets of bricks ``first`` to ``last``, added to ``out`` (bricks' order).

    Parameters
    ----------
    points : (n_nodes, 3)
    allowed : (b,) error of the sums that one cluster may cause in a brick
    mean : (b,) bound of the mean displacement there
    out : (targets of these bricks, columns of the charges)
    risk : (b,) the sum of the error bounds of all clusters, relative to ``allowed``, is added
    """
    n = tree.points.shape[0] + tree.proxies.shape[0]
    rows = 3 + charges.source.shape[1]
    far, near = np.empty((rows, n)), np.empty((rows, n))
    row = 0
    for b in range(first, last):
        x = points[bricks.targets[bricks.start[b] : bricks.start[b + 1]]]
        sums = out[row : row + x.shape[0]]
        row += x.shape[0]
        n_far, n_near, bound = _collect(b, bricks, tree, reach, charges, function, allowed[b], mean[b], far, near)
        risk[b] += bound
        _sum(x, near, n_near, function, sums)
        if n_far:
            _add_far(b, bricks, x, far, n_far, function, sums)


@kernel
def _weight(distance2, function):
    r = math.sqrt(distance2)
    return r**-function.a + function.kappa * r**-function.b


@kernel
def _square(x):
    return x[0] ** 2 + x[1] ** 2 + x[2] ** 2


@kernel
def _distance2(x, y):
    return (x[0] - y[0]) ** 2 + (x[1] - y[1]) ** 2 + (x[2] - y[2]) ** 2


@kernel
def _collect(b, bricks, tree, reach, charges, function, allowed, mean, far, near):
    """Walk the tree for one brick: what acts on its interpolation points (far) and on its nodes (near)."""
    count, radius = bricks.per_side[b], math.sqrt(_square(bricks.half[b]))
    # Few targets need no interpolation points of their own.
    few = bricks.start[b + 1] - bricks.start[b] <= 2 * count[0] * count[1] * count[2]
    stack = np.empty(_STACK, dtype=np.int64)
    stack[0] = 0
    depth = 1
    n_far = n_near = 0
    bound = 0.0
    while depth:
        depth -= 1
        c = stack[depth]
        distance = math.sqrt(_distance2(bricks.center[b], tree.center[c]))
        extent = math.sqrt(_square(tree.half[c]))
        if function.compact and distance - radius - extent >= 1.0:
            continue
        raw = tree.proxy[c + 1] == tree.proxy[c]
        use = _OPEN
        if not function.compact or distance + radius + extent <= 1.0:
            pull = reach.strength[c] * (reach.shift[c] + reach.turn[c] * distance + mean) / allowed
            use, caused = _accept(b, c, bricks, tree, function, distance, radius, extent, pull, raw, few)
            bound += caused
        if use == _OPEN:
            if tree.child[c] >= 0 and not raw:
                stack[depth], stack[depth + 1] = tree.child[c], tree.child[c] + 1
                depth += 2
                continue
            raw = True
        if use == _FAR:
            n_far = _append(tree, charges, c, raw, far, n_far)
        else:
            n_near = _append(tree, charges, c, raw, near, n_near)
    return n_far, n_near, bound


@kernel
def _accept(b, c, bricks, tree, function, distance, radius, extent, pull, raw, few):
    """Whether a cluster may act on the brick's interpolation points or on its nodes, and the error that it causes.

    ``raw`` clusters act with their sources, others with their interpolation points.
    """
    if not few and distance > extent and (raw or distance > radius):
        error = _error(bricks.half[b], bricks.per_side[b], distance - extent, distance, function)
        if not raw:
            error = max(error, _error(tree.half[c], tree.per_side[c], distance, distance, function))
        if pull * error < 0.5:
            return _FAR, pull * error
    if not raw and distance > radius:
        error = _error(tree.half[c], tree.per_side[c], distance - radius, distance - radius, function)
        if pull * error < 0.5:
            return _NEAR, pull * error
    return _OPEN, 0.0


@kernel
def _sum(targets, packed, n, function, out):
    if function.basis < 0:
        sum_block(targets, packed, n, function.a, function.b, function.kappa, out)
    else:
        radial_block(function.basis, targets, packed, n, out)


@kernel
def _error(half, count, gap, distance, function):
    """Error of interpolating the function over a box: its shape judged at ``gap``, its size at ``distance``."""
    if function.basis >= 0:
        return radial_error(function.basis, half, count, gap)
    ratio = function.kappa * gap ** (function.a - function.b)
    steep = ratio / (1.0 + ratio)
    error = 0.0
    if steep < 0.99:
        error += (1.0 - steep) * interpolation_error(half, count, gap, function.a)
    if steep > 0.01:
        error += steep * interpolation_error(half, count, gap, function.b)
    return error * _weight(distance * distance, function)


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
def _add_far(b, bricks, x, far, n_far, function, sums):
    """Sums at the brick's interpolation points, interpolated to its targets and added."""
    count = bricks.per_side[b]
    local = count[0] * count[1] * count[2]
    place, values = np.empty((local, 3)), np.zeros((local, sums.shape[1]))
    box_points(bricks.center[b], bricks.axes[b], bricks.half[b], count, place)
    _sum(place, far, n_far, function, values)
    node, weight, value = np.empty((3, 32)), np.empty((3, 32)), np.empty((3, 32))
    for d in range(3):
        chebyshev(count[d], node[d], weight[d])
    for t in range(x.shape[0]):
        for d in range(3):
            at = box_coordinate(x[t], bricks.center[b], bricks.axes[b], bricks.half[b], d)
            lagrange(count[d], node[d], weight[d], at, value[d])
        n = 0
        for i in range(count[0]):
            for j in range(count[1]):
                product = value[0, i] * value[1, j]
                for k in range(count[2]):
                    factor = product * value[2, k]
                    for c in range(sums.shape[1]):
                        sums[t, c] += factor * values[n, c]
                    n += 1
