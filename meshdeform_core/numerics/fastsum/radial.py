"""Fast sums of radial basis functions at target nodes.

Clusters of centres act by their skeletons. For a group of targets far from a cluster, the cluster's effect is a
polynomial on the box of the group, which the group's parts inherit. Clusters that are too near for that act on the
targets directly.

The basis of the polynomials consists of products of Chebyshev polynomials T_i(x) T_j(y) T_k(z) of limited total degree;
only those are used that matter in the Taylor series of a distant source, which are fewer along the short sides of a
box. They interpolate at approximate Fekete points (Sommariva & Vianello, Comput. Math. Appl. 57, 2009). Their accuracy
is measured once per box shape.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import scipy

from ...parallel import Nodes, for_chunks
from ..arrays import FloatArray, IntArray, Report, Shapes
from ..exact.basis import BASES
from ..exact.radial import radial_block, radial_matrix, radial_sums
from ..jit import fast_kernel, kernel, record
from .clusters import build_tree
from .nested import Bases, find_bases, gather_up, pack
from .targets import TargetTree, build_target_tree, leaves_of, shape_table
from .tuned import (
    AIM,
    CAPACITY,
    HIGHEST,
    RADIAL_LEAF,
    REACH,
    REFERENCE,
    SKELETONS,
    TERMS,
    TRIAL_LEAVES,
    TRIALS,
)  # fmt: skip

# Distances at which the error is measured: the first one, and the ratio between successive ones.
NEAREST, GROWTH = 1.3, 1.25
_DISTANCES, _SOURCES, _PLACES = 14, 80, 120
# Box shapes are rounded to half powers of 2; the ratio of the longest to the shortest side is limited to this power.
_FLATTEST = 14


@record("i8[::1], i8[:, ::1], f8[:, ::1], i8[::1], f8[::1], f8[:, ::1]")
class Spaces(NamedTuple):
    """The polynomial spaces of several box shapes, concatenated.

    Attributes
    ----------
    start : (s + 1,) start of each space in ``degree`` and ``points``
    degree : (total, 3) int64, degrees of each polynomial along the three sides
    points : (total, 3) interpolation points in [-1, 1]^3, as many as polynomials
    begin : (s + 1,) start of each matrix in ``matrix``
    matrix : (m, m) matrices, flat, that map values at the points to coefficients
    error : (s, d) largest error of r^2 log r in a box of radius 1 for sources at the distances
        ``NEAREST * GROWTH ** n``
    """

    start: np.ndarray
    degree: np.ndarray
    points: np.ndarray
    begin: np.ndarray
    matrix: np.ndarray
    error: np.ndarray


def spaces_of(half: FloatArray, accuracy: float) -> tuple[Spaces, IntArray]:
    """:class:`Spaces` for boxes with half sides (b, 3), and the number (b,) of the space of each box.

    Terms below ``accuracy`` are left out.
    """
    longest = half.max(axis=1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        flatness = np.floor(2.0 * np.log2(longest / half))
    flat = np.where(half > 1e-12 * longest, np.clip(flatness, 0, _FLATTEST), -1).astype(np.int64)
    shapes, which = np.unique(flat, axis=0, return_inverse=True)
    # A rank may have no targets.
    found = [_space(*map(int, shape), accuracy) for shape in shapes] or [_space(0, 0, 0, accuracy)]
    sizes = np.array([len(degree) for degree, _, _, _ in found])
    start, begin = np.append(0, np.cumsum(sizes)), np.append(0, np.cumsum(sizes**2))
    degree, points = (np.concatenate([each[part] for each in found]) for part in (0, 1))
    matrix, error = np.concatenate([each[2].ravel() for each in found]), np.stack([each[3] for each in found])
    return Spaces(start, degree, points, begin, matrix, error), which.ravel()


@functools.lru_cache(maxsize=1000)
def _space(a: int, b: int, c: int, accuracy: float) -> tuple[IntArray, FloatArray, FloatArray, FloatArray]:
    """Degrees (m, 3), points (m, 3), inverse (m, m) of the Vandermonde matrix, and errors, for one shape of box."""
    half = np.array([0.0 if n < 0 else 2.0 ** (-0.5 * n) for n in (a, b, c)])
    half /= np.linalg.norm(half) or 1.0
    most = [HIGHEST if h > 0 else 1 for h in half]
    degree = np.stack(np.meshgrid(*map(np.arange, most), indexing="ij"), axis=-1).reshape(-1, 3)
    total = degree.sum(axis=1)
    # The terms that matter, and all up to degree 2, which r^2 log r has at any distance:
    # (i + j + k)! / (i! j! k!) prod (h / 2 D)^i, a factor 2 for every direction of degree > 0, and n^-3 for r^2 log r.
    factorials = np.array([math.lgamma(n + 1) for n in range(3 * HIGHEST)])
    size = factorials[total] - factorials[degree].sum(axis=1) - 3.0 * np.log(np.maximum(total, 1))
    size += (degree * np.log(np.where(half > 0, half, 1.0) / (2.0 * REFERENCE))).sum(axis=1)
    size += np.log(2.0) * (degree > 0).sum(axis=1)
    degree = degree[(size >= math.log(accuracy)) | (total <= 2)]
    sides = [np.cos(np.pi * np.arange(n + 1) / n) if n else np.zeros(1) for n in degree.max(axis=0) + 1]
    sides = [side if h > 0 else np.zeros(1) for side, h in zip(sides, half, strict=True)]
    candidates = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    values = _polynomial_values(degree, candidates)
    chosen = scipy.linalg.qr(values.T, mode="r", pivoting=True)[1][: len(degree)]
    points, matrix = candidates[chosen], np.linalg.inv(values[chosen])
    # The largest error at each distance, over random sources and random points of the box.
    random = np.random.default_rng(0)
    places = random.uniform(-1.0, 1.0, (_PLACES, 3))
    shares = _polynomial_values(degree, places) @ matrix
    away = random.standard_normal((_SOURCES, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    errors = []
    for n in range(_DISTANCES):
        sources = NEAREST * GROWTH**n * away
        exact, known = (radial_matrix(BASES["tps"], np.ascontiguousarray(x * half), sources) for x in (places, points))
        errors.append(np.abs(shares @ known - exact).max())
    # Round-off aside, the error never grows with distance.
    return degree, points, matrix, np.maximum.accumulate(np.array(errors)[::-1])[::-1]


def _polynomial_values(degree: IntArray, points: FloatArray) -> FloatArray:
    """Values (n, m) of the polynomials at points (n, 3) of [-1, 1]^3."""
    values = np.ones((len(points), len(degree)))
    for d in range(3):
        values *= np.cos(degree[:, d] * np.arccos(points[:, d, None]))
    return values


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
    center, radius, child, span, points : of the tree, see :class:`.clusters.SourceTree`
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
                _fill_polynomial(kind, n, boxes, far, n_far, parent, polynomial[level - 1], polynomial[level])
            if tree.child[n, 0] < 0:
                x = points[tree.targets[tree.span[n, 0] : tree.span[n, 1]]]
                sums = out[tree.span[n, 0] - origin : tree.span[n, 1] - origin]
                radial_block(kind, x, near, n_near, sums)
                if known[level]:
                    _add_polynomial(n, boxes, polynomial[level], x, sums)
                continue
            for c in range(2):
                stack[depth, 0], stack[depth, 1], stack[depth, 2] = tree.child[n, 1 - c], level + 1, n
                depth += 1


@fast_kernel
def _fill_polynomial(kind, n, boxes, far, n_far, parent, inherited, polynomial):
    """Coefficients of the polynomial of a target tree node: what it inherits, if anything, plus its far clusters."""
    tree, spaces, s = boxes.tree, boxes.spaces, boxes.space[n]
    first, begin = spaces.start[s], spaces.begin[s]
    m = spaces.start[s + 1] - first
    place, value = np.empty((m, 3)), np.zeros((m, 3))
    for i in range(m):
        for d in range(3):
            place[i, d] = tree.center[n, d]
            for row in range(3):
                place[i, d] += tree.half[n, row] * spaces.points[first + i, row] * tree.axes[n, row, d]
    radial_block(kind, place, far, n_far, value)
    if parent >= 0:
        _add_polynomial(parent, boxes, inherited, place, value)
    for i in range(m):
        a = b = c = 0.0
        for j in range(m):
            w = spaces.matrix[begin + i * m + j]
            a += w * value[j, 0]
            b += w * value[j, 1]
            c += w * value[j, 2]
        polynomial[i, 0], polynomial[i, 1], polynomial[i, 2] = a, b, c


@fast_kernel
def _add_polynomial(box, boxes, coefficients, points, out):
    """Add the values (n, 3) of the polynomial of a target tree node at ``points`` (n, 3)."""
    tree, space = boxes.tree, boxes.space[box]
    center, axes, half = tree.center[box], tree.axes[box], tree.half[box]
    degree = boxes.spaces.degree[boxes.spaces.start[space] : boxes.spaces.start[space + 1]]
    n, most = points.shape[0], degree.max() + 1
    value = np.empty((3, most, n))
    for d in range(3):
        # Chebyshev polynomials along this side of the box.
        value[d, 0] = 1.0
        if most > 1:
            at = value[d, 1]
            at[:] = 0.0
            if half[d] > 0.0:
                for e in range(3):
                    factor, origin = axes[d, e] / half[d], center[e]
                    for t in range(n):
                        at[t] += factor * (points[t, e] - origin)
            for i in range(2, most):
                for t in range(n):
                    value[d, i, t] = 2.0 * at[t] * value[d, i - 1, t] - value[d, i - 2, t]
    total, pair, product = np.zeros((3, n)), np.empty(n), np.empty(n)
    for m in range(degree.shape[0]):
        i, j, k = degree[m]
        if k == 0:
            for t in range(n):
                pair[t] = value[0, i, t] * value[1, j, t]
        a, b, c = coefficients[m, 0], coefficients[m, 1], coefficients[m, 2]
        for t in range(n):
            product[t] = pair[t] * value[2, k, t]
            total[0, t] += a * product[t]
            total[1, t] += b * product[t]
            total[2, t] += c * product[t]
    for t in range(n):
        for c in range(3):
            out[t, c] += total[c, t]


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
    # Without views of rows, whose reference counts would cost more.
    own = np.sqrt(tree.half[n, 0] ** 2 + tree.half[n, 1] ** 2 + tree.half[n, 2] ** 2)
    x, y, z = tree.center[n, 0], tree.center[n, 1], tree.center[n, 2]
    for top in tops:
        stack[0] = top
        depth = 1
        while depth:
            depth -= 1
            c = stack[depth]
            radius, at = clusters.radius[c], clusters.center
            d = np.sqrt((x - at[c, 0]) ** 2 + (y - at[c, 1]) ** 2 + (z - at[c, 2]) ** 2)
            if clusters.compact and d >= 1.0 + own + radius:
                continue
            smooth = not clusters.compact or d + own + radius <= 1.0
            seen = smooth and d - own >= REACH * radius
            pull = np.inf
            if smooth and not few and d - radius > NEAREST * own:
                number = int(np.log((d - radius) / (NEAREST * max(own, 1e-300))) / np.log(GROWTH))
                error = boxes.spaces.error[s, min(number, boxes.spaces.error.shape[1] - 1)]
                pull = clusters.strength[c] * error / boxes.allowed[n]
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


# Leading singular term of each function at the origin: power of the distance, and size relative to that of r^2 log r.
_SINGULAR = {0: (2.0, 1.0), 1: (1.0, 0.5), 2: (3.0, 15.0), 3: (2.0, 20.0), 4: (3.0, 60.0), 5: (4.0, 60.0)}


class RadialTargets(NamedTuple):
    """Target nodes in trees, and where the accuracy of each leaf is judged.

    Attributes
    ----------
    coordinates : (n_nodes, 3) array, or one in parts
    tree : of the targets
    leaves : (b,) tree nodes that are leaves and hold targets
    places : (b, 9) positions in the tree's list of targets, spread over each leaf
    samples : (b, 9) the targets at these positions
    sizes : (b, 9) length of the shortest edge at each sample
    spaces : polynomial spaces, and the number (m,) of the space of each tree node's box
    """

    coordinates: Any
    tree: TargetTree
    leaves: np.ndarray
    places: np.ndarray
    samples: np.ndarray
    sizes: np.ndarray
    spaces: tuple[Spaces, np.ndarray]

    @property
    def points(self) -> FloatArray:
        """Coordinates (n_nodes, 3); of a grid in parts, only the rows that this rank holds."""
        return np.asarray(Nodes.of(self.coordinates).rows)

    @property
    def every(self) -> IntArray:
        """Flat indices of all targets."""
        return self.tree.targets

    def permitted(self, kind: int) -> FloatArray:
        """Length (m,) relative to which errors of a basis function are measured in each tree node.

        The shortest edge at its samples, divided by the size of the function's singular part at the radius of its box.
        """
        size, child = np.full(len(self.tree.span), np.inf), self.tree.child
        size[self.leaves] = self.sizes.min(axis=1)
        for n in range(len(size) - 1, -1, -1):
            if child[n, 0] >= 0:
                size[n] = size[child[n]].min()
        power, factor = _SINGULAR[kind]
        return size / (factor * np.maximum((self.tree.half**2).sum(axis=1), 1e-300) ** (0.5 * power))

    def flat(self, first: int, last: int) -> IntArray:
        """Flat indices of the targets in the regions first <= g < last."""
        roots = self.tree.region[[first, last - 1]]
        return self.tree.targets[self.tree.span[roots[0], 0] : self.tree.span[roots[1], 1]]


def make_radial_targets(coordinates: Any, shapes: Shapes, offsets: IntArray, flat: IntArray) -> RadialTargets:
    """Targets ``flat``, ascending, of a grid; those of this rank if the grid is in parts."""
    points, shapes = Nodes.of(coordinates).rows, shape_table(shapes)
    tree = build_target_tree(points, shapes, offsets, flat, CAPACITY)
    leaves, _, places, sizes = leaves_of(tree, points, shapes, offsets)
    return RadialTargets(coordinates, tree, leaves, places, tree.targets[places], sizes, spaces_of(tree.half, TERMS))


_FINEST = 1e-13

Use = Callable[[IntArray, FloatArray], object]


class FastRadial:
    """Clusters of the centres (n, 3), in units of the support radius, of one basis function.

    ``share`` of the error allowed to a sum is allowed to each cluster.
    """

    def __init__(self, kind: int, centres: FloatArray) -> None:
        self._kind, self._centres = kind, centres
        self._tree = build_tree(centres, 1, RADIAL_LEAF)
        self._radius = np.sqrt((self._tree.boxes.half**2).sum(axis=1))
        self._bases: dict[float, Bases] = {}
        self._tolerance, self._excess, self.share = SKELETONS, np.inf, 1.0

    def _refine(self, excess: float) -> None:
        """Raise the accuracy, as the error was ``excess`` times too large; if the previous increase had little effect,
        that of the skeletons."""
        if excess > 0.5 * self._excess:
            self._tolerance = max(0.01 * self._tolerance, _FINEST)
        self.share *= max(0.03, 0.6 * AIM / excess)
        self._excess = excess

    def apply(
        self, coefficients: FloatArray, targets: RadialTargets, tolerance: float, use: Use, excess: float = 0.0,
        progress: Report | None = None,
    ) -> FloatArray:  # fmt: skip
        """Call ``use`` with the flat indices (k,) of the targets of each region and the sums (k, 3) there for
        coefficients (n, 3); returns a bound (b,) of each leaf's error, in arbitrary units: leaves can be compared with
        each other.

        The targets have points in the unit of the centres. Sums are as fine as those at trial leaves, of all ranks,
        need to keep the ``tolerance``, which is relative to the sizes of the targets; if the latest sums had an error
        ``excess`` times too large, finer than these, else as if there had been none.
        """
        if excess:
            self._refine(excess)
        else:
            self._tolerance, self._excess, self.share = SKELETONS, np.inf, 1.0
        nodes = Nodes.of(targets.coordinates)
        counts = nodes.gather(len(targets.leaves))
        first = sum(counts[: nodes.ranks.number])
        chosen = np.unique(np.linspace(0, sum(counts) - 1, TRIAL_LEAVES).astype(int)) - first
        chosen = chosen[(chosen >= 0) & (chosen < len(targets.leaves))]
        x = targets.points[targets.samples[chosen]]
        exact = radial_sums(self._kind, x.reshape(-1, 3), self._centres, coefficients).reshape(x.shape)
        permitted = tolerance * targets.permitted(self._kind)
        for _ in range(TRIALS):
            clusters = self._clusters(coefficients)
            boxes = Boxes(targets.tree, *targets.spaces, self.share * permitted, np.ones(len(permitted), dtype=bool))
            found = self._on_leaves(chosen, targets, boxes, clusters)
            found = (np.linalg.norm(found - exact, axis=2) / targets.sizes[chosen]).max(initial=0.0)
            error = nodes.ranks.largest(float(found)) / tolerance
            if error <= AIM:
                break
            self._refine(error)
        risk = np.zeros(len(permitted))

        def work(lo: int, hi: int) -> None:
            flat = targets.flat(lo, hi)
            sums = np.zeros((len(flat), 3))
            sum_regions(self._kind, lo, hi, targets.points, boxes, clusters, sums, risk)
            use(flat, sums)

        for_chunks(work, len(targets.tree.region), 1, progress)
        return risk[targets.leaves]

    def _clusters(self, coefficients: FloatArray) -> Clusters:
        """The clusters of the centres with coefficients (n, 3)."""
        tree, radius = self._tree, self._radius
        if self._tolerance not in self._bases:
            acting = np.ones(len(radius), dtype=bool)
            self._bases[self._tolerance] = find_bases(self._kind, tree, radius, acting, self._tolerance)
        bases = self._bases[self._tolerance]
        charges, upper = coefficients[tree.order], np.empty((len(bases.place), 3))
        gather_up(tree.span, tree.child, bases, charges, upper)
        squares = np.append(0.0, np.cumsum((upper**2).sum(axis=1)))
        strength = np.sqrt(np.diff(squares[bases.start]))
        where = tree.boxes.center, radius, tree.child, tree.span, tree.points
        return Clusters(self._kind != BASES["tps"], *where, bases, charges, upper, strength)

    def _on_leaves(self, chosen: IntArray, targets: RadialTargets, boxes: Boxes, clusters: Clusters) -> FloatArray:
        """Sums at the samples of some leaves, computed in the same way as for all targets."""
        tree, leaves = targets.tree, targets.leaves[chosen]
        wanted = np.zeros(len(tree.span), dtype=bool)
        for leaf in leaves:
            wanted |= (tree.span[:, 0] <= tree.span[leaf, 0]) & (tree.span[leaf, 1] <= tree.span[:, 1])
        regions = np.searchsorted(tree.span[tree.region, 0], tree.span[leaves, 0], side="right") - 1
        found, boxes = np.empty((*targets.samples[chosen].shape, 3)), boxes._replace(wanted=wanted)
        for region in np.unique(regions):
            sums = np.zeros((len(targets.flat(region, region + 1)), 3))
            sum_regions(self._kind, region, region + 1, targets.points, boxes, clusters, sums, np.zeros(len(wanted)))
            here = regions == region
            found[here] = sums[targets.places[chosen[here]] - tree.span[tree.region[region], 0]]
        return found
