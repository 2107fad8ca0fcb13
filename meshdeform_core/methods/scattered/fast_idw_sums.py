"""Fast IDW sums over clusters of sources."""

from __future__ import annotations

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.fastsum.clusters.targets import interpolation_order, make_targets
from ...numerics.fastsum.clusters.tree import build_tree
from ...numerics.fastsum.weighted.sums import FastSums, Summands
from ...numerics.rigid import finish
from ...numerics.rows import put_rows, take_rows
from ...parallel import apart, rows_of
from ..base import Account, Progress, of_stage
from .idw_sums import Bound, ExactEvaluator, SourceValues, Weighed
from .summation import largest_error, sum_accurately


class FastEvaluator:
    """Fast sums: clusters of sources evaluated at bricks of targets, checked against exact sums at the worst nodes."""

    def __init__(self, bound: Bound, tolerance: float, account: Account):
        self.bound = bound
        self._tolerance = tolerance
        self._account = account
        grid, order = bound.grid, interpolation_order(tolerance)
        grid.hold_neighbours()
        with apart(grid.points):
            trees = [build_tree(bound.sources[group], order) for group in bound.groups]
            self._targets = make_targets(bound.points, grid.shapes, grid.offsets, bound.flat, order)
            self._sums = FastSums(bound.strength, bound.groups, trees, self._targets, tolerance, bound.room)
        self._weighed: Weighed | None = None

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""
        bound, rows, lasting = self.bound, rows_of(out), 1 if fit.transition.width else 0
        summands = Summands(fit.weights, fit.values, fit.shift, fit.turn, fit.still, lasting)

        def use(flat: IntArray, values: FloatArray) -> None:
            x, moved = np.empty((len(flat), 3)), np.empty((len(flat), 3))
            take_rows(bound.points, flat, x)
            x -= fit.origin
            finish(bound.rotation, values, x, moved, bound.repeats, fit.transition)
            put_rows(fit.frame.absolute(x + fit.origin, moved), flat, rows)

        def exact(flat: IntArray) -> FloatArray:
            found, self._weighed = ExactEvaluator(bound).checked(fit, flat, self._weighed)
            return found

        def once() -> float:
            with apart(out):
                risk = self._sums.evaluate(summands, use, rows, of_stage(progress, "idw"))
            return largest_error(bound.grid, self._targets, risk, rows, exact)

        sum_accurately("idw", self._sums, once, self._tolerance, self._account)
