"""Sums of radial basis functions at their own centres in nearly linear time: nested skeletons.

Clusters far from each other interact by their skeletons: charges are passed up the tree, from each cluster's children
to its skeleton, and potentials down again. Neighbouring leaves interact with all their centres. The structure is that
of the fast multipole method (Greengard & Rokhlin 1987) with skeletons instead of multipoles, which works for any
function, and for centres on surfaces or unevenly distributed ones.

A skeleton is a few sources of a cluster that represent all of them for distant targets. It results from an
interpolative decomposition (Cheng, Gimbutas, Martinsson & Rokhlin, SIAM J. Sci. Comput. 26, 2005) of the basis values
between the cluster's sources and proxy points around it: the charges of the other sources are distributed among those
of the skeleton. The proxy points lie on several spheres (Huang, Xing & Chow, H2Pack, ACM TOMS 47, 2020); one is not
enough, as the functions are not harmonic. Skeletons of large clusters are chosen among those of their children.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ...parallel import for_chunks
from ..arrays import BoolArray, FloatArray, IntArray
from ..exact.basis import BASES
from ..exact.radial import fill_rows, radial_block
from ..jit import fast_kernel, kernel, record
from .clusters import SourceTree, build_tree
from .tuned import NESTED_LEAF, REACH, SPHERES

_CHUNK = 16


@record("i8[::1], i8[::1], f8[:, ::1], i8[::1], i8[::1], i8[::1], f8[::1]")
class Bases(NamedTuple):
    """Skeletons of all clusters.

    Attributes
    ----------
    start : (m + 1,) start of each cluster's skeleton in ``place`` and ``points``
    place : (total,) positions of skeleton sources in the tree's order
    points : (total, 3) their coordinates
    first : (m + 1,) start of each cluster's candidates in ``order``: its sources, or the skeletons of its children
    order : candidates, numbered from 0 in each cluster, those chosen for the skeleton first
    begin : (m + 1,) start of each cluster's matrix in ``share``
    share : matrices (others, skeleton), flat: the share of the charge of each other candidate that each skeleton source
        takes
    """

    start: np.ndarray
    place: np.ndarray
    points: np.ndarray
    first: np.ndarray
    order: np.ndarray
    begin: np.ndarray
    share: np.ndarray


class NestedSums:
    """The product of the matrix of basis values between centres (n, 3), in units of the support radius, with
    coefficients, at the centres ``rows``, by default all.

    ``tolerance`` is the error of the effect of a unit charge at the distance of its cluster's radius, relative to the
    function there; clusters are those of the sums ``like`` these, if given, with the same centres.
    """

    def __init__(
        self,
        kind: int,
        centres: FloatArray,
        tolerance: float,
        rows: IntArray | None = None,
        like: NestedSums | None = None,
    ) -> None:
        self._kind = kind
        self._tree: SourceTree = like._tree if like else build_tree(centres, 1, NESTED_LEAF)
        radius = np.sqrt((self._tree.boxes.half**2).sum(axis=1))
        # Clusters far from cluster c and those near it: ``far[start[c] : start[c + 1]]`` with the starts of each kind.
        self._lists: list[IntArray] = like._lists if like else _partners(self._tree, radius, kind != BASES["tps"])
        self._bases = find_bases(kind, self._tree, radius, np.diff(self._lists[0]) > 0, tolerance)
        self._leaves = np.flatnonzero(self._tree.child < 0)
        self._leaves = self._leaves[np.argsort(self._tree.span[self._leaves, 0])]
        # Set the tree positions at which sums are evaluated, the range of them in each leaf, and that of each row.
        wanted = np.full(len(self._tree.order), rows is None)
        place = np.empty(len(wanted), dtype=np.int64)
        place[self._tree.order] = np.arange(len(wanted))
        if rows is not None:
            wanted[place[rows]] = True
        self._places = np.flatnonzero(wanted)
        self._result = np.searchsorted(self._places, place if rows is None else place[rows])
        ends = np.append(self._tree.span[self._leaves, 0], len(wanted))
        self._of_leaf = np.searchsorted(self._places, ends)

    @property
    def order(self) -> IntArray:
        """Centres (n,) in the tree's order, in which neighbours in space are close to each other."""
        return self._tree.order

    @property
    def pairs(self) -> int:
        """Number of pairs of points that one product evaluates."""
        size, span = np.diff(self._bases.start), np.diff(self._tree.span)[:, 0]
        far_start, far, near_start, near = self._lists
        of_skeletons = np.repeat(size, np.diff(far_start)) * size[far]
        return int(of_skeletons.sum() + (np.repeat(span, np.diff(near_start)) * span[near]).sum())

    def __call__(self, coefficients: FloatArray) -> FloatArray:
        """Sums (rows, 3) for coefficients (n, 3)."""
        tree, bases = self._tree, self._bases
        far_start, far_clusters, near_start, near_clusters = self._lists
        charges = coefficients[tree.order]
        upper, sums = np.empty((len(bases.place), 3)), np.empty((len(self._places), 3))
        gather_up(tree.span, tree.child, bases, charges, upper)
        far = np.zeros((len(bases.place), 3))

        def act(lo: int, hi: int) -> None:
            _act_far(self._kind, lo, hi, far_start, far_clusters, bases, upper, far)

        for_chunks(act, len(tree.span), _CHUNK)
        scatter_down(tree.child, bases, far)

        def finish(lo: int, hi: int) -> None:
            _act_near(self._kind, lo, hi, self._leaves, self._of_leaf, self._places, tree.span, tree.points, charges,
                      near_start, near_clusters, bases, far, sums)  # fmt: skip

        for_chunks(finish, len(self._leaves), _CHUNK)
        return sums[self._result]


