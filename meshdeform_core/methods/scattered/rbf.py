"""Radial basis functions with a linear polynomial (Sen et al. section 2.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from ...boundary import Kind
from ...errors import MethodError
from ...grid import FloatArray, IntArray
from ...numerics.exact.basis import BASES
from ..base import Account, Problem, Progress, Setting, of_stage
from ..kinks import CHOSEN, Kinks
from ..limits import warn_of_coarse_tolerance, warn_of_radius
from ..options import MethodOptions, option
from .centres import DIRECT_CENTRES, REACH, Centres, Coefficients
from .mirror import mirror_images
from .summation import Summation, summation_tolerance

if TYPE_CHECKING:
    from ...numerics.systems.greedy import Selection
    from .rbf_sums import LinearRBF, RadialSums

Basis = Literal["tps", "wendland-c0", "wendland-c2", "ctps-c1", "ctps-c2a", "ctps-c2b"]
_GREEDY: Mapping[str, tuple[str, ...]] = {"greedy": ("hybrid",)}
_COMPACT: Mapping[str, tuple[str, ...]] = {"basis": tuple(name for name in BASES if name != "tps")}
_ITERATIVE: Mapping[str, tuple[str, ...]] = {"solver": ("auto", "krylov")}


@dataclass(frozen=True)
class RBF(MethodOptions):
    """Interpolation by radial basis functions: one linear system in N_s, then a sum of cost N_v x N_s.

    Smooth over the whole domain and valid at larger rotations than the other methods, but does not move the near-wall
    grid rigidly with the wall. The system grows as N_s^2 in memory and N_s^3 in time; greedy reduction keeps a subset
    of the centres.

    Attributes
    ----------
    basis : ``tps`` (global), ``wendland-c0``, ``wendland-c2``, ``ctps-c1``, ``ctps-c2a``, ``ctps-c2b`` (Table I)
    radius : support radius of the compact bases (grid length unit), or ``"auto"``: the support of every centre
        covers the whole moving body
    solver : ``direct`` (Cholesky on the null space of the side conditions), ``krylov`` (preconditioned GMRES,
        for any number of centres), or ``"auto"``: direct up to 4000 centres, then krylov
    tolerance : of ``krylov``: ||r|| <= tolerance ||b||; ``"auto"``: 1e-6
    max_iterations : of ``krylov``; not converging is a warning
    greedy : ``none`` or ``hybrid`` (Sen et al.: rounds of single-point updates and exact solutions); compact bases only
    greedy_error : ``first-cell``: errors relative to the height of the first cell at each node; ``absolute``: lengths
    greedy_tolerance : eps_g, largest error at any boundary node, in the unit of ``greedy_error``
    greedy_start : number of the first source, counted from 0
    greedy_updates : m, number of single-point updates between exact solutions; 0: the number of sources
    greedy_max_points : most centres to keep; 0: all
    greedy_correct : add the remaining error to the nodes near each wall node, so that walls are matched exactly
    summation : ``exact`` sums at the nodes, or ``fast`` ones with clusters of centres, or ``"auto"``: fast from 2000
        centres and 2e8 pairs of nodes
    summation_tolerance : of fast sums: error of a node's displacement relative to its shortest cell edge, 1e-8 to 0.1
    """

    basis: Basis = option("tps", "no radius to choose; no other basis has a better worst cell on the splitter plate")
    radius: float | Literal["auto"] = option("auto", "every node sees the whole moving body", only_if=_COMPACT)
    solver: Literal["auto", "direct", "krylov"] = option(
        "auto", f"direct up to {DIRECT_CENTRES:,} centres, then krylov"
    )
    tolerance: float | Literal["auto"] = option("auto", "krylov 1e-6", only_if=_ITERATIVE)
    max_iterations: int = option(10000, "well above what a well-posed system needs", only_if=_ITERATIVE)
    greedy: Literal["none", "hybrid"] = option("none", "all centres are kept: exact at every boundary node")
    greedy_error: Literal["first-cell", "absolute"] = option(
        "first-cell", "errors matter most where cells are thin", only_if=_GREEDY
    )
    greedy_tolerance: float = option(0.1, "of the first-cell height: wall cells keep their shape", only_if=_GREEDY)
    greedy_start: int = option(0, "changes the number of points by only about 10 %", range="[0, inf)", only_if=_GREEDY)
    greedy_updates: int = option(0, "the number of sources, as in the paper", range="[0, inf)", only_if=_GREEDY)
    greedy_max_points: int = option(0, "no limit: the tolerance decides", range="[0, inf)", only_if=_GREEDY)
    greedy_correct: bool = option(True, "walls are matched exactly", only_if=_GREEDY)
    summation: Summation = option("auto", "fast where it pays")
    summation_tolerance: float = summation_tolerance()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.basis == "tps" and self.greedy != "none":
            raise MethodError(
                "method.rbf.greedy does not work with the thin plate spline: its value at distance 0 is 0, so no "
                'centre can correct its own error; choose a compact basis, like wendland-c2, or greedy = "none"'
            )

    def bind(self, problem: Problem) -> PreparedRBF:
        """Sources and their images at symmetry planes as centres; nothing is solved yet."""
        return PreparedRBF(self, problem)


class PreparedRBF:
    """RBF bound to the sources of one undeformed grid.

    Modules with compiled loops are imported when needed, as other methods do without them.
    """

    def __init__(self, options: RBF, problem: Problem):
        from .radial_system import RadialSystem

        self.options = options
        self.account = Account()
        self.problem = problem
        self.images = mirror_images(problem)
        self.centres = Centres.of(self.images.points, self._radius())
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
            names = ("error", "tolerance", "start", "updates", "max_points", "correct")
            self.account.settings |= options.used(*(f"greedy_{name}" for name in names))
            height = problem.first_cell_height[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
            unit = height if options.greedy_error == "first-cell" else np.ones(len(height))
            tolerance = options.greedy_tolerance * unit
            self.account.note("greedy tolerance", warn_of_coarse_tolerance(tolerance, height, options.greedy_correct))

    def _radius(self) -> float | None:
        o = self.options
        if o.basis == "tps":
            return None
        if o.radius != "auto":
            self.account.settings |= o.used("radius")
            return float(o.radius)
        problem = self.problem
        moving = problem.source_points[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
        centre, faces = moving.sum(axis=0) / len(moving), problem.grid.nodes.at(problem.topology.first)
        radius = float(sum(np.linalg.norm(points - centre, axis=1).max() for points in (moving, faces)))
        self.account.settings["radius"] = Setting(radius, "every node sees the whole moving body")
        return radius

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        if self.options.basis == "tps":
            return []
        terms = self.centres.polynomial(self.centres.points)
        return warn_of_radius(self.centres.scale, terms, self.images.displaced(step))

    def fit(self, displacement: FloatArray, progress: Progress | None = None) -> Coefficients:
        """Solve for one displacement of the sources (n_sources, 3)."""
        values, here = self.images.displaced(displacement), self.centres.points
        if self.options.greedy == "none":
            assert self.system is not None
            return Coefficients(here, *self.system.solve(values, self.account, progress))
        from ...numerics.exact.radial import radial_sums

        found = self._selected(values, progress)
        self._record(found)
        points = np.ascontiguousarray(here[found.active])
        residual = values - radial_sums(BASES[self.options.basis], here, points, found.coefficients)
        residual -= self.centres.polynomial(here)[:, : len(found.polynomial)] @ found.polynomial
        reach = REACH * float(np.linalg.norm(residual, axis=1).max())
        return Coefficients(points, found.coefficients, found.polynomial, residual, reach)

    def _selected(self, values: FloatArray, progress: Progress | None) -> Selection:
        """Centres chosen for values (n, 3) at all of them, with their coefficients."""
        from ...numerics.systems.greedy import Search, select

        o, n = self.options, len(values)
        scale = np.ones(n)
        if o.greedy_error == "first-cell":
            scale = self.problem.first_cell_height[self.images.owner]
        if o.greedy_start >= n:
            raise MethodError(f"method.rbf.greedy_start = {o.greedy_start}; expected 0 to {n - 1}")
        search = Search(o.greedy_tolerance, o.greedy_start, o.greedy_updates or n, o.greedy_max_points or n)
        points = self.centres.points, self.centres.polynomial(self.centres.points)
        report = of_stage(progress, "greedy")
        return self.problem.grid.nodes.on_first(lambda: select(BASES[o.basis], *points, values, scale, search, report))

    def _record(self, found: Selection) -> None:
        unit = "first-cell heights" if self.options.greedy_error == "first-cell" else "length unit"
        self.account.settings |= {
            "greedy": Setting(self.options.greedy),
            "greedy_points": Setting(len(found.active), f"of {len(found.error)} centres"),
            "greedy_rounds": Setting(found.rounds),
            "greedy_updates_done": Setting(found.updates),
            "greedy_tolerance": Setting(self.options.greedy_tolerance, unit),
            "greedy_error_reached": Setting(float(found.error.max()), unit),
        }
        failed = (
            f"greedy reduction stopped with {len(found.active)} points and an error of {found.error.max():.3g} "
            f"({unit}); asked for {self.options.greedy_tolerance:g}. Raise greedy_max_points or greedy_tolerance"
        )
        self.account.note("greedy", None if found.converged else failed)

    def linearised(self, evaluator: RadialSums, displacement: FloatArray) -> LinearRBF:
        """The derivative of the displacement of the nodes of ``evaluator``; the same at all displacements."""
        from .radial_system import RadialSystem
        from .rbf_sums import LinearRBF

        problem, reduces = self.problem, self.options.greedy != "none"
        system = RadialSystem.accurate(self.options, self.centres, problem.memory, problem.grid.nodes.ranks)
        return LinearRBF(system, problem.grid, evaluator.flat, self.images, Kinks({CHOSEN: 1} if reduces else {}))

    def at(self, flat: IntArray) -> RadialSums:
        """Bind to the target nodes ``flat``."""
        from .rbf_sums import RadialSums

        sums = RadialSums(self.problem.grid, flat, self.centres, self.options, self.account)
        if self.options.greedy == "none":
            sums.prepare(len(self.centres.points))
        return sums
