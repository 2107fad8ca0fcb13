"""The energy of hexahedra at their sample points, and its derivatives, for eight cells at a time.

The Jacobian matrix A of the map from the undeformed cell depends on three vectors e_0, e_1, e_2, the derivatives of
the position along the index axes: it is the sum of e_k g_k^T, with g_k the reciprocal vectors of the undeformed cell.
Second derivatives are therefore found for six pairs of these vectors instead of ten or more pairs of nodes. With V the
determinant of the undeformed vectors and K the cofactors of A, for cyclic (k, l, m)

    K g_k = e_l x e_m / V,    A (g_k x g_l) = e_m / V.

At a corner they are its edges, whose sense does not matter; elsewhere sums over the nodes times the slopes of their
shape functions.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir

from ...lanes import Array, Lanes, Mask, narrow
from .elements import GRIDS, add, add_energy, add_pair, add_to_nodes, at_corner, combined, growth, load, regular, slopes

WEIGHT = 27
"""Row of ``terms``, see :mod:`.loops`."""
FORCE = 36 * 9
"""Row of ``result``, see :mod:`.loops`, from which on it has first derivatives (8, 3); before are second ones
(36, 3, 3)."""

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
    def of(cls, vectors: list[np.ndarray], terms: Array, sample: ir.Value) -> _Map:
        """``vectors``: the e_k in the deformed, the undeformed and the reference cells."""
        edges, start, held = vectors
        [share] = load(terms, 0, (1,), sample)
        counts, areas = (share * 0.0).below(share), _areas(start)
        inverse = counts.choose(1.0 / (start[0] @ areas[0]), 0.0)
        dual, across = areas * inverse, _areas(edges) * inverse
        matrix = edges.T @ dual
        square, det = counts.choose((matrix * matrix).sum(), 3.0), counts.choose(edges[0] @ across[0], 1.0)
        return cls(counts, share, edges, dual, inverse, matrix, (edges - held).T @ dual, across, square, det)


def _adding_energy(at: Callable[..., Any]) -> Any:
    @narrow
    def add_energy_at(
        points: Array, terms: Array, slope: Array, sums: Array, sample: ir.Value, eps: Lanes, share: Lanes,
        cubic: Lanes, elastic: Lanes,
    ) -> None:  # fmt: skip
        """Add the energy at a sample point of all cells to ``sums``."""
        found = _Map.of(at(points, sample, 3, slope)[1], terms, sample)
        chi, _ = regular(found.det, eps)
        root = _inverse_root(chi)
        f = found.square * (1 / 3) * root * root + (found.det * found.det + 1.0) * 0.5 / chi
        part = share * found.share, cubic, elastic
        add_energy(sums, terms, WEIGHT, found.counts, found.det, chi, f, found.strain, *part)

    return add_energy_at


def _derivatives(
    found: _Map, terms: Array, eps: Lanes, share: Lanes, cubic: Lanes, elastic: Lanes, exact: Lanes
) -> tuple[np.ndarray, np.ndarray]:
    """The derivatives of the energy at a sample point with respect to the vectors e_k: the first ones (3, 3), and the
    second ones (3, 3, 3, 3)."""
    [weight, held] = load(terms, WEIGHT, (2,))
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
    return along * u + across * v + (found.dual @ found.strain.T) * stiff, second


def _adding_derivatives(at: Callable[..., Any], spread: Callable[..., None]) -> Any:
    @narrow
    def add_derivatives_at(
        points: Array, terms: Array, slope: Array, result: Array, sample: ir.Value, eps: Lanes, share: Lanes,
        cubic: Lanes, elastic: Lanes, exact: Lanes,
    ) -> None:  # fmt: skip
        """Add the derivatives of the energy at a sample point to ``result``; of the indefinite part of the second ones
        the share ``exact``."""
        nodes, vectors = at(points, sample, 3, slope)
        found = _Map.of(vectors, terms, sample)
        spread(result, FORCE, nodes, *_derivatives(found, terms, eps, share, cubic, elastic, exact))

    return add_derivatives_at


def _between(points: Array, sample: ir.Value, d: int, slope: Array) -> tuple[np.ndarray, list[np.ndarray]]:
    """The slopes (8, 3) of the shape functions at a sample point, and the vectors (3, 3) along the index axes."""
    first = slope.builder.mul(sample, sample.type(8 * d))
    weights = np.array([[slope.every(first, d * n + k) for k in range(d)] for n in range(8)])
    grids = [load(points, grid * 8 * d, (8, d)) for grid in range(GRIDS)]
    return weights, [np.array([w[:, None] * p for w, p in zip(weights, x, strict=True)]).sum(axis=0) for x in grids]


def _add_between(result: Array, first: int, weights: np.ndarray, force: np.ndarray, second: np.ndarray) -> None:
    number = ir.IntType(64)
    for n, own in enumerate(weights):
        add(result, first, own @ force, number(n))
        turned = (own @ second.reshape(3, 27)).reshape(3, 9)
        for o in range(n, 8):
            add_pair(result, number(n), number(o), (weights[o] @ turned).reshape(3, 3))


add_corner_energy, add_energy_between = _adding_energy(at_corner), _adding_energy(_between)
add_corner, add_between = _adding_derivatives(at_corner, add_to_nodes), _adding_derivatives(_between, _add_between)


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
