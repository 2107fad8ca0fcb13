"""Which points coincide: exact copies first, then pairs closer than the smaller of their own tolerances.

Plain numpy (``meshdeform info`` must start fast and imports no numba).
"""

from __future__ import annotations

import numpy as np

from ...parallel import OneRank, Ranks, Route, joined
from ..arrays import BoolArray, FloatArray, IntArray, spans
from .coincidence import ascending, connected_components, generic_key, integers, pairs_in_order

_WINDOW = 500_000
"""Points searched at a time, which bounds the memory."""

_SAMPLE = 1000
"""Points of each rank from which the ranges of keys are chosen."""


def coincident_groups(points: FloatArray, tolerance: FloatArray) -> IntArray:
    """Number points so that coincident ones share a number.

    Two points coincide when their distance is at most the *smaller* of their tolerances; coincidence is transitive.
    Beside the arguments it takes some 30 bytes per point, as points are compared a window at a time.

    Parameters
    ----------
    points : (n, 3) float64
    tolerance : (n,) float64, grid length unit

    Returns
    -------
    labels : (n,) int32 (int64 for 2^31 points or more) in ``0 ... n_groups - 1``, numbered by first occurrence
    """
    own = np.arange(len(points), dtype=integers(len(points)))
    return numbered_by_first(coincident_copies(OneRank(), own, points, tolerance)[0])[0]


def numbered_by_first(first: IntArray) -> tuple[IntArray, BoolArray]:
    """Numbers (n,) of the groups of n items, by first occurrence; ``first`` (n,) is the first item of each one's group.

    Also returns which items (n,) are the first of their groups.
    """
    leads = np.zeros(len(first), dtype=bool)
    leads[first] = True
    number = np.cumsum(leads, dtype=first.dtype)
    number -= 1
    return number[first], leads


def coincident_copies(
    ranks: Ranks, index: IntArray, points: FloatArray, edge: FloatArray, relative: float = 1.0
) -> tuple[IntArray, FloatArray]:
    """Coincidence, as in :func:`coincident_groups`, of points of which every rank has some; all ranks call this.

    Each rank compares the points of a range of keys with each other and with the next ones beyond the range, as far as
    tolerances reach.

    Parameters
    ----------
    index : (n,) numbers of the points, ascending through the ranks in their order
    points, edge : (n, 3) and (n,) float64; tolerances are ``relative * edge``

    Returns
    -------
    first, least : (n,) for each point, the smallest number and the smallest edge of all that coincide with it
    """
    route = Route(ranks, np.searchsorted(_splitters(ranks, points), generic_key(points), side="right"))
    here = [route.there(each) for each in (index, points, edge)]
    found = _Range(ranks, here[0], here[1], here[2], relative).copies()
    first, least = (route.back(each) for each in found)
    return first, least


