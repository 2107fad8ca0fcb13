"""Loops over target trees: sums of clusters at targets.

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
from typing import NamedTuple

import numpy as np
import scipy

from ..arrays import FloatArray, IntArray
from ..exact.basis import BASES
from ..exact.radial import radial_block, radial_matrix
from ..jit import fast_kernel, kernel, record
from .nested import Bases, pack
from .targets import TargetTree
from .tuned import HIGHEST, REACH, REFERENCE

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
