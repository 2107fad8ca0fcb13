"""Loops over target trees: sums of clusters at targets, and their transpose.

Clusters of centres act by their skeletons (:mod:`.skeletons`). For a group of targets far from a cluster, the cluster's
effect is a polynomial on the box of the group, which the group's parts inherit (:mod:`.polynomials`). Clusters that are
too near for that act on the targets directly. The transpose traverses the same trees in the opposite direction:
gradients are passed from nodes to polynomials (leaves to root), from polynomials to skeletons, and from skeletons to
centres (root to leaves).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...exact.radial import radial_block
from ...jit import inlined, kernel, record
from ..clusters.target_tree import TargetTree
from ..tuned import REACH
from .nested import Bases, pack, scatter_down, spread
from .polynomials import GROWTH, NEAREST, Spaces, add_polynomial, add_transposed, place_points, to_coefficients

_DEPTH = 32
_STACK = 512


@record("TargetTree, Spaces, i8[::1], f8[::1], b1[::1]", TargetTree, Spaces)
class Boxes(NamedTuple):
    """The boxes of a target tree with their spaces of polynomials.

    ``allowed`` (m,) is the error that one cluster may cause in each box, in the unit of ``Spaces.error``; boxes not
    ``wanted`` (m,) are skipped.
    """

    tree: TargetTree
    spaces: Spaces
    space: np.ndarray
    allowed: np.ndarray
    wanted: np.ndarray


@record("b1, f8[:, ::1], f8[::1], i8[::1], i8[:, ::1], f8[:, ::1], Bases, f8[:, ::1], f8[:, ::1], f8[::1]", Bases)
class Clusters(NamedTuple):
    """Clusters of centres with their skeletons.

    Attributes
    ----------
    compact : the basis function vanishes from distance 1 on
    center, radius, child, span, points : of the tree, see :class:`..clusters.tree.SourceTree`
    bases : skeletons
    charges, upper : (n, 3) charges of the centres in the tree's order, (s, 3) of the skeletons
    strength : (m,) root of the sum of squares of the charges of each skeleton
    """

    compact: bool
    center: np.ndarray
    radius: np.ndarray
    child: np.ndarray
    span: np.ndarray
    points: np.ndarray
    bases: Bases
    charges: np.ndarray
    upper: np.ndarray
    strength: np.ndarray


@kernel("i8, i8, i8, f8[:, ::1], Boxes, Clusters, f8[:, ::1], f8[::1]", Boxes, Clusters)
def sum_regions(kind, lo, hi, points, boxes, clusters, out, risk):
    """Sums (n, 3) at the targets of regions ``lo`` to ``hi``, added to ``out``."""
    tree, spaces = boxes.tree, boxes.spaces
    total = clusters.points.shape[0] + clusters.bases.points.shape[0]
    far, near = np.empty((6, total)), np.empty((6, total))
    left = np.empty((_DEPTH, clusters.child.size), dtype=np.int64)
    n_left, known = np.zeros(_DEPTH, dtype=np.int64), np.zeros(_DEPTH, dtype=np.bool_)
    polynomial = np.empty((_DEPTH, np.diff(spaces.start).max(), 3))
    stack = np.empty((_DEPTH, 3), dtype=np.int64)
    origin = tree.span[tree.region[lo], 0]
    # Level 0 is above the root of the target tree; it leaves the cluster of all centres to the root.
    left[0, 0], n_left[0] = 0, 1
    for g in range(lo, hi):
        stack[0, 0], stack[0, 1], stack[0, 2] = tree.region[g], 1, -1
        depth = 1
        while depth:
            depth -= 1
            n, level, parent = stack[depth]
            if not boxes.wanted[n] or tree.span[n, 0] == tree.span[n, 1]:
                continue
            tops = left[level - 1, : n_left[level - 1]]
            n_far, n_near, n_left[level] = _look(n, boxes, tops, clusters, far, near, left[level], risk)
            known[level] = n_far > 0 or known[level - 1]
            if known[level]:
                if not known[level - 1]:
                    parent = -1
                _fill(kind, n, boxes, far, n_far, parent, polynomial[level - 1], polynomial[level])
            if tree.child[n, 0] < 0:
                x = points[tree.targets[tree.span[n, 0] : tree.span[n, 1]]]
                sums = out[tree.span[n, 0] - origin : tree.span[n, 1] - origin]
                radial_block(kind, x, near, n_near, sums)
                if known[level]:
                    _add(n, boxes, polynomial[level], x, sums)
                continue
            for c in range(2):
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = tree.child[n, 1 - c], level + 1, n
                depth += 1


@kernel
def _fill(kind, n, boxes, far, n_far, parent, inherited, polynomial):
    """Coefficients of the polynomial of a target tree node: what it inherits, if anything, plus its far clusters."""
    tree, spaces, s = boxes.tree, boxes.spaces, boxes.space[n]
    first, last = spaces.start[s], spaces.start[s + 1]
    place, value = np.empty((last - first, 3)), np.zeros((last - first, 3))
    place_points(tree.center[n], tree.axes[n], tree.half[n], spaces.points[first:last], place)
    radial_block(kind, place, far, n_far, value)
    if parent >= 0:
        _add(parent, boxes, inherited, place, value)
    to_coefficients(spaces.matrix, spaces.begin[s], value, polynomial)


@kernel
def _add(n, boxes, polynomial, x, out):
    """Add the values of the polynomial of a target tree node at points (k, 3)."""
    tree, spaces, s = boxes.tree, boxes.spaces, boxes.space[n]
    degree = spaces.degree[spaces.start[s] : spaces.start[s + 1]]
    add_polynomial(tree.center[n], tree.axes[n], tree.half[n], degree, polynomial, x, out)


@inlined
def _square(x, i):
    """Squared length of row ``i`` of ``x`` (n, 3), without a view of the row, whose reference count would cost more."""
    return x[i, 0] ** 2 + x[i, 1] ** 2 + x[i, 2] ** 2


@inlined
def _distance2(x, i, y, j):
    """Squared distance of row ``i`` of ``x`` (n, 3) from row ``j`` of ``y`` (m, 3)."""
    return (x[i, 0] - y[j, 0]) ** 2 + (x[i, 1] - y[j, 1]) ** 2 + (x[i, 2] - y[j, 2]) ** 2


@kernel
def _error(error, distance, radius):
    """Error of a box's polynomial for a unit charge at a distance from its middle, in the unit of ``Spaces.error``."""
    if distance <= NEAREST * radius:
        return np.inf
    n = int(np.log(distance / (NEAREST * max(radius, 1e-300))) / np.log(GROWTH))
    return error[min(n, error.size - 1)]


