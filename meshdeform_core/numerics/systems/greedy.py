"""Choosing few centres out of many: greedy reduction (Rendall & Allen 2009; Wang et al. 2015; Sen et al. 2.2)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np

from ..arrays import FloatArray, Report
from ..exact.radial import fill_rows, radial_matrix
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
