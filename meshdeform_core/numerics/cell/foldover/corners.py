"""The energy of hexahedra at their sample points, and its derivatives, for eight cells at a time.

The Jacobian matrix A of the map from the undeformed cell depends on three vectors e_0, e_1, e_2, the derivatives of
the position along the index axes: it is the sum of e_k g_k^T, with g_k the reciprocal vectors of the undeformed cell.
Second derivatives are therefore found for six pairs of these vectors instead of ten or more pairs of nodes. With V the
determinant of the undeformed vectors and K the cofactors of A, for cyclic (k, l, m)

    K g_k = e_l x e_m / V,    A (g_k x g_l) = e_m / V.

At a corner they are edges, all pointing away from it, so that V may be negative. At sample points between corners they
are sums over the nodes times the slopes of their shape functions.
"""

from __future__ import annotations

from typing import NamedTuple

from llvmlite import ir

from ...lanes import NARROW as WIDTH
from ...lanes import Array, Lanes, Mask, narrow
from .jacobian import combined, growth, slopes
from .nodes import (
    BEND,
    PULL,
    Vector,
    add_blocks,
    add_forces,
    dot,
    load,
    neighbours,
    regular,
    row_of,
    slopes_of,
    store,
)

DEFORMED, UNDEFORMED, REFERENCE, GRIDS = 0, 1, 2, 3
"""Rows of ``points`` (GRIDS, 8, 3, WIDTH): coordinates of the corners of eight cells in three grids."""
WEIGHT, BETWEEN, HELD, TERMS = 27, 28, 29, 30
"""Rows of ``terms`` (TERMS, WIDTH): 1 where the sample point 0 to 26 counts, else 0; w of the cells, the share of their
sample points between corners, and the factor of their elastic energy."""
ENERGY, LOWEST, HIGHEST, SUMS = 0, 1, 2, 3
"""Rows of ``sums`` (SUMS, WIDTH): the energy, the smallest D, the largest f."""

# For x^(-1/3): the first guess from the bits of x is within 4 %, and every correction, by the first terms of the series
# of (1 - d)^(-1/3), raises the error to the third power.
_GUESS, _CORRECTIONS = 1430187000.0, 3


class _Map(NamedTuple):
    """The map at a sample point of eight cells: where it ``counts``, ``edges``: the vectors e_k, ``dual``: g_k,
    ``inverse``: 1 / V, the rows of A, ``across``: K g_k, |A|^2, and D. Where the point does not count, |A|^2 is 3, D is
    1 and all of the others but the edges are 0: what is left out by the factor 0 must not overflow."""

    counts: Mask
    edges: list[Vector]
    dual: list[Vector]
    inverse: Lanes
    matrix: list[Vector]
    across: list[Vector]
    square: Lanes
    det: Lanes


@narrow
def add_corner_energy(
    points: Array, terms: Array, sums: Array, node: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes, elastic: Lanes
) -> None:
    """Add the energy at the corner ``node`` of all cells to ``sums``."""
    found = _map(terms, node, _edges(points, UNDEFORMED, node), _edges(points, DEFORMED, node))
    stiff = 0.5 * elastic * load(terms, HELD) * _square(_strain(points, node, found))
    _add_energy(terms, sums, found, eps, share, cubic, stiff)


@narrow
def add_energy_between(
    points: Array, terms: Array, slope: Array, sums: Array, sample: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes
) -> None:
    """Add the energy at a sample point between corners to ``sums``; ``slope`` (27, 8, 3): of the shape functions."""
    found = _map(terms, sample, *(_sloped(points, grid, slope, sample) for grid in (UNDEFORMED, DEFORMED)))
    _add_energy(terms, sums, found, eps, share * load(terms, BETWEEN), cubic, found.det * 0.0)


