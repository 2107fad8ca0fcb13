"""Products of the matrix of basis values between centres with coefficients, for matrix-free solvers."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import scipy

from ...parallel import for_chunks
from ..arrays import FloatArray, IntArray
from ..exact.basis import BASES, apply_basis
from ..exact.radial import radial_sums
from ..fastsum.nested import NestedSums

_CHUNK = 512
# Number of centres above which nested sums are faster, and the largest part of all pairs that they may sum directly.
_FEWEST, _LARGEST_PART = 10_000, 0.5
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
        result = np.empty_like(coefficients)

        def work(lo: int, hi: int) -> None:
            result[lo:hi] = radial_sums(self._kind, self._points[lo:hi], self._points, coefficients)

        for_chunks(work, len(result), _CHUNK)
        return result

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
    return 8 * _NUMBERS * n if n >= _FEWEST else 0


def product_of(
    kind: int, points: FloatArray, tolerance: float, require: Callable[[int], object] = lambda size: None
) -> ExactProduct:
    """The cheapest product for centres (n, 3) and a solution with ``tolerance``.

    ``require(bytes)`` is called beforehand with the memory needed, and raises an error if there is too little.
    """
    sparse = sparse_radial_matrix(kind, points, require)
    if sparse is None and len(points) >= _FEWEST:
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
    pairs = tree.query_pairs(1.0, output_type="ndarray")
    values = np.append(((points[pairs[:, 0]] - points[pairs[:, 1]]) ** 2).sum(axis=1), 0.0)
    apply_basis(kind, values, len(values))
    lower, upper, diagonal = pairs[:, 0], pairs[:, 1], np.arange(n)
    rows = np.concatenate([lower, upper, diagonal])
    columns = np.concatenate([upper, lower, diagonal])
    entries = np.concatenate([values[:-1], values[:-1], np.full(n, values[-1])])
    return scipy.sparse.coo_array((entries, (rows, columns)), shape=(n, n)).tocsr()
