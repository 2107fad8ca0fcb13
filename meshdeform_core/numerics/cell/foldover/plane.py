"""The foldover-free energy of plane grids and its derivatives, for eight quadrilaterals at a time.

Their sample points are their corners. With A the Jacobian matrix (2, 2) of the map from the undeformed corner to the
deformed one, and D = det A,

    f = (|A|^2 + D^2 + 1) / (2 chi),    chi = (D + sqrt(eps^2 + D^2)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov: Foldover-free maps in 50 lines of code, ACM TOG 40(4), 2021,
eqs. 3 and 4 with d = 2 and lambda = 1). A cell in rigid motion has f = 2. Its energy follows from f as in
:mod:`meshdeform_core.numerics.cell.foldover`.

Split A = C + M into a similarity C and a mirrored similarity M: |A|^2 = |C|^2 + |M|^2 and 2 D = |C|^2 - |M|^2. In this
basis the second derivatives are diagonal but for one 2 x 2 matrix, so their negative part can be removed exactly.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir

from ...lanes import Array, Lanes, narrow
from .elements import add_energy, add_to_nodes, at_corner, combined, growth, load, plane_slopes, regular

WEIGHT, FORCE = 4, 40
"""Rows of ``terms`` and ``result``, see :mod:`.loops`: from FORCE on first derivatives (4, 2), before second ones
(10, 2, 2)."""

_HALF = math.sqrt(0.5)


def _map(points: Array, terms: Array, corner: ir.Value) -> tuple[Any, ...]:
    """The map at a corner of eight cells: its nodes, where it counts as a mask and as 0 or 1, the reciprocal vectors,
    A, A less that of the reference grid, |A|^2 and D; where it does not count, they are 0, |A|^2 is 2, and D is 1."""
    nodes, (edges, start, held) = at_corner(points, corner, 2)
    [count], ((p, q), (r, s)) = load(terms, 0, (1,), corner), start
    counts = (count * 0.0).below(count)
    dual = np.array([[s, r * -1.0], [q * -1.0, p]]) * counts.choose(1.0 / (p * s - q * r), 0.0)
    matrix, strain = edges.T @ dual, (edges - held).T @ dual
    (a, b), (c, d) = matrix
    square, det = counts.choose((matrix * matrix).sum(), 2.0), counts.choose(a * d - b * c, 1.0)
    return nodes, counts, count, dual, matrix, strain, square, det


@narrow
def add_plane_energy(
    points: Array, terms: Array, sums: Array, corner: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes, elastic: Lanes
) -> None:
    """Add the energy at a corner to ``sums``."""
    _, counts, _, _, _, strain, square, det = _map(points, terms, corner)
    chi, _ = regular(det, eps)
    f = 0.5 * (square + det * det + 1.0) / chi
    add_energy(sums, terms, WEIGHT, counts, det, chi, f, strain, share, cubic, elastic)


@narrow
def add_plane_corner(
    points: Array, terms: Array, result: Array, corner: ir.Value, eps: Lanes, share: Lanes, cubic: Lanes,
    elastic: Lanes, exact: Lanes,
) -> None:  # fmt: skip
    """Add the derivatives of the energy at a corner; of negative second derivatives only the share ``exact``."""
    nodes, counts, count, dual, matrix, strain, square, det = _map(points, terms, corner)
    [weight, stiff], ((a, b), (c, d)) = load(terms, WEIGHT, (2,)), matrix
    chi, root = regular(det, eps)
    f, *of_f = plane_slopes(square, det, chi, root)
    share, elastic = share * count, counts.choose(elastic * stiff, 0.0)
    one, two = growth(f)[1:]
    u, v, _, *second = combined(of_f, share * (weight + cubic * one), share * cubic * two)
    same, mirrored = [_HALF * (a + d), _HALF * (c - b)], [_HALF * (a - d), _HALF * (b + c)]
    values, vectors = _spectrum(same, mirrored, u, v, second)
    stress = matrix * u + np.array([[d, c * -1.0], [b * -1.0, a]]) * v + strain * elastic
    # The changes of A along the eigenvectors (4, 2, 2), and those per change of the edges (4, 2, 2).
    changes = np.array([[[e[0] + e[2], e[3] - e[1]], [e[1] + e[3], e[0] - e[2]]] for e in vectors]) * _HALF
    turned = changes @ dual.T
    scaled = [row * (value + elastic).max(exact * (value + elastic)) for row, value in zip(turned, values, strict=True)]
    bend = np.array([[np.array(scaled)[:, :, k].T @ turned[:, :, m] for m in range(2)] for k in range(2)])
    add_to_nodes(result, FORCE, nodes, dual @ stress.T, bend)


def _spectrum(
    c: list[Lanes], m: list[Lanes], u: Lanes, v: Lanes, second: list[Lanes]
) -> tuple[list[Lanes], list[list[Lanes]]]:
    """Eigenvalues (4,) and eigenvectors (4, 4) of the second derivatives.

    ``c`` (2,) and ``m`` (2,) are coordinates of the two parts of A; u, v and the ``second`` p, q, r are those of
    :func:`.jacobian.combined`.
    """
    of_square, mixed, of_det = second
    zero = u * 0.0
    (cc, c0, c1), (mm, m0, m1) = _unit(*c), _unit(*m)
    one = u + v + cc * cc * (of_square + 2.0 * mixed + of_det)
    two = u - v + mm * mm * (of_square - 2.0 * mixed + of_det)
    beside = cc * mm * (of_square - of_det)
    half, middle = 0.5 * (one - two), 0.5 * (one + two)
    radius = (half * half + beside * beside).sqrt()
    # The eigenvector of the larger eigenvalue in the plane spanned by the unit vectors along C and M.
    less = half.below(0.0)
    _, p, q = _unit(less.choose(beside, half + radius), less.choose(radius - half, beside))
    values = [u + v, u - v, middle + radius, middle - radius]
    vectors = [
        [c1 * -1.0, c0, zero, zero],
        [zero, zero, m1 * -1.0, m0],
        [p * c0, p * c1, q * m0, q * m1],
        [q * c0 * -1.0, q * c1 * -1.0, p * m0, p * m1],
    ]
    return values, vectors


def _unit(x: Lanes, y: Lanes) -> tuple[Lanes, Lanes, Lanes]:
    """The length of a vector, and the unit vector along it, (1, 0) if it is zero."""
    length = (x * x + y * y).sqrt()
    some = (length * 0.0).below(length)
    return length, some.choose(x / length, 1.0), some.choose(y / length, 0.0)
