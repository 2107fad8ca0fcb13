"""Which clusters act where: the lists that all displacements with the same key share."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....parallel import Shared, current_ranks, for_chunks
from ...arrays import BoolArray, FloatArray, IntArray
from ...exact.mixed import Scale
from ..clusters.acceptance import Kernel
from ..clusters.targets import Targets
from ..clusters.tree import CHARGES, SourceTree
from .treesum import Charges, interpolate_sums, places_of, sum_lists
from .walk import Lists, Reach, list_clusters


def rounded_up(bounds: list[FloatArray]) -> list[FloatArray]:
    """One bound for all clusters that move: the largest, rounded up to a power of four; zeros remain.

    Rounding is so coarse that the steps of a growing or oscillating motion share a few bounds.
    """
    most = max(float(each.max(initial=0.0)) for each in bounds)
    common = np.ldexp(1.0, 2 * -(-int(np.frexp(most)[1]) // 2))
    return [np.where(each > 0.0, common, 0.0) for each in bounds]


@dataclass(frozen=True, eq=False)
class PlanKey:
    """Everything that determines which clusters act where, and how their sums are taken.

    Attributes
    ----------
    kinds : weight function of each group
    reaches : bounds of the effect of each group's clusters, rounded up
    moving : (n,) which sources are summed separately from the others
    share : error allowed to one cluster, as a multiple of that allowed to the whole sum
    lasting : number of values per source whose sums are stored with the weights
    """

    kinds: list[Kernel]
    reaches: list[Reach]
    moving: BoolArray
    share: float
    lasting: int

    def agrees(self, other: PlanKey) -> bool:
        """Whether both lead to the same plan."""
        return (
            (self.kinds, self.share, self.lasting) == (other.kinds, other.share, other.lasting)
            and np.array_equal(self.moving, other.moving)
            and all(
                np.array_equal(one, two)
                for mine, its in zip(self.reaches, other.reaches, strict=True)
                for one, two in zip(mine, its, strict=True)
            )
        )


class Plan:
    """The lists of clusters of one :class:`PlanKey`, made on demand and stored while they fit into ``room`` (bytes).

    Weights of targets are stored only with ``weights``; ``scale`` as for :func:`.treesum.sum_lists`.

    Attributes
    ----------
    risk : (b,) bound of each brick's error, in arbitrary units
    moving : for each tree, which clusters (m,) hold sources that move
    weight : (n, 1 + lasting) of every target in the order of the bricks, and its sums of values that never change,
        known once ``weighed``; ``None`` without room
    used, direct : for each tree, whether the interpolation points of a cluster (m,) act anywhere, and whether its
        sources do by themselves, known after :meth:`survey`
    """

    def __init__(
        self,
        key: PlanKey,
        targets: Targets,
        trees: list[tuple[IntArray, SourceTree]],
        allowed: FloatArray,
        mean: FloatArray,
        room: int,
        weights: bool = True,
        scale: Scale | None = None,
    ) -> None:
        self.key, self._targets, self._trees = key, targets, [tree for _, tree in trees]
        self._allowed, self._mean, self._scale = allowed, mean, scale
        self.risk = np.zeros(len(allowed))
        self.moving = [_any_of(tree, key.moving[group]) for group, tree in trees]
        self._kept: dict[int, list[Lists]] = {}
        rows = len(targets.every)
        size = 8 * rows * (1 + key.lasting) if weights else 0
        self.weight = np.empty((rows, 1 + key.lasting)) if weights and size <= room else None
        self.weighed = False
        self._surveyed: tuple[int, int] | None = None
        self.used, self.direct = ([np.zeros(len(tree.child), dtype=bool) for tree in self._trees] for _ in range(2))
        self._room = room - size

    def survey(self, chunk: int) -> None:
        """Make the lists of all regions, ``chunk`` at a time, which tell the clusters whose charges are needed.

        Of several ranks, or beside few targets, these are a part of the clusters. What one rank of several knows is
        not enough where it works alone, so a plan is surveyed again by other ranks.
        """
        ranks, targets = current_ranks(), self._targets
        if self._surveyed != (ranks.number, ranks.count):
            for_chunks(self.lists_of, targets.n_regions, chunk, shared=[Shared(self.risk, targets.numbers)])
            self.weighed, self._surveyed = False, (ranks.number, ranks.count)

    def lists_of(self, first: int, last: int) -> list[Lists]:
        """:class:`.walk.Lists` of each group for the regions first <= g < last; called from several threads."""
        if first in self._kept:
            return self._kept[first]
        targets, key = self._targets, self.key
        self.risk[targets.numbers(first, last)] = 0.0
        where = targets.regions, targets.bricks
        found = [
            list_clusters(first, last, *where, tree, reach, kind, self._allowed, self._mean, self.risk)
            for tree, reach, kind in zip(self._trees, key.reaches, key.kinds, strict=True)
        ]
        for used, direct, lists in zip(self.used, self.direct, found, strict=True):
            for acting, raw in ((used, 0), (direct, 1)):
                acting[lists.codes[lists.codes & 1 == raw] >> 1] = True
        size = sum(lists.codes.nbytes + lists.stop.nbytes for lists in found)
        if size <= self._room:
            self._room -= size
            self._kept[first] = found
        return found

    def sums(self, first: int, last: int, passes: Sequence[Sequence[Charges]], weighing: bool) -> list[FloatArray]:
        """Sums (m, 8) of every pass at the nodes of the regions first <= g < last; called from several threads.

        A pass consists of the charges of each tree. Clusters without moving sources count only in the first pass, when
        ``weighing``, and are summed separately, so the sums of the moving ones are the same to the last bit either way.
        """
        targets, lists = self._targets, self.lists_of(first, last)
        bricks, regions = targets.bricks, targets.regions
        places, found = places_of(first, last, targets.points, bricks, regions), []
        n_nodes = len(targets.flat(first, last))
        for number, charges in enumerate(passes):
            total, filled = np.zeros((len(places.points), CHARGES)), np.zeros(len(places.span), dtype=bool)
            for tree, charge, kind, each, moving in zip(
                self._trees, charges, self.key.kinds, lists, self.moving, strict=True
            ):
                filled |= sum_lists(places, tree, charge, each, kind, moving, self._scale, total)
                if weighing and number == 0:
                    filled |= sum_lists(places, tree, charge, each, kind, ~moving, self._scale, total)
            every = any(charge.all for charge in charges)
            interpolate_sums(first, last, bricks, regions, places, filled, every, total)
            found.append(total[:n_nodes])
        return found


def _any_of(tree: SourceTree, chosen: BoolArray) -> BoolArray:
    """Which clusters (m,) hold any of the ``chosen`` sources (n,)."""
    count = np.append(0, np.cumsum(chosen[tree.order]))
    return np.asarray(count[tree.span[:, 1]] > count[tree.span[:, 0]])
