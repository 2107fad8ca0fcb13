"""Fast IDW sums over clusters of sources."""

from __future__ import annotations

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.fastsum.clusters import build_tree
from ...numerics.fastsum.targets import interpolation_order, make_targets
from ...numerics.fastsum.tuned import SHARE, SINGLE_TOLERANCE
from ...numerics.fastsum.weighted import Accuracy, FastSums, Scaled
from ...parallel import Nodes
from ..base import Account, Progress, of_stage
from .idw_sums import Bound, SourceValues, Weights
from .summation import DERIVATIVE_TOLERANCE, largest_error, sum_accurately

_ORDER = 5
"""Interpolation points per side in derivatives; among 4 to 7, the fastest on the hemisphere."""
_PER_POINT = 4
"""Nodes of a brick per interpolation point in derivatives; twice as many, as the method itself has, take a quarter
longer."""


class FastEvaluator:
    """Fast sums: clusters of sources evaluated at bricks of targets, checked against exact sums at the worst nodes."""

    def __init__(self, bound: Bound, tolerance: float, account: Account):
        self.bound = bound
        self._tolerance, self._account = tolerance, account
        grid, order = bound.grid, interpolation_order(tolerance)
        grid.hold_neighbours()
        trees = [build_tree(bound.sources[group], order) for group in bound.groups]
        targets = make_targets(bound.points, grid.shapes, grid.offsets, bound.flat, order)
        self.sums = FastSums(bound.strength, bound.groups, trees, targets, bound.room)
        self.restart()

    def restart(self) -> None:
        """Return to the initial accuracy, with which the first sum of every displacement is taken."""
        self._share = SHARE / (interpolation_order(self._tolerance) - 2) ** 2
        self._single = self._tolerance >= SINGLE_TOLERANCE

    def refine(self, excess: float) -> None:
        """Raise the accuracy of all sums until :meth:`restart`, as the error was ``excess`` times too large; then they
        are in double precision."""
        self._share, self._single = self._share * 0.25 / excess, False

    def evaluate(self, fit: SourceValues, out: FloatArray, progress: Progress | None) -> None:
        """Write the displacement of the targets into ``out`` (n_nodes, 3)."""
        bound, sums, rows = self.bound, self.sums, Nodes.of(out).rows
        scaled = Scaled.of(fit.values, fit.still, sums.strength)
        moving, lasting = scaled.moving, 1 if fit.transition.width else 0

        def use_sums(_: slice, flat: IntArray, values: FloatArray) -> None:
            rows[flat] = bound.displacement(fit, flat, np.ascontiguousarray(values.T))

        def once() -> float:
            accuracy = Accuracy(self._tolerance * self._share, True, self._single)
            sums.prepare(fit.weights, fit.shift, fit.turn, moving, accuracy, lasting)
            sums.apply(scaled, use_sums, progress=of_stage(progress, "idw"))
            return largest_error(bound.grid, sums.targets, sums.risk, rows, lambda flat: bound.exact(fit, flat))

        sum_accurately("idw", self, once, self._tolerance, self._account)


def fast_sums(bound: Bound, weights: Weights, acting: BoolArray, share: float) -> FastSums:
    """Sums for derivatives, whose accuracy is relative to the largest change of a value, whatever the displacement;
    each cluster is allowed the error ``share``, relative to that allowed to the sum."""
    # Clusters of acting sources alone, as few sources act.
    parts = [
        (some, each)
        for group, each in zip(bound.groups, weights, strict=True)
        for some in (group[acting[group]], group[~acting[group]])
        if some.size
    ]
    grid, groups = bound.grid, [group for group, _ in parts]
    trees = [build_tree(bound.sources[group], _ORDER) for group in groups]
    targets = make_targets(bound.points, grid.shapes, grid.offsets, bound.flat, _ORDER, _PER_POINT)
    found = FastSums(bound.strength, groups, trees, targets, 2 * targets.every.nbytes)
    # Bounds are rounded up to powers of four: that of one half is one.
    shift, turn = np.where(acting, 0.5, 0.0), np.zeros(len(acting))
    accuracy = Accuracy(DERIVATIVE_TOLERANCE * share, False, False)
    found.prepare([each for _, each in parts], shift, turn, acting, accuracy)
    return found