@kernel
def _look(n, boxes, tops, clusters, far, near, left, risk):
    """Sort the clusters that the parent of a target tree node has left: those that act on the node's polynomial (far),
    those that act on its targets (near, in leaves only), and those left to its children."""
    tree, child = boxes.tree, clusters.child
    stack = np.empty(_STACK, dtype=np.int64)
    n_far = n_near = n_left = 0
    s = boxes.space[n]
    leaf = tree.child[n, 0] < 0
    # With fewer targets than coefficients, a polynomial does not pay.
    few = leaf and tree.span[n, 1] - tree.span[n, 0] <= boxes.spaces.start[s + 1] - boxes.spaces.start[s]
    own = np.sqrt(_square(tree.half, n))
    for top in tops:
        stack[0] = top
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            radius, d = clusters.radius[c], np.sqrt(_distance2(tree.center, n, clusters.center, c))
            if clusters.compact and d >= 1.0 + own + radius:
                continue
            smooth = not clusters.compact or d + own + radius <= 1.0
            seen = smooth and d - own >= REACH * radius
            pull = np.inf
            if smooth and not few:
                pull = clusters.strength[c] * _error(boxes.spaces.error[s], d - radius, own) / boxes.allowed[n]
            if pull <= 1.0 and (seen or child[c] < 0):
                risk[n] += pull
                n_far = _act(c, seen, clusters, far, n_far)
            elif leaf and (seen or child[c] < 0):
                n_near = _act(c, seen, clusters, near, n_near)
            elif child[c] >= 0 and (leaf or radius > own):
                stack[depth], stack[depth + 1] = child[c], child[c] + 1
                depth += 2
            else:
                left[n_left] = c
                n_left += 1
    return n_far, n_near, n_left


@kernel
def _act(c, seen, clusters, packed, n):
    """Append the skeleton of a cluster, if it is ``seen`` from afar, or else its centres."""
    if seen:
        start = clusters.bases.start
        return pack(clusters.bases.points, clusters.upper, start[c], start[c + 1], packed, n)
    return pack(clusters.points, clusters.charges, clusters.span[c, 0], clusters.span[c, 1], packed, n)


@kernel("i8[::1], i8[:, ::1], Bases, f8[:, ::1], f8[:, ::1]", Bases)
def scatter_to_centres(child, span, bases, upper, charges):
    """Transpose of :func:`.nested.gather_up`: add to the gradients of ``charges`` (n, 3) those of the skeletons."""
    scatter_down(child, bases, upper)
    for c in range(child.size):
        if child[c] < 0:
            spread(c, span[c, 0], bases, upper, charges)


