"""Fast IDW sums over clusters of sources; ``method`` is a :class:`.idw.PreparedIDW`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ...grid import FloatArray, IntArray
from ...numerics.arrays import Report, weighted_total
from ...numerics.fastsum.clusters import build_tree
from ...numerics.fastsum.targets import interpolation_order, make_targets
from ...numerics.fastsum.tuned import SHARE, SINGLE_TOLERANCE
from ...numerics.fastsum.weighted import Accuracy, FastSums
from ...parallel import Nodes
from .idw_sums import ExactSums, SourceValues, Use
from .summation import largest_error, sum_accurately

CHECKED = 64
"""Nodes per chunk when fast sums are compared with exact ones."""
# Fraction of the remaining memory for data kept between displacements.
_KEPT = 2


def fast_sums(method: Any) -> FastSums:
    """Sums over clusters of a method's sources at bricks of its targets."""
    method.problem.grid.hold_neighbours()
    order = interpolation_order(method.options.summation_tolerance)
    return sums_of_groups(method, method.groups, order, method.problem.memory.size // _KEPT)


def sums_of_groups(method: Any, groups: Sequence[IntArray], order: int, room: int, *per_point: int) -> FastSums:
    """Sums over clusters of groups of sources; arguments as of ``FastSums`` and ``make_targets``."""
    grid = method.problem.grid
    trees = [build_tree(method.images.points[group], order) for group in groups]
    targets = make_targets(grid.nodes.rows, grid.shapes, grid.offsets, method.flat, order, *per_point)
    return FastSums(method.strength, groups, trees, targets, room)


def apply_fast(
    method: Any, sums: FastSums, fit: SourceValues, use: Use, out: FloatArray, progress: Report | None
) -> None:
    """Call ``use`` with the sums at all targets, which writes their displacements into ``out`` (n_nodes, 3), compared
    with exact sums at the worst nodes."""
    tolerance, grid = method.options.summation_tolerance, method.problem.grid
    lasting, found = 1 if fit.transition.width else 0, Nodes.of(out).rows
    mean = weighted_total(sums.strength, fit.values.T) / sums.strength.sum()
    middle = mean if fit.still is None else fit.still
    moving = (fit.values != middle[:, None]).any(axis=0)
    share, single = SHARE / (interpolation_order(tolerance) - 2) ** 2, tolerance >= SINGLE_TOLERANCE

    def exact(flat: IntArray) -> FloatArray:
        # Sources that do not move are summed once.
        plan, apart = sums.plans[0], fit.values - middle[:, None]
        weigh = not plan.checked.size
        found = ExactSums(method, fit.weights, moving).at(flat, apart, weigh, CHECKED)
        if weigh:
            plan.checked = found[:, 0].copy()
        found[:, 0] = plan.checked
        found[:, 1:] += found[:, :1] * middle
        return method.displacement(fit, flat, found.T)

    def once(excess: float) -> float:
        nonlocal share, single
        if excess:
            # In double precision from now on.
            share, single = share * 0.25 / excess, False
        accuracy = Accuracy(tolerance * share, True, single)
        sums.prepare(fit.weights, fit.shift, fit.turn, moving, accuracy, lasting)
        sums.apply(fit.values, use, progress=progress, middle=middle)
        return largest_error(grid, sums.targets, sums.risk, found, exact)

    sum_accurately("idw", once, tolerance, method.account)
