"""Radial basis functions with given values at centres: normalised coordinates, the linear system, sums at points; and
bound to a grid: solved at the sources, summed at the nodes, exactly or fast with clusters of centres, differentiated.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy

from ...boundary import Kind
from ...grid import FloatArray, IntArray
from ...memory import UNLIMITED, MemoryLimit
from ...numerics.arrays import Report, lengths
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_matrix, radial_sums
from ...numerics.krylov import ExactProduct, KrylovSolver, nested_bytes, product_of
from ...numerics.saddle import DirectSolver, independent, select
from ...parallel import Nodes, Ranks, for_chunks, thread_count
from ..base import Account, Kinks, Linearised, Problem, Progress, Setting, of_stage
from ..limits import CHOSEN, warn_of_coarse_tolerance, warn_of_radius
from .images import mirror_images
from .summation import DIRECT_CENTRES, fast_pays, largest_error, sum_accurately

if TYPE_CHECKING:
    from ...numerics.fastsum.radial import FastRadial, RadialTargets

_TOLERANCE = 1e-6
ROUND_OFF = 1e-13
"""Tolerance of iterative solutions to which forward and transposed derivatives agree."""
# Nodes per chunk of exact sums, and in derivatives.
_CHUNK, _ROWS = 1024, 1 << 16
_REACH = 20.0
"""Distance from a wall over which nodes are corrected by the residual of a greedy reduction there, as a multiple of the
residual; large enough that the correction cannot fold cells."""


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
        solve = self._solve_krylov if self.solver == "krylov" else self._solve_direct
        coefficients, polynomial, found = self._ranks.on_first(partial(solve, values, progress))
        account.note("solver", None)
        account.include(found)
        account.settings["solver"] = Setting(self.solver, self._reason)
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
        product = self._krylov.product if self._krylov else ExactProduct(self.kind, self.centres.points)
        return self._ranks.on_first(partial(product, coefficients))

    def _solve_direct(self, values: FloatArray, _: Progress | None) -> tuple[FloatArray, FloatArray, Account]:
        if self._direct is None:
            self._direct = DirectSolver(lambda: radial_matrix(self.kind, *(self.centres.points,) * 2), self.terms)
        multiply = ExactProduct(self.kind, self.centres.points)
        coefficients, polynomial, rest = np.zeros_like(values), np.zeros((self.terms.shape[1], 3)), values
        # One step of iterative refinement, with a sum over centres, as the factorisation overwrote the matrix.
        for _step in range(2):
            more, shift = self._direct.solve(rest)
            coefficients, polynomial = coefficients + more, polynomial + shift
            rest = values - multiply(coefficients) - self.terms @ polynomial
        settings = {
            "factorisation": Setting(self._direct.kind),
            "residual": Setting(float(np.abs(rest).max()), "largest error at a centre, length unit"),
        }
        return coefficients, polynomial, Account(settings)

    def _solve_krylov(self, values: FloatArray, progress: Progress | None) -> tuple[FloatArray, FloatArray, Account]:
        if self._krylov is None:
            points = self.centres.points
            solver = KrylovSolver.memory(len(points), self._tolerance)
            product = product_of(self.kind, points, self._tolerance, lambda size: self._require(solver + size))
            self._krylov = KrylovSolver(self.kind, points, self.terms, product, self._tolerance)
        report = of_stage(progress, "krylov")
        found = self._krylov.solve(values, self._tolerance, self.options.max_iterations, report)
        account = Account(
            {
                "products": Setting(self._krylov.product.how),
                "iterations": Setting(found.iterations, "all components together"),
                "tolerance": Setting(self._tolerance),
                "residual": Setting(found.residual.tolist(), "||b - K x|| / ||b||, computed from the solution"),
            }
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
        return found.coefficients, found.polynomial, account


class PreparedRBF:
    """RBF bound to the sources and the target nodes ``flat`` of one undeformed grid; ``options`` are those of
    :class:`.rbf.RBF`."""

    def __init__(self, options: Any, problem: Problem, flat: IntArray):
        self.options, self.kind = options, BASES[options.basis]
        self.problem, self.flat = problem, flat
        self.account = Account()
        self.images = mirror_images(problem)
        radius: float | None = None
        if options.radius != "auto" and options.basis != "tps":
            radius = float(options.radius)
            self.account.settings |= options.used("radius")
        elif options.basis != "tps":
            moving = problem.source_points[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
            centre, faces = moving.sum(axis=0) / len(moving), problem.grid.nodes.at(problem.topology.first)
            radius = float(sum(np.linalg.norm(points - centre, axis=1).max() for points in (moving, faces)))
            self.account.settings["radius"] = Setting(radius, "every node sees the whole moving body")
        self.centres = Centres.of(self.images.points, radius)
        # Without greedy reduction the size of the system is known: refuse it now if it is too large.
        self.system: RadialSystem | None = None
        if options.greedy == "none":
            self.system = RadialSystem(options, self.centres, problem.memory, problem.grid.nodes.ranks)
        self.account.settings |= options.used("basis", "solver", "tolerance", "max_iterations", "greedy") | {
            "centres": Setting(len(self.images.points)),
            "polynomial": Setting(
                f"linear in {len(self.centres.axes)} directions",
                "" if len(self.centres.axes) == 3 else "the centres lie in a plane or on a line",
            ),
        }
        if options.greedy != "none":
            names = ("error", "tolerance", "updates", "correct")
            self.account.settings |= options.used(*(f"greedy_{name}" for name in names))
            height = problem.first_cell_height[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
            unit = height if options.greedy_error == "first-cell" else np.ones(len(height))
            tolerance = options.greedy_tolerance * unit
            self.account.note("greedy tolerance", warn_of_coarse_tolerance(tolerance, height, options.greedy_correct))
        # Target nodes sorted for fast sums, and the centres of the latest ones.
        self._targets: RadialTargets | None = None
        self._tree: tuple[FloatArray, FastRadial] | None = None
        # Distance of every target from the nearest source, and the number of that.
        self._nearest: tuple[FloatArray, IntArray] | None = None
        if options.greedy == "none":
            self._is_fast(len(self.images.points))

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        if self.options.basis == "tps":
            return []
        terms = self.centres.polynomial(self.centres.points)
        return warn_of_radius(self.centres.scale, terms, self.images.displaced(step))

    def fit(self, displacement: FloatArray, progress: Progress | None = None) -> Coefficients:
        """Solve for one displacement of the sources (n_sources, 3)."""
        values, here, o = self.images.displaced(displacement), self.centres.points, self.options
        if o.greedy == "none":
            assert self.system is not None
            return Coefficients(here, *self.system.solve(values, self.account, progress))
        by_height, report = o.greedy_error == "first-cell", of_stage(progress, "greedy")
        scale = self.problem.first_cell_height[self.images.owner] if by_height else np.ones(len(values))
        given = here, self.centres.polynomial(here), values, scale, o.greedy_tolerance, o.greedy_updates or len(values)
        found = self.problem.grid.nodes.ranks.on_first(partial(select, self.kind, *given, report))
        unit = "first-cell heights" if by_height else "length unit"
        self.account.settings |= {
            "greedy": Setting(o.greedy),
            "greedy_points": Setting(len(found.active), f"of {len(values)} centres"),
            "greedy_rounds": Setting(found.rounds),
            "greedy_updates_done": Setting(found.updates),
            "greedy_tolerance": Setting(o.greedy_tolerance, unit),
            "greedy_error_reached": Setting(found.error, unit),
        }
        failed = (
            f"greedy reduction stopped with {len(found.active)} points and an error of {found.error:.3g} "
            f"({unit}); asked for {o.greedy_tolerance:g}. Raise greedy_tolerance"
        )
        self.account.note("greedy", failed if found.error > o.greedy_tolerance else None)
        points, reach = np.ascontiguousarray(here[found.active]), _REACH * float(lengths(found.residual).max())
        return Coefficients(points, found.coefficients, found.polynomial, found.residual, reach)

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative of the displacement of the targets; the same at all displacements.

        All sources are centres, and sums are exact.
        """
        nodes, memory, flat = self.problem.grid.nodes, self.problem.memory, self.flat
        system = RadialSystem(accurate(self.options), self.centres, memory, nodes.ranks)
        # Factorised here, once.
        system.solve(np.zeros_like(self.centres.points), Account(), None)

        def push(change: FloatArray, out: FloatArray) -> None:
            solution = system.solve(self.images.displaced(change), Account(), None)
            self._sum_exactly(Coefficients(self.centres.points, *solution), Nodes.of(out).rows)

        def pull(gradient: FloatArray) -> FloatArray:
            rows = Nodes.of(gradient).rows
            upper, lower = np.zeros_like(self.centres.points), np.zeros((system.terms.shape[1], 3))
            for first in range(0, len(flat), _ROWS):
                some = flat[first : first + _ROWS]
                more = system.transposed_sums(nodes.rows[some], rows[some])
                upper, lower = upper + more[0], lower + more[1]
            return self.images.gathered(system.solve_transposed(nodes.total(upper), nodes.total(lower)))

        return Linearised(push, pull, Kinks({CHOSEN: 1} if self.options.greedy != "none" else {}))

    def _is_fast(self, n_centres: int) -> bool:
        """Whether fast sums pay for this number of centres; then the target nodes are sorted for them."""
        o, grid, settings = self.options, self.problem.grid, self.account.settings
        fast, settings["summation"] = fast_pays(o.summation, sum(grid.nodes.gather(len(self.flat))), n_centres)
        if fast and self._targets is None:
            # Imported here, as its loops take a while to load and exact sums need none of them.
            from ...numerics.fastsum.radial import make_radial_targets

            settings["summation_tolerance"] = Setting(o.summation_tolerance, "error relative to the local cell")
            grid.hold_neighbours()
            points = grid.nodes.like(3)
            Nodes.of(points).each(lambda rows: np.copyto(points[rows], self.centres.normalised(grid.points[rows])))
            grid.hold_neighbours(points)
            targets = make_radial_targets(points, grid.shapes, grid.offsets, self.flat)
            self._targets = targets._replace(sizes=targets.sizes * self.centres.scale)
        return fast

    def evaluate(self, fit: Coefficients, out: FloatArray, progress: Progress | None = None) -> None:
        """Write the displacement of the targets into their rows of ``out`` (n_nodes, 3)."""
        report, rows, tolerance = of_stage(progress, "rbf"), Nodes.of(out).rows, self.options.summation_tolerance
        if self._is_fast(len(fit.centres)):
            from ...numerics.fastsum.radial import FastRadial

            assert self._targets is not None
            targets = self._targets
            if self._tree is None or not np.array_equal(self._tree[0], fit.centres):
                self._tree = fit.centres, FastRadial(self.kind, fit.centres)
            sums = self._tree[1]

            def use(flat: IntArray, found: FloatArray) -> None:
                rows[flat] = found + self.centres.drift(targets.points[flat], fit.polynomial)

            def once(excess: float) -> float:
                risk = sums.apply(fit.coefficients, targets, tolerance, use, excess, report)
                return largest_error(self.problem.grid, targets, risk, rows, partial(self._displacement, fit))

            sum_accurately("rbf", once, tolerance, self.account)
        else:
            self._sum_exactly(fit, rows, report)
        if self.options.greedy_correct and fit.reach > 0:
            self._add_residual(fit, rows)

    def _displacement(self, fit: Coefficients, flat: IntArray) -> FloatArray:
        """Displacement (n, 3) of the nodes ``flat`` by exact sums."""
        return self.centres.displacement(self.kind, self.problem.grid.nodes.rows[flat], fit)

    def _sum_exactly(self, fit: Coefficients, out: FloatArray, report: Report | None = None) -> None:
        """Write the displacement of the targets into their rows of ``out``, by exact sums."""

        def work(lo: int, hi: int) -> None:
            out[self.flat[lo:hi]] = self._displacement(fit, self.flat[lo:hi])

        for_chunks(work, len(self.flat), _CHUNK, report)

    def _add_residual(self, fit: Coefficients, out: FloatArray) -> None:
        """Add the residual of the nearest source, which fades out with the distance from it (Wendland C2)."""
        assert fit.residual is not None
        if self._nearest is None:
            tree = scipy.spatial.cKDTree(self.centres.points * self.centres.scale + self.centres.origin)
            self._nearest = tree.query(self.problem.grid.nodes.rows[self.flat], workers=thread_count())
        distance, nearest = self._nearest
        residual, flat = fit.residual, self.flat

        def work(lo: int, hi: int) -> None:
            r = np.minimum(distance[lo:hi] / fit.reach, 1.0)
            out[flat[lo:hi]] += ((1 - r) ** 4 * (4 * r + 1))[:, None] * residual[nearest[lo:hi]]

        for_chunks(work, len(flat), _CHUNK)
