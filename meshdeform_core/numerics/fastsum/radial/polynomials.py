"""Polynomials on boxes: the effect of far clusters on a group of targets.

The basis consists of products of Chebyshev polynomials T_i(x) T_j(y) T_k(z) of limited total degree; only those are
used that matter in the Taylor series of a distant source, which are fewer along the short sides of a box. They
interpolate at approximate Fekete points (Sommariva & Vianello, Comput. Math. Appl. 57, 2009). Their accuracy is
measured once per box shape.
"""

from __future__ import annotations

import functools
import math
from typing import NamedTuple

import numpy as np
import scipy

from ...arrays import FloatArray, IntArray
from ...exact.basis import BASES
from ...exact.radial import radial_matrix
from ...jit import fast_kernel, record
from ..tuned import HIGHEST, REFERENCE

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
    degree = _terms(half, accuracy)
    sides = [np.cos(np.pi * np.arange(n + 1) / n) if n else np.zeros(1) for n in degree.max(axis=0) + 1]
    sides = [side if h > 0 else np.zeros(1) for side, h in zip(sides, half, strict=True)]
    candidates = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
    values = _values(degree, candidates)
    chosen = scipy.linalg.qr(values.T, mode="r", pivoting=True)[1][: len(degree)]
    points, matrix = candidates[chosen], np.linalg.inv(values[chosen])
    return degree, points, matrix, _errors(half, degree, points, matrix)


def _terms(half: FloatArray, accuracy: float) -> IntArray:
    """Degrees (m, 3) of the terms that matter, including all up to degree 2, which r^2 log r has at any distance."""
    most = [HIGHEST if h > 0 else 1 for h in half]
    degree = np.stack(np.meshgrid(*map(np.arange, most), indexing="ij"), axis=-1).reshape(-1, 3)
    total = degree.sum(axis=1)
    factorials = np.array([math.lgamma(n + 1) for n in range(3 * HIGHEST)])
    # (i + j + k)! / (i! j! k!) prod (h / 2 D)^i, a factor 2 for every direction of degree > 0, and n^-3 for r^2 log r.
    size = factorials[total] - factorials[degree].sum(axis=1) - 3.0 * np.log(np.maximum(total, 1))
    size += (degree * np.log(np.where(half > 0, half, 1.0) / (2.0 * REFERENCE))).sum(axis=1)
    size += np.log(2.0) * (degree > 0).sum(axis=1)
    return degree[(size >= math.log(accuracy)) | (total <= 2)]


def _values(degree: IntArray, points: FloatArray) -> FloatArray:
    """Values (n, m) of the polynomials at points (n, 3) of [-1, 1]^3."""
    values = np.ones((len(points), len(degree)))
    for d in range(3):
        values *= np.cos(degree[:, d] * np.arccos(points[:, d, None]))
    return values


def _errors(half: FloatArray, degree: IntArray, points: FloatArray, matrix: FloatArray) -> FloatArray:
    """Largest error (d,) at each distance, over random sources and random points of the box."""
    random = np.random.default_rng(0)
    places = random.uniform(-1.0, 1.0, (_PLACES, 3))
    shares = _values(degree, places) @ matrix
    away = random.standard_normal((_SOURCES, 3))
    away /= np.linalg.norm(away, axis=1)[:, None]
    errors = []
    for n in range(_DISTANCES):
        sources = NEAREST * GROWTH**n * away
        exact, known = (radial_matrix(BASES["tps"], np.ascontiguousarray(x * half), sources) for x in (places, points))
        errors.append(np.abs(shares @ known - exact).max())
    # Round-off aside, the error never grows with distance.
    return np.maximum.accumulate(np.array(errors)[::-1])[::-1]


@fast_kernel
def place_points(center, axes, half, canonical, out):
    """Map points ``canonical`` (m, 3) of [-1, 1]^3 into a box with half sides ``half`` along the rows of ``axes``."""
    for n in range(canonical.shape[0]):
        for d in range(3):
            out[n, d] = center[d]
            for row in range(3):
                out[n, d] += half[row] * canonical[n, row] * axes[row, d]


@fast_kernel
def to_coefficients(matrix, first, values, out):
    """Coefficients (m, 3) from values (m, 3) at the interpolation points."""
    m = values.shape[0]
    for i in range(m):
        a = b = c = 0.0
        for j in range(m):
            w = matrix[first + i * m + j]
            a += w * values[j, 0]
            b += w * values[j, 1]
            c += w * values[j, 2]
        out[i, 0], out[i, 1], out[i, 2] = a, b, c


@fast_kernel
def add_polynomial(center, axes, half, degree, coefficients, points, out):
    """Add the values (n, 3) of a box's polynomial at ``points`` (n, 3)."""
    n, most = points.shape[0], degree.max() + 1
    value = np.empty((3, most, n))
    for d in range(3):
        _chebyshev(center, axes, half, d, points, value[d])
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


@fast_kernel
def add_transposed(center, axes, half, degree, points, gradient, out):
    """Transpose of :func:`add_polynomial`: add to the gradient (m, 3) of the coefficients that (n, 3) of the values."""
    n, most = points.shape[0], degree.max() + 1
    value = np.empty((3, most, n))
    for d in range(3):
        _chebyshev(center, axes, half, d, points, value[d])
    given, pair, product = np.empty((3, n)), np.empty(n), np.empty(n)
    for t in range(n):
        for c in range(3):
            given[c, t] = gradient[t, c]
    for m in range(degree.shape[0]):
        i, j, k = degree[m]
        if k == 0:
            for t in range(n):
                pair[t] = value[0, i, t] * value[1, j, t]
        a = b = c = 0.0
        for t in range(n):
            product[t] = pair[t] * value[2, k, t]
            a += product[t] * given[0, t]
            b += product[t] * given[1, t]
            c += product[t] * given[2, t]
        out[m, 0] += a
        out[m, 1] += b
        out[m, 2] += c


@fast_kernel
def _chebyshev(center, axes, half, d, points, value):
    """Values (degrees, n) of Chebyshev polynomials along side ``d`` of a box."""
    n = points.shape[0]
    value[0] = 1.0
    if value.shape[0] == 1:
        return
    at = value[1]
    at[:] = 0.0
    if half[d] > 0.0:
        for e in range(3):
            factor, origin = axes[d, e] / half[d], center[e]
            for t in range(n):
                at[t] += factor * (points[t, e] - origin)
    for i in range(2, value.shape[0]):
        for t in range(n):
            value[i, t] = 2.0 * at[t] * value[i - 1, t] - value[i - 2, t]
