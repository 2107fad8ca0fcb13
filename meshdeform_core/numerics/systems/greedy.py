"""Choosing few centres out of many: greedy reduction (Rendall & Allen 2009; Wang et al. 2015; Sen et al. 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray, Report
from ..exact.basis import apply_basis
from ..exact.radial import radial_matrix
from ..jit import kernel
from .saddle import DirectSolver


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
    its own basis function and so chooses it, and then solves exactly on the chosen centres.

    Parameters
    ----------
    kind : basis number; its value at 0 must be 1 (compact bases)
    centres : (n, 3) in units of the support radius
    polynomial : (n, q)
    values : (n, m) displacements at the centres
    scale : (n,) lengths relative to which errors are measured
    """
    n = len(centres)
    columns, residual = np.ascontiguousarray(centres.T), np.array(values, dtype=np.float64)
    chosen, order = np.zeros(n, dtype=np.bool_), np.empty(n, dtype=np.int64)
    first, count, rounds, updates = search.start, 0, 0, 0
    while True:
        done, count = _update(
            kind, columns, residual, 1.0 / scale, chosen, order, count, search.max_points, search.per_round, first
        )
        first, rounds, updates = -1, rounds + 1, updates + done
        solved, residual = _solve_exactly(kind, centres, polynomial, values, order[:count])
        error = np.abs(residual).max(axis=1) / scale
        if progress:
            progress(count, search.max_points)
        if error.max() <= search.tolerance or count >= search.max_points or done == 0:
            break
    converged = bool(error.max() <= search.tolerance)
    return Selection(order[:count].copy(), *solved, error, rounds, updates, converged)


def _solve_exactly(
    kind: int, centres: FloatArray, polynomial: FloatArray, values: FloatArray, active: IntArray
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    points = np.ascontiguousarray(centres[active])
    solver = DirectSolver(lambda: radial_matrix(kind, points, points), independent(polynomial[active]))
    coefficients, part = solver.solve(values[active])
    terms = np.zeros((polynomial.shape[1], values.shape[1]))
    terms[: len(part)] = part
    # Even for few centres, the matrix between all nodes and them would need more memory than the surface itself.
    residual = values - polynomial @ terms
    for first in range(0, len(centres), 4096):
        rows = slice(first, first + 4096)
        residual[rows] -= radial_matrix(kind, centres[rows], points) @ coefficients
    return (coefficients, terms), residual


def independent(polynomial: FloatArray) -> FloatArray:
    """The columns of a polynomial (n, q) that n points determine: all of them, or only the constant."""
    if len(polynomial) > polynomial.shape[1] and np.linalg.matrix_rank(polynomial) == polynomial.shape[1]:
        return polynomial
    return polynomial[:, :1]


@kernel("i8, f8[:, ::1], f8[:, ::1], f8[::1], b1[::1], i8[::1], i8, i8, i8, i8")
def _update(kind, columns, residual, inverse_scale, chosen, order, count, max_points, limit, start):
    """Make at most ``limit`` single-point updates; return their number and the number of chosen centres.

    ``columns`` (3, n) are the coordinates of the centres, ``residual`` (n, m) the error at each, which is updated;
    ``start`` is the first centre to be corrected, -1 for that with the largest error.
    """
    n, m = residual.shape
    value = np.empty(n)
    for done in range(limit):
        point = start
        if point < 0 or done > 0:
            # The largest component, the paper's "maximum absolute error".
            largest, point = -1.0, 0
            for i in range(n):
                for c in range(m):
                    size = abs(residual[i, c]) * inverse_scale[i]
                    if size > largest:
                        largest, point = size, i
            if largest <= 0.0 and done > 0:
                return done, count
        if not chosen[point]:
            if count >= max_points:
                return done, count
            chosen[point] = True
            order[count] = point
            count += 1
        for i in range(n):
            dx = columns[0, i] - columns[0, point]
            dy = columns[1, i] - columns[1, point]
            dz = columns[2, i] - columns[2, point]
            value[i] = dx * dx + dy * dy + dz * dz
        apply_basis(kind, value, n)
        for c in range(m):
            change = residual[point, c]
            for i in range(n):
                residual[i, c] -= change * value[i]
        if count >= max_points:
            return done + 1, count
    return limit, count
