"""Systems of radial basis functions too large to factorise: block GMRES with fast products.

GMRES (Saad & Schultz 1986) preconditioned from the right, in the block form (Simoncini & Gallopoulos 1996): all
right-hand sides search one common space, so that one product with A serves them all and each profits from the others.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np

from .earlier import EarlierSolutions
from .schwarz import SchwarzPreconditioner

_RESTART = 40
_DEPENDENT = 1e-14


@dataclass(frozen=True)
class Solution:
    """Coefficients (n, 3), polynomial (q, 3), number of iterations, and ||r|| / ||b|| (3,) computed anew from them.

    ``started`` is the residual (3,) of what the search set out from, 1 without earlier solutions; ``stalled``: more
    iterations would not have helped.
    """

    coefficients: np.ndarray
    polynomial: np.ndarray
    iterations: int
    residual: np.ndarray
    started: np.ndarray
    stalled: bool


class KrylovSolver:
    """Solver of ``A c + P p = b, P^T c = 0``; set up once, for any number of right-hand sides.

    It sets out from the best combination of the solutions that it has found before. A solution therefore depends on
    what was solved earlier, but only within the tolerance: its residual is computed from it, whatever it came from.

    Parameters
    ----------
    kind : basis number, see :data:`.basis.BASES`
    points : (n, 3) centres in units of the support radius
    polynomial : (n, q), full column rank
    product : A times (n, 3), to an accuracy below the tolerance asked for
    remembered : how many earlier right-hand sides (n, 3) may be kept with their solutions

    Attributes
    ----------
    earlier : the solutions kept; ``earlier.clear()`` forgets them
    """

    def __init__(self, kind, points, polynomial, product, remembered=0):
        self._polynomial, self._product = polynomial, product
        self.preconditioner = SchwarzPreconditioner(kind, points, polynomial)
        self.earlier = EarlierSolutions(len(points), polynomial.shape[1], remembered * points.shape[1])

    @staticmethod
    def memory(n, remembered=0):
        """Bytes that it takes for ``n`` centres, the product not counted."""
        return SchwarzPreconditioner.memory(n) + 8 * n * 3 * (_RESTART + 6 + 2 * remembered)

    def solve(self, values, tolerance, max_iterations, progress=None):
        """Solve for values (n, 3) until ``||r|| <= tolerance ||b||`` in every column.

        Stops without that after ``max_iterations``, or when a whole cycle between restarts has not halved the residual:
        then round-off or the accuracy of the product is reached. ``progress`` is called with (iterations,
        max_iterations).
        """
        norm = np.linalg.norm(values, axis=0)
        # Unit columns: one tolerance for all, and no component drowns in another.
        scale = np.where(norm > 0, norm, 1.0)
        right = values / scale
        coefficients, polynomial = self.earlier.nearest(right)
        rest, iterations, stalled = right, 0, False
        if coefficients.any() or polynomial.any():
            rest = right - self._image(coefficients, polynomial)
        started = residual = np.linalg.norm(rest, axis=0)
        while iterations < max_iterations and (residual > tolerance).any() and not stalled:
            report = None if progress is None else partial(_advance, progress, iterations, max_iterations)
            limit = min(_RESTART, max_iterations - iterations)
            direction, steps = self._search(rest, tolerance, limit, report)
            more, shift = self.preconditioner.solve(direction)
            coefficients, polynomial, iterations = coefficients + more, polynomial + shift, iterations + steps
            rest = right - self._image(coefficients, polynomial)
            before, residual = residual, np.linalg.norm(rest, axis=0)
            stalled = bool(residual.max() > max(0.5 * before.max(), tolerance))
        if iterations:
            self.earlier.add(coefficients, polynomial, right - rest, tolerance)
        return Solution(coefficients * scale, polynomial * scale, iterations, residual, started, stalled)

    def _image(self, coefficients, polynomial):
        return self._product(coefficients) + self._polynomial @ polynomial

    def _search(self, rest, tolerance, limit, report):
        """One cycle: y (n, m) for which A M y is nearest to ``rest`` (n, m), and its number of iterations."""
        n, m = rest.shape
        space = np.empty((n, m * (limit + 1)), order="F")
        hessenberg = np.zeros((m * (limit + 1), m * limit))
        start = np.zeros((m * (limit + 1), m))
        space[:, :m], start[:m] = _orthonormal(rest, 1.0)
        for step in range(1, limit + 1):
            old, new = slice(m * (step - 1), m * step), slice(m * step, m * (step + 1))
            image = self._image(*self.preconditioner.solve(np.ascontiguousarray(space[:, old])))
            size = np.linalg.norm(image)
            # Twice is enough for full orthogonality (Giraud, Langou & Rozloznik 2005).
            for _ in range(2):
                overlap = space[:, : new.start].T @ image
                image -= space[:, : new.start] @ overlap
                hessenberg[: new.start, old] += overlap
            space[:, new], hessenberg[new, old] = _orthonormal(image, size)
            found = hessenberg[: new.stop, : new.start]
            y = np.linalg.lstsq(found, start[: new.stop], rcond=None)[0]
            if report:
                report(step)
            if (np.linalg.norm(start[: new.stop] - found @ y, axis=0) <= 0.9 * tolerance).all():
                break
        return space[:, : new.start] @ y, step


def _advance(progress, before, total, step):
    progress(before + step, total)


def _orthonormal(block, size):
    """Factors Q (n, m), R (m, m) of a block; columns of Q that add nothing above round-off of ``size`` are zero."""
    left, length, right = np.linalg.svd(block, full_matrices=False)
    length[length <= _DEPENDENT * size] = 0.0
    q, r = np.zeros_like(block), np.zeros((block.shape[1], block.shape[1]))
    # Fewer rows than columns leave columns of zeros too.
    q[:, : len(length)], r[: len(length)] = left * (length > 0.0), length[:, None] * right
    return q, r
