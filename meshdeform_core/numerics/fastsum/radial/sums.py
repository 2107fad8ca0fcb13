"""Fast sums of radial basis functions at target nodes.

Clusters of centres act by their skeletons (:mod:`.skeletons`). For a group of targets far from a cluster, the cluster's
effect is a polynomial on the box of the group, which the group's parts inherit (:mod:`.polynomials`). Clusters that are
too near for that act on the targets directly.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ....parallel import Nodes, agreed, for_chunks
from ...arrays import FloatArray, IntArray, Report
from ...exact.basis import BASES
from ...exact.radial import radial_block, radial_sums
from ...jit import inlined, kernel, record
from ..clusters.target_tree import TargetTree
from ..clusters.tree import build_tree
from ..tuned import AIM, RADIAL_LEAF, REACH, SKELETONS, TRIAL_LEAVES, TRIALS
from .nested import Bases, find_bases, gather_up, pack
from .polynomials import GROWTH, NEAREST, Spaces, add_polynomial, place_points, to_coefficients
from .targets import RadialTargets

_FINEST = 1e-13
_CHUNK = 1
DEPTH = 32
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


class FastRadial:
    """Clusters of the centres of one basis function.

    Parameters
    ----------
    kind : number of the basis function, see :data:`.basis.BASES`
    centres : (n, 3) in units of the support radius
    """

    def __init__(self, kind: int, centres: FloatArray) -> None:
        self._kind, self._centres = kind, centres
        self._tree = build_tree(centres, 1, RADIAL_LEAF)
        self._radius = np.sqrt((self._tree.boxes.half**2).sum(axis=1))
        self._bases: dict[float, Bases] = {}
        self.restart()

    def restart(self) -> None:
        """Return to the initial accuracy, with which the first sum for any coefficients begins."""
        self._tolerance, self._excess = SKELETONS, np.inf
        self.share = 1.0

    def refine(self, excess: float) -> None:
        """Raise the accuracy of all sums until :meth:`restart`, as the error was ``excess`` times too large.

        If the previous increase had little effect, the skeletons are refined.
        """
        if excess > 0.5 * self._excess:
            self._tolerance = max(0.01 * self._tolerance, _FINEST)
        self.share *= max(0.03, 0.6 * AIM / excess)
        self._excess = excess

    def evaluate(
        self,
        fitted: tuple[Clusters, Boxes],
        targets: RadialTargets,
        use: Callable,
        progress: Report | None = None,
    ) -> FloatArray:
        """Sums at target nodes; ``use`` is called with the sums of each region and their flat indices.

        Parameters
        ----------
        fitted : from :meth:`fitted`
        targets : with points in the unit of the centres

        Returns
        -------
        risk : (b,) bound of each leaf's error, in arbitrary units
        """
        clusters, boxes = fitted
        risk = np.zeros(len(boxes.allowed))

        def work(lo: int, hi: int) -> None:
            use(targets.flat(lo, hi), self.of_regions(lo, hi, targets, boxes, clusters, risk))

        for_chunks(work, len(targets.tree.region) - 1, _CHUNK, progress)
        return risk[targets.leaves]

    def fitted(self, coefficients: FloatArray, targets: RadialTargets, tolerance: float) -> tuple[Clusters, Boxes]:
        """Clusters with coefficients (n, 3), and boxes fine enough for the sums at trial leaves to keep the
        ``tolerance``, which is relative to the local cell size. The trial leaves of all ranks count."""
        nodes = Nodes.of(targets.coordinates)
        counts = nodes.gather(len(targets.leaves))
        chosen = np.unique(np.linspace(0, sum(counts) - 1, TRIAL_LEAVES).astype(int)) - sum(
            counts[: nodes.ranks.number]
        )
        chosen = chosen[(chosen >= 0) & (chosen < len(targets.leaves))]
        samples = targets.samples[chosen]
        exact = radial_sums(self._kind, targets.points[samples.ravel()], self._centres, coefficients)
        exact = exact.reshape(*samples.shape, 3)
        permitted = tolerance * targets.permitted(self._kind)
        every = np.ones(len(permitted), dtype=bool)
        for _ in range(TRIALS):
            clusters = self._clusters(coefficients)
            boxes = Boxes(targets.tree, *targets.spaces, self.share * permitted, every)
            found = self._on_leaves(chosen, targets, boxes, clusters)
            found = (np.linalg.norm(found - exact, axis=2) / targets.sizes[chosen]).max(initial=0.0)
            error = agreed(nodes.ranks, float(found)) / tolerance
            if error <= AIM:
                break
            self.refine(error)
        return clusters, boxes

    @property
    def order(self) -> IntArray:
        """The centre (n,) at each position of the tree's order."""
        return self._tree.order

    def charged(self, clusters: Clusters, coefficients: FloatArray) -> Clusters:
        """``clusters`` with other coefficients (n, 3), but the same ``strength``, so that the same ones are far."""
        charges, upper = coefficients[self._tree.order], np.empty_like(clusters.upper)
        gather_up(clusters.span, clusters.child, clusters.bases, charges, upper)
        return clusters._replace(charges=charges, upper=upper)

    def _clusters(self, coefficients: FloatArray) -> Clusters:
        """:class:`Clusters` with these charges (n, 3)."""
        tree = self._tree
        bases = self._bases.get(self._tolerance)
        if bases is None:
            acting = np.ones(len(self._radius), dtype=bool)
            bases = self._bases[self._tolerance] = find_bases(self._kind, tree, self._radius, acting, self._tolerance)
        charges, upper = coefficients[tree.order], np.empty((len(bases.place), 3))
        gather_up(tree.span, tree.child, bases, charges, upper)
        squares = np.append(0.0, np.cumsum((upper**2).sum(axis=1)))
        strength = np.sqrt(np.diff(squares[bases.start]))
        where = tree.boxes.center, self._radius, tree.child, tree.span, tree.points
        return Clusters(self._kind != BASES["tps"], *where, bases, charges, upper, strength)

    def _on_leaves(self, chosen: IntArray, targets: RadialTargets, boxes: Boxes, clusters: Clusters) -> FloatArray:
        """Sums at the samples of some leaves, computed in the same way as for all targets."""
        tree, leaves = targets.tree, targets.leaves[chosen]
        wanted = np.zeros(len(tree.span), dtype=bool)
        for leaf in leaves:
            wanted |= (tree.span[:, 0] <= tree.span[leaf, 0]) & (tree.span[leaf, 1] <= tree.span[:, 1])
        regions = np.searchsorted(tree.region, leaves, side="right") - 1
        found, boxes = np.empty((*targets.samples[chosen].shape, 3)), boxes._replace(wanted=wanted)
        for region in np.unique(regions):
            sums = self.of_regions(region, region + 1, targets, boxes, clusters, np.zeros(len(wanted)))
            here = regions == region
            found[here] = sums[targets.places[chosen[here]] - tree.span[tree.region[region], 0]]
        return found

    def of_regions(
        self, lo: int, hi: int, targets: RadialTargets, boxes: Boxes, clusters: Clusters, risk: FloatArray
    ) -> FloatArray:
        """Sums (n, 3) at the targets of the regions lo <= g < hi that lie in ``wanted`` boxes."""
        sums = np.zeros((len(targets.flat(lo, hi)), 3))
        sum_regions(self._kind, lo, hi, targets.points, boxes, clusters, sums, risk)
        return sums


@kernel("i8, i8, i8, f8[:, ::1], Boxes, Clusters, f8[:, ::1], f8[::1]", Boxes, Clusters)
def sum_regions(kind, lo, hi, points, boxes, clusters, out, risk):
    """Sums (n, 3) at the targets of regions ``lo`` to ``hi``, added to ``out``."""
    tree, spaces = boxes.tree, boxes.spaces
    total = clusters.points.shape[0] + clusters.bases.points.shape[0]
    far, near = np.empty((6, total)), np.empty((6, total))
    left = np.empty((DEPTH, clusters.child.size), dtype=np.int64)
    n_left, known = np.zeros(DEPTH, dtype=np.int64), np.zeros(DEPTH, dtype=np.bool_)
    polynomial = np.empty((DEPTH, np.diff(spaces.start).max(), 3))
    stack = np.empty((DEPTH, 3), dtype=np.int64)
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
            n_far, n_near, n_left[level] = look(n, boxes, tops, clusters, far, near, left[level], risk)
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
def look(n, boxes, tops, clusters, far, near, left, risk):
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
