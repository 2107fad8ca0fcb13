"""Fast IDW sums over clusters of sources."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.fastsum.clusters.targets import Targets, interpolation_order, make_targets
from ...numerics.fastsum.clusters.tree import build_tree
from ...numerics.fastsum.weighted.sums import FastSums, Summands
from ...numerics.rigid import finish
from ...numerics.rows import put_rows, take_rows
from ...parallel import alike, apart, own_rows, rows_of
from ..base import Account, Progress, of_stage
from .idw_sums import Bound, ExactEvaluator, SourceValues, Weighed
from .summation import largest_error, sum_accurately


class FastEvaluator:
    """Fast sums: clusters of sources evaluated at bricks of targets, checked against exact sums at the worst nodes."""

    def __init__(self, bound: Bound, tolerance: float, account: Account):
        self.bound = bound
        self._tolerance = tolerance
        self._account = account
        bound.grid.hold_neighbours()
        with apart(bound.grid.points):
            self._sums = self._sorted(bound.sources, bound.points)
        self._weighed: Weighed | None = None

    def _sorted(self, sources: FloatArray, points: FloatArray) -> FastSums:
        grid, order = self.bound.grid, interpolation_order(self._tolerance)
        trees = [build_tree(sources[group], order) for group in self.bound.groups]
        targets = make_targets(points, grid.shapes, grid.offsets, self.bound.flat, order)
        if points is not self.bound.points:
            # Accuracy is relative to the undeformed cells, although targets have moved in later steps.
            targets = targets.sized(self.bound.points, grid.shapes, grid.offsets)
        return FastSums(self.bound.strength, self.bound.groups, trees, targets, self._tolerance, self.bound.room)

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""

        def exact(flat: IntArray) -> FloatArray:
            found, self._weighed = ExactEvaluator(self.bound).checked(fit, flat, self._weighed)
            return found

        def once() -> float:
            with apart(out):
                targets, risk = self._sum(fit, rows_of(out), progress)
            return largest_error(self.bound.grid, targets, risk, rows_of(out), exact)

        sum_accurately("idw", self._sums, once, self._tolerance, self._account)

    def _sum(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> tuple[Targets, FloatArray]:
        """Write displacements to ``out``; return the last targets and an error bound for each brick, up to a factor."""
        report = of_stage(progress, "idw")
        bound, sums, points = self.bound, self._sums, self.bound.points
        own = slice(*own_rows(bound.grid.points))
        for step, sources in enumerate(fit.path):
            if step:
                points = rows_of(alike(bound.grid.points))
                points[own] = bound.points[own]
                points[bound.flat] += out[bound.flat] - fit.frame.shift
                sums = self._sorted(sources + fit.origin, points)
                sums.share = self._sums.share

            def use(flat: IntArray, values: FloatArray, points: FloatArray = points, step: int = step) -> None:
                x, moved = np.empty((len(flat), 3)), np.empty((len(flat), 3))
                take_rows(points, flat, x)
                x -= fit.origin
                finish(bound.rotation, values, x, moved, bound.repeats, fit.transition)
                put_rows(moved + out[flat] if step else fit.frame.absolute(x + fit.origin, moved), flat, out)

            lasting = 1 if fit.transition.width else 0
            summands = Summands(fit.weights, fit.values, fit.shift, fit.turn, fit.still, lasting)
            risk = sums.evaluate(summands, use, out, report)
        return sums.targets, np.asarray(risk)