@kernel("i8, i8, f8[:, ::1], Boxes, Clusters, f8[:, ::1], f8[:, ::1]", Boxes, Clusters)
def spread_region(kind, region, points, boxes, clusters, gradient, out):
    """Transpose of :func:`sum_regions` for one region: add to ``out`` (n + m, 3), the gradients of centres and
    skeletons, those that follow from the ``gradient`` (k, 3) of its targets.

    The charges of ``clusters`` are row numbers of ``out``.
    """
    tree = boxes.tree
    total = out.shape[0]
    far, near = np.empty((6, total)), np.empty((6, total))
    left = np.empty((_DEPTH, clusters.child.size), dtype=np.int64)
    n_left, known = np.zeros(_DEPTH, dtype=np.int64), np.zeros(_DEPTH, dtype=np.bool_)
    polynomial = np.zeros((_DEPTH, np.diff(boxes.spaces.start).max(), 3))
    stack = np.empty((2 * _DEPTH, 3), dtype=np.int64)
    risk = np.zeros(boxes.allowed.size)
    origin = tree.span[tree.region[region], 0]
    left[0, 0], n_left[0] = 0, 1
    stack[0, 0], stack[0, 1], stack[0, 2] = tree.region[region], 1, 0
    depth = 1
    while depth:
        depth -= 1
        n, level, leaving = stack[depth]
        if tree.span[n, 0] == tree.span[n, 1]:
            continue
        tops = left[level - 1, : n_left[level - 1]]
        n_far, n_near, n_left[level] = _look(n, boxes, tops, clusters, far, near, left[level], risk)
        leaf = tree.child[n, 0] < 0
        if not leaving:
            known[level] = n_far > 0 or known[level - 1]
            polynomial[level] = 0.0
            if not leaf:
                # Push the node again: it is finished after its children.
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = n, level, 1
                for c in range(2):
                    stack[depth + 1 + c, 0], stack[depth + 1 + c, 1] = tree.child[n, c], level + 1
                    stack[depth + 1 + c, 2] = 0
                depth += 3
                continue
            x = points[tree.targets[tree.span[n, 0] : tree.span[n, 1]]]
            given = gradient[tree.span[n, 0] - origin : tree.span[n, 1] - origin]
            _spread_sums(kind, x, given, near, n_near, out)
            if known[level]:
                _collect(n, boxes, x, given, polynomial[level])
        if not known[level]:
            continue
        place, value = _at_points(n, boxes, polynomial[level])
        _spread_sums(kind, place, value, far, n_far, out)
        if known[level - 1]:
            # Pass the gradient on to the polynomial of the parent's box.
            _collect(_parent(n, level, stack, depth), boxes, place, value, polynomial[level - 1])


@kernel
def _at_points(n, boxes, polynomial):
    """Interpolation points (m, 3) of a tree node's box, and the gradients (m, 3) there that follow from the gradient of
    its ``polynomial`` (m, 3)."""
    tree, spaces, s = boxes.tree, boxes.spaces, boxes.space[n]
    first, m = spaces.start[s], spaces.start[s + 1] - spaces.start[s]
    place, value = np.empty((m, 3)), np.zeros((m, 3))
    place_points(tree.center[n], tree.axes[n], tree.half[n], spaces.points[first : first + m], place)
    for i in range(m):
        for j in range(m):
            w = spaces.matrix[spaces.begin[s] + i * m + j]
            for d in range(3):
                value[j, d] += w * polynomial[i, d]
    return place, value


@kernel
def _parent(n, level, stack, depth):
    """The tree node one level up that is on the stack until its children are finished."""
    for at in range(depth - 1, -1, -1):
        if stack[at, 2] == 1 and stack[at, 1] == level - 1:
            return stack[at, 0]
    return -1


@kernel
def _collect(n, boxes, x, gradient, out):
    """Add to the gradient of the polynomial of target tree node ``n`` that of its values at points ``x`` (k, 3)."""
    tree, spaces, s = boxes.tree, boxes.spaces, boxes.space[n]
    degree = spaces.degree[spaces.start[s] : spaces.start[s + 1]]
    add_transposed(tree.center[n], tree.axes[n], tree.half[n], degree, x, gradient, out)


@kernel
def _spread_sums(kind, x, gradient, packed, n, out):
    """Add to the rows of ``out`` whose numbers ``packed`` (6, ...) holds instead of charges the sums over points ``x``
    (k, 3)."""
    if n == 0:
        return
    k = x.shape[0]
    source, given, sums = np.empty((n, 3)), np.empty((6, k)), np.zeros((n, 3))
    for s in range(n):
        for d in range(3):
            source[s, d] = packed[d, s]
    for t in range(k):
        for d in range(3):
            given[d, t], given[3 + d, t] = x[t, d], gradient[t, d]
    radial_block(kind, source, given, k, sums)
    for s in range(n):
        row = int(packed[3, s])
        for d in range(3):
            out[row, d] += sums[s, d]
