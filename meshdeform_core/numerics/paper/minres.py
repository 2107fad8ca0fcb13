"""The paper's solver of the radial basis function system (Sen et al.): MINRES without a preconditioner."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray, Report


def minres(
    multiply: Callable, rhs: FloatArray, tolerance: float, max_iterations: int, progress: Report | None = None
) -> tuple[FloatArray, IntArray, FloatArray]:
    """Minimum residual method for a symmetric operator, all right-hand sides side by side (Paige & Saunders 1975).

    Stops when ||r|| <= tolerance ||b|| for every column, with the residual norm of the recurrence, which is the
    criterion of the paper (scipy's stops at residuals 10 to 1000 times larger).

    Parameters
    ----------
    multiply : operator on (n, m) arrays
    rhs : (n, m)

    Returns
    -------
    solution : (n, m)
    iterations : (m,) int64 until each column met the tolerance
    residual : (m,) ||b - K x|| / ||b||, computed from the solution
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

    def __init__(self, rhs: FloatArray, norm: FloatArray) -> None:
        self.v, self.v_old = rhs / norm, np.zeros_like(rhs)
        self.w, self.w_old = np.zeros_like(rhs), np.zeros_like(rhs)
        self.beta = np.zeros(len(norm))
        self.c, self.c_old = np.ones(len(norm)), np.ones(len(norm))
        self.s, self.s_old = np.zeros(len(norm)), np.zeros(len(norm))
        self.eta, self.residual = norm.copy(), norm.copy()

    def step(self, multiply: Callable) -> FloatArray:
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

    def keep(self, mask: BoolArray) -> None:
        """Continue with some of the columns only."""
        if mask.all():
            return
        for name, value in vars(self).items():
            setattr(self, name, value[..., mask])
