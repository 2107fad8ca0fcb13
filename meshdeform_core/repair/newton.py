"""The linear system of a Newton step: a sparse matrix of square blocks, solved by preconditioned conjugate gradients.

A symmetric matrix A of square blocks with unit diagonal is divided into ranges of rows: A = I + L + L^T + E, where L is
the strictly lower part within the ranges, and E couples different ranges. With D = I / w, conjugate gradients solve

    (D + L)^-1 A (D + L^T)^-1 y = (D + L)^-1 b,    x = (D + L^T)^-1 y,

whose matrix is applied with one pass over the blocks (Eisenstat, Efficient implementation of a class of preconditioned
conjugate gradient methods, SIAM J. Sci. Stat. Comput. 2, 1981): with t = (D + L^T)^-1 p, the image of p is
t + (D + L)^-1 (p + (I - 2 D) t + E t). The more nodes there are along a side of the grid, the nearer the best w is to 2
(symmetric successive over-relaxation: Axelsson, A generalized SSOR method, BIT 12, 1972). This takes a sixth of the
iterations in plane grids and a quarter in space, each hardly more costly than a product with A: its halves are stored
apart, as each sweep reads one of them.
"""

from __future__ import annotations

import itertools
from functools import partial

import numpy as np
import scipy

from ..numerics.arrays import FloatArray
from ..numerics.cell.foldover.loops import places_of_pairs
from ..numerics.jit import inlined, kernel
from ..numerics.lanes import solve_pair, solve_three, with_room
from ..parallel import for_chunks, thread_count
from .energy import Penalty, Region

# Number of rows in a range; a thread sweeps through a whole range.
_SWEPT = 1 << 15
# The over-relaxation w is 2 / (1 + _SLACK / d-th root of the number of unknowns). Of 10, 20 and 40 the best in planes
# of 1,817, 5,300 and 38,848 nodes, of 4, 8 and 16 in space with 9,401 and 23,541 nodes; the optimum is flat.
_SLACK = {2: 20.0, 3: 8.0}
# Unknowns per call of a loop.
_ROWS = 2048
# Measured work of one block on or above the diagonal in an iteration, in the unit of :class:`.options.Limit`.
_BLOCK = 0.009


# Blocks of a sparse matrix, where its rows start, and the columns of the blocks.
_BLOCKS = "Tuple((f4[:, :, ::1], i8[::1], i4[::1],))"


def scalar_product(a: FloatArray, b: FloatArray) -> float:
    """The sum of the products of the entries of ``a`` and ``b``, always in the same order."""
    # The libraries behind numpy's scalar product divide long vectors among threads.
    return float(np.einsum("i,i", a.ravel(), b.ravel()))


