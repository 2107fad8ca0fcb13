"""The linear system of a Newton step: a sparse matrix of square blocks, solved by conjugate gradients."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy

from ...numerics.arrays import FloatArray
from ...numerics.jit import kernel, summing_kernel
from ...numerics.systems.block_rows import with_room
from .elements import Penalty, Rows
from .products import Plain, Products, Swept, over_rows, sum_over_rows
from .region import Region

# Unknowns per call of a loop.
_ROWS = 2048
# Measured work of one block in a product with the matrix, in the unit of limit.py.
_BLOCK = 0.0045


class NewtonSystem:
    """Gradient and Hessian of a region's energy, recomputed for every step by ``fill``.

    A rank holds the rows of its own unknowns, with the columns of their neighbours.

    The Hessian is scaled from both sides by the inverse Cholesky factors of its diagonal blocks and stored in single
    precision, which only makes steps slightly inexact. :mod:`.products` preconditions it further.

    Attributes
    ----------
    unknowns : how the region's nodes depend on the unknowns, at the coordinates of the last ``fill``
    gradient : (n_unknowns, d) of the energy there
    work : cost of one iteration, in the unit of :mod:`..limit`
    iterations : number of iterations that the last ``direction`` took
    """

    def __init__(self, region: Region) -> None:
        n, d, rows = region.n_unknowns, region.dimension, region.dealt.rows
        self.unknowns, self._rows = region.unknowns, rows
        of_element = region.number[region.energy.nodes]
        used = of_element >= 0
        element = np.broadcast_to(np.arange(len(of_element))[:, None], of_element.shape)[used]
        touch = scipy.sparse.csr_array(
            (np.ones(element.size, np.int32), (of_element[used], element)), shape=(n, len(of_element))
        )
        own = touch if (rows.low, rows.high) == (0, n) else touch[rows.own]
        pattern = (own @ touch.T).tocsr()
        pattern.sort_indices()
        starts = np.pad(pattern.indptr.astype(np.int64), (rows.low, 0))
        self._starts = np.pad(starts, (0, n - rows.high), mode="edge")
        self._columns = pattern.indices.astype(np.int32)
        ends = [*range(rows.low, rows.high, _ROWS), rows.high]
        self._elements = [
            np.unique(touch.indices[touch.indptr[lo] : touch.indptr[hi]]).astype(np.int64)
            for lo, hi in itertools.pairwise(ends)
        ]
        self._longest = max(
            (self._starts[high] - self._starts[low] for low, high in itertools.pairwise(ends)), default=0
        )
        self._matrix = with_room((len(self._columns), d, d), np.float32)
        self._factor = np.zeros((n, d, d))
        matrix = self._matrix, self._starts, self._columns
        self._products: Products = Plain(matrix, rows) if d == 3 else Swept(matrix, rows)
        self.work, self.iterations = _BLOCK * int(rows.joined(np.array([len(self._columns)])).sum()), 0
        self.solved = False
        self.gradient = np.empty((n, d))

    @staticmethod
    def memory(n_unknowns: int, dimension: int) -> int:
        """Peak memory in bytes, reached while the sparsity pattern is found."""
        return n_unknowns * (27 * (36 + 24) + 300 if dimension == 3 else 9 * (16 + 24) + 700)

    def fill(self, region: Region, x: FloatArray, reference: FloatArray, penalty: Penalty) -> bool:
        """Compute gradient and scaled Hessian at the coordinates ``x`` (n, d); see :mod:`...numerics.cell.foldover`.

        ``region`` must be the one that the system was made for, except for the weights of its samples.
        Returns ``False`` if a diagonal block is not positive definite, which cannot happen with the convex part of the
        energy alone.
        """
        starts, columns, all_rows = self._starts, self._columns, self._rows
        self.unknowns, freedom = region.directions(x)
        self.gradient[...] = 0.0
        bad = np.zeros(len(self._elements), dtype=np.int64)
        # Fresh memory for every call would cost a tenth of the time.
        spare: list[FloatArray] = []

        def add(low: int, high: int) -> None:
            try:
                kept = spare.pop()
            except IndexError:
                kept = np.empty((self._longest, *self._matrix.shape[1:]))
            blocks = kept[: starts[high] - starts[low]]
            blocks[...] = 0.0
            rows, number = Rows(low, high, starts, columns, blocks, self.gradient), (low - all_rows.low) // _ROWS
            region.energy.add(x, reference, penalty, self._elements[number], self.unknowns, rows)
            bad[number] = factor_diagonal(blocks, rows.pattern, freedom, self._factor)
            scale_left(blocks, rows.pattern, self._factor, self._matrix)
            spare.append(kept)

        over_rows(add, all_rows, _ROWS)
        all_rows.complete(self._factor)
        over_rows(partial(scale_right, self._matrix, starts, columns, self._factor), all_rows, _ROWS)
        return not (penalty.exact > 0.0 and all_rows.joined(bad).any())

    def slope(self, step: FloatArray) -> float:
        """The product of the gradient with a step (n_unknowns, d)."""
        return self._summed(dot_rows, self.gradient, step)

    def _summed(self, work: Callable[..., float], *values: Any) -> float:
        """Sum of ``work(*values, low, high)`` over the rows of vectors (n_unknowns, d), which are passed flat."""
        d, flat = self.gradient.shape[1], [v.ravel() if isinstance(v, np.ndarray) else v for v in values]
        return sum_over_rows(lambda low, high: work(*flat, low * d, high * d), self._rows)

    def direction(self, tolerance: float, most: int) -> tuple[FloatArray, bool]:
        """The Newton step (n_unknowns, d), and whether the Hessian was convex along all directions searched.

        Conjugate gradients take at most ``most`` iterations, until ``|r| <= tolerance |b|`` after preconditioning. They
        stop at a direction of negative curvature; the step found up to there is a descent direction. ``solved`` then
        says whether they met the tolerance.
        """
        factor, products = self._factor, self._products
        r = products.begin(-np.einsum("nij,nj->ni", factor, self.gradient))
        y, p, image = np.zeros_like(r), with_room(r.shape), np.zeros_like(r)
        p[...] = r
        rho = self._summed(dot_rows, r, r)
        goal, convex = tolerance * tolerance * rho, True
        self.iterations = 0
        for _ in range(most):
            if rho <= goal:
                break
            self.iterations += 1
            curvature = products.multiply(p, image)
            if curvature <= 0.0:
                convex = False
                break
            length, before = rho / curvature, rho
            rho = self._summed(advance_rows, y, r, p, image, length)
            p *= rho / before
            p += r
        self.solved = rho <= goal
        return self._rows.complete(np.einsum("nji,nj->ni", factor, products.end(y))), convex

    def dense(self) -> FloatArray:
        """The scaled Hessian as a dense matrix (d n, d n), for small regions."""
        n, d = self.gradient.shape
        blocks = self._matrix.astype(np.float64), self._columns, self._starts
        return scipy.sparse.bsr_array(blocks, shape=(d * n, d * n)).toarray()


@kernel
def factor_diagonal(blocks, rows, freedom, factor):
    """Fill ``factor`` with the inverse Cholesky factors of diagonal blocks; return the number of negative pivots.

    ``rows`` as in :func:`...numerics.cell.foldover.hexahedra.add_derivatives`. ``freedom`` (n, d, d) projects onto the
    directions in which an unknown may move; in all others, the trace of its block serves as stiffness.
    """
    first, last, starts, columns = rows
    size, bad = freedom.shape[1], 0
    for row in range(first, last):
        at = starts[row]
        while columns[at] != row:
            at += 1
        a, f = blocks[at - starts[first]], factor[row]
        trace = 0.0
        for d in range(size):
            trace += a[d, d]
        # An unknown that no sample depends on does not move.
        small = 1e-14 * abs(trace) + 1e-300
        for d in range(size):
            for e in range(d + 1):
                a[d, e] += ((1.0 if d == e else 0.0) - freedom[row, d, e]) * trace
        # First the factor, in the lower triangle of f, then its inverse, column by column.
        for d in range(size):
            for e in range(d + 1):
                total = a[d, e]
                for o in range(e):
                    total -= f[d, o] * f[e, o]
                if d == e and total < -small:
                    bad += 1
                f[d, e] = np.sqrt(max(total, small)) if d == e else total / f[e, e]
            for e in range(d + 1, size):
                a[d, e] = a[d, e] - freedom[row, d, e] * trace
                f[d, e] = 0.0
        for e in range(size):
            f[e, e] = 1.0 / f[e, e]
            for d in range(e + 1, size):
                total = 0.0
                for o in range(e, d):
                    total += f[d, o] * f[o, e]
                f[d, e] = -total / f[d, d]
    return bad


@kernel
def scale_left(blocks, rows, factor, matrix):
    """``matrix_ij = F_i H_ij`` for the block rows i of ``rows``, whose H are ``blocks``."""
    first, last, starts, _ = rows
    size = factor.shape[1]
    for row in range(first, last):
        a, b, c = factor[row, 0, 0], factor[row, 1, 0], factor[row, 1, 1]
        for at in range(starts[row], starts[row + 1]):
            n = at - starts[first]
            for e in range(size):
                x, y = blocks[n, 0, e], blocks[n, 1, e]
                matrix[at, 0, e], matrix[at, 1, e] = a * x, b * x + c * y
        if size == 3:
            a, b, c = factor[row, 2, 0], factor[row, 2, 1], factor[row, 2, 2]
            for at in range(starts[row], starts[row + 1]):
                n = at - starts[first]
                for e in range(3):
                    matrix[at, 2, e] = a * blocks[n, 0, e] + b * blocks[n, 1, e] + c * blocks[n, 2, e]


@kernel
def scale_right(matrix, starts, columns, factor, low, high):
    """``H_ij <- H_ij F_j^T`` for the block rows low <= i < high."""
    size = factor.shape[1]
    for at in range(starts[low], starts[high]):
        column = columns[at]
        a, b, c = factor[column, 0, 0], factor[column, 1, 0], factor[column, 1, 1]
        if size == 3:
            p, q, r = factor[column, 2, 0], factor[column, 2, 1], factor[column, 2, 2]
            for d in range(3):
                matrix[at, d, 2] = p * matrix[at, d, 0] + q * matrix[at, d, 1] + r * matrix[at, d, 2]
        for d in range(size):
            x, y = matrix[at, d, 0], matrix[at, d, 1]
            matrix[at, d, 0], matrix[at, d, 1] = a * x, b * x + c * y


@summing_kernel
def advance_rows(y, r, p, image, length, low, high):
    """Update entries low <= i < high of ``y`` and ``r`` in a conjugate gradient step; return their part of r . r."""
    total = 0.0
    for i in range(low, high):
        y[i] += length * p[i]
        r[i] -= length * image[i]
        total += r[i] * r[i]
    return total


@summing_kernel
def dot_rows(a, b, low, high):
    """The part of ``a . b`` from entries low <= i < high."""
    total = 0.0
    for i in range(low, high):
        total += a[i] * b[i]
    return total