def find_bases(kind: int, tree: SourceTree, radius: FloatArray, acting: BoolArray, tolerance: float) -> Bases:
    """:class:`Bases` of the clusters ``acting`` (m,) on far ones and of their descendants, from the leaves upwards."""
    m = len(radius)
    depth, wanted = np.zeros(m, dtype=np.int64), acting.copy()
    for c in range(m):
        if tree.child[c] >= 0:
            both = slice(tree.child[c], tree.child[c] + 2)
            depth[both], wanted[both] = depth[c] + 1, wanted[c] | wanted[both]
    # Proxy points (3, n) around a cluster of radius 1, spread over spheres (golden spirals).
    spheres = []
    for size, count in SPHERES:
        z = 1 - (2 * np.arange(count) + 1) / count
        angle, side = math.pi * (1 + math.sqrt(5)) * np.arange(count), np.sqrt(1 - z * z)
        spheres.append(REACH * size * np.stack([side * np.cos(angle), side * np.sin(angle), z]))
    proxies = np.concatenate(spheres, axis=1)
    found: list = [(np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 0)))] * m

    def make(c: int) -> None:
        child = tree.child[c]
        places = np.arange(*tree.span[c]) if child < 0 else np.concatenate([found[child][0], found[child + 1][0]])
        n = len(places)
        # A change of unit adds to thin plate splines only polynomials, which a few points reproduce.
        unit = radius[c] if kind == BASES["tps"] and radius[c] > 0 else 1.0
        points = (tree.points[places] - tree.boxes.center[c]) / unit
        order, share = np.empty(n, dtype=np.int64), np.zeros((n, n))
        rank = decompose(kind, points, proxies * (radius[c] / unit), tolerance, order, share)
        # Positions of the skeleton, the order of its candidates, and the shares of those that are not in it.
        found[c] = places[order[:rank]], order, share[: n - rank, :rank].copy()

    for level in range(depth.max(), -1, -1):
        here = np.flatnonzero((depth == level) & wanted)

        def work(lo: int, hi: int, here: IntArray = here) -> None:
            for c in here[lo:hi]:
                make(c)

        for_chunks(work, len(here), _CHUNK)
    place, order, share = zip(*found, strict=True)
    start, first, begin = (np.append(0, np.cumsum([each.size for each in part])) for part in (place, order, share))
    places = np.concatenate(place)
    shares = np.concatenate([each.ravel() for each in share])
    return Bases(start, places, tree.points[places], first, np.concatenate(order), begin, shares)