class NewtonSystem:
    """Gradient and Hessian of a region's energy, recomputed for every step by ``fill``.

    The Hessian is scaled from both sides by the inverse Cholesky factors of its diagonal blocks and stored in single
    precision, which only makes steps slightly inexact. The preconditioner is described above.

    Attributes
    ----------
    matrix, columns, starts : the scaled Hessian on and above its diagonal: transposed blocks, their columns, row starts
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
        pattern = scipy.sparse.triu(touch @ touch.T, format="csr")
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
        below = scipy.sparse.csr_array((number, self.columns, self.starts), shape=(n, n)).tocsc()
        self._mirror = np.empty_like(number)
        self._mirror[below.data] = number
        self.matrix, lower = (with_room((len(self.columns), d, d), np.float32) for _ in range(2))
        self._upper = self.matrix, self.starts, self.columns
        self._lower = lower, below.indptr.astype(np.int64), below.indices.astype(np.int32, copy=False)
        self._factor = np.zeros((n, d, d))
        self._relaxation = 2.0 / (1.0 + _SLACK[d] / max(n, 1) ** (1.0 / d))
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
        starts, n = self.starts, len(self.gradient)
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
            bad[number] = scale_left(blocks, starts, freedom, self._factor, self.matrix, low, high)
            spare.append(kept)

        for_chunks(add, n, _ROWS)
        for_chunks(partial(scale_right, self._upper, self._mirror, self._lower[0], self._factor), n, _ROWS)
        return not (penalty.exact > 0.0 and bad.any())

    def direction(self, tolerance: float, most: int) -> tuple[FloatArray, bool]:
        """The Newton step (n_unknowns, d), and whether the Hessian was convex along all directions searched.

        Conjugate gradients take at most ``most`` iterations, until ``|r| <= tolerance |b|`` after preconditioning. They
        stop at a direction of negative curvature; the step found up to there is a descent direction. ``solved`` then
        says whether they met the tolerance.
        """
        factor = self._factor
        b = -np.einsum("nij,nj->ni", factor, self.gradient)
        y, r, p, image, swept = (with_room(b.shape) for _ in range(5))
        y[...] = swept[...] = 0.0
        self._sweep_on(b, swept, r)
        p[...] = r
        rho = scalar_product(r, r)
        goal, convex = tolerance * tolerance * rho, True
        self.iterations = 0
        for _ in range(most):
            if rho <= goal:
                break
            self.iterations += 1
            self._sweep_back(p, swept)
            curvature = self._sweep_on(p, swept, image)
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
        self._sweep_back(y, swept)
        return np.einsum("nji,nj->ni", factor, swept), convex

    def _sweep_back(self, p: FloatArray, t: FloatArray) -> None:
        for_chunks(partial(sweep_back, self._upper, self._relaxation, p, t), len(p), _SWEPT)

    def _sweep_on(self, p: FloatArray, t: FloatArray, image: FloatArray) -> float:
        """Fill ``image``, that of ``p``, and return ``p . image``, always summed in the same order."""
        parts = np.zeros(-(-len(p) // _SWEPT))

        def work(low: int, high: int) -> None:
            parts[low // _SWEPT] = sweep_on(self._upper, self._lower, self._relaxation, p, t, image, low, high)

        for_chunks(work, len(p), _SWEPT)
        return float(parts.sum())


@kernel(f"{_BLOCKS}, f8, f8[:, ::1], f8[:, ::1], i8, i8")
def sweep_back(upper, relaxation, p, t, low, high):
    """``t = (D + L^T)^-1 p`` in the range low <= i < high of vectors (n, d).

    The matrix and vectors have room for one more row, see :func:`..numerics.lanes.with_room`.
    """
    blocks, starts, columns = upper
    for row in range(high - 1, low - 1, -1):
        last = starts[row + 1] - 1
        while columns[last] >= high:
            last -= 1
        if t.shape[1] == 3:
            solve_three(blocks, columns, t, p, row, last, last - starts[row], -1, relaxation)
        else:
            solve_pair(blocks, columns, t, p, row, last, last - starts[row], -1, relaxation)


@kernel(f"{_BLOCKS}, {_BLOCKS}, f8, f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, i8")
def sweep_on(upper, lower, relaxation, p, t, image, low, high):
    """``image = t + (D + L)^-1 (p + (I - 2 D) t + E t)`` in the range low <= i < high, after :func:`sweep_back` of all
    ranges; return its part of ``p . image``."""
    (blocks, starts, columns), (mirrored, before, left) = upper, lower
    size, less = p.shape[1], 1.0 - 2.0 / relaxation
    # Rows are solved in a loop of their own: what has just been stored one by one cannot be loaded as a pair at once.
    for row in range(low, high):
        for d in range(size):
            image[row, d] = p[row, d] + less * t[row, d]
        at = before[row]
        while left[at] < low:
            _add_product(mirrored, at, t, left[at], image, row)
            at += 1
        at = starts[row + 1] - 1
        while columns[at] >= high:
            _add_product(blocks, at, t, columns[at], image, row)
            at -= 1
    for row in range(low, high):
        first = before[row]
        while left[first] < low:
            first += 1
        if size == 3:
            solve_three(mirrored, left, image, image, row, first, before[row + 1] - 1 - first, 1, relaxation)
        else:
            solve_pair(mirrored, left, image, image, row, first, before[row + 1] - 1 - first, 1, relaxation)
    total = np.zeros(3)
    for row in range(low, high):
        for d in range(size):
            image[row, d] += t[row, d]
            total[d] += p[row, d] * image[row, d]
    return total.sum()


@inlined
def _add_product(blocks, at, t, column, image, row):
    for d in range(t.shape[1]):
        for e in range(t.shape[1]):
            image[row, d] += blocks[at, e, d] * t[column, e]


@kernel("f8[:, :, ::1], i8[::1], f8[:, :, ::1], f8[:, :, ::1], f4[:, :, ::1], i8, i8")
def scale_left(blocks, starts, freedom, factor, matrix, low, high):
    """``matrix_ij = F_i H_ij`` for j >= i in the block rows low <= i < high, whose H are ``blocks``, with the inverse
    Cholesky ``factor`` of H_ii; return whether some H_ii had a negative pivot.

    In directions in which an unknown must not move (see ``freedom``), the trace of H_ii serves as stiffness.
    """
    # Of known size, the loops over an entry's terms are unrolled.
    if factor.shape[1] == 3:
        return _scale_left(blocks, starts, freedom, factor, matrix, low, high, 3)
    return _scale_left(blocks, starts, freedom, factor, matrix, low, high, 2)


@inlined
def _scale_left(blocks, starts, freedom, factor, matrix, low, high, size):
    negative, first = False, starts[low]
    for row in range(low, high):
        negative |= _factorise(blocks[starts[row] - first], freedom[row], factor[row], size)
        for at in range(starts[row], starts[row + 1]):
            for d in range(size):
                for e in range(size):
                    total = 0.0
                    for f in range(d + 1):
                        total += factor[row, d, f] * blocks[at - first, f, e]
                    matrix[at, e, d] = total
    return negative


@inlined
def _factorise(block, freedom, inverse, size):
    """The inverse Cholesky factor of a diagonal block, whether it had a negative pivot. Unknowns that no sample depends
    on, whose blocks are zero, do not move."""
    trace, negative = 0.0, False
    for d in range(size):
        trace += block[d, d]
    small = 3e-14 * abs(trace) + 1e-300
    for d in range(size):
        for e in range(d + 1):
            total = block[d, e] + ((1.0 if d == e else 0.0) - freedom[d, e]) * trace
            for f in range(e):
                total -= inverse[d, f] * inverse[e, f]
            if e < d:
                inverse[d, e] = total / inverse[e, e]
            else:
                negative |= total < -small
                inverse[d, d] = np.sqrt(max(total, small))
    for d in range(size):
        inverse[d, d] = 1.0 / inverse[d, d]
        for e in range(d):
            total = 0.0
            for f in range(e, d):
                total += inverse[d, f] * inverse[f, e]
            inverse[d, e] = -total * inverse[d, d]
    return negative


@kernel(f"{_BLOCKS}, i4[::1], f4[:, :, ::1], f8[:, :, ::1], i8, i8")
def scale_right(upper, mirror, lower, factor, low, high):
    """``H_ij <- H_ij F_j^T`` in the block rows low <= i < high of the ``upper`` half, and its transpose at its
    ``mirror``ed place in the ``lower`` one."""
    if factor.shape[1] == 3:
        _scale_right(upper, mirror, lower, factor, low, high, 3)
    else:
        _scale_right(upper, mirror, lower, factor, low, high, 2)


@inlined
def _scale_right(upper, mirror, lower, factor, low, high, size):
    blocks, starts, columns = upper
    for at in range(starts[low], starts[high]):
        for d in range(size):
            # The last column first, as it depends on those before it.
            for e in range(size - 1, -1, -1):
                total = 0.0
                for f in range(e + 1):
                    total += factor[columns[at], e, f] * blocks[at, f, d]
                blocks[at, e, d] = lower[mirror[at], d, e] = total
