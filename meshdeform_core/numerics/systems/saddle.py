"""The interpolation system of radial basis functions with a linear polynomial (Sen et al. eqs. 12, 13).

    [ A   P ] [alpha]   [d]
    [ P^T 0 ] [beta ] = [0]

A (n, n) holds the basis values between centres, P (n, q) the polynomial terms.
"""

import numpy as np
import scipy


class DirectSolver:
    """Factorisation of the system, in the memory of ``A``.

    The side conditions P^T alpha = 0 are turned into "the first q entries are zero" by q Householder reflections. What
    is left of A is positive definite (conditionally positive definite bases, and all positive definite ones), so that
    a Cholesky factorisation does: half the work and the memory of an LU. If round-off or the basis prevents that, the
    whole system is factorised by LU.

    Parameters
    ----------
    matrix : function that makes A, (n, n) float64, symmetric; called again only if Cholesky fails
    polynomial : (n, q), full column rank
    """

    def __init__(self, matrix, polynomial):
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

    def _factorise(self, a):
        # The transpose of a symmetric C-ordered matrix is itself in Fortran order: LAPACK works in place.
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

    def solve(self, values):
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
    def _reflect(values, reflectors):
        result = np.array(values, dtype=np.float64)
        for v in reflectors:
            result -= np.outer(v, v @ result)
        return result


def minres(multiply, rhs, tolerance, max_iterations, progress=None):
    """Minimum residual method for a symmetric operator, all right-hand sides side by side (Paige & Saunders 1975).

    Stops when ||r|| <= tolerance ||b|| for every column; the residual norm is the recurrence's own, which is the
    test of the paper (scipy's stops 10 to 1000 times earlier).

    Parameters
    ----------
    multiply : operator on (n, m) arrays
    rhs : (n, m)

    Returns
    -------
    solution : (n, m)
    iterations : (m,) int64 until each column met the tolerance
    residual : (m,) ||b - K x|| / ||b||, computed anew from the solution
    """
    norm_b = np.linalg.norm(rhs, axis=0)
    live = np.flatnonzero(norm_b > 0)
    x = np.zeros_like(rhs)
    iterations = np.zeros(rhs.shape[1], dtype=np.int64)
    state = _Lanczos(rhs[:, live], norm_b[live])
    solution = np.zeros((len(rhs), live.size))
    active = np.arange(live.size)
    for count in range(1, max_iterations + 1):
        if active.size == 0:
            break
        solution[:, active] += state.step(multiply)
        iterations[live[active]] = count
        keep = state.residual > tolerance * norm_b[live[active]]
        active = active[keep]
        state.keep(keep)
        if progress and count % 20 == 0:
            progress(count, max_iterations)
    x[:, live] = solution
    residual = np.zeros(rhs.shape[1])
    if live.size:
        true = rhs[:, live] - multiply(solution)
        residual[live] = np.linalg.norm(true, axis=0) / norm_b[live]
    return x, iterations, residual


class _Lanczos:
    """The three-term recurrences of MINRES for several columns."""

    def __init__(self, rhs, norm):
        self.v, self.v_old = rhs / norm, np.zeros_like(rhs)
        self.w, self.w_old = np.zeros_like(rhs), np.zeros_like(rhs)
        self.beta = np.zeros(len(norm))
        self.c, self.c_old = np.ones(len(norm)), np.ones(len(norm))
        self.s, self.s_old = np.zeros(len(norm)), np.zeros(len(norm))
        self.eta, self.residual = norm.copy(), norm.copy()

    def step(self, multiply):
        """One iteration; returns the update of the solution."""
        p = multiply(self.v)
        alpha = np.einsum("nm,nm->m", self.v, p)
        p -= alpha * self.v + self.beta * self.v_old
        beta = np.linalg.norm(p, axis=0)
        # Givens rotations on the new column of the tridiagonal matrix.
        rho0 = self.c * alpha - self.c_old * self.s * self.beta
        rho1 = np.hypot(rho0, beta)
        rho2 = self.s * alpha + self.c_old * self.c * self.beta
        rho3 = self.s_old * self.beta
        safe = np.where(rho1 > 0, rho1, 1.0)
        c, s = rho0 / safe, beta / safe
        w = (self.v - rho3 * self.w_old - rho2 * self.w) / safe
        update = c * self.eta * w
        self.w_old, self.w = self.w, w
        self.v_old, self.v = self.v, p / np.where(beta > 0, beta, 1.0)
        self.c_old, self.s_old, self.c, self.s, self.beta = self.c, self.s, c, s, beta
        self.residual = np.abs(s) * self.residual
        self.eta = -s * self.eta
        return update

    def keep(self, mask):
        """Go on with some of the columns."""
        if mask.all():
            return
        for name, value in vars(self).items():
            setattr(self, name, value[..., mask])
