"""Systems of radial basis functions too large to factorise: block GMRES with fast products of the matrix of basis
values between centres with coefficients.

Flexible GMRES (Saad 1993) preconditioned from the right, in block form (Simoncini & Gallopoulos 1996): all right-hand
sides share one search space, so one product with A serves them all and each profits from the others.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import scipy

from ..parallel import for_chunks, thread_count
from .arrays import FloatArray, IntArray, Report
from .exact.basis import BASES, apply_basis
from .exact.radial import fill_rows, radial_matrix, radial_sums
from .fastsum.nested import NestedSums
from .saddle import DirectSolver, projected

_RESTART = 40
_DEPENDENT = 1e-14
# Fraction of the tolerance that errors of the product may use up.
_LARGEST_ERROR = 0.3
# Tolerance below which a preconditioner with boxes twice as large pays: it saves three iterations in ten.
_MANY_DIGITS = 1e-9
# Reduction of the residual after which a cycle ends: beyond it, the recursive residual deviates from the true one.
_REDUCTION = 1e-7

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

# Number of centres above which nested sums are faster, and the largest part of all pairs that they may sum directly.
_NESTED_FROM, _LARGEST_PART = 10_000, 0.5
_SAMPLES = 512
# Accuracy of nested sums relative to that of the solution, the factor by which it is refined, and the finest one.
_FINER, _REFINEMENT, _FINEST = 3e-4, 1e-2, 1e-13
# Accuracy in a preconditioner; not less, as rough residuals have large coefficients, which nearly cancel.
_ROUGH = 1e-7
# Numbers per centre that nested sums store: shares of skeletons, for fine and for rough sums.
_NUMBERS = 250
# Of sparse matrices: the most neighbours of a centre, and the largest part of all centres that they may be; work space
# for a nonzero value, and for all of them.
_MOST_NEIGHBOURS, _LARGEST_SHARE = 500, 0.05
_BYTES, _MOST_BYTES = 64, 2**32


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
        coarse = min(n // COARSENING + _FEWEST, _DIRECT)
        boxes = n * OVERLAP * _widening(tolerance) + coarse * coarse
        return 8 * (boxes + n * 3 * (2 * _RESTART + 6))

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


class SchwarzPreconditioner:
    """Approximate inverse of the system ``A c + P p = r, P^T c = 0``: overlapping Schwarz with a coarse level.

    Beatson, Light & Billings, Fast solution of the radial basis function interpolation equations: domain decomposition
    methods, SIAM J. Sci. Comput. 22 (2000), in the restricted form (Cai & Sarkis 1999): for every box of centres an
    interpolation problem with an overlap is solved; the coefficients of the box's own centres are kept, those of the
    overlap dropped. The smooth part, which boxes do not resolve, is treated by interpolating the remaining residual on
    a small set of centres.

    Boxes of at most ``OWN`` centres result from repeated bisection across the direction of largest extent, so that they
    follow clustered nodes; they are widened to ``OVERLAP`` centres. One centre in ``COARSENING``, the middle of a
    smaller box, is a coarse centre. Both must follow the clustering: with coarse centres spread evenly in space, or an
    overlap measured as a length, a surface clustered towards an edge takes 4 to 10 times the iterations. The coarse
    system is factorised. Arguments as of :class:`KrylovSolver`; ``OWN`` and ``OVERLAP`` are multiplied by
    ``widening``.
    """

    def __init__(
        self, kind: int, points: FloatArray, polynomial: FloatArray, product: ExactProduct, widening: int = 1
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


def _coarse(points: FloatArray, polynomial: FloatArray) -> IntArray:
    """The node nearest to the mean of each small box, and nodes that determine the polynomial; no two coincide."""
    # As many as can be factorised, at most; the nodes that determine the polynomial are added to these.
    n = len(points)
    boxes = bisect(points, min(n, max(_FEWEST, min(n // COARSENING, _DIRECT - 8))))
    arms = (np.linalg.norm(points[box] - points[box].mean(axis=0), axis=1) for box in boxes)
    middles = [box[np.argmin(length)] for box, length in zip(boxes, arms, strict=True)]
    corners = scipy.linalg.qr(polynomial.T, mode="r", pivoting=True)[1][: polynomial.shape[1]]
    chosen = np.unique(np.concatenate([middles, corners]))
    return chosen[np.unique(points[chosen], axis=0, return_index=True)[1]]


def _last_rows(kind: int, points: FloatArray, basis: FloatArray, count: int) -> FloatArray:
    """The last rows (count, n) of the inverse of A on the orthogonal complement of the polynomials.

    ``basis`` (n, q) are orthonormal polynomials, see :func:`.saddle.projected`.
    """
    n, shift, info = len(points), 0.0, 1
    a = np.empty((n, n))
    fill_rows(kind, points, np.ascontiguousarray(points.T), a)
    b, _, t = projected(a, basis)
    while info:
        # Centres coincide, or round-off is too large: for a preconditioner, the smallest sufficient shift will do.
        factor, info = scipy.linalg.lapack.dpotrf(b + shift * t * np.eye(n).T, lower=1, overwrite_a=1, clean=0)
        shift = max(_SHIFT, 100.0 * shift)
    unit = np.zeros((n, count), order="F")
    unit[n - count :] = np.eye(count)
    columns, _ = scipy.linalg.lapack.dpotrs(factor, unit, lower=1, overwrite_b=1)
    return np.ascontiguousarray(columns.T) - basis[n - count :] @ basis.T / t


class ExactProduct:
    """A times coefficients (n, 3): all pairs of centres, or the nonzero entries of a sparse matrix.

    ``how`` is the name of this kind of product, for reports.
    """

    def __init__(self, kind: int, points: FloatArray, matrix: Any = None) -> None:
        self._kind, self._points, self._matrix = kind, points, matrix
        self.how = "exact sums" if matrix is None else f"sparse matrix of {matrix.nnz:,} values"

    def __call__(self, coefficients: FloatArray) -> FloatArray:
        """Sums (n, 3)."""
        if self._matrix is not None:
            return np.asarray(self._matrix @ coefficients)
        return radial_sums(self._kind, self._points, self._points, coefficients)

    def error(self, coefficients: FloatArray, found: FloatArray) -> FloatArray:
        """Norm (3,) of the error, without round-off, of the sums ``found`` (n, 3) for these coefficients."""
        return np.zeros(3)

    def restart(self) -> None:
        """Return to the accuracy with which every solution starts."""

    def refine(self) -> None:
        """Raise the accuracy of all products until :meth:`restart`."""

    def roughly_at(self, rows: IntArray) -> Callable[[FloatArray], FloatArray]:
        """A function of coefficients (n, 3) that returns the product at some centres, to a few digits."""
        if self._matrix is not None:
            return self._matrix[rows].dot
        return partial(radial_sums, self._kind, self._points[rows], self._points)


class NestedProduct(ExactProduct):
    """Nested sums, compared with exact ones at centres spread evenly over the tree."""

    def __init__(self, kind: int, points: FloatArray, sums: NestedSums, tolerance: float) -> None:
        super().__init__(kind, points)
        self._first, self._sums = tolerance, sums
        self._made = {tolerance: sums}
        self._rows = sums.order[np.linspace(0, len(points) - 1, min(_SAMPLES, len(points))).astype(np.int64)]
        self.restart()

    def __call__(self, coefficients: FloatArray) -> FloatArray:
        return self._sums(coefficients)

    def error(self, coefficients: FloatArray, found: FloatArray) -> FloatArray:
        exact = radial_sums(self._kind, self._points[self._rows], self._points, coefficients)
        return np.sqrt(((found[self._rows] - exact) ** 2).mean(axis=0) * len(self._points))

    def restart(self) -> None:
        self._use(self._first)

    def refine(self) -> None:
        if self._tolerance > _FINEST:
            self._use(self._tolerance * _REFINEMENT)

    def _use(self, tolerance: float) -> None:
        if tolerance not in self._made:
            self._made[tolerance] = NestedSums(self._kind, self._points, tolerance, like=self._sums)
        self._tolerance, self._sums, self.how = tolerance, self._made[tolerance], f"nested sums to {tolerance:.0e}"

    def roughly_at(self, rows: IntArray) -> NestedSums:
        return NestedSums(self._kind, self._points, _ROUGH, rows, self._sums)


def nested_bytes(n: int) -> int:
    """Bytes that nested sums of n centres take; 0 if there are too few centres for nested sums."""
    return 8 * _NUMBERS * n if n >= _NESTED_FROM else 0


def product_of(
    kind: int, points: FloatArray, tolerance: float, require: Callable[[int], object] = lambda size: None
) -> ExactProduct:
    """The cheapest product for centres (n, 3) and a solution with ``tolerance``.

    ``require(bytes)`` is called beforehand with the memory needed, and raises an error if there is too little.
    """
    sparse = sparse_radial_matrix(kind, points, require)
    if sparse is None and len(points) >= _NESTED_FROM:
        require(nested_bytes(len(points)))
        finer = max(_FINER * tolerance, _FINEST)
        sums = NestedSums(kind, points, finer)
        if sums.pairs <= _LARGEST_PART * len(points) ** 2:
            return NestedProduct(kind, points, sums, finer)
    return ExactProduct(kind, points, sparse)


def sparse_radial_matrix(kind: int, points: FloatArray, require: Callable[[int], object]) -> Any:
    """The matrix (n, n) of a compact basis without its zeros, in CSR format, or ``None`` if that does not pay.

    It pays when centres have on average at most 500 neighbours, at most a twentieth of all centres, and when the work
    space is at most 4 GiB (a fixed limit, so that results do not depend on the memory available). ``require(bytes)`` is
    called with the memory needed. Centres (n, 3) are in units of the support radius.
    """
    if kind == BASES["tps"]:
        return None
    tree, n = scipy.spatial.cKDTree(points), len(points)
    count = int(tree.count_neighbors(tree, 1.0))
    if count > n * min(_MOST_NEIGHBOURS, _LARGEST_SHARE * n) or _BYTES * count > _MOST_BYTES:
        return None
    require(_BYTES * count)
    distances = tree.sparse_distance_matrix(tree, 1.0, output_type="coo_matrix")
    values = distances.data**2
    apply_basis(kind, values, len(values))
    return scipy.sparse.coo_array((values, (distances.row, distances.col)), shape=(n, n)).tocsr()
