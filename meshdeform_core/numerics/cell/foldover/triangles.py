"""Derivatives of the energy of eight triangles of a plane grid at a time; formulas in :mod:`.plane`."""

from __future__ import annotations

import math

from ...lanes import Array, Lanes, narrow
from .jacobian import growth, slopes_of_triangle
from .nodes import load, regular, store

DEFORMED, REFERENCE, SLOPE, WEIGHT, GIVEN = 0, 6, 12, 18, 19
"""Rows of ``given`` (GIVEN, WIDTH): coordinates (3, 2) of the nodes in two grids, gradients (3, 2) of their shape
functions, and w."""
FORCE, ROWS = 24, 32
"""Rows of ``result`` (ROWS, WIDTH): second derivatives (6, 2, 2) for pairs of nodes in ascending order, from FORCE on
the first ones (3, 2)."""

_HALF = math.sqrt(0.5)


@narrow
def triangle_derivatives(
    given: Array, result: Array, eps: Lanes, share: Lanes, cubic: Lanes, elastic: Lanes, exact: Lanes
) -> None:
    """Derivatives of the energy of eight triangles; of negative second derivatives only the share ``exact``."""
    slope = [[load(given, SLOPE + 2 * n + k) for k in range(2)] for n in range(3)]
    (a, b), (c, d) = matrix = _matrix(given, DEFORMED, slope)
    held = _matrix(given, REFERENCE, slope)
    det = a * d - b * c
    chi, root = regular(det, eps)
    f, dg, dd, gd, ddd = slopes_of_triangle.py_func(a * a + b * b + c * c + d * d, det, chi, root)
    one, two = growth.py_func(f)[1:]
    one, two = share * (load(given, WEIGHT) + cubic * one), share * cubic * two
    u, v = 2.0 * dg * one, dd * one
    second = two * dg * dg, one * gd + two * dg * dd, one * ddd + two * dd * dd
    same, mirrored = [_HALF * (a + d), _HALF * (c - b)], [_HALF * (a - d), _HALF * (b + c)]
    values, vectors = _spectrum(same, mirrored, u, v, second)
    values = [(value + elastic).max(exact * (value + elastic)) for value in values]
    cofactors = [[d, c * -1.0], [b * -1.0, a]]
    stress = [
        [u * matrix[i][k] + v * cofactors[i][k] + elastic * (matrix[i][k] - held[i][k]) for k in range(2)]
        for i in range(2)
    ]
    turned = [[_turned(vector, s) for vector in vectors] for s in slope]
    row = 0
    for n in range(3):
        for i in range(2):
            store(result, FORCE + 2 * n + i, stress[i][0] * slope[n][0] + stress[i][1] * slope[n][1])
        scaled = [[value * c for c in vector] for value, vector in zip(values, turned[n], strict=True)]
        for o in range(n, 3):
            for i in range(2):
                for k in range(2):
                    parts = [one[i] * other[k] for one, other in zip(scaled, turned[o], strict=True)]
                    store(result, row, (parts[0] + parts[1]) + (parts[2] + parts[3]))
                    row += 1


def _turned(vector: list[Lanes], slope: list[Lanes]) -> list[Lanes]:
    """The change of A along an eigenvector per displacement of a node."""
    e, (p, q) = vector, slope
    return [_HALF * ((e[0] + e[2]) * p + (e[3] - e[1]) * q), _HALF * ((e[1] + e[3]) * p + (e[0] - e[2]) * q)]


def _spectrum(
    c: list[Lanes], m: list[Lanes], u: Lanes, v: Lanes, second: tuple[Lanes, Lanes, Lanes]
) -> tuple[list[Lanes], list[list[Lanes]]]:
    """Eigenvalues (4,) and eigenvectors (4, 4) of the second derivatives.

    ``c`` (2,) and ``m`` (2,) are coordinates of the two parts of A; ``u`` is twice the derivative along g = |A|^2,
    ``v`` the one along D; ``second``: those along g, along g and D, and along D.
    """
    gg, gd, dd = second
    zero = u * 0.0
    (cc, c0, c1), (mm, m0, m1) = _unit(*c), _unit(*m)
    one = u + v + cc * cc * (4.0 * gg + 4.0 * gd + dd)
    two = u - v + mm * mm * (4.0 * gg - 4.0 * gd + dd)
    mixed = cc * mm * (4.0 * gg - dd)
    half, middle = 0.5 * (one - two), 0.5 * (one + two)
    radius = (half * half + mixed * mixed).sqrt()
    # The eigenvector of the larger eigenvalue in the plane spanned by the unit vectors along C and M.
    less = half.below(0.0)
    _, p, q = _unit(less.choose(mixed, half + radius), less.choose(radius - half, mixed))
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


def _matrix(given: Array, grid: int, slope: list[list[Lanes]]) -> list[list[Lanes]]:
    """The Jacobian matrix of a grid by rows."""
    place = [[load(given, grid + 2 * n + i) for i in range(2)] for n in range(3)]
    return [
        [sum((place[n][i] * slope[n][k] for n in (1, 2)), place[0][i] * slope[0][k]) for k in range(2)]
        for i in range(2)
    ]