def _add_energy(terms: Array, sums: Array, found: _Map, eps: Lanes, share: Lanes, cubic: Lanes, stiff: Lanes) -> None:
    chi, _ = regular(found.det, eps)
    root, infinite = _inverse_root(chi), found.det * 0.0 + float("inf")
    f = found.square * (1 / 3) * root * root + (found.det * found.det + 1.0) * 0.5 / chi
    f = (chi * 0.0).below(chi).choose(f, infinite)
    total = share * (load(terms, WEIGHT) * f + cubic * growth(f)[0]) + stiff
    store(sums, ENERGY, load(sums, ENERGY) + found.counts.choose(total, 0.0))
    store(sums, LOWEST, load(sums, LOWEST).min(found.counts.choose(found.det, infinite)))
    store(sums, HIGHEST, load(sums, HIGHEST).max(found.counts.choose(f, 0.0)))


@narrow
def add_corner_derivatives(
    points: Array,
    terms: Array,
    result: Array,
    node: ir.Value,
    eps: Lanes,
    share: Lanes,
    cubic: Lanes,
    elastic: Lanes,
    exact: Lanes,
) -> None:
    """Add the derivatives of the energy at the corner ``node`` of all cells to ``result``."""
    found = _map(terms, node, _edges(points, UNDEFORMED, node), _edges(points, DEFORMED, node))
    stiff, strain = found.counts.choose(elastic * load(terms, HELD), 0.0), _strain(points, node, found)
    pull, second = _derivatives(terms, found, eps, share, cubic, stiff, exact)
    for k in range(3):
        pull[k] = [pull[k][d] + stiff * dot(strain[d], found.dual[k]) for d in range(3)]
    add_forces(result, node, pull)
    add_blocks(result, node, second)


@narrow
def derivatives_between(
    points: Array,
    terms: Array,
    slope: Array,
    parts: Array,
    sample: ir.Value,
    eps: Lanes,
    share: Lanes,
    cubic: Lanes,
    exact: Lanes,
) -> None:
    """The derivatives at a sample point between corners, with respect to the vectors e_k, in ``parts``."""
    found = _map(terms, sample, *(_sloped(points, grid, slope, sample) for grid in (UNDEFORMED, DEFORMED)))
    share = share * load(terms, BETWEEN)
    pull, second = _derivatives(terms, found, eps, share, cubic, found.det * 0.0, exact)
    for k in range(3):
        for d in range(3):
            store(parts, PULL + 3 * k + d, pull[k][d])
            for m in range(3):
                for e in range(3):
                    store(parts, BEND + 9 * (3 * k + m) + 3 * d + e, second[k][m][d][e])


def _derivatives(
    terms: Array, found: _Map, eps: Lanes, share: Lanes, cubic: Lanes, stiff: Lanes, exact: Lanes
) -> tuple[list[Vector], list[list[list[Vector]]]]:
    """First (3, 3) and second derivatives (3, 3, 3, 3) with respect to the vectors e_k; the first ones without the
    elastic energy, whose stiffness is ``stiff``."""
    chi, root = regular(found.det, eps)
    third = _inverse_root(chi)
    f, u, v, w, q, r, least = slopes(found.square, found.det, chi, root, third * third)
    r = r.max(r * exact + least * (exact * -1.0 + 1.0))
    one, two = growth(f)[1:]
    part = found.counts.choose(share, 0.0)
    u, v, w, p, q, r = combined((u, v, w, q, r), part * (load(terms, WEIGHT) + cubic * one), part * cubic * two)
    along = [[dot(row, dual) for row in found.matrix] for dual in found.dual]
    pull = [[u * a + v * c for a, c in zip(*pair, strict=True)] for pair in zip(along, found.across, strict=True)]
    return pull, _second(found, along, w + stiff, v * exact * found.inverse, p, q, r)


