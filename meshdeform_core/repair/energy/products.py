"""Products of the matrix of a Newton step, and its preconditioning, in conjugate gradients.

A symmetric matrix A of square blocks with unit diagonal is divided into ranges of rows: A = I + L + L^T + E, where L is
the strictly lower part within the ranges, and E couples different ranges. With D = I / w, conjugate gradients solve

    (D + L)^-1 A (D + L^T)^-1 y = (D + L)^-1 b,    x = (D + L^T)^-1 y,

whose matrix is applied with one pass over the blocks (Eisenstat, Efficient implementation of a class of preconditioned
conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981): with t = (D + L^T)^-1 p, the image of p is
t + (D + L)^-1 (p + (I - 2 D) t + E t). The more nodes there are along a side of the grid, the nearer the best w is to 2
(symmetric successive over-relaxation: Axelsson, A generalized SSOR method, BIT 12, 1972). In plane grids this takes a
sixth of the iterations, each hardly more costly. With 3 x 3 blocks the sweeps take more than twice as long as a product
and save no more than that, so A itself is used.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...numerics.arrays import FloatArray, IntArray
from ...numerics.jit import inlined, kernel
from ...numerics.systems.block_rows import multiply_row, solve_row
from ...parallel import Halo, for_chunks

# Number of rows summed at a time; ranks own whole ranges of :data:`..shares.ROWS` rows.
_LONG = 1 << 14
# Number of rows in a range; a thread sweeps through a whole range.
_SWEPT = 1 << 15
# The over-relaxation w is 2 / (1 + _SLACK / root of the number of unknowns). Of 10, 20 and 40, that took the fewest
# iterations for plane grids of 1,817, 5,300 and 38,848 nodes; the optimum is flat.
_SLACK = 20.0

Matrix = tuple[NDArray[np.float32], IntArray, NDArray[np.int32]]
"""Blocks, where the rows start, and columns."""


class Products(Protocol):
    """Products of this rank's rows of the preconditioned matrix with vectors (n, d); other rows are undefined."""

    def begin(self, b: FloatArray) -> FloatArray:
        """The right-hand side of the preconditioned system."""
        ...

    def multiply(self, p: FloatArray, image: FloatArray) -> float:
        """Fill ``image`` with the product of the matrix and ``p``; return ``p . image``."""
        ...

    def end(self, y: FloatArray) -> FloatArray:
        """The solution from that of the preconditioned system."""
        ...


class Plain:
    """Products of the matrix itself, with 3 x 3 blocks."""

    def __init__(self, matrix: Matrix, rows: Halo) -> None:
        self._matrix, self._rows = matrix, rows

    def begin(self, b: FloatArray) -> FloatArray:
        return b

    def multiply(self, p: FloatArray, image: FloatArray) -> float:
        self._rows.complete(p)
        return sum_over_rows(partial(multiply_rows, *self._matrix, p, image), self._rows)

    def end(self, y: FloatArray) -> FloatArray:
        return y


class Swept:
    """Products of the matrix between triangular factors, with 2 x 2 blocks."""

    def __init__(self, matrix: Matrix, rows: Halo) -> None:
        self._matrix, self._rows, self._t = matrix, rows, np.zeros((len(matrix[1]) - 1, 2))
        self._relaxation = 2.0 / (1.0 + _SLACK / np.sqrt(rows.total))

    def begin(self, b: FloatArray) -> FloatArray:
        self._t[...] = 0.0
        image = np.zeros_like(b)
        self._on(b, image)
        return image

    def multiply(self, p: FloatArray, image: FloatArray) -> float:
        self._back(p)
        return self._on(p, image)

    def end(self, y: FloatArray) -> FloatArray:
        self._back(y)
        return self._t.copy()

    def _back(self, p: FloatArray) -> None:
        over_rows(partial(sweep_back, self._matrix, self._relaxation, p, self._t), self._rows, _SWEPT)

    def _on(self, p: FloatArray, image: FloatArray) -> float:
        self._rows.complete(self._t)
        work = partial(sweep_on, self._matrix, self._relaxation, p, self._t, image)
        return sum_over_rows(work, self._rows, _SWEPT)


def over_rows(work: Callable[[int, int], object], rows: Halo, chunk: int) -> None:
    """Call ``work(low, high)`` for chunks of this rank's rows."""
    for_chunks(lambda low, high: work(rows.low + low, rows.low + high), rows.high - rows.low, chunk)


def sum_over_rows(work: Callable[[int, int], float], rows: Halo, chunk: int | None = None) -> float:
    """Sum of ``work(low, high)`` over chunks of the rows of all ranks, always in the same order."""
    chunk = chunk or _LONG
    parts = np.zeros(-(-(rows.high - rows.low) // chunk))

    def add(low: int, high: int) -> None:
        parts[(low - rows.low) // chunk] = work(low, high)

    over_rows(add, rows, chunk)
    return float(rows.joined(parts).sum())


@kernel
def multiply_rows(matrix, starts, columns, p, image, low, high):
    """Rows low <= i < high of the product of the matrix and ``p`` (n, 3); return their part of ``p . image``.

    The matrix and ``p`` have room for one more row, see :mod:`...numerics.systems.block_rows`.
    """
    total = 0.0
    for row in range(low, high):
        multiply_row(matrix, columns, p, image, row, starts[row], starts[row + 1])
        total += image[row, 0] * p[row, 0] + image[row, 1] * p[row, 1] + image[row, 2] * p[row, 2]
    return total


@kernel
def sweep_back(matrix, relaxation, p, t, low, high):
    """``t = (D + L^T)^-1 p`` in the range low <= i < high of vectors (n, 2)."""
    blocks, starts, columns = matrix
    for row in range(high - 1, low - 1, -1):
        last = starts[row + 1] - 1
        while columns[last] >= high:
            last -= 1
        at = last
        while columns[at] > row:
            at -= 1
        solve_row(blocks, columns, t, p, row, last, last - at, -1, relaxation)


@kernel
def sweep_on(matrix, relaxation, p, t, image, low, high):
    """``image = t + (D + L)^-1 (p + (I - 2 D) t + E t)`` in the range low <= i < high, after :func:`sweep_back` of all
    ranges; return its part of ``p . image``."""
    blocks, starts, columns = matrix
    less = 1.0 - 2.0 / relaxation
    # Rows are solved in a loop of their own: what has just been stored one by one cannot be loaded as a pair at once.
    for row in range(low, high):
        image[row, 0], image[row, 1] = p[row, 0] + less * t[row, 0], p[row, 1] + less * t[row, 1]
        at = starts[row]
        while columns[at] < low:
            _add_product(blocks, at, t, columns[at], image, row)
            at += 1
        at = starts[row + 1] - 1
        while columns[at] >= high:
            _add_product(blocks, at, t, columns[at], image, row)
            at -= 1
    for row in range(low, high):
        first = starts[row]
        while columns[first] < low:
            first += 1
        at = first
        while columns[at] < row:
            at += 1
        solve_row(blocks, columns, image, image, row, first, at - first, 1, relaxation)
    x = y = 0.0
    for row in range(low, high):
        image[row, 0] += t[row, 0]
        image[row, 1] += t[row, 1]
        x += p[row, 0] * image[row, 0]
        y += p[row, 1] * image[row, 1]
    return x + y


@inlined
def _add_product(blocks, at, t, column, image, row):
    image[row, 0] += blocks[at, 0, 0] * t[column, 0] + blocks[at, 0, 1] * t[column, 1]
    image[row, 1] += blocks[at, 1, 0] * t[column, 0] + blocks[at, 1, 1] * t[column, 1]
