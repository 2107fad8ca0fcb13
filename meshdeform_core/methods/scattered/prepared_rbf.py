"""Radial basis functions bound to a grid: solved at the sources, summed at the nodes, exactly or fast with clusters of
centres, and differentiated."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import scipy

from ...boundary import Kind
from ...errors import MethodError
from ...grid import FloatArray, IntArray
from ...numerics.arrays import Report
from ...numerics.exact.basis import BASES
from ...numerics.exact.radial import radial_sums
from ...numerics.fastsum.radial import FastRadial, RadialTargets, make_radial_targets
from ...numerics.systems.saddle import Search, select
from ...parallel import Nodes, for_chunks, thread_count
from ..base import Account, Kinks, Linearised, Problem, Progress, Setting, of_stage
from ..limits import CHOSEN, warn_of_coarse_tolerance, warn_of_radius
from .images import mirror_images
from .radial_system import Centres, Coefficients, RadialSystem, accurate
from .summation import fast_pays, largest_error, sum_accurately

# Nodes per chunk of exact sums, and in derivatives.
_CHUNK, _ROWS = 1024, 1 << 16
_REACH = 20.0
"""Distance from a wall over which nodes are corrected by the residual of a greedy reduction there, as a multiple of the
residual; large enough that the correction cannot fold cells."""


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
            names = ("error", "tolerance", "start", "updates", "max_points", "correct")
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
        n = len(values)
        if o.greedy_start >= n:
            raise MethodError(f"method.rbf.greedy_start = {o.greedy_start}; expected 0 to {n - 1}")
        scale = self.problem.first_cell_height[self.images.owner] if o.greedy_error == "first-cell" else np.ones(n)
        search = Search(o.greedy_tolerance, o.greedy_start, o.greedy_updates or n, o.greedy_max_points or n)
        terms, report = self.centres.polynomial(here), of_stage(progress, "greedy")
        choose = partial(select, self.kind, here, terms, values, scale, search, report)
        found = self.problem.grid.nodes.on_first(choose)
        unit = "first-cell heights" if o.greedy_error == "first-cell" else "length unit"
        self.account.settings |= {
            "greedy": Setting(o.greedy),
            "greedy_points": Setting(len(found.active), f"of {len(found.error)} centres"),
            "greedy_rounds": Setting(found.rounds),
            "greedy_updates_done": Setting(found.updates),
            "greedy_tolerance": Setting(o.greedy_tolerance, unit),
            "greedy_error_reached": Setting(float(found.error.max()), unit),
        }
        failed = (
            f"greedy reduction stopped with {len(found.active)} points and an error of {found.error.max():.3g} "
            f"({unit}); asked for {o.greedy_tolerance:g}. Raise greedy_max_points or greedy_tolerance"
        )
        self.account.note("greedy", None if found.converged else failed)
        points = np.ascontiguousarray(here[found.active])
        residual = values - radial_sums(self.kind, here, points, found.coefficients)
        residual -= terms[:, : len(found.polynomial)] @ found.polynomial
        reach = _REACH * float(np.linalg.norm(residual, axis=1).max())
        return Coefficients(points, found.coefficients, found.polynomial, residual, reach)

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
            assert self._targets is not None
            targets = self._targets
            if self._tree is None or not np.array_equal(self._tree[0], fit.centres):
                self._tree = fit.centres, FastRadial(self.kind, fit.centres)
            sums = self._tree[1]

            def use(flat: IntArray, found: FloatArray) -> None:
                rows[flat] = found + self.centres.drift(targets.points[flat], fit.polynomial)

            def once(excess: float) -> float:
                if excess:
                    sums.refine(excess)
                else:
                    sums.restart()
                sums.prepare(fit.coefficients, targets, tolerance)
                risk = sums.apply(use, progress=report)
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