def _splitters(ranks: Ranks, points: FloatArray) -> FloatArray:
    """Keys (n_ranks - 1,) at which the ranges of the ranks begin: about equally many points are in each."""
    total = sum(ranks.gather([len(points)]))
    few = np.sort(joined(ranks, generic_key(points[:: max(total // (_SAMPLE * ranks.count), 1)])))
    return few[np.arange(1, ranks.count) * len(few) // ranks.count]


class _Range:
    """The points of a rank, in the order of their keys, in groups of equal ones.

    Groups are numbered through the ranks in their order; those of this rank begin at ``base``.
    """

    def __init__(self, ranks: Ranks, index: IntArray, points: FloatArray, edge: FloatArray, relative: float):
        key = generic_key(points)
        self._ranks, self._index, self._points, self._edge, self._relative = ranks, index, points, edge, relative
        self._order = np.argsort(key).astype(integers(len(points)))
        self._keys = key[self._order]
        self._new = _new_points(self._keys, self._order, points)
        self._group: IntArray = np.cumsum(self._new, dtype=self._order.dtype)
        self._group -= 1
        self._count = int(self._group[-1]) + 1 if len(key) else 0
        self._base = sum(ranks.gather([self._count])[: ranks.number])

    def copies(self) -> tuple[IntArray, FloatArray]:
        """See :func:`coincident_copies`, in the order in which the points came."""
        pairs, end = self._close_groups(), self._base + self._count
        inside = pairs[:, 1] < end
        own, across = pairs[inside] - self._base, pairs[~inside]
        leader = np.arange(self._count, dtype=self._order.dtype)
        some = ascending(own)
        leader[some] = some[connected_components(len(some), np.searchsorted(some, own))]
        label = np.empty_like(self._order)
        label[self._order] = leader[self._group]
        first = np.zeros(self._count, dtype=self._index.dtype)
        first[label[::-1]] = self._index[::-1]
        least = np.full(self._count, np.inf)
        np.minimum.at(least, label, self._edge)
        self._unite(joined(self._ranks, across), leader, first, least)
        return first[label], least[label]

    def _unite(self, pairs: IntArray, leader: IntArray, first: IntArray, least: FloatArray) -> None:
        """Give groups of several ranks, of which ``pairs`` (n, 2) are close, the smallest of their values."""
        ends = ascending(pairs)
        leaders = joined(self._ranks, self._base + leader[ends[self._own(ends)] - self._base].astype(np.int64))
        some = ascending(leaders)
        whole = connected_components(len(some), np.searchsorted(some, leaders[np.searchsorted(ends, pairs)]))
        own = self._own(some)
        for values in (first, least):
            each = joined(self._ranks, values[some[own] - self._base])
            smallest = each.copy()
            np.minimum.at(smallest, whole, each)
            values[some[own] - self._base] = smallest[whole[own]]

    def _own(self, groups: IntArray) -> slice:
        """Those of the ascending numbers ``groups`` that are of this rank."""
        return slice(*np.searchsorted(groups, [self._base, self._base + self._count]).tolist())

    def _close_groups(self) -> IntArray:
        """Pairs (m, 2), ascending each, of close groups, of which the first is one of this rank's.

        A window at a time along the keys; it extends beyond its own groups as far as their tolerances reach.
        """
        keys, beyond = self._keys, self._beyond()
        found, lo = [np.empty((0, 2), dtype=np.int64)], 0
        while lo < len(keys):
            end = min(lo + _WINDOW, len(keys))
            own = int(np.searchsorted(keys, keys[end - 1], side="right"))
            reach = keys[own - 1] + self._reach(lo, own)
            hi = int(np.searchsorted(keys, reach, side="right"))
            groups = self._groups(lo, hi)
            if hi == len(keys):
                more = beyond[: np.searchsorted(beyond[:, 0], reach, side="right")]
                columns = more[:, 0], more[:, 1:4], more[:, 4]
                groups = tuple(np.concatenate(each) for each in zip(groups, columns, strict=True))
            pairs = int(self._group[lo]) + pairs_in_order(*groups)
            found.append(self._base + pairs[pairs[:, 0] <= self._group[own - 1]])
            lo = own
        return np.concatenate(found)

    def _reach(self, lo: int, hi: int) -> float:
        """How far the groups of the points lo <= n < hi may be from others with larger keys that are close.

        The smaller tolerance of a pair counts, so that those of the others do not matter.
        """
        return 1.01 * (self._relative * float(self._edge[self._order[lo:hi]].max(initial=0.0)))

    def _groups(self, lo: int, hi: int) -> tuple[FloatArray, ...]:
        """Key, coordinates and largest tolerance of the groups of the points lo <= n < hi."""
        first, members = np.flatnonzero(self._new[lo:hi]), self._order[lo:hi]
        tolerance = self._relative * self._edge[members]
        return self._keys[lo:hi][first], self._points[members[first]], np.maximum.reduceat(tolerance, first)

    def _beyond(self) -> FloatArray:
        """Key, coordinates and tolerance (n, 5) of the next groups, of other ranks, within the reach of this one's."""
        last = self._keys[-1] + self._reach(0, len(self._keys)) if len(self._keys) else -np.inf
        reach = np.array(self._ranks.gather([last]))[: self._ranks.number]
        sizes = np.zeros(self._ranks.count, dtype=np.int64)
        ends = np.searchsorted(self._keys, reach, side="right")
        key, points, tolerance = self._groups(0, int(ends.max(initial=0)))
        sizes[: len(ends)] = np.append(0, np.cumsum(self._new[: ends.max(initial=0)]))[ends]
        target, group = spans(sizes)
        return Route(self._ranks, target).there(np.column_stack([key, points, tolerance])[group])


def _new_points(key: FloatArray, order: IntArray, points: FloatArray) -> BoolArray:
    """Which points, in the ``order`` of their ``key``, differ from the one before."""
    new = np.append(True, key[1:] != key[:-1])[: len(key)]
    # Few keys are equal, and those of different points hardly ever.
    same = np.flatnonzero(~new)
    for lo in range(0, len(same), _WINDOW):
        some = same[lo : lo + _WINDOW]
        new[some[(points[order[some]] != points[order[some - 1]]).any(axis=1)]] = True
    return new
