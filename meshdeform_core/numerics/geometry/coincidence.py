"""Which points coincide: exact copies, pairs closer than the smaller of their own tolerances; equal rows of integers.

Plain numpy (``meshdeform info`` must start fast and imports no numba).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...parallel import thread_count
from ..arrays import BoolArray, FloatArray, IntArray, KeyArray

# A direction that no grid line is aligned with: projected on it, distinct nodes hardly ever share a key.
_GENERIC = np.array([0.5403023058681398, 0.6427876096865393, 0.5446390350150271])

_MANY = 50_000
"""From this number of points on, close pairs are searched only among points with a close neighbour."""

_WINDOW = 500_000
"""Points whose copies are searched at a time, which bounds the memory."""

_SPARSE = 16
"""Numbers are sorted instead of marked if their range exceeds this many times their count."""


def generic_key(points: FloatArray) -> FloatArray:
    """Coordinate (n,) of points (n, 3) along a direction in which different points hardly ever have the same."""
    # Not a matrix product: equal points must get equal keys, and the order in which a BLAS sums may vary.
    key: FloatArray = points[:, 0] * _GENERIC[0]
    key += points[:, 1] * _GENERIC[1]
    key += points[:, 2] * _GENERIC[2]
    return key


def _differ(rows: FloatArray | IntArray) -> BoolArray:
    """Which rows (n, m) differ from the preceding one: (n - 1,). Column by column, as reducing a short axis is slow."""
    differ = rows[1:, 0] != rows[:-1, 0]
    for column in range(1, rows.shape[1]):
        differ |= rows[1:, column] != rows[:-1, column]
    return differ


def close_pairs(points: FloatArray, tolerance: FloatArray) -> IntArray:
    """All pairs of points closer than the smaller of their tolerances, ``(m, 2)`` int64.

    Sweeps along one direction, from the coarsest tolerance to the finest: if only points of at least a given tolerance
    take part, few lie within that tolerance of any plane, however strongly the grid is clustered.
    """
    chosen = np.arange(len(points))
    if len(points) > _MANY:
        # Points whose nearest neighbour is within their tolerance, which holds for both points of any close pair. The
        # keys of many points are dense: sweeping all of them would compare each with hundreds of others.
        # Imported late: the format readers import this module and must start fast.
        import scipy

        tree = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)
        bound = float(tolerance.max(initial=0.0)) * (1.0 + 1e-9)
        distance, _ = tree.query(points, k=2, distance_upper_bound=bound, workers=thread_count())
        chosen = np.flatnonzero(distance[:, 1] <= tolerance * (1.0 + 1e-9))
        points, tolerance = points[chosen], tolerance[chosen]
    key = generic_key(points)
    order = np.argsort(key)
    return chosen[order[pairs_in_order(key[order], points[order], tolerance[order])]]


def pairs_in_order(key: FloatArray, points: FloatArray, tolerance: FloatArray) -> IntArray:
    """:func:`close_pairs` for points in the order of their keys."""
    gap = np.diff(key)
    near = np.zeros(len(key), dtype=bool)
    # The keys of a close pair, and consecutive keys in between, differ by at most its distance, up to round-off.
    near[1:] = gap <= 1.01 * tolerance[1:]
    near[:-1] |= gap <= 1.01 * tolerance[:-1]
    chosen = np.flatnonzero(near)
    key, points, tolerance = key[chosen], points[chosen], tolerance[chosen]
    level = np.frexp(tolerance)[1]
    found = []
    for current in np.unique(level)[::-1]:
        members = np.flatnonzero(level >= current)
        keys, reach = key[members], np.ldexp(1.0, int(current))
        active = np.flatnonzero(keys[1:] - keys[:-1] <= reach)
        shift = 1
        while active.size:
            a, b = members[active], members[active + shift]
            reached = np.minimum(tolerance[a], tolerance[b])
            here = (np.minimum(level[a], level[b]) == current) & (key[b] - key[a] <= 1.01 * reached)
            a, b = a[here], b[here]
            reached = reached[here]
            # Most candidate pairs are rejected by one coordinate.
            close = np.abs(points[a, 0] - points[b, 0]) <= reached
            few = np.flatnonzero(close)
            close[few] = np.linalg.norm(points[a[few]] - points[b[few]], axis=1) <= reached[few]
            found.append(np.stack([a[close], b[close]], axis=1))
            shift += 1
            active = active[active + shift < len(members)]
            active = active[keys[active + shift] - keys[active] <= reach]
    return chosen[np.concatenate(found)] if found else np.empty((0, 2), dtype=np.int64)


def numbered_by_first(first: IntArray) -> tuple[IntArray, BoolArray]:
    """Numbers (n,) of the groups of n items, by first occurrence; ``first`` (n,) is the first item of each one's group.

    Also returns which items (n,) are the first of their groups.
    """
    leads = np.zeros(len(first), dtype=bool)
    leads[first] = True
    number = np.cumsum(leads, dtype=first.dtype)
    number -= 1
    return number[first], leads


def coincident_copies(points: FloatArray, edge: FloatArray, relative: float = 1.0) -> tuple[IntArray, FloatArray]:
    """For each of ``points`` (n, 3), the smallest number and the smallest edge of all that coincide with it.

    Two points coincide when their distance is at most the *smaller* of their tolerances, ``relative * edge`` (n,);
    coincidence is transitive. Numbers are int32 (int64 for 2^31 points or more). Beside the arguments it takes some 30
    bytes per point, as points are compared a window at a time.
    """
    key = generic_key(points)
    order = np.argsort(key).astype(integers(len(points)))
    keys = key[order]
    # Which points, in the ``order`` of their ``key``, differ from the one before.
    new = np.append(True, keys[1:] != keys[:-1])[: len(keys)]
    # Few keys are equal, and those of different points hardly ever.
    same = np.flatnonzero(~new)
    for lo in range(0, len(same), _WINDOW):
        some = same[lo : lo + _WINDOW]
        new[some[(points[order[some]] != points[order[some - 1]]).any(axis=1)]] = True
    group: IntArray = np.cumsum(new, dtype=order.dtype)
    group -= 1
    count = int(group[-1]) + 1 if len(key) else 0
    # Pairs, ascending each, of close groups of equal points. A window at a time; it extends beyond its own groups as
    # far as their tolerances reach. The smaller tolerance of a pair counts, so that those of the others do not matter.
    found, lo = [np.empty((0, 2), dtype=np.int64)], 0
    while lo < len(keys):
        end = min(lo + _WINDOW, len(keys))
        own = int(np.searchsorted(keys, keys[end - 1], side="right"))
        reach = keys[own - 1] + 1.01 * float((relative * edge[order[lo:own]]).max(initial=0.0))
        hi = int(np.searchsorted(keys, reach, side="right"))
        first, members = np.flatnonzero(new[lo:hi]), order[lo:hi]
        largest = np.maximum.reduceat(relative * edge[members], first)
        close = int(group[lo]) + pairs_in_order(keys[lo:hi][first], points[members[first]], largest)
        found.append(close[close[:, 0] <= group[own - 1]])
        lo = own
    pairs = np.concatenate(found)
    leader = np.arange(count, dtype=order.dtype)
    some = ascending(pairs)
    leader[some] = some[connected_components(len(some), np.searchsorted(some, pairs))]
    label = np.empty_like(order)
    label[order] = leader[group]
    first = np.zeros_like(leader)
    least = np.full(count, np.inf)
    first[label[::-1]] = np.arange(len(points))[::-1]
    np.minimum.at(least, label, edge)
    return first[label], least[label]


def connected_components(n: int, pairs: IntArray) -> IntArray:
    """Smallest member of each connected component: the larger of two labels leads to the smaller one and from there to
    where that leads, which halves the number of labels that are left, at least."""
    labels = np.arange(n)
    while len(pairs):
        one, two = (labels.take(pairs[:, end]) for end in (0, 1))
        pairs = np.stack([np.minimum(one, two), np.maximum(one, two)], axis=1)[one != two]
        np.minimum.at(labels, pairs[:, 1], pairs[:, 0])
        while not np.array_equal(further := labels[labels], labels):
            labels = further
    return labels


def integers(count: int) -> np.dtype[np.signedinteger[Any]]:
    """The type of integers below ``count``: 32 bits where they suffice, as large grids have many."""
    return np.dtype(np.int32 if count < 2**31 else np.int64)


def equal_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Partner (n,) of each sorted row of a table (n, 2 or 4) of non-negative integers, the other row that is equal to
    it, and the size (n,) of its group.

    Partners are -1 where no other row is equal; the rows of groups of more than two point in a ring.
    """
    if not len(rows):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    key = mixed(rows)
    order = np.argsort(key, kind="stable")
    ordered, key = rows[order], key[order]
    differ = _differ(ordered)
    if np.count_nonzero(differ) > np.count_nonzero(key[1:] != key[:-1]):
        # Different rows have the same key.
        order = np.lexsort(rows.T[::-1])
        ordered = rows[order]
        differ = _differ(ordered)
    start = np.flatnonzero(np.r_[True, differ])
    size = np.diff(np.r_[start, len(rows)])
    count = np.empty(len(rows), dtype=np.int64)
    count[order] = np.repeat(size, size)
    following = np.arange(1, len(rows) + 1)
    following[start + size - 1] = start
    partner = np.empty(len(rows), dtype=np.int64)
    partner[order] = order[following]
    return np.where(count > 1, partner, -1), count


