"""Fast weighted sums as one object: trees, bricks and accuracy of one undeformed grid (see :mod:`.treesum`)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ....parallel import Shared, for_chunks
from ...arrays import BoolArray, FloatArray, IntArray, Report, weighted_total
from ...exact.direct import N_VALUES
from ..clusters.acceptance import Kernel, inverse_powers
from ..clusters.targets import Targets, interpolation_order
from ..clusters.tree import SourceTree
from ..tuned import SHARE, SINGLE_TOLERANCE
from .plan import Plan, PlanKey, rounded_up
from .treesum import Charges, add_totals, charge_rows, cluster_reach, gather
from .walk import Reach

CHUNK = 2
"""Regions per call, if they are no smaller than usual."""
_TARGETS = 4096
"""Targets per call of small regions, about: those of small blocks."""
_TOGETHER = 50_000
"""Sources whose charges are computed at a time, which bounds the memory."""
# Plans that are kept: a motion that swings passes between two sizes.
_PLANS = 2


Use = Callable[[IntArray, FloatArray], object]


class Summands(NamedTuple):
    """What is summed at one displacement.

    Attributes
    ----------
    weights : (a, b, kappa) per group of sources
    values : (k, n) per source
    shift, turn : (n,) displacement and rotation angle (radians) of each source, for error bounds
    still : (k,) values of the sources that do not move, if there are any
    lasting : number of trailing rows of ``values`` that never change; their sums are stored with the weights
    """

    weights: Sequence[tuple[float, float, float]]
    values: FloatArray
    shift: FloatArray
    turn: FloatArray
    still: FloatArray | None = None
    lasting: int = 0


@dataclass(frozen=True)
class Scaled:
    """Values scaled to the order of one: (value - middle) / spread, computed for some sources at a time.

    Attributes
    ----------
    values : (k, n) of the sources
    middle : (k,) the value of the sources that do not move or a mean of all
    spread : (k,) largest difference from it, 1 where there is none
    """

    values: FloatArray
    middle: FloatArray
    spread: FloatArray

    @classmethod
    def of(cls, summands: Summands, strength: FloatArray) -> Scaled:
        """The values of summands."""
        values = summands.values
        middle = weighted_total(strength, values.T) / strength.sum() if summands.still is None else summands.still
        spread = np.array([np.abs(row - offset).max() for row, offset in zip(values, middle, strict=True)])
        spread[spread == 0.0] = 1.0
        return cls(values, middle, spread)

    def part(self, which: slice, sources: slice | IntArray) -> FloatArray:
        """The values ``which`` of some sources, (m, s)."""
        rest: FloatArray = self.values[which][:, sources] - self.middle[which, None]
        rest /= self.spread[which, None]
        return rest

    @property
    def moving(self) -> BoolArray:
        """(n,) sources with any value other than the middle."""
        found = np.empty(self.values.shape[1], dtype=bool)
        for lo in range(0, len(found), _TOGETHER):
            some = slice(lo, lo + _TOGETHER)
            found[some] = (self.part(slice(None), some) != 0.0).any(axis=0)
        return found


class FastSums:
    """Weighted sums over groups of sources, with an error that is small relative to the cells at each target.

    Which clusters act where, and the weight of every target, are stored for all displacements with the same
    :class:`.plan.PlanKey`. Once the weights are known, only sources that move are summed; as these are always summed
    separately from the others, results are the same to the last bit.

    Parameters
    ----------
    strength : (n,) per source
    groups : index arrays, the sources of each weight function
    trees : source tree of each group, from :func:`..clusters.tree.build_tree`, of the order that the tolerance requires
    targets : from :func:`..clusters.targets.make_targets`
    tolerance : error of the weighted mean displacement relative to the local cell size
    room : limit in bytes for stored lists and weights; results do not depend on it

    Attributes
    ----------
    share : error allowed to one cluster; once :meth:`refine` has reduced it, sums are in double precision
    """

    def __init__(
        self,
        strength: FloatArray,
        groups: Sequence[IntArray],
        trees: Sequence[SourceTree],
        targets: Targets,
        tolerance: float,
        room: int,
    ) -> None:
        self._strength, self.targets = strength / strength.max(), targets
        self.tolerance = tolerance
        self._groups = [(np.asarray(group), tree) for group, tree in zip(groups, trees, strict=True)]
        self._room = room
        self._plans: list[Plan] = []
        self.restart()

    def restart(self) -> None:
        """Return to the initial accuracy, with which the first sum of every displacement is taken."""
        self.share = self._first_share = SHARE / (interpolation_order(self.tolerance) - 2) ** 2

    def refine(self, excess: float) -> None:
        """Raise the accuracy of all sums until :meth:`restart`, as the error was ``excess`` times too large."""
        self.share *= 0.25 / excess

    def evaluate(self, summands: Summands, use: Use, result: FloatArray, progress: Report | None = None) -> FloatArray:
        """Compute the sums brick by brick and call ``use`` with those of each chunk.

        Parameters
        ----------
        use : called with flat indices (m,) and sums (m, 1 + k), the weight first, from several threads
        result : (n_nodes, ...) array of which ``use`` fills these rows

        Returns
        -------
        risk : (b,) bound of each brick's error, in arbitrary units
        """
        targets, k, lasting = self.targets, len(summands.values), summands.lasting
        scaled = Scaled.of(summands, self._strength)
        chunk = max(CHUNK, _TARGETS * targets.n_regions // max(len(targets.every), 1))
        plan = self._planned(summands, scaled.moving)
        plan.survey(chunk)
        weight = plan.weight if plan.weighed else None
        # Sums of values that never change are known once the weights are.
        end = k if weight is None else k - lasting
        passes = [
            self._charges(scaled, slice(first, min(first + N_VALUES, end)), plan, weight is None and first == 0)
            for first in range(0, k, N_VALUES)
        ]
        middle, spread = scaled.middle, scaled.spread

        def work(lo: int, hi: int) -> None:
            flat, here = targets.flat(lo, hi), targets.places(lo, hi)
            sums = np.empty((len(flat), 1 + k))
            for number, part in enumerate(plan.sums(lo, hi, passes, weight is None)):
                if number == 0:
                    sums[:, 0] = part[:, 0] if weight is None else weight[here, 0]
                columns = slice(number * N_VALUES, min(k, (number + 1) * N_VALUES))
                some = sums[:, 1 + columns.start : 1 + columns.stop]
                np.multiply(part[:, 1 : 1 + some.shape[1]], spread[columns], out=some)
                if middle.any():
                    some += sums[:, :1] * middle[columns]
            if plan.weight is not None:
                one, other = (sums, plan.weight[here]) if weight is not None else (plan.weight[here], sums)
                _copy_lasting(one, other, lasting)
            use(flat, sums)

        for_chunks(work, targets.n_regions, chunk, progress, [Shared(result, targets.flat)])
        plan.weighed = plan.weight is not None
        return plan.risk

    def _reaches(self, shift: FloatArray, turn: FloatArray) -> list[Reach]:
        """Bounds, rounded up, of the effect of each group's clusters."""
        found = [cluster_reach(tree, self._strength[g], shift[g], turn[g]) for g, tree in self._groups]
        shifts, turns = (rounded_up([getattr(each, name) for each in found]) for name in ("shift", "turn"))
        return [Reach(each.strength, *bounds) for each, *bounds in zip(found, shifts, turns, strict=True)]

    def _planned(self, summands: Summands, moving: BoolArray) -> Plan:
        """The plan for these weights and motions: a stored one or a new one."""
        single = self.tolerance >= SINGLE_TOLERANCE and self.share == self._first_share
        kinds = [
            inverse_powers(a, b, kappa, single and a in (3.0, 4.0) and b == 5.0) for a, b, kappa in summands.weights
        ]
        reaches = self._reaches(summands.shift, summands.turn)
        key = PlanKey(kinds, reaches, moving, self.share, summands.lasting)
        plan = next((each for each in self._plans if each.key.agrees(key)), None)
        others = [each for each in self._plans if each is not plan]
        if plan is None:
            del others[_PLANS - 1 :]
            self._plans = others
            trees = [tree for _, tree in self._groups]
            allowed = allowance(self.targets, trees, kinds, reaches, self.tolerance * self.share)
            plan = Plan(key, self.targets, self._groups, *allowed, self._room // _PLANS)
        self._plans = [plan, *others]
        return plan

    def _charges(self, scaled: Scaled, which: slice, plan: Plan, weighing: bool) -> list[Charges]:
        """Charges of one pass, per group: of the values ``which``; ``weighing`` includes the strength itself, whose sum
        is the weight."""
        charges = []
        for (group, tree), used, direct in zip(self._groups, plan.used, plan.direct, strict=True):
            (rows, start), members = charge_rows(tree, used), group[tree.order]
            for lo in range(0, len(members), _TOGETHER):
                some = members[lo : lo + _TOGETHER]
                source = rows[lo : lo + len(some), 3:]
                if weighing:
                    source[:, 0] = self._strength[some]
                values = self._strength[some] * scaled.part(which, some)
                source[:, 1 : 1 + len(values)] = values.T
            charges.append(gather(tree, rows, start).of_sources(tree, direct))
        return charges


def allowance(
    targets: Targets, trees: Sequence[SourceTree], kinds: list[Kernel], reaches: list[Reach], tolerance: float
) -> tuple[FloatArray, FloatArray]:
    """Weighted displacement error that one cluster may cause in each brick, and the mean displacement there.

    ``tolerance`` is that of one cluster, relative to the cell sizes at the targets.
    """
    points, samples = targets.points, targets.samples
    total, moved = np.zeros(samples.shape), np.zeros(samples.shape)

    def work(lo: int, hi: int) -> None:
        at = points[samples[lo:hi].ravel()]
        for tree, reach, kind in zip(trees, reaches, kinds, strict=True):
            add_totals(at, tree, reach, kind, total[lo:hi].reshape(-1), moved[lo:hi].reshape(-1))

    for_chunks(work, len(samples), 64, shared=[Shared(total), Shared(moved)])
    return (total * targets.sizes).min(axis=1) * tolerance, (moved / total).max(axis=1)


def _copy_lasting(one: FloatArray, other: FloatArray, lasting: int) -> None:
    """Copy weights (m, 0) and the last columns, which stay as they are, from ``other`` sums."""
    one[:, 0] = other[:, 0]
    one[:, one.shape[1] - lasting :] = other[:, other.shape[1] - lasting :]