@kernel("i8[:, ::1], i8[::1], Bases, f8[:, ::1], f8[:, ::1]", Bases)
def gather_up(span, child, bases, charges, out):
    """Charges of all skeletons from those of the sources, computed from the leaves up."""
    for c in range(span.shape[0] - 1, -1, -1):
        s, rank = bases.start[c], bases.start[c + 1] - bases.start[c]
        o, n = bases.first[c], bases.first[c + 1] - bases.first[c]
        at, source = span[c, 0], charges
        if child[c] >= 0:
            at, source = bases.start[child[c]], out
        for j in range(rank):
            for k in range(3):
                out[s + j, k] = source[at + bases.order[o + j], k]
        b = bases.begin[c]
        for i in range(n - rank):
            p = at + bases.order[o + rank + i]
            x, y, z = source[p, 0], source[p, 1], source[p, 2]
            for j in range(rank):
                w = bases.share[b + j]
                out[s + j, 0] += w * x
                out[s + j, 1] += w * y
                out[s + j, 2] += w * z
            b += rank


@kernel
def spread(c, at, bases, skeleton, out):
    """Add the potentials at the skeleton of cluster ``c`` to its candidates, from row ``at`` of ``out`` on."""
    s, rank = bases.start[c], bases.start[c + 1] - bases.start[c]
    o, n = bases.first[c], bases.first[c + 1] - bases.first[c]
    for j in range(rank):
        for k in range(3):
            out[at + bases.order[o + j], k] += skeleton[s + j, k]
    b = bases.begin[c]
    for i in range(n - rank):
        x = y = z = 0.0
        for j in range(rank):
            w = bases.share[b + j]
            x += w * skeleton[s + j, 0]
            y += w * skeleton[s + j, 1]
            z += w * skeleton[s + j, 2]
        p = at + bases.order[o + rank + i]
        out[p, 0] += x
        out[p, 1] += y
        out[p, 2] += z
        b += rank


@kernel("i8[::1], Bases, f8[:, ::1]", Bases)
def scatter_down(child, bases, far):
    """Pass the potentials at the skeletons on to those of their children, from the root to the leaves."""
    for c in range(child.size):
        if child[c] >= 0:
            spread(c, bases.start[child[c]], bases, far, far)


@kernel("i8, i8, i8, i8[::1], i8[::1], Bases, f8[:, ::1], f8[:, ::1]", Bases)
def _act_far(kind, lo, hi, far_start, far, bases, charges, out):
    """Add the potentials of the skeletons of far clusters at the skeletons of clusters ``lo`` to ``hi``."""
    packed = np.empty((6, bases.points.shape[0]))
    for t in range(lo, hi):
        n = 0
        for c in far[far_start[t] : far_start[t + 1]]:
            n = pack(bases.points, charges, bases.start[c], bases.start[c + 1], packed, n)
        mine = slice(bases.start[t], bases.start[t + 1])
        radial_block(kind, bases.points[mine], packed, n, out[mine])


@kernel(
    "i8, i8, i8, i8[::1], i8[::1], i8[::1], i8[:, ::1], f8[:, ::1], f8[:, ::1], i8[::1], i8[::1], Bases, "
    "f8[:, ::1], f8[:, ::1]",
    Bases,
)
def _act_near(kind, lo, hi, leaves, of_leaf, places, span, points, charges, near_start, near, bases, far, out):
    """Sums at positions in leaves: contributions of far clusters by the skeletons, of neighbouring leaves directly."""
    packed = np.empty((6, points.shape[0]))
    for leaf in range(lo, hi):
        t = leaves[leaf]
        own = slice(of_leaf[leaf], of_leaf[leaf + 1])
        mine = places[own]
        felt = np.zeros((span[t, 1] - span[t, 0], 3))
        spread(t, 0, bases, far, felt)
        out[own] = felt[mine - span[t, 0]]
        n = 0
        for c in near[near_start[t] : near_start[t + 1]]:
            n = pack(points, charges, span[c, 0], span[c, 1], packed, n)
        radial_block(kind, points[mine], packed, n, out[own])


@kernel
def pack(points, charges, first, last, packed, n):
    """Copy points and charges first <= s < last to columns of ``packed`` (6, m) from ``n`` on; return the end."""
    for s in range(first, last):
        for d in range(3):
            packed[d, n] = points[s, d]
            packed[3 + d, n] = charges[s, d]
        n += 1
    return n


