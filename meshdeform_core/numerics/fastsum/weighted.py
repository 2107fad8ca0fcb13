"""Fast weighted sums between clusters of sources and bricks of target nodes, and their transposes.

:mod:`.walk` lists which clusters act on the interpolation points of a region of bricks, on those of a brick and on its
nodes. Here these lists are evaluated; results are interpolated from a region to its bricks and from these to the nodes.

Numerator and denominator of a weighted mean (eq. 14) use the same approximate weights, so its error is the error of the
weights times the *difference* of a cluster's displacement from the mean: a motion common to all sources is exact.

Source: barycentric cluster-cluster treecodes (Wang, Krasny, Tlupova 2020), with two levels of targets and the
acceptance of a weighted mean.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ...parallel import empty, for_chunks
from ..arrays import BoolArray, FloatArray, IntArray, Report
from ..exact.direct import N_VALUES, sum_groups
from .clusters import CHARGES, SourceTree, interpolate
from .plan import Charges, Plan, charge_points, cluster_reach, gather, places_of
from .targets import Targets, spans
from .walk import Kernel

CHUNK = 2
"""Regions per call, if they are no smaller than usual."""
_TARGETS = 4096
"""Targets per call of small regions, about: those of small blocks."""
_TOGETHER = 50_000
"""Sources whose charges are computed at a time, which bounds the memory."""
# Plans that are kept: a motion that swings passes between two sizes.
_PLANS = 2
_MOST_PORTIONS = 64
_SOURCES = 2048

Use = Callable[[slice, IntArray, FloatArray], object]
Make = Callable[[slice, IntArray, int], FloatArray]


class Accuracy(NamedTuple):
    """Accuracy of sums: the error that one cluster may cause, relative to the cell sizes at the targets times the total
    weight, or to the total weight alone if not ``local``; whether weights may be in ``single`` precision."""

    tolerance: float
    local: bool
    single: bool


class FastSums:
    """Sums of weights and of weights times values over groups of sources, at target nodes; linear in the values.

    Which clusters act where, and the weight of every target, are stored for all displacements with the same weight
    functions, accuracy, moving sources and bounds of their motion (:class:`.plan.Plan`). Once the weights are known,
    only sources that move are summed; as these are always summed separately from the others, results are the same to
    the last bit. ``groups`` are the sources of each weight function; each has a tree (:func:`.clusters.build_tree`), of
    the order that the tolerance requires. ``room`` limits the bytes of stored lists and weights; results do not depend
    on it.
    """

    def __init__(
        self, strength: FloatArray, groups: Sequence[IntArray], trees: Sequence[SourceTree], targets: Targets, room: int
    ) -> None:
        self.strength, self.targets = strength / strength.max(), targets
        self._groups = [(np.asarray(group), tree) for group, tree in zip(groups, trees, strict=True)]
        self._room = room
        self.plans: list[Plan] = []
        self._chunk = max(CHUNK, _TARGETS * targets.n_regions // max(len(targets.every), 1))

    @property
    def acting(self) -> BoolArray:
        """Which sources (n,) have values."""
        return self._plan.acting

    @property
    def risk(self) -> FloatArray:
        """Bound (b,) of the error in each brick, in arbitrary units."""
        return self._plan.risk

    @property
    def _plan(self) -> Plan:
        return self.plans[0]

    @property
    def flat(self) -> IntArray:
        """Flat indices (n,) of the nodes at which sums are taken, in the order of their rows."""
        return self.targets.every

    def prepare(
        self,
        weights: Sequence[tuple[float, float, float]],
        shift: FloatArray,
        turn: FloatArray,
        moving: BoolArray,
        accuracy: Accuracy,
        lasting: int | None = None,
    ) -> None:
        """Find which clusters act where, for weights (a, b, kappa) per group and motions, unless it is known.

        ``shift`` and ``turn`` (n,) are the displacement and rotation angle (radians) of each source, for error bounds;
        ``moving`` (n,) are the sources with values other than zero. The sums of the last ``lasting`` values, which
        never change, are stored with the weights, neither if it is ``None``.
        """
        kinds = [Kernel.of(*each, accuracy.single) for each in weights]
        reaches = cluster_reach(self._groups, np.stack([self.strength, shift, turn], axis=1))
        key = kinds, accuracy, lasting, moving.tobytes(), *(each.tobytes() for each in reaches)
        plan = next((each for each in self.plans if each.key == key), None)
        self.plans = [each for each in self.plans if each is not plan][: _PLANS - 1]
        given = self.targets, self._groups, kinds, reaches, moving, accuracy, lasting
        self.plans.insert(0, plan or Plan(key, *given, self._chunk, self._room // _PLANS))

    def apply(
        self, values: FloatArray, use: Use, weigh: bool = True, progress: Report | None = None,
        middle: FloatArray | None = None,
    ) -> None:  # fmt: skip
        """Call ``use`` with sums (m, 1 + k) of values (k, n) for some rows, with these rows and flat indices (m,).

        The first column is the total weight of all sources if ``weigh``, else zero. ``use`` is called from several
        threads. Sums are taken of the differences from ``middle`` (k,), the values of sources that do not move or a
        mean of all, scaled to the order of one.
        """
        plan, targets, k = self._plan, self.targets, len(values)
        offset = np.zeros(k) if middle is None else middle
        spread = np.array([np.abs(row - about).max() for row, about in zip(values, offset, strict=True)])
        spread[spread == 0.0] = 1.0

        def scaled(which: slice, sources: IntArray) -> FloatArray:
            """The values ``which`` of some sources at a time, which bounds the memory."""
            return np.asarray((values[which][:, sources] - offset[which, None]) / spread[which, None])

        known = plan.weight if plan.weighed and weigh else None
        summing = weigh and known is None
        # Sums of values that never change are known once the weights are.
        end = k if known is None else k - plan.lasting
        passes = [
            self._charges(scaled, slice(first, min(first + N_VALUES, end)), plan, summing and first == 0)
            for first in range(0, max(k, 1), N_VALUES)
        ]

        def work(lo: int, hi: int) -> None:
            flat, here = targets.flat(lo, hi), targets.places(lo, hi)
            sums = np.zeros((len(flat), 1 + k))
            for number, part in enumerate(plan.sums(lo, hi, passes, summing)):
                if number == 0 and weigh:
                    sums[:, 0] = part[:, 0] if known is None else known[here, 0]
                columns = slice(number * N_VALUES, min(k, (number + 1) * N_VALUES))
                some = sums[:, 1 + columns.start : 1 + columns.stop]
                np.multiply(part[:, 1 : 1 + some.shape[1]], spread[columns], out=some)
                if offset.any():
                    some += sums[:, :1] * offset[columns]
            if known is not None:
                sums[:, 1 + end :] = known[here, 1:]
            elif plan.weight is not None and weigh:
                stored = plan.weight[here]
                stored[:, 0], stored[:, 1:] = sums[:, 0], sums[:, 1 + k - plan.lasting :]
            use(here, flat, sums)

        for_chunks(work, targets.n_regions, self._chunk, progress)
        plan.weighed = plan.weighed or (weigh and plan.weight is not None)

    @property
    def portions(self) -> int:
        """Number of parts of the targets that :meth:`transpose` sums separately; depends on sizes only."""
        size = CHARGES * sum(
            len(tree.order) + tree.boxes.proxy[-1]
            for (_, tree), moving in zip(self._groups, self._plan.moving, strict=True) if moving.any()
        )  # fmt: skip
        # The sums of all portions together are no larger than a quarter of the coordinates, unless there are two.
        return int(np.clip(3 * len(self.targets.points) // (4 * max(size, 1)), 2, _MOST_PORTIONS))

    def transpose(self, make: Make, k: int) -> FloatArray:
        """Transpose of :meth:`apply`: gradients (k, n_sources) of the values from those (m, k) of their sums.

        ``make(rows, flat, portion)`` returns the gradients of the sums of some rows; it is called from several threads,
        within a portion one call after the other. Charges of groups without moving sources are skipped.
        """
        plan = self._plan
        none = Charges.none()
        points = [
            charge_points(tree, tree.boxes.proxy) if moving.any() else (none.points, none.rows)
            for (_, tree), moving in zip(self._groups, plan.moving, strict=True)
        ]
        ends = np.append(0, np.cumsum([len(x) for x, _ in points]))
        passes, portions, targets = -(-k // N_VALUES), self.portions, self.targets
        # Lists are stored for chunks that begin at multiples of the chunk size.
        cut = np.linspace(0, -(-targets.n_regions // self._chunk), portions + 1).astype(np.int64)
        totals = empty((portions, passes, int(ends[-1]), CHARGES))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                totals[portion] = 0.0
                for chunk in range(cut[portion], cut[portion + 1]):
                    first, last = chunk * self._chunk, min((chunk + 1) * self._chunk, targets.n_regions)
                    gradient = make(targets.places(first, last), targets.flat(first, last), portion)
                    self._spread_gradients(plan, first, last, gradient, points, totals[portion], ends)

        for_chunks(work, portions, 1)
        found = np.zeros((k, len(self.strength)))
        for number in range(passes):
            some = slice(number * N_VALUES, min(k, (number + 1) * N_VALUES))
            for (group, tree), (x, _), lo, hi in zip(self._groups, points, ends[:-1], ends[1:], strict=True):
                if lo < hi:
                    total = np.asarray(sum(totals[portion, number, lo:hi] for portion in range(portions)))
                    _to_sources(tree, x, total)
                    members = group[tree.order]
                    source = total[: len(members), 1 : 1 + some.stop - some.start]
                    found[some, members] = self.strength[members] * source.T
        return np.where(plan.acting, found, 0.0)

    def _spread_gradients(
        self, plan: Plan, first: int, last: int, gradient: FloatArray, points: list[tuple[FloatArray, IntArray]],
        total: FloatArray, ends: IntArray,
    ) -> None:  # fmt: skip
        """Add the contributions of some regions with gradients (m, k) to ``total`` (passes, points, 8)."""
        targets, lists = self.targets, plan.lists_of(first, last)
        places = places_of(first, last, targets)
        filled = np.zeros(len(places.span), dtype=bool)
        for (codes, stop), moving in zip(lists, plan.moving, strict=True):
            count = np.append(0, np.cumsum(moving[codes >> 1]))
            filled |= np.diff(count[np.append(0, stop)]) > 0
        of_regions, of_bricks = places.tasks(filled)
        here = np.empty((len(places.points), CHARGES))
        for number in range(len(total)):
            here[:] = 0.0
            part = gradient[:, number * N_VALUES : (number + 1) * N_VALUES]
            here[: len(part), 1 : 1 + part.shape[1]] = part
            every = bool(here[:, -1].any())
            columns = (0, CHARGES) if every else (1, CHARGES - 1)
            for boxes, tasks in ((targets.bricks, of_bricks), (targets.regions, of_regions)):
                interpolate(boxes, tasks, places.points, here, *columns, True)
            # The transpose of Places.add: from the places of each list, some of which have no points, to the sources
            # and interpolation points of its clusters.
            for (x, rows), (codes, stop), kind, moving, lo, hi in zip(
                points, lists, plan.kinds, plan.moving, ends[:-1], ends[1:], strict=True
            ):
                active = moving[codes >> 1]
                codes, item = codes[active], np.repeat(np.arange(len(stop)), np.diff(stop, prepend=0))
                order = np.argsort(codes, kind="stable")
                found, start = np.unique(codes[order], return_index=True)
                if len(found):
                    pieces = places.span[item[active][order]]
                    sum_groups(x, rows[found], places.points, here, pieces, spans(np.append(start, len(order))),
                               kind.a, kind.b, kind.kappa, every, total[number, lo:hi])  # fmt: skip

    def _charges(
        self, scaled: Callable[[slice, IntArray], FloatArray], which: slice, plan: Plan, weighing: bool
    ) -> list[Charges]:
        """Charges of one pass, per group: of the values ``which``; ``weighing`` includes the strength itself, whose sum
        is the weight."""
        charges = []
        for (group, tree), used, moving in zip(self._groups, plan.used, plan.moving, strict=True):
            if not (weighing or moving.any()):
                charges.append(Charges.none())
                continue
            members = group[tree.order]
            start = np.append(0, np.cumsum(np.where(used, np.diff(tree.boxes.proxy), 0)))
            values = np.zeros((len(members) + start[-1], CHARGES))
            for lo in range(0, len(members), _TOGETHER):
                some = members[lo : lo + _TOGETHER]
                source = values[lo : lo + len(some)]
                if weighing:
                    source[:, 0] = self.strength[some]
                parts = self.strength[some] * scaled(which, some)
                source[:, 1 : 1 + len(parts)] = parts.T
            charges.append(gather(tree, start, values))
        return charges


def _to_sources(tree: SourceTree, points: FloatArray, total: FloatArray) -> None:
    """Transpose of :func:`.plan.gather`: add to the gradients of sources, the first rows of ``total`` (n + m, 8), those
    of the interpolation points of their clusters."""
    n, every = len(tree.order), np.arange(len(tree.child))
    count = np.append(0, np.cumsum(total[n:].any(axis=1)))
    used = count[tree.boxes.proxy[1:]] > count[tree.boxes.proxy[:-1]]

    def work(lo: int, hi: int) -> None:
        low, high = np.maximum(tree.span[:, 0], lo), np.minimum(tree.span[:, 1], hi)
        tasks = np.stack([every, n + tree.boxes.proxy[:-1], low, high], axis=1)[used & (low < high)]
        interpolate(tree.boxes, tasks, points, total, 0, CHARGES, False)

    for_chunks(work, n, _SOURCES)
