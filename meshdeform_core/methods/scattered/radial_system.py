"""Radial basis functions with given values at centres: normalised coordinates, the linear system, sums at points."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...grid import FloatArray
from ...memory import UNLIMITED, MemoryLimit
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_matrix, radial_sums
from ...numerics.systems.krylov import KrylovSolver
from ...numerics.systems.products import ExactProduct, nested_bytes, product_of
from ...numerics.systems.saddle import DirectSolver, independent
from ...parallel import Ranks
from ..base import Account, Progress, Setting, of_stage
from .tuned import DIRECT_CENTRES

_TOLERANCE = 1e-6
ROUND_OFF = 1e-13
"""Tolerance of iterative solutions to which forward and transposed derivatives agree."""


@dataclass(frozen=True)
class Centres:
    """Centres in normalised coordinates with the polynomial terms that they determine.

    Thin plate splines with a linear polynomial do not depend on the unit of length, and compact functions take
    distances in radii; both are best conditioned with distances near one. If all centres lie in a plane, its normal
    direction has no polynomial term, so that 2-D grids and planar patches have a solution.
    """

    points: FloatArray
    origin: FloatArray
    scale: float
    axes: FloatArray

    @classmethod
    def of(cls, points: FloatArray, radius: float | None) -> Centres:
        origin = points.mean(axis=0)
        arms = points - origin
        extent = float(np.linalg.norm(arms, axis=1).max()) or 1.0
        _, sizes, axes = np.linalg.svd(arms, full_matrices=False)
        spread = axes[sizes > 1e-8 * extent * np.sqrt(len(points))]
        scale = extent if radius is None else radius
        return cls(np.ascontiguousarray(arms / scale), origin, scale, spread)

    def normalised(self, points: FloatArray) -> FloatArray:
        """Points in the normalised coordinates."""
        return (points - self.origin) / self.scale

    def polynomial(self, normalised: FloatArray) -> FloatArray:
        """Polynomial terms (n, q) at normalised points: the constant and the directions in which the centres extend."""
        return np.column_stack([np.ones(len(normalised)), *(self._along(axis, normalised) for axis in self.axes)])

    def drift(self, normalised: FloatArray, polynomial: FloatArray) -> FloatArray:
        """Values (n, 3) at normalised points of a ``polynomial`` (q, 3), which may lack the last terms; of each point
        the same to the last bit for any n, unlike ``@``."""
        found = np.tile(polynomial[0], (len(normalised), 1)) if len(polynomial) else np.zeros((len(normalised), 3))
        for axis, slope in zip(self.axes, polynomial[1:], strict=False):
            found += self._along(axis, normalised)[:, None] * slope
        return found

    def displacement(self, kind: int, points: FloatArray, fit: Coefficients) -> FloatArray:
        """Values (n, 3) at ``points`` (n, 3), which are not normalised, by exact sums of a ``kind`` of basis."""
        x = self.normalised(points)
        return np.asarray(radial_sums(kind, x, fit.centres, fit.coefficients) + self.drift(x, fit.polynomial))

    @staticmethod
    def _along(axis: FloatArray, points: FloatArray) -> FloatArray:
        return np.asarray(points[:, 0] * axis[0] + points[:, 1] * axis[1] + points[:, 2] * axis[2])


@dataclass(frozen=True)
class Coefficients:
    """Solved coefficients: ``centres`` (k, 3) normalised, ``coefficients`` (k, 3), ``polynomial`` (q, 3).

    ``residual`` (n, 3) is the error that a greedy reduction left at the sources (else ``None``), ``reach`` the length
    over which it is spread.
    """

    centres: FloatArray
    coefficients: FloatArray
    polynomial: FloatArray
    residual: FloatArray | None = None
    reach: float = 0.0


def accurate(options: Any) -> Any:
    """The options, those of :class:`.rbf.RBF`, for derivatives: a direct solution, or an iterative one to round-off."""
    return dataclasses.replace(options, solver="auto", tolerance=ROUND_OFF)


class RadialSystem:
    """The linear system of one set of centres; its factorisation or preconditioner is made on first use and stored.

    Of several ``ranks`` the first solves it, on all cores of its machine, and the others get the solution.
    """

    def __init__(self, options: Any, centres: Centres, limit: MemoryLimit = UNLIMITED, ranks: Ranks | None = None):
        self._ranks = ranks or Ranks()
        self.options, self.centres = options, centres
        self.kind = BASES[options.basis]
        # A small set of greedy centres (a single one if nothing moves) may not determine all polynomial terms.
        self.terms = independent(centres.polynomial(centres.points))
        n = len(centres.points)
        dense = 8 * n * n
        self._direct_fits = dense <= limit.size
        self.solver, self._reason = options.solver, ""
        if options.solver == "auto":
            self.solver = "direct" if n <= DIRECT_CENTRES else "krylov"
            self._reason = f"{n:,} centres, direct up to {DIRECT_CENTRES:,}"
        self._limit = limit
        self._tolerance = _TOLERANCE if options.tolerance == "auto" else float(options.tolerance)
        krylov = KrylovSolver.memory(n, self._tolerance) + nested_bytes(n)
        self._require(krylov if self.solver == "krylov" else dense)
        self._direct: DirectSolver | None = None
        self._krylov: KrylovSolver | None = None

    def _require(self, needed: int) -> None:
        """Refuse a system that exceeds the memory limit; another solver would change the result."""
        self._limit.require(
            needed,
            f"a radial basis function system of {len(self.centres.points):,} centres",
            f"use {'' if self.solver == 'krylov' else 'solver = krylov, '}greedy reduction (a compact basis), the "
            "hybrid idw-tfi, or fewer boundary nodes",
        )

    def solve(self, values: FloatArray, account: Account, progress: Progress | None) -> tuple[FloatArray, FloatArray]:
        """Coefficients (n, 3) and polynomial (q, 3) for values at the centres (n, 3)."""
        account.settings["solver"] = Setting(self.solver, self._reason)

        def solved() -> tuple[FloatArray, FloatArray, Account]:
            own = Account()
            if self.solver == "krylov":
                return *self._solve_krylov(values, own, progress), own
            return *self._solve_direct(values, own), own

        coefficients, polynomial, found = self._ranks.on_first(solved)
        account.note("solver", None)
        account.include(found)
        return coefficients, polynomial

    def transposed_sums(self, points: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradients of the coefficients (n, 3) and of the polynomial (q, 3) from those (m, 3) of the values at
        ``points`` (m, 3), which are not normalised."""
        x = self.centres.normalised(points)
        terms = self.centres.polynomial(x)[:, : self.terms.shape[1]]
        return radial_sums(self.kind, self.centres.points, x, gradient), np.asarray(terms.T @ gradient)

    def solve_transposed(self, upper: FloatArray, lower: FloatArray) -> FloatArray:
        """Transpose of :meth:`solve`: gradient (n, 3) of the values from those of the coefficients (n, 3) and of the
        polynomial (q, 3).

        The matrix [A P; P^T 0] is symmetric. A combination of the columns of P satisfies the lower rows of the
        right-hand side; the solver takes what remains.
        """
        part = self.terms @ np.linalg.solve(self.terms.T @ self.terms, lower)
        return np.asarray(part + self.solve(upper - self.multiply(part), Account(), None)[0])

    def multiply(self, coefficients: FloatArray) -> FloatArray:
        """The matrix of basis values between centres times coefficients (n, 3), with the solver's latest accuracy."""

        def product() -> FloatArray:
            if self._krylov is not None:
                return np.asarray(self._krylov.product(coefficients))
            return ExactProduct(self.kind, self.centres.points)(coefficients)

        return self._ranks.on_first(product)

    def _solve_direct(self, values: FloatArray, account: Account) -> tuple[FloatArray, FloatArray]:
        if self._direct is None:
            self._direct = DirectSolver(lambda: radial_matrix(self.kind, *(self.centres.points,) * 2), self.terms)
            account.settings["factorisation"] = Setting(self._direct.kind)
        multiply = ExactProduct(self.kind, self.centres.points)
        coefficients, polynomial = self._direct.solve(values)
        # One step of iterative refinement, with a sum over centres, as the factorisation overwrote the matrix.
        rest = values - multiply(coefficients) - self.terms @ polynomial
        more, shift = self._direct.solve(rest)
        coefficients, polynomial = coefficients + more, polynomial + shift
        rest = values - multiply(coefficients) - self.terms @ polynomial
        account.settings["residual"] = Setting(float(np.abs(rest).max()), "largest error at a centre, length unit")
        return coefficients, polynomial

    def _solve_krylov(
        self, values: FloatArray, account: Account, progress: Progress | None
    ) -> tuple[FloatArray, FloatArray]:
        if self._krylov is None:
            points = self.centres.points
            solver = KrylovSolver.memory(len(points), self._tolerance)
            product = product_of(self.kind, points, self._tolerance, lambda size: self._require(solver + size))
            self._krylov = KrylovSolver(self.kind, points, self.terms, product, self._tolerance)
        report = of_stage(progress, "krylov")
        found = self._krylov.solve(values, self._tolerance, self.options.max_iterations, report)
        account.settings["products"] = Setting(self._krylov.product.how)
        account.settings["iterations"] = Setting(found.iterations, "all components together")
        account.settings["tolerance"] = Setting(self._tolerance)
        account.settings["residual"] = Setting(
            found.residual.tolist(), "||b - K x|| / ||b||, computed from the solution"
        )
        # For smooth bases of large radius, coefficients nearly cancel, which limits the accuracy of their sums.
        more = "the limit of round-off; " if found.stalled else "raise method.rbf.max_iterations, "
        other = " or solver = direct" if self._direct_fits and not found.stalled else ""
        worst = float(found.residual.max())
        failed = (
            f"GMRES stopped after {found.iterations} iterations with a residual of {worst:.2e} (asked for "
            f"{self._tolerance:g}); {more}loosen tolerance, use a smaller radius{other}"
        )
        account.note("solver", failed if worst > self._tolerance else None)
        return found.coefficients, found.polynomial
