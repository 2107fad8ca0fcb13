"""The interpolation system of radial basis functions with a linear polynomial (Sen et al. eqs. 12, 13).

    [ A   P ] [alpha]   [d]
    [ P^T 0 ] [beta ] = [0]

A (n, n) holds the basis values between centres, P (n, q) the polynomial terms.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy

from ..arrays import FloatArray


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
