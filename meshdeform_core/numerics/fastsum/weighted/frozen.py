"""Fast weighted sums as a linear map of the values, with its transpose; clusters, orders and lists are fixed.

For derivatives: the accuracy is relative to the largest change of a value, whatever the displacement. Both directions
use the same weights (to the last bit, or to double precision) and add products in double precision, so they are
transposes of each other to round-off.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from ....parallel import Ranks, Shared, empty, for_chunks
from ...arrays import BoolArray, FloatArray, IntArray
from ...exact.direct import N_VALUES
from ...exact.mixed import scale_of
from ..clusters.acceptance import inverse_powers
from ..clusters.targets import Targets, sample_places
from ..clusters.tree import CHARGES, SourceTree, interpolation_points
from .plan import Plan, PlanKey
from .sums import CHUNK, allowance
from .transposed import collect_sums, filled_by, spread_charges, spread_lists, used_clusters
from .treesum import Charges, charge_rows, cluster_reach, gather, places_of

Use = Callable[[slice, IntArray, FloatArray], object]
Make = Callable[[slice, IntArray, int], FloatArray]

_MOST_PORTIONS = 64
_SOURCES = 2048
# Charges of groups that do not act.
_NONE = Charges(np.empty((0, 3 + CHARGES)), np.empty(0, dtype=np.int64), np.empty((0, 2), dtype=np.int64), False)


class Accuracy(NamedTuple):
    """Accuracy of sums.

    Attributes
    ----------
    tolerance : error of a sum of unit values relative to the total weight
    share : error allowed to one cluster, as a multiple of that allowed to the sum
    single : whether weights may be in single precision where there is such a loop; sums that overflow it are not finite
    ranks : that sum at their own targets, with the same rounding in single precision
    """

    tolerance: float
    share: float
    single: bool
    ranks: Ranks


class FrozenSums:
    """Sums of weights times values over groups of sources; values are zero except at ``acting`` (n,) sources.

    Parameters
    ----------
    groups, trees, targets : as for :class:`.sums.FastSums`; sources that act and others in groups of their own
    strength : (n,) per source, weights : (a, b, kappa) per group

    Attributes
    ----------
    portions : number of parts of the targets that :meth:`pull` sums separately; depends on sizes only
    """

    def __init__(
        self,
        groups: Sequence[IntArray],
        trees: Sequence[SourceTree],
        targets: Targets,
        strength: FloatArray,
        weights: Sequence[tuple[float, float, float]],
        acting: BoolArray,
        accuracy: Accuracy,
    ) -> None:
        self._groups = [(np.asarray(group), tree) for group, tree in zip(groups, trees, strict=True)]
        self._targets, self._strength, self.acting = targets, strength / strength.max(), acting
        kinds = [inverse_powers(*each) for each in weights]
        unit, still = np.where(acting, 1.0, 0.0), np.zeros(len(strength))
        reaches = [cluster_reach(tree, self._strength[g], unit[g], still[g]) for g, tree in self._groups]
        alike = targets._replace(sizes=np.ones_like(targets.sizes))
        allowed, mean = allowance(alike, trees, kinds, reaches, accuracy.tolerance * accuracy.share)
        whole = all(kind.a in (3.0, 4.0) and kind.b == 5.0 for kind in kinds)
        every = [targets.bricks.boxes.proxies, targets.regions.boxes.proxies]
        both = [np.concatenate([tree.points, interpolation_points(tree, tree.boxes.proxy)]) for tree in trees]
        boxes = [np.stack([each.min(axis=0), each.max(axis=0)]) for each in (*every, *both) if len(each)]
        self._scale = scale_of(accuracy.ranks.gather(boxes)) if accuracy.single and whole else None
        key, room = PlanKey(kinds, reaches, acting, accuracy.share, 0), targets.every.nbytes
        self._plan = Plan(key, targets, self._groups, allowed, mean, room, weights=False, scale=self._scale)
        # The transpose skips groups that do not act.
        self._points = [
            points if moving.any() else np.empty((0, 3)) for points, moving in zip(both, self._plan.moving, strict=True)
        ]
        size = CHARGES * sum(map(len, self._points))
        # The sums of all portions together are no larger than a quarter of the coordinates, unless there are two.
        self.portions = int(np.clip(3 * len(targets.points) // (4 * size), 2, _MOST_PORTIONS))

    @property
    def flat(self) -> IntArray:
        """Flat indices (n,) of the nodes at which sums are taken, in the order of their rows."""
        return self._targets.every

    @property
    def risk(self) -> FloatArray:
        """Bound (b,) of the error in each brick, in arbitrary units; known after :meth:`push` with ``weigh``."""
        return self._plan.risk

    @property
    def samples(self) -> IntArray:
        """Rows (b, 9) spread over the nodes of each brick."""
        return sample_places(self._targets.bricks.start)

    @property
    def every(self) -> IntArray:
        """All rows."""
        return np.arange(len(self._targets.every))

    def push(
        self,
        values: FloatArray,
        use: Use,
        result: FloatArray | None = None,
        kept: Sequence[FloatArray] = (),
        weigh: bool = False,
    ) -> None:
        """Call ``use`` with sums (m, 1 + k) of values (k, n) for some rows, with these rows and flat indices (m,).

        The first column is the total weight of all sources if ``weigh``, else zero. ``use`` is called from several
        threads and fills the nodes of ``result`` (n_nodes, ...) and the rows of the arrays ``kept`` (n, ...).
        """
        k, targets = len(values), self._targets
        passes = [self._charges(values[n : n + N_VALUES], weigh and n == 0) for n in range(0, k, N_VALUES)]

        def work(lo: int, hi: int) -> None:
            parts = self._plan.sums(lo, hi, passes, weigh)
            columns = [part[:, 1 : 1 + k - n] for n, part in zip(range(0, k, N_VALUES), parts, strict=True)]
            use(targets.places(lo, hi), targets.flat(lo, hi), np.concatenate([parts[0][:, :1], *columns], axis=1))

        def rows_of(lo: int, hi: int) -> range:
            return range(targets.places(lo, hi).start, targets.places(lo, hi).stop)

        shared = [Shared(each, rows_of) for each in kept]
        shared += [Shared(self._plan.risk, targets.numbers)] if weigh else []
        shared += [] if result is None else [Shared(result, targets.flat)]
        for_chunks(work, targets.n_regions, CHUNK, shared=shared)

    def pull(self, make: Make, k: int, beside: FloatArray) -> FloatArray:
        """Transpose of :meth:`push`: gradients (k, n_sources) of the values from those (m, k) of their sums.

        ``make(rows, flat, portion)`` returns the gradients of the sums of some rows; it is called from several threads,
        within a portion one call after the other.
        """
        sizes = np.append(0, np.cumsum([len(points) for points in self._points]))
        passes = -(-k // N_VALUES)
        # Lists are stored for chunks that begin at multiples of the chunk size.
        chunks = -(-self._targets.n_regions // CHUNK)
        cut = np.linspace(0, chunks, self.portions + 1).astype(np.int64)
        totals = empty((self.portions, passes, int(sizes[-1]), CHARGES))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                totals[portion] = 0.0
                for chunk in range(cut[portion], cut[portion + 1]):
                    first, last = chunk * CHUNK, min((chunk + 1) * CHUNK, self._targets.n_regions)
                    rows, flat = self._targets.places(first, last), self._targets.flat(first, last)
                    self._spread(first, last, make(rows, flat, portion), totals[portion], sizes)

        for_chunks(work, self.portions, 1, shared=[Shared(totals), Shared(beside)])
        found = np.zeros((k, len(self._strength)))
        for number in range(passes):
            some = slice(number * N_VALUES, min(k, (number + 1) * N_VALUES))
            for (group, tree), lo, hi in zip(self._groups, sizes[:-1], sizes[1:], strict=True):
                if lo == hi:
                    continue
                total = sum(totals[portion, number, lo:hi] for portion in range(self.portions))
                source = self._sources(tree, np.asarray(total))
                members = group[tree.order]
                found[some, members] = self._strength[members] * source[:, 1 : 1 + some.stop - some.start].T
        return np.where(self.acting, found, 0.0)

    def _spread(self, first: int, last: int, gradient: FloatArray, total: FloatArray, sizes: IntArray) -> None:
        """Add the contributions of some regions with gradients (m, k) to ``total`` (passes, points, 8)."""
        targets = self._targets
        lists = self._plan.lists_of(first, last)
        places = places_of(first, last, targets.points, targets.bricks, targets.regions)
        filled = np.logical_or.reduce([filled_by(each, m) for each, m in zip(lists, self._plan.moving, strict=True)])
        charged = np.empty((len(places.points), 3 + CHARGES))
        charged[:, :3], here = places.points, charged[:, 3:]
        for number in range(len(total)):
            here[:] = 0.0
            part = gradient[:, number * N_VALUES : (number + 1) * N_VALUES]
            here[: len(part), 1 : 1 + part.shape[1]] = part
            every = bool(here[:, -1].any())
            collect_sums(first, last, targets.bricks, targets.regions, places, filled, every, here)
            for (_, tree), points, each, kind, moving, lo, hi in zip(
                self._groups, self._points, lists, self._plan.key.kinds, self._plan.moving, sizes[:-1], sizes[1:],
                strict=True,
            ):  # fmt: skip
                if lo < hi:
                    spread_lists(
                        places.span, charged, tree, points, each, kind, moving, self._scale, every, total[number, lo:hi]
                    )

    def _sources(self, tree: SourceTree, total: FloatArray) -> FloatArray:
        """Gradients (n, 8) of the sources of a tree in its order, from those of its sources and points (n + m, 8)."""
        n = len(tree.order)
        source, proxy = total[:n].copy(), np.ascontiguousarray(total[n:])
        used = used_clusters(tree, proxy)
        for_chunks(lambda lo, hi: spread_charges(tree, proxy, used, lo, hi, source), n, _SOURCES)
        return source

    def _charges(self, values: FloatArray, weigh: bool) -> list[Charges]:
        charges = []
        for (group, tree), moving in zip(self._groups, self._plan.moving, strict=True):
            if not (weigh or moving.any()):
                charges.append(_NONE)
                continue
            (rows, start), members = charge_rows(tree), group[tree.order]
            source = rows[: len(members), 3:]
            if weigh:
                source[:, 0] = self._strength[members]
            source[:, 1 : 1 + len(values)] = (self._strength * self.acting)[members][:, None] * values[:, members].T
            charges.append(gather(tree, rows, start))
        return charges