def mixed(rows: IntArray) -> KeyArray:
    """One key per row of integers, hardly ever the same for different rows."""
    factors = np.array(
        [0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9, 0x27D4EB2F165667C5], dtype=np.uint64
    )
    key = np.zeros(len(rows), dtype=np.uint64)
    for column in range(rows.shape[1]):
        key = (key ^ (key >> np.uint64(29))) + rows[:, column].astype(np.uint64) * factors[column]
    return key


def ascending(numbers: IntArray) -> IntArray:
    """Distinct integers of ``numbers`` (any shape), ascending, int64; sorts, which is faster than numpy.unique."""
    found = np.sort(numbers, axis=None)
    return found[np.append(True, found[1:] != found[:-1])[: found.size]].astype(np.int64, copy=False)


def distinct(numbers: IntArray, size: int) -> IntArray:
    """Distinct values of ``numbers`` (any shape, integers in 0 ... size - 1), ascending, int64.

    They are marked in an array of length ``size``, which is faster than sorting or hashing unless they are few.
    """
    if size > _SPARSE * numbers.size:
        return ascending(numbers)
    marked = np.zeros(size, dtype=bool)
    marked[numbers] = True
    return np.flatnonzero(marked)


def connected_rows(rows: IntArray, count: int) -> IntArray:
    """Number (n,) of the connected part of every row (n, m) of numbers below ``count``: those with a common number."""
    n = len(rows)
    pairs = np.stack([np.repeat(np.arange(n), rows.shape[1]), rows.ravel()], axis=1, dtype=np.int64)
    pairs[:, 1] += n
    return np.asarray(np.unique(connected_components(n + count, pairs)[:n], return_inverse=True)[1])


