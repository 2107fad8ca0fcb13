"""Fast sums of radial basis functions as a linear map of the coefficients, with its transpose.

For derivatives: skeletons, polynomials and lists are chosen once, for a set of coefficients as rough as any of its
size, and never change. The transpose traverses the same trees in the opposite direction: gradients are passed from
nodes to polynomials (leaves to root), from polynomials to skeletons, and from skeletons to centres (root to leaves).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ....parallel import empty, for_chunks
from ...arrays import FloatArray, IntArray
from ...exact.radial import radial_block
from ...jit import kernel
from .nested import Bases, _scatter_down, _spread
from .polynomials import add_transposed, place_points
from .sums import DEPTH, Boxes, Clusters, FastRadial, look
from .targets import RadialTargets

_MOST_PORTIONS = 64


class FrozenRadial:
    """Sums at targets over centres (m, 3), for coefficients that grow no rougher than ``coefficients`` (m, 3).

    Parameters
    ----------
    kind, centres : as for :class:`.sums.FastRadial`
    targets : with points in the unit of the centres
    tolerance : error of the sums of ``coefficients``
    """

    def __init__(
        self, kind: int, centres: FloatArray, targets: RadialTargets, coefficients: FloatArray, tolerance: float
    ) -> None:
        self._kind, self._targets = kind, targets._replace(sizes=np.ones_like(targets.sizes))
        self._sums = FastRadial(kind, centres)
        self._clusters, self._boxes = self._sums.fitted(coefficients, self._targets, tolerance)
        size = 3 * (len(centres) + len(self._clusters.bases.place))
        regions = len(targets.tree.region) - 1
        # The sums of all portions together are no larger than the coordinates.
        self._portions = int(np.clip(3 * len(targets.points) // size, 1, min(_MOST_PORTIONS, regions)))

    def push(self, coefficients: FloatArray, use: Callable[[IntArray, FloatArray], object]) -> FloatArray:
        """Call ``use`` with sums (k, 3) and the flat indices (k,) of their nodes.

        Returns a bound (b,) of the error in each leaf, in arbitrary units: leaves can be compared with each other.
        """
        clusters, targets = self._sums.charged(self._clusters, coefficients), self._targets
        risk = np.zeros(len(self._boxes.allowed))

        def work(lo: int, hi: int) -> None:
            use(targets.flat(lo, hi), self._sums.of_regions(lo, hi, targets, self._boxes, clusters, risk))

        for_chunks(work, len(targets.tree.region) - 1, 1)
        return risk[targets.leaves]

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (m, 3) of the coefficients from that of the nodes (n_nodes, 3)."""
        targets, clusters = self._targets, self._clusters
        n, total = len(clusters.points), len(clusters.bases.place)
        # Row numbers take the place of charges, so that lists say which centres and skeletons they hold.
        number = np.zeros((n + total, 3))
        number[:, 0] = np.arange(n + total)
        numbered = clusters._replace(charges=number[:n], upper=number[n:])
        cut = np.linspace(0, len(targets.tree.region) - 1, self._portions + 1).astype(np.int64)
        parts = empty((self._portions, n + total, 3))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                parts[portion] = 0.0
                for region in range(cut[portion], cut[portion + 1]):
                    given = np.ascontiguousarray(gradient[targets.flat(region, region + 1)])
                    spread_region(self._kind, region, targets.points, self._boxes, numbered, given, parts[portion])

        for_chunks(work, self._portions, 1)
        whole = np.asarray(sum(parts[portion] for portion in range(self._portions)))
        charges, upper = whole[:n].copy(), whole[n:].copy()
        scatter_to_centres(clusters.child, clusters.span, clusters.bases, upper, charges)
        found = np.empty_like(charges)
        found[self._sums.order] = charges
        return found


@kernel("i8[::1], i8[:, ::1], Bases, f8[:, ::1], f8[:, ::1]", Bases)
def scatter_to_centres(child, span, bases, upper, charges):
    """Transpose of :func:`.nested.gather_up`: add to the gradients of ``charges`` (n, 3) those of the skeletons."""
    _scatter_down(child, bases, upper)
    for c in range(child.size):
        if child[c] < 0:
            _spread(c, span[c, 0], bases, upper, charges)


@kernel("i8, i8, f8[:, ::1], Boxes, Clusters, f8[:, ::1], f8[:, ::1]", Boxes, Clusters)
def spread_region(kind, region, points, boxes, clusters, gradient, out):
    """Transpose of :func:`.sums.sum_regions` for one region: add to ``out`` (n + m, 3), the gradients of centres and
    skeletons, those that follow from the ``gradient`` (k, 3) of its targets.

    The charges of ``clusters`` are row numbers of ``out``.
    """
    tree = boxes.tree
    total = out.shape[0]
    far, near = np.empty((6, total)), np.empty((6, total))
    left = np.empty((DEPTH, clusters.child.size), dtype=np.int64)
    n_left, known = np.zeros(DEPTH, dtype=np.int64), np.zeros(DEPTH, dtype=np.bool_)
    polynomial = np.zeros((DEPTH, np.diff(boxes.spaces.start).max(), 3))
    stack = np.empty((2 * DEPTH, 3), dtype=np.int64)
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
        n_far, n_near, n_left[level] = look(n, boxes, tops, clusters, far, near, left[level], risk)
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
