"""Sums over the sources of inverse distance weighting as a linear map of their values, and its transpose."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...numerics.exact.direct import N_VALUES, weighted_sums
from ...numerics.fastsum.clusters.targets import make_targets
from ...numerics.fastsum.clusters.tree import build_tree
from ...numerics.fastsum.weighted.frozen import Accuracy, FrozenSums, Make, Use
from ...parallel import Shared, apart, empty, for_chunks, ranks_of
from ..scattered.idw_sums import Bound

TOLERANCE = 1e-5
"""Error of fast sums in derivatives, relative to the largest change of a value."""
_ORDER = 5
"""Interpolation points per side; among 4 to 7, the fastest on the hemisphere."""
_PER_POINT = 4
"""Nodes of a brick per interpolation point; twice as many, as the forward method has, take a quarter longer."""
_CHUNK = 2048
_PORTIONS = 32

Weights = tuple[tuple[float, float, float], ...]


def sums_of(
    bound: Bound, fast: bool, weights: Weights, acting: BoolArray, share: float = 1.0, single: bool = True
) -> LinearSums:
    """Exact sums over all sources, or fast ones with fixed clusters, each allowed the error ``share``.

    ``single`` as for :class:`.FrozenSums`.
    """
    if not fast:
        return ExactSums(bound, weights, acting)
    # Clusters of acting sources alone, as few sources act.
    parts = [
        (some, each)
        for group, each in zip(bound.groups, weights, strict=True)
        for some in (group[acting[group]], group[~acting[group]])
        if some.size
    ]
    grid, groups = bound.grid, [group for group, _ in parts]
    kinds = [each for _, each in parts]
    with apart(grid.points):
        trees = [build_tree(bound.sources[group], _ORDER) for group in groups]
        targets = make_targets(bound.points, grid.shapes, grid.offsets, bound.flat, _ORDER, _PER_POINT)
        accuracy = Accuracy(TOLERANCE, share, single, ranks_of(grid.points))
        return FrozenSums(groups, trees, targets, bound.strength, kinds, acting, accuracy)


class ExactSums:
    """Exact sums, every node with every source; interface as :class:`..fastsum.weighted.frozen.FrozenSums`."""

    def __init__(self, bound: Bound, weights: Weights, acting: BoolArray) -> None:
        self._bound, self._weights, self.acting = bound, weights, acting
        # The sums of all portions together are no larger than half of the coordinates.
        self._n_acting = int(acting.sum())
        most = 3 * len(bound.grid.points) // (2 * (1 + N_VALUES) * max(self._n_acting, 1))
        self.portions = max(1, min(_PORTIONS, len(bound.flat) // _CHUNK, most))

    @property
    def flat(self) -> IntArray:
        """Flat indices (n,) of the nodes at which sums are taken."""
        return self._bound.flat

    def push(
        self,
        values: FloatArray,
        use: Use,
        result: FloatArray | None = None,
        kept: Sequence[FloatArray] = (),
        weigh: bool = False,
    ) -> None:
        """Call ``use`` with sums (m, 1 + k) of values (k, n), some rows at a time."""
        bound = self._bound

        def work(lo: int, hi: int) -> None:
            flat = bound.flat[lo:hi]
            x = bound.points[flat]
            sums = np.zeros((len(flat), 1 + len(values)))
            for group, weights in zip(bound.groups, self._weights, strict=True):
                for some, kept in self._parts(group, values, weigh):
                    near = bound.sources[some], bound.strength[some]
                    sums[:, : 1 + len(kept)] += weighted_sums(x, *near, weights, kept[:, some], chunk=len(x))
            if not weigh:
                sums[:, 0] = 0.0
            use(slice(lo, hi), flat, sums)

        shared = [Shared(each) for each in kept]
        shared += [] if result is None else [Shared(result, lambda lo, hi: bound.flat[lo:hi])]
        for_chunks(work, len(bound.flat), _CHUNK, shared=shared)

    def _parts(self, group: IntArray, values: FloatArray, weigh: bool) -> list[tuple[IntArray, FloatArray]]:
        """Sources with their values; to ``weigh``, also the others, without values."""
        acting = self.acting[group]
        others = [(group[~acting], values[:0])] if weigh and not acting.all() else []
        return [(group[acting], values), *others]

    def pull(self, make: Make, k: int, beside: FloatArray) -> FloatArray:
        """Transpose of :meth:`push`: gradients (k, n_sources) from those (m, k) of the sums of values."""
        bound, n = self._bound, len(self._bound.sources)
        cut = np.linspace(0, len(bound.flat), self.portions + 1).astype(np.int64)
        place = np.cumsum(self.acting) - 1
        totals = empty((self.portions, k, self._n_acting))

        def work(lo: int, hi: int) -> None:
            for portion in range(lo, hi):
                totals[portion] = 0.0
                for first in range(cut[portion], cut[portion + 1], _CHUNK):
                    rows = slice(first, min(first + _CHUNK, int(cut[portion + 1])))
                    flat = bound.flat[rows]
                    given = np.ascontiguousarray(make(rows, flat, portion).T)
                    x, ones = bound.points[flat], np.ones(len(flat))
                    for group, weights in zip(bound.groups, self._weights, strict=True):
                        some = group[self.acting[group]]
                        found = weighted_sums(bound.sources[some], x, ones, weights, given, chunk=n)
                        totals[portion][:, place[some]] += bound.strength[some] * found[:, 1:].T

        for_chunks(work, self.portions, 1, shared=[Shared(totals), Shared(beside)])
        gradient = np.zeros((k, n))
        gradient[:, self.acting] = sum(totals[portion] for portion in range(self.portions))
        return gradient


LinearSums = ExactSums | FrozenSums
