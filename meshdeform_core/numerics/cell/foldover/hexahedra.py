"""The energy of hexahedra at their sample points, and its derivatives, for eight cells at a time.

The Jacobian matrix A of the map from the undeformed cell depends on three vectors e_0, e_1, e_2, the derivatives of
the position along the index axes: it is the sum of e_k g_k^T, with g_k the reciprocal vectors of the undeformed cell.
Second derivatives are therefore found for six pairs of these vectors instead of ten or more pairs of nodes. With V the
determinant of the undeformed vectors and K the cofactors of A, for cyclic (k, l, m)

    K g_k = e_l x e_m / V,    A (g_k x g_l) = e_m / V.

They are sums over the nodes times the slopes of their shape functions; at a corner, edges that point along the axes.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from llvmlite import ir

from ...jit import inlined
from ...lanes import Array, Lanes, Mask, narrow
from .elements import add, combined, growth, load, regular, slopes, slopes_of, store, vectors_at

WEIGHT = 27
"""Row of ``terms``, see :mod:`.loops`."""
ENERGY, LOWEST, HIGHEST, SUMS = 0, 1, 2, 3
"""Rows of ``sums`` (SUMS, WIDTH): the energy, the smallest D, the largest f."""
FORCE = 36 * 9
"""Row of ``result``, see :mod:`.loops`, from which on it has first derivatives (8, 3); before are second ones
(36, 3, 3)."""
PULL, BEND, TURNED, PARTS = 0, 9, 90, 117
"""Rows of ``parts`` (PARTS, WIDTH), derivatives at a sample point with respect to the vectors e_k: the first ones
(3, 3), the second ones (3, 3, 3, 3), and those (3, 3, 3) with respect to a node and the vectors."""

# For x^(-1/3): the first guess from the bits of x is within 4 %, and every correction, by the first terms of the series
# of (1 - d)^(-1/3), raises the error to the third power.
_GUESS, _CORRECTIONS = 1430187000.0, 3


class _Map(NamedTuple):
    """The map at a sample point of eight cells, arrays of :class:`Lanes`: where it ``counts`` and its ``share`` of the
    energy, ``edges``: the vectors e_k, ``dual``: g_k, ``inverse``: 1 / V, A, A less that of the reference grid,
    ``across``: K g_k, |A|^2, and D. Where the point does not count, |A|^2 is 3, D is 1 and all of the others but the
    edges are 0: what is left out by the factor 0 must not overflow."""

    counts: Mask
    share: Lanes
    edges: np.ndarray
    dual: np.ndarray
    inverse: Lanes
    matrix: np.ndarray
    strain: np.ndarray
    across: np.ndarray
    square: Lanes
    det: Lanes

    @classmethod
    def at(cls, points: Array, terms: Array, slope: Array, sample: ir.Value) -> _Map:
        """``slope`` (27, 8, 3): of the shape functions."""
        _, (edges, start, held) = vectors_at(points, slope, sample, 3)
        [share] = load(terms, 0, (1,), sample)
        counts, areas = (share * 0.0).below(share), _areas(start)
        inverse = counts.choose(1.0 / (start[0] @ areas[0]), 0.0)
        dual, across = areas * inverse, _areas(edges) * inverse
        matrix = edges.T @ dual
        square, det = counts.choose((matrix * matrix).sum(), 3.0), counts.choose(edges[0] @ across[0], 1.0)
        return cls(counts, share, edges, dual, inverse, matrix, (edges - held).T @ dual, across, square, det)


@narrow
def add_energy(
    points: Array, terms: Array, slope: Array, sums: Array, sample: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes,
    elastic: Lanes,
) -> None:  # fmt: skip
    """Add the energy at a sample point of all cells to ``sums``."""
    found, [weight, held] = _Map.at(points, terms, slope, sample), load(terms, WEIGHT, (2,))
    chi, _ = regular(found.det, eps)
    root, infinite = _inverse_root(chi), found.det * 0.0 + float("inf")
    f = found.square * (1 / 3) * root * root + (found.det * found.det + 1.0) * 0.5 / chi
    f = (chi * 0.0).below(chi).choose(f, infinite)
    energy, lowest, highest = load(sums, ENERGY, (SUMS,))
    stiff = 0.5 * elastic * held * (found.strain * found.strain).sum()
    total = share * found.share * (weight * f + cubic * growth(f)[0]) + stiff
    lowest = lowest.min(found.counts.choose(found.det, infinite))
    highest = highest.max(found.counts.choose(f, 0.0))
    store(sums, ENERGY, [energy + found.counts.choose(total, 0.0), lowest, highest])


@narrow
def derivatives(
    points: Array, terms: Array, slope: Array, parts: Array, sample: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes,
    elastic: Lanes, exact: Lanes,
) -> None:  # fmt: skip
    """The derivatives of the energy at a sample point with respect to the vectors e_k, in ``parts``."""
    found, [weight, held] = _Map.at(points, terms, slope, sample), load(terms, WEIGHT, (2,))
    chi, root = regular(found.det, eps)
    third = _inverse_root(chi)
    f, u, v, w, q, r, least = slopes(found.square, found.det, chi, root, third * third)
    r = r.max(r * exact + least * (exact * -1.0 + 1.0))
    one, two = growth(f)[1:]
    part, stiff = share * found.share, found.counts.choose(elastic * held, 0.0)
    u, v, w, p, q, r = combined((u, v, w, q, r), part * (weight + cubic * one), part * cubic * two)
    along, across, turning = found.dual @ found.matrix.T, found.across, v * exact * found.inverse
    left, right = along * p + across * q, along * q + across * r
    second = np.empty((3, 3, 3, 3), dtype=object)
    for k, m in itertools.combinations_with_replacement(range(3), 2):
        pair = left[k][:, None] * along[m] + right[k][:, None] * across[m]
        same = (w + stiff) * (found.dual[k] @ found.dual[m])
        for d in range(3):
            pair[d, d] = pair[d, d] + same
        if k != m:
            # The matrix of the cross product with the third vector, whose sense follows from the order of the axes.
            turned = found.edges[3 - k - m] * turning * (1.0 if m == k + 1 else -1.0)
            for d, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
                pair[i, j], pair[j, i] = pair[i, j] + turned[d], pair[j, i] - turned[d]
        second[k, m], second[m, k] = pair, pair.T
    store(parts, PULL, along * u + across * v + (found.dual @ found.strain.T) * stiff)
    store(parts, BEND, second)


@narrow
def turn_to_node(slope: Array, parts: Array, result: Array, sample: ir.Value, node: ir.Value) -> None:
    """Add the first derivatives at a sample point to those of a node; in ``parts``, the second ones with respect to the
    node and the vectors."""
    own = slopes_of(slope, sample, node, 3)
    add(result, FORCE, own @ load(parts, PULL, (3, 3)), node)
    store(parts, TURNED, own @ load(parts, BEND, (3, 27)))


@narrow
def add_to_pair(slope: Array, parts: Array, result: Array, sample: ir.Value, node: ir.Value, other: ir.Value) -> None:
    """Add the second derivatives with respect to a node, from :func:`turn_to_node`, and one that is not less."""
    builder, values = result.builder, slopes_of(slope, sample, other, 3) @ load(parts, TURNED, (3, 9))
    # Before the pairs of a node are those of lower ones, each of which has one less than the one before.
    before = builder.lshr(builder.mul(node, builder.sub(node.type(15), node)), node.type(1))
    add(result, 0, values.reshape(3, 3), builder.add(before, other))


@inlined
def add_sample(points, terms, slope, parts, result, s, eps, share, cubic, elastic, exact):
    """Add the derivatives of the energy at a sample point to ``result``; of the indefinite part of the second ones the
    share ``exact``."""
    derivatives(points, terms, slope, parts, s, eps, share, cubic, elastic, exact)
    for n in range(8):
        if _enters(slope, s, n):
            turn_to_node(slope, parts, result, s, n)
            for o in range(n, 8):
                if _enters(slope, s, o):
                    add_to_pair(slope, parts, result, s, n, o)


@inlined
def _enters(slope, s, n):
    """Whether the map at a sample point depends on a node."""
    return slope[s, n, 0] != 0.0 or slope[s, n, 1] != 0.0 or slope[s, n, 2] != 0.0


def _areas(edges: np.ndarray) -> np.ndarray:
    """The cross product of the other two edges, for each edge."""
    return np.cross(np.roll(edges, -1, axis=0), np.roll(edges, -2, axis=0))


def _inverse_root(x: Lanes) -> Lanes:
    """x^(-1/3) of positive numbers."""
    r = (_GUESS - x.bits() * (1 / 3)).from_bits()
    for _ in range(_CORRECTIONS):
        d = 1.0 - x * r * r * r
        r = r + r * d * (d * (2 / 9) + 1 / 3)
    return r
