"""The linear system of one Newton step: blocks of 3 x 3, scaled by their diagonal, conjugate gradients."""

import itertools
from functools import partial

import numpy as np
import scipy

from ...parallel import for_chunks
from ..cell.foldover import add_derivatives
from ..jit import kernel

_ROWS = 2048
# Rows of vectors, which cost less.
_LONG = 1 << 14


class NewtonSystem:
    """Gradient and Hessian of a region's energy, filled anew in every step.

    The Hessian is scaled from both sides by the Cholesky factors of its diagonal blocks (block-Jacobi
    preconditioning) and kept in single precision: conjugate gradients stop long before that matters.
    """

    def __init__(self, region):
        self._region, n = region, region.n_unknowns
        of_cell = region.unknowns[0][region.cells]
        used = of_cell >= 0
        cell = np.broadcast_to(np.arange(len(of_cell))[:, None], of_cell.shape)[used]
        touch = scipy.sparse.csr_array((np.ones(cell.size, np.int32), (of_cell[used], cell)), shape=(n, len(of_cell)))
        pattern = (touch @ touch.T).tocsr()
        pattern.sort_indices()
        self._starts, self._columns = pattern.indptr.astype(np.int64), pattern.indices.astype(np.int64)
        ends = [*range(0, n, _ROWS), n]
        self._cells = [
            np.unique(touch.indices[touch.indptr[lo] : touch.indptr[hi]]).astype(np.int64)
            for lo, hi in itertools.pairwise(ends)
        ]
        self._matrix = np.empty((len(self._columns), 3, 3), np.float32)
        self._factor = np.empty((n, 3, 3))
        self.gradient = np.empty((n, 3))

    @staticmethod
    def memory(n_unknowns):
        """Bytes that it takes, while the pattern is being found."""
        return n_unknowns * (27 * (36 + 24) + 300)

    def fill(self, x, eps, t):
        """Gradient and scaled Hessian at the coordinates ``x`` (n, 3); see :mod:`..foldover`."""
        region, starts, columns = self._region, self._starts, self._columns
        self.gradient[...] = 0.0

        def add(low, high):
            first, last = starts[low], starts[high]
            blocks = np.zeros((last - first, 3, 3))
            rows = low, high, starts - first, columns[first:last]
            which = self._cells[low // _ROWS]
            add_derivatives(x, *region.energy, eps, t, which, region.unknowns, rows, blocks, self.gradient)
            factor_diagonal(blocks, rows, region.freedom, self._factor)
            scale_left(blocks, rows, self._factor)
            self._matrix[first:last] = blocks

        for_chunks(add, region.n_unknowns, _ROWS)
        for_chunks(
            lambda *ends: scale_right(self._matrix, starts, columns, self._factor, *ends), region.n_unknowns, _ROWS
        )

    def direction(self, tolerance, most):
        """The Newton step (n_unknowns, 3), by conjugate gradients until ``|r| <= tolerance |b|``; iterations."""
        factor = self._factor
        r = -np.einsum("nij,nj->ni", factor, self.gradient)
        y, p, image = np.zeros_like(r), r.copy(), np.empty_like(r)
        rho = _sum_over_rows(partial(dot_rows, r, r), len(r))
        goal, count = tolerance * tolerance * rho, 0
        matrix = self._matrix, self._starts, self._columns
        while rho > goal and count < most:
            curvature = _sum_over_rows(partial(multiply_rows, *matrix, p, image), len(r))
            if curvature <= 0.0:
                # Round-off: what has been found so far is a direction of descent.
                break
            length, before = rho / curvature, rho
            rho = _sum_over_rows(partial(advance_rows, y, r, p, image, length), len(r))
            p *= rho / before
            p += r
            count += 1
        return np.einsum("nji,nj->ni", factor, y), count

    def dense(self):
        """The scaled Hessian as one matrix (3 n, 3 n), for small regions."""
        n = self._region.n_unknowns
        blocks = self._matrix.astype(np.float64), self._columns, self._starts
        return scipy.sparse.bsr_array(blocks, shape=(3 * n, 3 * n)).toarray()


def _sum_over_rows(work, n):
    """Sum of ``work(low, high)`` over chunks of rows, always in the same order."""
    parts = np.zeros(-(-n // _LONG))

    def add(low, high):
        parts[low // _LONG] = work(low, high)

    for_chunks(add, n, _LONG)
    return parts.sum()


@kernel
def factor_diagonal(blocks, rows, freedom, factor):
    """The inverse Cholesky factors of the diagonal blocks of ``rows``, see :func:`..foldover.add_derivatives`.

    ``freedom`` (n, 3, 3) projects on the directions in which an unknown may move; the others get a stiffness of their
    own.
    """
    first, last, starts, columns = rows
    for row in range(first, last):
        for at in range(starts[row], starts[row + 1]):
            if columns[at] == row:
                break
        a = blocks[at]
        trace = a[0, 0] + a[1, 1] + a[2, 2]
        for d in range(3):
            for e in range(3):
                a[d, e] += ((1.0 if d == e else 0.0) - freedom[row, d, e]) * trace
        # An unknown that no sample depends on stays.
        small = 1e-14 * trace + 1e-300
        l00 = np.sqrt(max(a[0, 0], small))
        l10, l20 = a[1, 0] / l00, a[2, 0] / l00
        l11 = np.sqrt(max(a[1, 1] - l10 * l10, small))
        l21 = (a[2, 1] - l20 * l10) / l11
        l22 = np.sqrt(max(a[2, 2] - l20 * l20 - l21 * l21, small))
        f = factor[row]
        f[...] = 0.0
        f[0, 0], f[1, 1], f[2, 2] = 1.0 / l00, 1.0 / l11, 1.0 / l22
        f[1, 0] = -l10 * f[0, 0] * f[1, 1]
        f[2, 1] = -l21 * f[1, 1] * f[2, 2]
        f[2, 0] = -(l20 * f[0, 0] + l21 * f[1, 0]) * f[2, 2]


@kernel
def scale_left(blocks, rows, factor):
    """``H_ij <- F_i H_ij`` in some rows."""
    first, last, starts, _ = rows
    for row in range(first, last):
        f = factor[row]
        for at in range(starts[row], starts[row + 1]):
            block = blocks[at]
            # F is a lower triangle: from below, nothing is overwritten before it is needed.
            for d in range(2, -1, -1):
                for e in range(3):
                    total = f[d, d] * block[d, e]
                    for o in range(d):
                        total += f[d, o] * block[o, e]
                    block[d, e] = total


@kernel
def scale_right(matrix, starts, columns, factor, low, high):
    """``H_ij <- H_ij F_j^T`` in the rows low <= i < high."""
    for row in range(low, high):
        for at in range(starts[row], starts[row + 1]):
            block, f = matrix[at], factor[columns[at]]
            for d in range(3):
                for e in range(2, -1, -1):
                    total = f[e, e] * block[d, e]
                    for o in range(e):
                        total += f[e, o] * block[d, o]
                    block[d, e] = total


@kernel
def multiply_rows(matrix, starts, columns, p, image, low, high):
    """The rows low <= i < high of the product of the matrix and ``p`` (n, 3); returns their share of ``p . image``."""
    total = 0.0
    for row in range(low, high):
        x = y = z = 0.0
        for at in range(starts[row], starts[row + 1]):
            m, o = matrix[at], columns[at]
            a, b, c = p[o, 0], p[o, 1], p[o, 2]
            x += m[0, 0] * a + m[0, 1] * b + m[0, 2] * c
            y += m[1, 0] * a + m[1, 1] * b + m[1, 2] * c
            z += m[2, 0] * a + m[2, 1] * b + m[2, 2] * c
        image[row, 0], image[row, 1], image[row, 2] = x, y, z
        total += x * p[row, 0] + y * p[row, 1] + z * p[row, 2]
    return total


@kernel
def advance_rows(y, r, p, image, length, low, high):
    """One step of conjugate gradients in the rows; returns their share of the new ``r . r``."""
    total = 0.0
    for row in range(low, high):
        for d in range(3):
            y[row, d] += length * p[row, d]
            r[row, d] -= length * image[row, d]
            total += r[row, d] * r[row, d]
    return total


@kernel
def dot_rows(a, b, low, high):
    """Share of the rows in ``a . b``."""
    total = 0.0
    for row in range(low, high):
        for d in range(3):
            total += a[row, d] * b[row, d]
    return total
