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
from typing import NamedTuple

import numpy as np
import scipy

from ..arrays import FloatArray, Report
from ..exact.radial import fill_rows, radial_matrix


class DirectSolver:
    """Factorisation of the system, in the memory of ``A``.

    q Householder reflections transform the side conditions P^T alpha = 0 into "the first q entries are zero". The
    remaining block of A is positive definite (for conditionally positive definite bases and all positive definite
    ones), so that a Cholesky factorisation suffices, with half the work and memory of an LU. If round-off or the basis
    prevents that, the whole system is factorised by LU: ``matrix()`` then makes A (n, n) again. The polynomial (n, q)
    has full column rank.
    """

    def __init__(self, matrix: Callable, polynomial: FloatArray) -> None:
        self._polynomial = polynomial
        self.kind = "cholesky"
        if not self._factorise(matrix()):
            self.kind = "lu"
            del self._factor
            n, q = polynomial.shape
            system = np.zeros((n + q, n + q))
            system[:n, :n] = matrix()
            system[:n, n:], system[n:, :n] = polynomial, polynomial.T
            self._lu = scipy.linalg.lu_factor(system, overwrite_a=True, check_finite=False)

    def _factorise(self, a: FloatArray) -> bool:
        # The transpose of a symmetric C-ordered matrix is the same matrix in Fortran order: LAPACK works in place.
        a, p = a.T, self._polynomial.copy()
        n, q = p.shape
        self._reflectors = []
        for k in range(q):
            v = np.zeros(n)
            v[k:] = p[k:, k]
            v[k] += np.copysign(np.linalg.norm(v), v[k])
            v *= np.sqrt(2.0) / np.linalg.norm(v)
            p -= np.outer(v, v @ p)
            w = scipy.linalg.blas.dsymv(1.0, a, v, lower=1)
            w -= 0.5 * (v @ w) * v
            a = scipy.linalg.blas.dsyr2(-1.0, v, w, a=a, lower=1, overwrite_a=1)
            self._reflectors.append(v)
        self._triangle = p[:q].copy()
        self._coupling = np.tril(a[:, :q]).T.copy()
        self._coupling[:, :q] += np.tril(self._coupling[:, :q].T, -1).T
        a[:, :q] = 0.0
        a[np.arange(q), np.arange(q)] = 1.0
        self._factor, info = scipy.linalg.lapack.dpotrf(a, lower=1, overwrite_a=1, clean=0)
        return info == 0

    def solve(self, values: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, m) and polynomial (q, m) for boundary values (n, m)."""
        n, q = self._polynomial.shape
        if self.kind == "lu":
            full = np.concatenate([values, np.zeros((q, values.shape[1]))])
            solution = scipy.linalg.lu_solve(self._lu, full, overwrite_b=True, check_finite=False)
            return solution[:n], solution[n:]
        reflected = self._reflect(values, self._reflectors)
        rest = reflected.copy()
        rest[:q] = 0.0
        y, _ = scipy.linalg.lapack.dpotrs(self._factor, np.asfortranarray(rest), lower=1)
        y[:q] = 0.0
        polynomial = np.linalg.solve(self._triangle, reflected[:q] - self._coupling @ y) if q else np.zeros((0, 0))
        return self._reflect(y, self._reflectors[::-1]), polynomial

    @staticmethod
    def _reflect(values: FloatArray, reflectors: list[FloatArray]) -> FloatArray:
        result = np.array(values, dtype=np.float64)
        for v in reflectors:
            result -= np.outer(v, v @ result)
        return result


class Search(NamedTuple):
    """How centres are chosen: ``start`` is the first, ``per_round`` the number of updates between exact solutions.

    The search ends when the error at all centres is within ``tolerance``, or when ``max_points`` are chosen.
    """

    tolerance: float
    start: int
    per_round: int
    max_points: int


@dataclass(frozen=True)
class Selection:
    """Result of a greedy reduction.

    Attributes
    ----------
    active : (k,) int64, chosen centres in the order in which they were chosen
    coefficients, polynomial : (k, m), (q, m) of the reduced interpolation
    error : (n,) largest error component at every centre in units of ``scale``
    rounds, updates : number of exact solutions and of single-point updates that it took
    converged : whether the largest error is within the tolerance
    """

    active: np.ndarray
    coefficients: np.ndarray
    polynomial: np.ndarray
    error: np.ndarray
    rounds: int
    updates: int
    converged: bool


def select(
    kind: int,
    centres: FloatArray,
    polynomial: FloatArray,
    values: FloatArray,
    scale: FloatArray,
    search: Search,
    progress: Report | None = None,
) -> Selection:
    """Choose centres until the error at all of them is within the tolerance of ``search``.

    Every round makes ``per_round`` single-point updates, each of which corrects the centre with the largest error by
    its own basis function, whose value at 0 is 1 (compact bases), and so chooses it, and then solves exactly on the
    chosen centres. Of the centres (n, 3), in units of the support radius: polynomial (n, q), displacements (n, m), and
    lengths (n,) relative to which errors are measured.
    """
    residual, order, rounds, updates = values, list[int](), 0, 0
    while True:
        start = search.start if rounds == 0 else None
        done = _update(kind, centres, residual.T.copy(), 1.0 / scale, order, search, start)
        rounds, updates = rounds + 1, updates + done
        active = np.array(order, dtype=np.int64)
        points = np.ascontiguousarray(centres[active])
        solver = DirectSolver(partial(radial_matrix, kind, points, points), independent(polynomial[active]))
        coefficients, part = solver.solve(values[active])
        terms = np.zeros((polynomial.shape[1], values.shape[1]))
        terms[: len(part)] = part
        # Even for few centres, the matrix between all nodes and them would need more memory than the surface itself.
        residual = values - polynomial @ terms
        for first in range(0, len(centres), 4096):
            rows = slice(first, first + 4096)
            residual[rows] -= radial_matrix(kind, centres[rows], points) @ coefficients
        error = np.abs(residual).max(axis=1) / scale
        if progress:
            progress(len(order), search.max_points)
        if error.max() <= search.tolerance or len(order) >= search.max_points or done == 0:
            break
    converged = bool(error.max() <= search.tolerance)
    return Selection(active, coefficients, terms, error, rounds, updates, converged)


def independent(polynomial: FloatArray) -> FloatArray:
    """The columns of a polynomial (n, q) that n points determine: all of them, or only the constant."""
    if len(polynomial) > polynomial.shape[1] and np.linalg.matrix_rank(polynomial) == polynomial.shape[1]:
        return polynomial
    return polynomial[:, :1]


def _update(
    kind: int, centres: FloatArray, residual: FloatArray, inverse: FloatArray, order: list[int], search: Search,
    start: int | None,
) -> int:  # fmt: skip
    """Make at most ``search.per_round`` single-point updates, append the new centres to ``order``, and return their
    number.

    ``residual`` (m, n) is the error at every centre, which is updated, ``inverse`` (n,) one over its scale. The first
    centre to be corrected is ``start``, or, as all others, that with the largest error.
    """
    columns, value, chosen = np.ascontiguousarray(centres.T), np.empty((1, len(centres))), set(order)
    for done in range(search.per_round):
        # The largest component, the paper's "maximum absolute error".
        size = np.abs(residual).max(axis=0) * inverse
        point = int(np.argmax(size)) if start is None or done else start
        if size[point] <= 0.0 and done:
            return done
        if point not in chosen:
            if len(order) >= search.max_points:
                return done
            chosen.add(point)
            order.append(point)
        fill_rows(kind, centres[point : point + 1], columns, value)
        residual -= residual[:, point, None].copy() * value[0]
        if len(order) >= search.max_points:
            return done + 1
    return search.per_round