def _second(
    found: _Map, along: list[Vector], factor: Lanes, turning: Lanes, p: Lanes, q: Lanes, r: Lanes
) -> list[list[list[Vector]]]:
    """Second derivatives (3, 3, 3, 3) with respect to two of the vectors e_k."""
    across = found.across
    left = [[p * a + q * c for a, c in zip(*pair, strict=True)] for pair in zip(along, across, strict=True)]
    right = [[q * a + r * c for a, c in zip(*pair, strict=True)] for pair in zip(along, across, strict=True)]
    result: list[list[list[Vector]]] = [[[] for _ in range(3)] for _ in range(3)]
    for k in range(3):
        for m in range(k, 3):
            of_pair = [[left[k][d] * along[m][e] + right[k][d] * across[m][e] for e in range(3)] for d in range(3)]
            same = factor * dot(found.dual[k], found.dual[m])
            for d in range(3):
                of_pair[d][d] = of_pair[d][d] + same
            if k != m:
                # The matrix of the cross product with the third vector, whose sense follows from the order of the axes.
                x, y, z = (turning * c if m == k + 1 else turning * c * -1.0 for c in found.edges[3 - k - m])
                of_pair[0][1], of_pair[1][0] = of_pair[0][1] + z, of_pair[1][0] - z
                of_pair[1][2], of_pair[2][1] = of_pair[1][2] + x, of_pair[2][1] - x
                of_pair[2][0], of_pair[0][2] = of_pair[2][0] + y, of_pair[0][2] - y
            result[k][m] = of_pair
            result[m][k] = [list(column) for column in zip(*of_pair, strict=True)]
    return result


def _map(terms: Array, sample: ir.Value, start: list[Vector], edges: list[Vector]) -> _Map:
    count = terms.load(terms.builder.mul(sample, sample.type(WIDTH)))
    counts = (count * 0.0 + 0.5).below(count)
    areas = _areas(start)
    inverse = counts.choose(1.0 / dot(start[0], areas[0]), 0.0)
    dual = [[inverse * c for c in area] for area in areas]
    matrix = _matrix(edges, dual)
    across = [[inverse * c for c in area] for area in _areas(edges)]
    square, det = counts.choose(_square(matrix), 3.0), counts.choose(dot(edges[0], across[0]), 1.0)
    return _Map(counts, edges, dual, inverse, matrix, across, square, det)


def _sloped(points: Array, grid: int, slope: Array, sample: ir.Value) -> list[Vector]:
    """The vectors e_k of a grid at a sample point."""
    total: list[Vector] = []
    for n in range(8):
        node = sample.type(n)
        factors = slopes_of(slope, sample, node)
        place = [points.load(row_of(points, node), (grid * 24 + d) * WIDTH) for d in range(3)]
        more = [[factor * c for c in place] for factor in factors]
        total = [[a + b for a, b in zip(*pair, strict=True)] for pair in zip(total, more, strict=True)] if n else more
    return total


def _strain(points: Array, node: ir.Value, found: _Map) -> list[Vector]:
    """A less that of the reference grid, by rows."""
    reference = _edges(points, REFERENCE, node)
    change = [[a - b for a, b in zip(*pair, strict=True)] for pair in zip(found.edges, reference, strict=True)]
    return _matrix(change, found.dual)


def _edges(points: Array, grid: int, node: ir.Value) -> list[Vector]:
    """The edges from a node of the cells to its neighbours along the index axes."""
    first = grid * 8 * 3 * WIDTH
    start = [points.load(row_of(points, node), first + d * WIDTH) for d in range(3)]
    ends = (
        [points.load(row_of(points, other), first + d * WIDTH) for d in range(3)] for other in neighbours(points, node)
    )
    return [[b - a for a, b in zip(start, end, strict=True)] for end in ends]


def _square(rows: list[Vector]) -> Lanes:
    return dot(rows[0], rows[0]) + dot(rows[1], rows[1]) + dot(rows[2], rows[2])


def _areas(edges: list[Vector]) -> list[Vector]:
    """The cross product of the other two edges, for each edge."""
    pairs = [(edges[(k + 1) % 3], edges[(k + 2) % 3]) for k in range(3)]
    return [[a[i] * b[j] - a[j] * b[i] for i, j in ((1, 2), (2, 0), (0, 1))] for a, b in pairs]


def _matrix(edges: list[Vector], dual: list[Vector]) -> list[Vector]:
    """The sum of e_k g_k^T, by rows."""
    return [
        [edges[0][d] * dual[0][k] + edges[1][d] * dual[1][k] + edges[2][d] * dual[2][k] for k in range(3)]
        for d in range(3)
    ]


def _inverse_root(x: Lanes) -> Lanes:
    """x^(-1/3) of positive numbers."""
    r = (_GUESS - x.bits() * (1 / 3)).from_bits()
    for _ in range(_CORRECTIONS):
        d = 1.0 - x * r * r * r
        r = r + r * d * (d * (2 / 9) + 1 / 3)
    return r
