"""The linear system of a Newton step: a sparse matrix of square blocks, solved by preconditioned conjugate gradients.

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

import itertools
from collections.abc import Callable
from functools import partial

import numpy as np
import scipy

from ..numerics.arrays import FloatArray
from ..numerics.cell.foldover.loops import places_of_pairs
from ..numerics.jit import inlined, kernel
from ..numerics.lanes import multiply_row, solve_row, with_room
from ..parallel import for_chunks, thread_count
from .energy import Penalty, Region

# Number of rows summed at a time.
_LONG = 1 << 14
# Number of rows in a range; a thread sweeps through a whole range.
_SWEPT = 1 << 15
# The over-relaxation w is 2 / (1 + _SLACK / root of the number of unknowns). Of 10, 20 and 40, that took the fewest
# iterations for plane grids of 1,817, 5,300 and 38,848 nodes; the optimum is flat.
_SLACK = 20.0
# Unknowns per call of a loop.
_ROWS = 2048
# Measured work of one block in a product with the matrix, in the unit of :class:`.options.Limit`.
_BLOCK = 0.0045


def sum_over_rows(work: Callable[[int, int], float], n: int, chunk: int = _LONG) -> float:
    """Sum of ``work(low, high)`` over chunks of ``n`` rows, always in the same order."""
    parts = np.zeros(-(-n // chunk))

    def add(low: int, high: int) -> None:
        parts[low // chunk] = work(low, high)

    for_chunks(add, n, chunk)
    return float(parts.sum())


def scalar_product(a: FloatArray, b: FloatArray) -> float:
    """The sum of the products of the entries of ``a`` and ``b``, always in the same order."""
    # The libraries behind numpy's scalar product divide long vectors among threads.
    return float(np.einsum("i,i", a.ravel(), b.ravel()))


def inverse_factors(blocks: FloatArray) -> tuple[FloatArray, bool]:
    """The inverse Cholesky factors of symmetric matrices (n, d, d), and whether any of these had a negative pivot.

    An unknown that no sample depends on, whose matrix is zero, does not move.
    """
    trace, negative = np.trace(blocks, axis1=1, axis2=2), False
    factor, inverse = np.zeros_like(blocks), np.zeros_like(blocks)
    small = 1e-14 * np.abs(trace) + 1e-300
    for d in range(blocks.shape[1]):
        for e in range(d):
            total = blocks[:, d, e] - (factor[:, d, :e] * factor[:, e, :e]).sum(axis=1)
            factor[:, d, e] = total / factor[:, e, e]
        pivot = blocks[:, d, d] - (factor[:, d, :d] ** 2).sum(axis=1)
        negative |= bool((pivot < -small).any())
        factor[:, d, d] = np.sqrt(np.maximum(pivot, small))
        inverse[:, d, d] = 1.0 / factor[:, d, d]
        for e in range(d):
            total = (factor[:, d, e:d] * inverse[:, e:d, e]).sum(axis=1)
            inverse[:, d, e] = -total / factor[:, d, d]
    return inverse, negative


class NewtonSystem:
    """Gradient and Hessian of a region's energy, recomputed for every step by ``fill``.

    The Hessian is scaled from both sides by the inverse Cholesky factors of its diagonal blocks and stored in single
    precision, which only makes steps slightly inexact. The preconditioner is described above.

    Attributes
    ----------
    matrix, columns, starts : the scaled Hessian: blocks, their columns, and where the rows start
    unknowns : how the region's nodes depend on the unknowns, at the coordinates of the last ``fill``
    gradient : (n_unknowns, d) of the energy there
    work : cost of one iteration, in the unit of :class:`.Limit`
    iterations : number of iterations that the last ``direction`` took
    """

    def __init__(self, region: Region) -> None:
        n, d = region.fixed.shape[:2]
        self.unknowns, of_cell = region.unknowns, region.unknowns.number[region.energy.nodes]
        used = of_cell >= 0
        cell = np.broadcast_to(np.arange(len(of_cell))[:, None], of_cell.shape)[used]
        touch = scipy.sparse.csr_array((np.ones(cell.size, np.int32), (of_cell[used], cell)), shape=(n, len(of_cell)))
        pattern = (touch @ touch.T).tocsr()
        pattern.sort_indices()
        self.starts, self.columns = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int32, copy=False)
        ends = [*range(0, n, _ROWS), n]
        self._cells = [
            np.unique(touch.indices[touch.indptr[lo] : touch.indptr[hi]]).astype(np.int64)
            for lo, hi in itertools.pairwise(ends)
        ]
        self._longest = max((self.starts[high] - self.starts[low] for low, high in itertools.pairwise(ends)), default=0)
        del used, cell, touch, pattern
        self._places = places_of_pairs(of_cell, self.starts, self.columns)
        number = np.arange(len(self.columns), dtype=np.int32)
        self._mirror = scipy.sparse.csr_array((number, self.columns, self.starts), shape=(n, n)).tocsc().data
        self.matrix = with_room((len(self.columns), d, d), np.float32)
        self._factor = np.zeros((n, d, d))
        self._diagonal = np.flatnonzero(self.columns == np.repeat(np.arange(n), np.diff(self.starts)))
        self._rows, self._swept = (self.matrix, self.starts, self.columns), np.zeros((n, 2)) if d == 2 else None
        self._relaxation = 2.0 / (1.0 + _SLACK / np.sqrt(max(n, 1)))
        self.work, self.iterations, self.solved = _BLOCK * len(self.columns), 0, False
        self.gradient = np.empty((n, d))

    @staticmethod
    def memory(n_unknowns: int, dimension: int) -> int:
        """Peak memory in bytes, reached when the matrix is made."""
        return n_unknowns * (27 * (36 + 24) + 360 if dimension == 3 else 9 * (16 + 24) + 700)

    def fill(self, region: Region, x: FloatArray, reference: FloatArray, penalty: Penalty) -> bool:
        """Compute gradient and scaled Hessian at the coordinates ``x`` (n, d); see :mod:`..numerics.cell.foldover`.

        ``region`` must be the one that the system was made for, except for the weights of its samples.
        Returns ``False`` if a diagonal block is not positive definite, which cannot happen with the convex part of the
        energy alone.
        """
        starts, columns, diagonal, n = self.starts, self.columns, self._diagonal, len(self.gradient)
        self.unknowns, freedom = region.directions(x)
        self.gradient[...] = 0.0
        bad = np.zeros(len(self._cells), dtype=bool)
        # Memory of each thread: fresh one for every call would cost a tenth of the time.
        spare = [np.empty((self._longest, *self.matrix.shape[1:])) for _ in range(thread_count())]

        def add(low: int, high: int) -> None:
            kept = spare.pop()
            blocks = kept[: starts[high] - starts[low]]
            blocks[...] = 0.0
            rows, number = (low, high, int(starts[low])), low // _ROWS
            cells = self._cells[number], self._places
            region.energy.add(x, reference, penalty, *cells, self.unknowns, rows, blocks, self.gradient)
            own = diagonal[low:high] - starts[low]
            # In directions in which an unknown must not move, the trace of its block serves as stiffness.
            trace = np.trace(blocks[own], axis1=1, axis2=2)[:, None, None]
            blocks[own] += (np.eye(blocks.shape[1]) - freedom[low:high]) * trace
            self._factor[low:high], bad[number] = inverse_factors(blocks[own])
            scale_left(blocks, starts, diagonal, self._factor, self.matrix, low, high)
            spare.append(kept)

        for_chunks(add, n, _ROWS)
        ends = starts, diagonal, columns, self._mirror
        for_chunks(partial(scale_right, self.matrix, ends, self._factor), n, _ROWS)
        return not (penalty.exact > 0.0 and bad.any())

    def direction(self, tolerance: float, most: int) -> tuple[FloatArray, bool]:
        """The Newton step (n_unknowns, d), and whether the Hessian was convex along all directions searched.

        Conjugate gradients take at most ``most`` iterations, until ``|r| <= tolerance |b|`` after preconditioning. They
        stop at a direction of negative curvature; the step found up to there is a descent direction. ``solved`` then
        says whether they met the tolerance.
        """
        factor = self._factor
        r = -np.einsum("nij,nj->ni", factor, self.gradient)
        if self._swept is not None:
            b, r = r, np.zeros_like(r)
            self._swept[...] = 0.0
            self._sweep_on(b, r)
        y, p, image = np.zeros_like(r), with_room(r.shape), np.zeros_like(r)
        p[...] = r
        rho = scalar_product(r, r)
        goal, convex = tolerance * tolerance * rho, True
        self.iterations = 0
        for _ in range(most):
            if rho <= goal:
                break
            self.iterations += 1
            curvature = self._multiply(p, image)
            if curvature <= 0.0:
                convex = False
                break
            length, before = rho / curvature, rho
            y += length * p
            r -= length * image
            rho = scalar_product(r, r)
            p *= rho / before
            p += r
        self.solved = rho <= goal
        if self._swept is not None:
            self._sweep_back(y)
            y = self._swept
        return np.einsum("nji,nj->ni", factor, y), convex

    def _multiply(self, p: FloatArray, image: FloatArray) -> float:
        """Fill ``image`` with the product of the matrix, in a plane between triangular factors, and ``p``; return
        ``p . image``."""
        if self._swept is None:
            return sum_over_rows(partial(multiply_rows, *self._rows, p, image), len(image))
        self._sweep_back(p)
        return self._sweep_on(p, image)

    def _sweep_back(self, p: FloatArray) -> None:
        for_chunks(partial(sweep_back, self._rows, self._relaxation, p, self._swept), len(p), _SWEPT)

    def _sweep_on(self, p: FloatArray, image: FloatArray) -> float:
        work = partial(sweep_on, self._rows, self._relaxation, p, self._swept, image)
        return sum_over_rows(work, len(image), _SWEPT)


@kernel("f4[:, :, ::1], i8[::1], i4[::1], f8[:, ::1], f8[:, ::1], i8, i8")
def multiply_rows(matrix, starts, columns, p, image, low, high):
    """Rows low <= i < high of the product of the matrix and ``p`` (n, 3); return their part of ``p . image``.

    The matrix and ``p`` have room for one more row, see :func:`..numerics.lanes.with_room`.
    """
    total = 0.0
    for row in range(low, high):
        multiply_row(matrix, columns, p, image, row, starts[row], starts[row + 1])
        total += image[row, 0] * p[row, 0] + image[row, 1] * p[row, 1] + image[row, 2] * p[row, 2]
    return total


@kernel("Tuple((f4[:, :, ::1], i8[::1], i4[::1],)), f8, f8[:, ::1], f8[:, ::1], i8, i8")
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


@kernel("Tuple((f4[:, :, ::1], i8[::1], i4[::1],)), f8, f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, i8")
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


@kernel("f8[:, :, ::1], i8[::1], i8[::1], f8[:, :, ::1], f4[:, :, ::1], i8, i8")
def scale_left(blocks, starts, diagonal, factor, matrix, low, high):
    """``matrix_ij = F_i H_ij`` for j >= i in the block rows low <= i < high, whose H are ``blocks``."""
    for row in range(low, high):
        for at in range(diagonal[row], starts[row + 1]):
            if factor.shape[1] == 3:
                _scale_left(blocks[at - starts[low]], factor[row], matrix[at], 3)
            else:
                _scale_left(blocks[at - starts[low]], factor[row], matrix[at], 2)


@inlined
def _scale_left(block, factor, scaled, size):
    for d in range(size):
        for e in range(size):
            total = 0.0
            for f in range(d + 1):
                total += factor[d, f] * block[f, e]
            scaled[d, e] = total


@kernel("f4[:, :, ::1], Tuple((i8[::1], i8[::1], i4[::1], i4[::1],)), f8[:, :, ::1], i8, i8")
def scale_right(matrix, blocks, factor, low, high):
    """``H_ij <- H_ij F_j^T`` for j >= i in the block rows low <= i < high, and its transpose in H_ji.

    ``blocks``: where rows start and have their diagonal, the columns of all blocks, and where their transposes are.
    """
    starts, diagonal, columns, mirror = blocks
    for row in range(low, high):
        for at in range(diagonal[row], starts[row + 1]):
            # Of known size, the loops over an entry's terms are unrolled.
            if factor.shape[1] == 3:
                _scale_right(matrix[at], factor[columns[at]], matrix[mirror[at]], 3)
            else:
                _scale_right(matrix[at], factor[columns[at]], matrix[mirror[at]], 2)


@inlined
def _scale_right(block, factor, mirrored, size):
    for d in range(size):
        # The last column first, as it depends on those before it.
        for e in range(size - 1, -1, -1):
            total = 0.0
            for f in range(e + 1):
                total += factor[e, f] * block[d, f]
            block[d, e] = total
    for d in range(size):
        for e in range(d):
            mirrored[d, e], mirrored[e, d] = block[e, d], block[d, e]
        mirrored[d, d] = block[d, d]
