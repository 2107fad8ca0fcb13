"""Systems of radial basis functions too large to factorise: block GMRES with fast products.

Flexible GMRES (Saad 1993) preconditioned from the right, in block form (Simoncini & Gallopoulos 1996): all right-hand
sides share one search space, so one product with A serves them all and each profits from the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import FloatArray, Report
from .products import ExactProduct
from .schwarz import SchwarzPreconditioner

_RESTART = 40
_DEPENDENT = 1e-14
# Fraction of the tolerance that errors of the product may use up.
_LARGEST_ERROR = 0.3
# Tolerance below which a preconditioner with boxes twice as large pays: it saves three iterations in ten.
_MANY_DIGITS = 1e-9
# Reduction of the residual after which a cycle ends: beyond it, the recursive residual deviates from the true one.
_REDUCTION = 1e-7


@dataclass(frozen=True)
class Solution:
    """Coefficients (n, 3), polynomial (q, 3), number of iterations, and the true residual ||r|| / ||b|| (3,).

    ``stalled``: further iterations would not reduce the residual.
    """

    coefficients: np.ndarray
    polynomial: np.ndarray
    iterations: int
    residual: np.ndarray
    stalled: bool


class KrylovSolver:
    """Solver of ``A c + P p = b, P^T c = 0``, set up once for any number of right-hand sides; a solution does not
    depend on earlier ones.

    Centres (n, 3) are in units of the support radius, P (n, q) has full column rank, ``product`` is A times (n, 3).
    Small tolerances, of the solutions for which it is set up, make the boxes of the preconditioner larger.
    """

    def __init__(
        self, kind: int, points: FloatArray, polynomial: FloatArray, product: ExactProduct, tolerance: float = 1e-6
    ) -> None:
        self._polynomial, self.product = polynomial, product
        self.preconditioner = SchwarzPreconditioner(kind, points, polynomial, product, _widening(tolerance))

    @staticmethod
    def memory(n: int, tolerance: float = 1e-6) -> int:
        """Bytes that the solver takes for ``n`` centres and this tolerance, without the product."""
        return SchwarzPreconditioner.memory(n, _widening(tolerance)) + 8 * n * 3 * (2 * _RESTART + 6)

    def solve(
        self, values: FloatArray, tolerance: float, max_iterations: int, progress: Report | None = None
    ) -> Solution:
        """Solve for values (n, 3) until ``||r|| <= tolerance ||b||`` in every column.

        Stops earlier after ``max_iterations``, or when a whole cycle between restarts has not halved the residual, as
        the limit of round-off or of the product's accuracy is then reached. ``progress`` is called with (iterations,
        max_iterations).
        """
        norm = np.linalg.norm(values, axis=0)
        # Columns are scaled to unit norm, so that one tolerance serves all and small components count, too.
        scale = np.where(norm > 0, norm, 1.0)
        rest = right = values / scale
        coefficients, polynomial = np.zeros_like(right), np.zeros((self._polynomial.shape[1], right.shape[1]))
        error, iterations, stalled = np.zeros(right.shape[1]), 0, False
        self.product.restart()
        residual = np.linalg.norm(rest, axis=0)
        while iterations < max_iterations and (residual > tolerance).any() and not stalled:
            limit = min(_RESTART, max_iterations - iterations)
            wanted = max(tolerance - error.max(), _REDUCTION * residual.min(initial=1.0, where=norm > 0.0))

            def report(step: int, before: int = iterations) -> None:
                if progress:
                    progress(before + step, max_iterations)

            more, shift, steps = self._search(rest, wanted, limit, report)
            coefficients, polynomial, iterations = coefficients + more, polynomial + shift, iterations + steps
            error = np.full_like(error, np.inf)
            while True:
                largest, sums = error.max(), self.product(coefficients)
                error = self.product.error(coefficients, sums)
                # The product is refined until its error is small compared to the tolerance, or round-off, which finer
                # sums do not reduce.
                if error.max() <= _LARGEST_ERROR * tolerance or error.max() > 0.3 * largest:
                    break
                self.product.refine()
            rest = right - sums - self._polynomial @ polynomial
            before, residual = residual, np.linalg.norm(rest, axis=0) + error
            stalled = bool(residual.max() > max(0.5 * before.max(), tolerance))
        return Solution(coefficients * scale, polynomial * scale, iterations, residual, stalled)

    def _search(
        self, rest: FloatArray, tolerance: float, limit: int, report: Callable[[int], None]
    ) -> tuple[FloatArray, FloatArray, int]:
        """One cycle: the solution whose image is nearest to ``rest`` (n, m), and its number of iterations."""
        n, m = rest.shape
        space = np.empty((n, m * (limit + 1)), order="F")
        hessenberg = np.zeros((m * (limit + 1), m * limit))
        start = np.zeros((m * (limit + 1), m))
        space[:, :m], start[:m] = _orthonormal(rest, 1.0)
        directions = []
        for step in range(1, limit + 1):
            old, new = slice(m * (step - 1), m * step), slice(m * step, m * (step + 1))
            directions.append(self.preconditioner.solve(np.ascontiguousarray(space[:, old])))
            image = self.product(directions[-1][0]) + self._polynomial @ directions[-1][1]
            size = np.linalg.norm(image)
            # Two passes suffice for full orthogonality (Giraud, Langou & Rozloznik 2005).
            for _ in range(2):
                overlap = space[:, : new.start].T @ image
                image -= space[:, : new.start] @ overlap
                hessenberg[: new.start, old] += overlap
            space[:, new], hessenberg[new, old] = _orthonormal(image, size)
            found = hessenberg[: new.stop, : new.start]
            y = np.linalg.lstsq(found, start[: new.stop], rcond=None)[0]
            report(step)
            if (np.linalg.norm(start[: new.stop] - found @ y, axis=0) <= 0.9 * tolerance).all():
                break
        parts = [(c @ each, p @ each) for (c, p), each in zip(directions, y.reshape(-1, m, m), strict=True)]
        return *(sum(part) for part in zip(*parts, strict=True)), step


def _widening(tolerance: float) -> int:
    return 2 if tolerance < _MANY_DIGITS else 1


def _orthonormal(block: FloatArray, size: np.floating | float) -> tuple[FloatArray, FloatArray]:
    """Factors Q (n, m), R (m, m) of a block; columns of Q that add nothing above round-off of ``size`` are zero."""
    left, length, right = np.linalg.svd(block, full_matrices=False)
    length[length <= _DEPENDENT * size] = 0.0
    q, r = np.zeros_like(block), np.zeros((block.shape[1], block.shape[1]))
    # Fewer rows than columns leave columns of zeros too.
    q[:, : len(length)], r[: len(length)] = left * (length > 0.0), length[:, None] * right
    return q, r