def one_side(quads: IntArray) -> BoolArray:
    """Which of the face quads (n, 4), or cell edges (n, 2), to keep if one of two between the same nodes is enough, as
    the sides of a plate. All are wound as seen from outside; those of a plate that are kept look to the same side."""
    (n, corners), twin = quads.shape, equal_rows(np.sort(quads, axis=1))[0]
    if (twin < 0).all():
        return np.ones(n, dtype=bool)
    # Their edges, in a plane their ends, and in which of two senses each is passed.
    ends = quads[:, :, None] if corners == 2 else np.stack([quads, np.roll(quads, -1, axis=1)], axis=2)
    sense = np.tile([True, False], n) if corners == 2 else (ends[:, :, 0] < ends[:, :, 1]).ravel()
    quad, ends = np.repeat(np.arange(n), corners), np.sort(ends, axis=2).reshape(n * corners, -1)
    edge = np.unique(ends, axis=0, return_inverse=True)[1].ravel()
    # Neighbours on one side pass their edge in opposite senses; four quads of a plate have one in common.
    order, pairs = np.argsort(edge, kind="stable"), []
    for apart in (1, 2, 3):
        one, two = order[:-apart], order[apart:]
        joined = (edge[one] == edge[two]) & (sense[one] != sense[two]) & (twin[quad[one]] != quad[two])
        pairs.append(np.stack([quad[one], quad[two]], axis=1)[joined])
    side = connected_components(n, np.concatenate(pairs))
    return (twin < 0) | (side < side[twin]) | ((side == side[twin]) & (np.arange(n) < twin))
