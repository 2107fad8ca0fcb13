"""Fast IDW sums over clusters of sources; ``method`` is a :class:`.idw.PreparedIDW`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.arrays import Report
from ...numerics.fastsum.clusters import build_tree
from ...numerics.fastsum.targets import interpolation_order, make_targets
from ...numerics.fastsum.tuned import SHARE, SINGLE_TOLERANCE
from ...numerics.fastsum.weighted import Accuracy, FastSums, Scaled
from ...parallel import Nodes
from .idw_sums import ExactSums, SourceValues, Use, Weights
from .summation import DERIVATIVE_TOLERANCE, largest_error, sum_accurately

CHECKED = 64
"""Nodes per chunk when fast sums are compared with exact ones."""
# Fraction of the remaining memory for data kept between displacements.
_KEPT = 2
_ORDER = 5
"""Interpolation points per side in derivatives; among 4 to 7, the fastest on the hemisphere."""
_PER_POINT = 4
"""Nodes of a brick per interpolation point in derivatives; twice as many, as the method itself has, take a quarter
longer."""


def fast_sums(method: Any) -> FastSums:
    """Sums over clusters of a method's sources at bricks of its targets."""
    method.problem.grid.hold_neighbours()
    order = interpolation_order(method.options.summation_tolerance)
    return _sums(method, method.groups, order, method.problem.memory.size // _KEPT)


def _sums(method: Any, groups: Sequence[IntArray], order: int, room: int, *per: int) -> FastSums:
    grid = method.problem.grid
    trees = [build_tree(method.images.points[group], order) for group in groups]
    targets = make_targets(grid.nodes.rows, grid.shapes, grid.offsets, method.flat, order, *per)
    return FastSums(method.strength, groups, trees, targets, room)


def apply_fast(
    method: Any, sums: FastSums, fit: SourceValues, use: Use, out: FloatArray, progress: Report | None
) -> None:
    """Call ``use`` with the sums at all targets, which writes their displacements into ``out`` (n_nodes, 3), compared
    with exact sums at the worst nodes."""
    tolerance, grid = method.options.summation_tolerance, method.problem.grid
    scaled, lasting = Scaled.of(fit.values, fit.still, sums.strength), 1 if fit.transition.width else 0
    moving, found = scaled.moving, Nodes.of(out).rows
    share, single = SHARE / (interpolation_order(tolerance) - 2) ** 2, tolerance >= SINGLE_TOLERANCE

    def exact(flat: IntArray) -> FloatArray:
        return method.displacement(fit, flat, ExactSums(method, fit.weights).at(flat, fit.values, chunk=CHECKED).T)

    def once(excess: float) -> float:
        nonlocal share, single
        if excess:
            # In double precision from now on.
            share, single = share * 0.25 / excess, False
        accuracy = Accuracy(tolerance * share, True, single)
        sums.prepare(fit.weights, fit.shift, fit.turn, moving, accuracy, lasting)
        sums.apply(scaled, use, progress=progress)
        return largest_error(grid, sums.targets, sums.risk, found, exact)

    sum_accurately("idw", once, tolerance, method.account)


def sums_of_changes(method: Any, weights: Weights, acting: BoolArray, share: float) -> FastSums:
    """Sums for derivatives, whose accuracy is relative to the largest change of a value, whatever the displacement;
    each cluster is allowed the error ``share``, relative to that allowed to the sum."""
    # Clusters of acting sources alone, as few sources act.
    parts = [
        (some, each)
        for group, each in zip(method.groups, weights, strict=True)
        for some in (group[acting[group]], group[~acting[group]])
        if some.size
    ]
    found = _sums(method, [group for group, _ in parts], _ORDER, 2 * method.flat.nbytes, _PER_POINT)
    # Bounds are rounded up to powers of four: that of one half is one.
    shift, turn = np.where(acting, 0.5, 0.0), np.zeros(len(acting))
    accuracy = Accuracy(DERIVATIVE_TOLERANCE * share, False, False)
    found.prepare([each for _, each in parts], shift, turn, acting, accuracy)
    return found
