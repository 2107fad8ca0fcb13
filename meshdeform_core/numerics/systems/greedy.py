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
    """How centres are chosen: ``method`` is ``single``, ``hybrid`` or ``double-edged``; ``start`` is the first centre.

    The search ends when the error at all centres is within ``tolerance``, or when ``max_points`` are chosen.
    """

    method: str
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
    rounds : exact solutions that it took
    sequence : (u,) int64, the centres of all single-point updates, in their order
    converged : whether the largest error is within the tolerance
    """

    active: np.ndarray
    coefficients: np.ndarray
    polynomial: np.ndarray
    error: np.ndarray
    rounds: int
    sequence: np.ndarray
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

    ``single``: repeatedly correct the centre with the largest error by its own basis function; every centre corrected
    at least once is chosen. ``hybrid``: rounds of ``per_round`` such updates and an exact solution on the chosen
    centres. ``double-edged``: like ``hybrid``, but every update also corrects the centre with the largest error in the
    opposite direction.

    Parameters
    ----------
    kind : basis number; its value at 0 must be 1 (compact bases)
    centres : (n, 3) in units of the support radius
    polynomial : (n, q)
    values : (n, m) displacements at the centres
    scale : (n,) lengths relative to which errors are measured
    """
    method, tolerance, start, per_round, max_points = search
    n = len(centres)
    columns = np.ascontiguousarray(centres.T)
    residual = np.array(values, dtype=np.float64)
    weight = np.zeros_like(residual)
    chosen = np.zeros(n, dtype=np.bool_)
    order = np.empty(n, dtype=np.int64)
    pairs = method == "double-edged"
    count = rounds = 0
    sequence = [order[:0]]
    solved = weight[:0], np.zeros((polynomial.shape[1], values.shape[1]))
    while True:
        # Between exact solutions all updates are made, as the error is known only after the solution.
        limit, enough = (100 * n, tolerance) if method == "single" else (per_round, 0.0)
        state = _State(columns, residual, weight, 1.0 / scale, chosen, order, np.empty(limit + 1, dtype=np.int64))
        first = start if rounds == 0 else -1
        done, count = _update(kind, state, count, max_points, limit, enough, first, pairs)
        sequence.append(state.sequence[:done].copy())
        active = order[:count]
        if method == "single":
            solved = weight[active], solved[1]
            break
        rounds += 1
        solved, residual = _solve_exactly(kind, centres, polynomial, values, active)
        error = np.abs(residual).max(axis=1) / scale
        if progress:
            progress(count, max_points)
        if error.max() <= tolerance or count >= max_points or done == 0:
            break
    error = np.abs(residual).max(axis=1) / scale
    converged = bool(error.max() <= tolerance)
    return Selection(active.copy(), *solved, error, rounds, np.concatenate(sequence), converged)


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


class _State(NamedTuple):
    """State of a reduction: coordinates (3, n) of the centres, error (n, m), coefficients (n, m), one over the scale
    (n,), which centres are chosen (n,), and in which order (n,); ``sequence`` receives the centres of all corrections.
    """

    columns: np.ndarray
    residual: np.ndarray
    weight: np.ndarray
    inverse_scale: np.ndarray
    chosen: np.ndarray
    order: np.ndarray
    sequence: np.ndarray


@kernel
def _update(kind, state, count, max_points, limit, tolerance, start, pairs):
    """Make at most ``limit`` single-point corrections; return their number and the number of chosen centres."""
    columns, residual, weight, inverse_scale, chosen, order, sequence = state
    value = np.empty(residual.shape[0])
    done = 0
    while done < limit:
        worst = start
        if worst < 0 or done > 0:
            worst = _largest(residual, inverse_scale)
        if np.abs(residual[worst]).max() * inverse_scale[worst] <= tolerance and done > 0:
            break
        second = _opposite(residual, inverse_scale, worst) if pairs else -1
        for point in (worst, second):
            if point < 0 or (not chosen[point] and count >= max_points):
                continue
            if not chosen[point]:
                chosen[point] = True
                order[count] = point
                count += 1
            _correct(kind, columns, residual, weight, point, value)
            sequence[done] = point
            done += 1
        if count >= max_points:
            break
    return done, count


@kernel
def _largest(residual, inverse_scale):
    """The centre with the largest error component (the paper's "maximum absolute error")."""
    best, where = -1.0, 0
    for i in range(residual.shape[0]):
        for c in range(residual.shape[1]):
            size = abs(residual[i, c]) * inverse_scale[i]
            if size > best:
                best, where = size, i
    return where


@kernel
def _opposite(residual, inverse_scale, worst):
    """The centre with the largest error in the direction opposite to that of ``worst``; -1 if there is none."""
    lowest, where = 0.0, -1
    for i in range(residual.shape[0]):
        along = 0.0
        for c in range(residual.shape[1]):
            along += residual[i, c] * residual[worst, c]
        along *= inverse_scale[i]
        if along < lowest:
            lowest, where = along, i
    return where


@kernel
def _basis_around(kind, columns, point, value):
    """Basis values (n,) between one centre and all of them."""
    n = columns.shape[1]
    for i in range(n):
        dx = columns[0, i] - columns[0, point]
        dy = columns[1, i] - columns[1, point]
        dz = columns[2, i] - columns[2, point]
        value[i] = dx * dx + dy * dy + dz * dz
    apply_basis(kind, value, n)


@kernel
def _correct(kind, columns, residual, weight, point, value):
    """Remove the error at one centre with its own basis function."""
    n, m = residual.shape
    _basis_around(kind, columns, point, value)
    for c in range(m):
        change = residual[point, c]
        weight[point, c] += change
        for i in range(n):
            residual[i, c] -= change * value[i]


@kernel
def correct_again(kind, columns, sequence, residual, weight):
    """Repeat the corrections of a ``sequence`` of centres, with coordinates ``columns`` (3, n), for other values.

    ``residual`` (n, m) holds the values on entry and the residual on return; ``weight`` (n, m), zero on entry, the
    coefficients.
    """
    value = np.empty(residual.shape[0])
    for point in sequence:
        _correct(kind, columns, residual, weight, point, value)


@kernel
def correct_transposed(kind, columns, sequence, residual, weight):
    """Transpose of :func:`correct_again`.

    ``residual`` (n, m) holds the gradient of the residual on entry and that of the values on return; ``weight`` (n, m)
    is the gradient of the coefficients.
    """
    n, m = residual.shape
    value = np.empty(n)
    for step in range(len(sequence) - 1, -1, -1):
        point = sequence[step]
        _basis_around(kind, columns, point, value)
        for c in range(m):
            total = weight[point, c]
            for i in range(n):
                total -= residual[i, c] * value[i]
            residual[point, c] += total
