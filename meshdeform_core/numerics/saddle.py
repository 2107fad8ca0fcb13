"""The interpolation system of radial basis functions with a linear polynomial (Sen et al. eqs. 12, 13).

    [ A   P ] [alpha]   [d]
    [ P^T 0 ] [beta ] = [0]

A (n, n) holds the basis values between centres, P (n, q) the polynomial terms. Few centres out of many are chosen by
greedy reduction (Rendall & Allen 2009; Wang et al. 2015; Sen et al. 2.2).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import scipy

from .arrays import FloatArray, Report
from .exact.radial import fill_rows, radial_matrix

_ROWS = 4096
"""Centres whose errors are computed at a time: the matrix between all of them and few would take more memory than the
surface itself."""


def projected(a: FloatArray, basis: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """A (n, n) on the orthogonal complement of the polynomials with the orthonormal ``basis`` Q (n, q).

    Returns ``B = (I - Q Q^T) A (I - Q Q^T) + t Q Q^T``, its lower triangle in the memory of A, with A Q and t: B is
    positive definite for conditionally positive definite functions, and its inverse differs from that of A on the
    complement only by ``Q Q^T / t``.
    """
    t = float(max(a.max(), -a.min())) or 1.0
    # B is A - Q U^T - U Q^T.
    coupling = a @ basis
    u = coupling - 0.5 * basis @ (basis.T @ coupling + t * np.eye(basis.shape[1]))
    # The transpose of a symmetric C-ordered matrix is the same matrix in Fortran order: BLAS works in place.
    b = scipy.linalg.blas.dsyr2k(-1.0, basis, u, beta=1.0, c=a.T, lower=1, overwrite_c=1)
    return b, coupling, t


class DirectSolver:
    """Factorisation of the system, in the memory of ``A``.

    On the complement of the polynomials, A is positive definite (for conditionally positive definite bases and all
    positive definite ones), so that a Cholesky factorisation suffices, with half the work and memory of an LU. If
    round-off or the basis prevents that, the factors are L D L^T: ``matrix()`` then makes A (n, n) again. The
    polynomial (n, q) has full column rank.
    """

    def __init__(self, matrix: Callable[[], FloatArray], polynomial: FloatArray) -> None:
        self._basis, self._triangle = np.linalg.qr(polynomial)
        b, self._coupling, _ = projected(matrix(), self._basis)
        self.kind, lapack = "cholesky", scipy.linalg.lapack
        factor, info = lapack.dpotrf(b, lower=1, overwrite_a=1, clean=0)
        self._solve = partial(lapack.dpotrs, factor, lower=1)
        if info:
            # Freed before the matrix is made again.
            del b, factor, self._solve
            self.kind = "ldl"
            b, work = projected(matrix(), self._basis)[0], 64 * len(polynomial)
            *factors, _ = lapack.dsytrf(b, lower=1, lwork=work, overwrite_a=1)
            self._solve = partial(lapack.dsytrs, *factors, lower=1)

    def solve(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, m) and polynomial (q, m) for boundary values (n, m)."""
        part = self._basis.T @ values
        found, _ = self._solve(values - self._basis @ part)
        found -= self._basis @ (self._basis.T @ found)
        return np.ascontiguousarray(found), np.linalg.solve(self._triangle, part - self._coupling.T @ found)


@dataclass(frozen=True)
class Selection:
    """Result of a greedy reduction.

    Attributes
    ----------
    active : (k,) int64, chosen centres in the order in which they were chosen
    coefficients, polynomial : (k, m), (q, m) of the reduced interpolation
    residual : (n, m) error at every centre
    error : its largest component in units of ``scale``
    rounds, updates : number of exact solutions and of single-point updates that it took
    """

    active: np.ndarray
    coefficients: np.ndarray
    polynomial: np.ndarray
    residual: np.ndarray
    error: float
    rounds: int
    updates: int


def select(
    kind: int,
    centres: FloatArray,
    polynomial: FloatArray,
    values: FloatArray,
    scale: FloatArray,
    tolerance: float,
    per_round: int,
    progress: Report | None = None,
) -> Selection:
    """Choose centres until the error at all of them is within the tolerance, or a round chooses none.

    Every round makes ``per_round`` single-point updates, each of which corrects the centre with the largest error by
    its own basis function, whose value at 0 is 1 (compact bases), and so chooses it, and then solves exactly on the
    chosen centres; the first centre of all is the first one. Of the centres (n, 3), in units of the support radius:
    polynomial (n, q), displacements (n, m), and lengths (n,) relative to which errors are measured.
    """
    columns, value, inverse = np.ascontiguousarray(centres.T), np.empty((1, len(centres))), 1.0 / scale
    # The centres chosen are the keys.
    chosen, residual, rounds, updates, error = dict[int, None](), values, 0, 0, np.inf
    while error > tolerance:
        before, rest = len(chosen), residual.T.copy()
        for _ in range(per_round):
            # The largest component, the paper's "maximum absolute error".
            size = np.abs(rest).max(axis=0) * inverse
            point = int(np.argmax(size)) if chosen else 0
            if chosen and size[point] <= 0.0:
                break
            chosen[point] = None
            fill_rows(kind, centres[point : point + 1], columns, value)
            rest -= rest[:, point, None].copy() * value[0]
            updates += 1
        if len(chosen) == before:
            break
        active = np.array([*chosen], dtype=np.int64)
        points = np.ascontiguousarray(centres[active])
        terms = independent(polynomial[active])
        coefficients, part = DirectSolver(partial(radial_matrix, kind, points, points), terms).solve(values[active])
        residual, rounds = values - polynomial[:, : len(part)] @ part, rounds + 1
        for first in range(0, len(centres), _ROWS):
            rows = slice(first, first + _ROWS)
            residual[rows] -= radial_matrix(kind, centres[rows], points) @ coefficients
        error = float((np.abs(residual).max(axis=1) * inverse).max())
        if progress:
            progress(len(chosen), len(centres))
    return Selection(active, coefficients, part, residual, error, rounds, updates)


def independent(polynomial: FloatArray) -> FloatArray:
    """The columns of a polynomial (n, q) that n points determine: all of them, or only the constant."""
    if len(polynomial) > polynomial.shape[1] and np.linalg.matrix_rank(polynomial) == polynomial.shape[1]:
        return polynomial
    return polynomial[:, :1]