def _partners(tree: SourceTree, radius: FloatArray, compact: bool) -> list[IntArray]:
    """For the clusters far from each one, and for those near it: start (m + 1,) of its partners, and all partners."""
    center, child, (a, b) = tree.boxes.center, tree.child, np.zeros((2, 1), dtype=np.int64)
    far, near = [np.empty((2, 0), dtype=np.int64)], [np.empty((2, 0), dtype=np.int64)]
    # Level by level, pairs of clusters that are neither far from each other nor both leaves are divided.
    while a.size:
        distance, one, two = np.sqrt(((center[a] - center[b]) ** 2).sum(axis=1)), radius[a], radius[b]
        apart = (a != b) & (distance - two >= REACH * one) & (distance - one >= REACH * two)
        outside = np.zeros(len(a), dtype=bool)
        if compact:
            outside = (a != b) & (distance - one - two >= 1.0)
            apart &= distance + one + two <= 1.0
        ended = ~apart & (child[a] < 0) & (child[b] < 0)
        far.append(np.stack([a, b])[:, apart & ~outside])
        near.append(np.stack([a, b])[:, ended & ~outside])
        left = ~(apart | ended | outside)
        a, b, one, two = a[left], b[left], one[left], two[left]
        same, other = child[a[a == b]], a != b
        a, b, one, two = a[other], b[other], one[other], two[other]
        changed = (child[a] < 0) | ((child[b] >= 0) & (two > one))
        a, b = np.where(changed, b, a), np.where(changed, a, b)
        a, b = (
            np.concatenate(parts)
            for parts in ((child[a], child[a] + 1, same, same, same + 1), (b, b, same, same + 1, same + 1))
        )
    found = []
    for pairs in (np.concatenate(far, axis=1), np.concatenate(near, axis=1)):
        cluster, partner = np.concatenate([pairs, pairs[::-1, pairs[0] != pairs[1]]], axis=1)
        order = np.lexsort((partner, cluster))
        found += [np.searchsorted(cluster[order], np.arange(len(child) + 1)), partner[order]]
    return found


@fast_kernel("i8, f8[:, ::1], f8[:, ::1], f8, i8[::1], f8[:, ::1]")
def decompose(kind, points, proxies, tolerance, order, share):
    """Choose a skeleton of ``points`` (n, 3) seen from ``proxies`` (3, m); returns its number of points.

    ``tolerance`` is the largest error (root mean square over the proxies) of the effect of a unit charge. Filled are
    ``order`` (n,), the points, those of the skeleton first, and ``share`` (n, n), the part of the charge of the i-th
    other point that goes to the j-th skeleton point.
    """
    n, m = points.shape[0], proxies.shape[1]
    values, norm = np.empty((n, m)), np.empty(n)
    fill_rows(kind, points, proxies, values)
    for i in range(n):
        order[i] = i
        norm[i] = _dot(values[i], values[i])
    # Coefficients of each row with respect to the orthonormal rows chosen so far.
    factor = np.zeros((n, n))
    limit = tolerance * tolerance * m
    rank = 0
    while rank < n:
        best = rank
        for i in range(rank + 1, n):
            if norm[order[i]] > norm[order[best]]:
                best = i
        if norm[order[best]] <= limit:
            break
        order[best], order[rank] = order[rank], order[best]
        if _choose(values, order, rank, factor, norm, limit):
            rank += 1
    # The other rows by those of the skeleton: back substitution with its triangular factor.
    for i in range(rank, n):
        for j in range(rank - 1, -1, -1):
            s = factor[order[i], j]
            for k in range(j + 1, rank):
                s -= share[i - rank, k] * factor[order[k], j]
            share[i - rank, j] = s / factor[order[j], j]
    return rank


@fast_kernel
def _choose(values, order, rank, factor, norm, limit):
    """Normalise row ``rank`` and make later rows orthogonal to it; False if its square does not exceed ``limit``."""
    p = order[rank]
    row = values[p]
    # Orthogonalise again against the rows chosen before, as updates lose digits.
    for j in range(rank):
        s = _dot(row, values[order[j]])
        factor[p, j] += s
        _subtract(row, s, values[order[j]])
    square = _dot(row, row)
    if square <= limit:
        norm[p] = 0.0
        return False
    length = math.sqrt(square)
    factor[p, rank] = length
    for k in range(row.size):
        row[k] /= length
    for i in range(rank + 1, order.size):
        other = values[order[i]]
        s = _dot(other, row)
        factor[order[i], rank] = s
        _subtract(other, s, row)
        norm[order[i]] = _dot(other, other)
    return True


@fast_kernel
def _dot(a, b):
    s = 0.0
    for k in range(a.size):
        s += a[k] * b[k]
    return s


@fast_kernel
def _subtract(a, factor, b):
    for k in range(a.size):
        a[k] -= factor * b[k]
