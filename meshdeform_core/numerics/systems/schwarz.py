"""Overlapping Schwarz preconditioner with a coarse level for systems of radial basis functions.

Beatson, Light & Billings, Fast solution of the radial basis function interpolation equations: domain decomposition
methods, SIAM J. Sci. Comput. 22 (2000), in the restricted form (Cai & Sarkis 1999): for every box of centres an
interpolation problem with an overlap is solved; the coefficients of the box's own centres are kept, those of the
overlap dropped. The smooth part, which boxes do not resolve, is treated by interpolating the remaining residual on a
small set of centres.
"""

from __future__ import annotations

import numpy as np
import scipy

from ...parallel import for_chunks, thread_count
from ..arrays import FloatArray, IntArray
from ..exact.radial import fill_rows, radial_matrix
from .products import ExactProduct
from .saddle import DirectSolver

OWN = 60
OVERLAP = 300
COARSENING = 25
# The coarse system stays small enough to factorise: with 60 centres per coarse one instead of 25, 8 iterations are
# needed instead of 6.
_DIRECT = 8000
_FEWEST = 500
_SPACING = 20
_SHIFT = 1e-13
_BOXES = 8


class SchwarzPreconditioner:
    """Approximate inverse of the system ``A c + P p = r, P^T c = 0``.

    Boxes of at most ``OWN`` centres result from repeated bisection across the direction of largest extent, so that they
    follow clustered nodes; they are widened to ``OVERLAP`` centres. One centre in ``COARSENING``, the middle of a
    smaller box, is a coarse centre. Both must follow the clustering: with coarse centres spread evenly in space, or an
    overlap measured as a length, a surface clustered towards an edge takes 4 to 10 times the iterations. The coarse
    system is factorised. Arguments as of :class:`.krylov.KrylovSolver`; ``OWN`` and ``OVERLAP`` are multiplied by
    ``widening``.
    """

    def __init__(
        self,
        kind: int,
        points: FloatArray,
        polynomial: FloatArray,
        product: ExactProduct,
        widening: int = 1,
    ) -> None:
        self._side = np.linalg.qr(polynomial)[0]
        self._own = bisect(points, -(-len(points) // (OWN * widening)))
        # Each box with the points nearest to it, ``size`` in all, its own points last. Distance is measured relative to
        # the local spacing of the box's points; otherwise the coarse end of a box in a graded grid would get no
        # neighbours.
        size = OVERLAP * widening
        tree = scipy.spatial.cKDTree(points)
        candidates = np.arange(1, min(len(points), size // 3) + 1)

        def widened(box: IntArray) -> IntArray:
            distance, around = tree.query(points[box], candidates, workers=thread_count())
            spacing = distance[:, min(len(candidates) - 1, _SPACING)][:, None]
            around = around.ravel()[np.argsort((distance / np.where(spacing > 0, spacing, 1.0)).ravel(), kind="stable")]
            once, rank = np.unique(around, return_index=True)
            outside = ~np.isin(once, box)
            nearest = once[outside][np.argsort(rank[outside])]
            return np.concatenate([nearest[: size - len(box)], box])

        self._near = [widened(box) for box in self._own]
        # For each box, the matrix (own, near) that maps values at its points to the coefficients of its own centres.
        self._rows = [np.empty((0, 0))] * len(self._own)

        def work(lo: int, hi: int) -> None:
            for box in range(lo, hi):
                x = points[self._near[box]]
                # Orthonormal linear polynomials (n, q), without the directions in which the points do not extend.
                arms = x - x.mean(axis=0)
                left, size, _ = np.linalg.svd(arms, full_matrices=False)
                spread = left[:, size > 1e-6 * size[0]] if size[0] > 0 else left[:, :0]
                self._rows[box] = _last_rows(
                    kind, x, np.concatenate([np.full((len(x), 1), len(x) ** -0.5), spread], axis=1), len(self._own[box])
                )

        for_chunks(work, len(self._own), _BOXES)
        self._coarse = _coarse(points, polynomial)
        self._at_coarse = product.roughly_at(self._coarse)
        centres = np.ascontiguousarray(points[self._coarse])
        self._next = DirectSolver(lambda: radial_matrix(kind, centres, centres), polynomial[self._coarse])

    @staticmethod
    def memory(n: int, widening: int = 1) -> int:
        """Bytes that the preconditioner takes for ``n`` centres."""
        coarse = min(n // COARSENING + _FEWEST, _DIRECT)
        return 8 * (n * OVERLAP * widening + coarse * coarse)

    def solve(self, residual: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, 3), with P^T c = 0, and polynomial (q, 3) for a residual (n, 3)."""
        coefficients = np.empty_like(residual)

        def work(lo: int, hi: int) -> None:
            for box in range(lo, hi):
                coefficients[self._own[box]] = self._rows[box] @ residual[self._near[box]]

        for_chunks(work, len(self._own), _BOXES)
        coefficients -= self._side @ (self._side.T @ coefficients)
        correction, polynomial = self._next.solve(residual[self._coarse] - self._at_coarse(coefficients))
        coefficients[self._coarse] += correction
        return coefficients, polynomial


def bisect(points: FloatArray, parts: int) -> list[IntArray]:
    """Divide points (n, 3) into ``parts`` boxes with nearly equal numbers of points; return the indices in each box."""
    boxes, pending = [], [(np.arange(len(points)), parts)]
    while pending:
        box, parts = pending.pop()
        if parts == 1:
            boxes.append(np.sort(box))
            continue
        arms = points[box] - points[box].mean(axis=0)
        _, axes = np.linalg.eigh(arms.T @ arms)
        first = parts // 2
        cut = len(box) * first // parts
        order = np.argpartition(arms @ axes[:, -1], cut)
        pending += [(box[order[:cut]], first), (box[order[cut:]], parts - first)]
    return boxes


def coarse_count(n: int) -> int:
    """Number of coarse centres for ``n`` centres, one in ``COARSENING``, or as many as can be factorised."""
    # The centres that determine the polynomial are added to these.
    return min(n, max(_FEWEST, min(n // COARSENING, _DIRECT - 8)))


def _coarse(points: FloatArray, polynomial: FloatArray) -> IntArray:
    """The node nearest to the mean of each small box, and nodes that determine the polynomial; no two coincide."""
    boxes = bisect(points, coarse_count(len(points)))
    arms = (np.linalg.norm(points[box] - points[box].mean(axis=0), axis=1) for box in boxes)
    middles = [box[np.argmin(length)] for box, length in zip(boxes, arms, strict=True)]
    corners = scipy.linalg.qr(polynomial.T, mode="r", pivoting=True)[1][: polynomial.shape[1]]
    chosen = np.unique(np.concatenate([middles, corners]))
    return chosen[np.unique(points[chosen], axis=0, return_index=True)[1]]


def _last_rows(kind: int, points: FloatArray, basis: FloatArray, count: int) -> FloatArray:
    """The last rows (count, n) of the inverse of A on the orthogonal complement of the polynomials.

    With orthonormal polynomials Q, ``B = (I - Q Q^T) A (I - Q Q^T) + t Q Q^T`` is positive definite for conditionally
    positive definite functions, and its inverse differs from the required one only by ``Q Q^T / t``.
    """
    n, shift, info = len(points), 0.0, 1
    a = np.empty((n, n))
    fill_rows(kind, points, np.ascontiguousarray(points.T), a)
    t = float(np.abs(a).max()) or 1.0
    # A - Q U^T - U Q^T with U = A Q - Q (Q^T A Q + t I) / 2.
    u = a @ basis
    u -= 0.5 * basis @ (basis.T @ u + t * np.eye(basis.shape[1]))
    a -= basis @ u.T + u @ basis.T
    while info:
        # Centres coincide, or round-off is too large: for a preconditioner, the smallest sufficient shift will do.
        factor, info = scipy.linalg.lapack.dpotrf((a + shift * t * np.eye(n)).T, lower=1, overwrite_a=1, clean=0)
        shift = max(_SHIFT, 100.0 * shift)
    unit = np.zeros((n, count), order="F")
    unit[n - count :] = np.eye(count)
    columns, _ = scipy.linalg.lapack.dpotrs(factor, unit, lower=1, overwrite_b=1)
    return np.ascontiguousarray(columns.T) - basis[n - count :] @ basis.T / t
