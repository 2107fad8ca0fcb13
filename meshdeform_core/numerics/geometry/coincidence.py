"""Which points coincide: exact copies first, then pairs closer than the smaller of their own tolerances.

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

_SPARSE = 16
"""Numbers are sorted instead of marked if their range exceeds this many times their count."""


_WINDOW = 500_000
"""Points searched at a time, which bounds the memory."""


def _key(points: FloatArray) -> FloatArray:
    # Not a matrix product: equal points must get equal keys, and the order in which a BLAS sums may vary.
    key: FloatArray = points[:, 0] * _GENERIC[0]
    key += points[:, 1] * _GENERIC[1]
    key += points[:, 2] * _GENERIC[2]
    return key


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
    key, integer = _key(points), integers(len(points))
    order = np.argsort(key).astype(integer)
    key = key[order]
    new = _new_points(key, order, points)
    label = np.cumsum(new, dtype=integer)
    label -= 1
    count, pairs = int(label[-1]) + 1, _close_groups(key, order, new, label, points, tolerance)
    del key, new
    leader = np.arange(count, dtype=integer)
    some = ascending(pairs)
    leader[some] = some[connected_components(len(some), np.searchsorted(some, pairs))]
    labels = np.empty(len(points), dtype=integer)
    labels[order] = leader[label]
    del order, label, leader
    return _by_first_occurrence(labels, count)


def _new_points(key: FloatArray, order: IntArray, points: FloatArray) -> BoolArray:
    """Which points, in the ``order`` of their ``key``, differ from the one before."""
    new = np.append(True, key[1:] != key[:-1])
    # Few keys are equal, and those of different points hardly ever.
    same = np.flatnonzero(~new)
    for lo in range(0, len(same), _WINDOW):
        some = same[lo : lo + _WINDOW]
        new[some[(points[order[some]] != points[order[some - 1]]).any(axis=1)]] = True
    return new


def _close_groups(
    key: FloatArray, order: IntArray, new: BoolArray, label: IntArray, points: FloatArray, tolerance: FloatArray
) -> IntArray:
    """Pairs (m, 2) of close groups of equal points, which are numbered ``label`` (n,) in the ``order`` of the points.

    A window at a time along the keys; it extends beyond its own groups as far as their tolerances reach.
    """
    found, lo = [np.empty((0, 2), dtype=np.int64)], 0
    while lo < len(key):
        end = min(lo + _WINDOW, len(key))
        own = int(np.searchsorted(key, key[end - 1], side="right"))
        # The smaller tolerance of a pair counts, so that those of points beyond the window do not matter.
        reach = 1.01 * float(tolerance[order[lo:own]].max())
        hi = int(np.searchsorted(key, key[own - 1] + reach, side="right"))
        first, members = np.flatnonzero(new[lo:hi]), order[lo:hi]
        leading = members[first]
        most = np.maximum.reduceat(tolerance[members], first)
        pairs = int(label[lo]) + _sweep(key[lo:hi][first], points[leading], most)
        found.append(pairs[pairs[:, 0] <= label[own - 1]])
        lo = own
    return np.concatenate(found)


def coincident_within(part: IntArray, points: FloatArray, tolerance: FloatArray) -> IntArray:
    """As :func:`coincident_groups`, but only points of the same ``part`` (n,), numbered from 0, coincide."""
    labels, count = np.empty(len(points), dtype=integers(len(points))), 0
    for number in range(int(part.max(initial=0)) + 1):
        own = np.flatnonzero(part == number)
        labels[own] = count + coincident_groups(points[own], tolerance[own])
        count = int(labels[own].max(initial=count - 1)) + 1
    return _by_first_occurrence(labels, count)


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
    if len(points) > _MANY:
        chosen = _with_close_neighbour(points, tolerance)
        return chosen[_sweep_in_order(points[chosen], tolerance[chosen])]
    return _sweep_in_order(points, tolerance)


def _with_close_neighbour(points: FloatArray, tolerance: FloatArray) -> IntArray:
    """Points whose nearest neighbour is within their tolerance, which holds for both points of any close pair.

    The keys of many points are dense: sweeping all of them would compare each with hundreds of others.
    """
    # Imported late: the format readers import this module and must start fast.
    import scipy

    tree = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)
    bound = float(tolerance.max(initial=0.0)) * (1.0 + 1e-9)
    distance, _ = tree.query(points, k=2, distance_upper_bound=bound, workers=thread_count())
    return np.flatnonzero(distance[:, 1] <= tolerance * (1.0 + 1e-9))


def _sweep_in_order(points: FloatArray, tolerance: FloatArray) -> IntArray:
    key = _key(points)
    order = np.argsort(key)
    return order[_sweep(key[order], points[order], tolerance[order])]


def _sweep(key: FloatArray, points: FloatArray, tolerance: FloatArray) -> IntArray:
    """:func:`close_pairs` for points in the order of their keys."""
    gap = np.diff(key)
    near = np.zeros(len(key), dtype=bool)
    # The keys of a close pair, and consecutive keys in between, differ by at most its distance, up to round-off.
    near[1:] = gap <= 1.01 * tolerance[1:]
    near[:-1] |= gap <= 1.01 * tolerance[:-1]
    chosen = np.flatnonzero(near)
    return chosen[_sweep_all(key[chosen], points[chosen], tolerance[chosen])]


def _sweep_all(key: FloatArray, points: FloatArray, tolerance: FloatArray) -> IntArray:
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
            near = _within(points, tolerance, a, b)
            found.append(np.stack([a[near], b[near]], axis=1))
            shift += 1
            active = active[active + shift < len(members)]
            active = active[keys[active + shift] - keys[active] <= reach]
    return np.concatenate(found) if found else np.empty((0, 2), dtype=np.int64)


def _within(points: FloatArray, tolerance: FloatArray, a: IntArray, b: IntArray) -> BoolArray:
    reach = np.minimum(tolerance[a], tolerance[b])
    # Most candidate pairs are rejected by one coordinate.
    near = np.abs(points[a, 0] - points[b, 0]) <= reach
    few = np.flatnonzero(near)
    near[few] = np.linalg.norm(points[a[few]] - points[b[few]], axis=1) <= reach[few]
    return near


def connected_components(n: int, pairs: IntArray) -> IntArray:
    """Smallest member of each connected component, by label propagation with pointer jumping."""
    labels = np.arange(n)
    while len(pairs):
        low = np.minimum(labels[pairs[:, 0]], labels[pairs[:, 1]])
        before = labels.copy()
        np.minimum.at(labels, pairs[:, 0], low)
        np.minimum.at(labels, pairs[:, 1], low)
        labels = labels[labels]
        if np.array_equal(labels, before):
            break
    return labels


def _by_first_occurrence(labels: IntArray, count: int) -> IntArray:
    """Labels below ``count``, renumbered by first occurrence."""
    own = np.arange(len(labels), dtype=labels.dtype)
    first = np.empty(count, dtype=labels.dtype)
    first[labels[::-1]] = own[::-1]
    number = np.cumsum(first[labels] == own, dtype=labels.dtype)
    number -= 1
    return np.asarray(number[first[labels]])


def integers(count: int) -> np.dtype[np.signedinteger[Any]]:
    """The type of integers below ``count``: 32 bits where they suffice, as large grids have many."""
    return np.dtype(np.int32 if count < 2**31 else np.int64)


def equal_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Partner of each row of an integer table: the other row that is equal to it.

    Parameters
    ----------
    rows : (n, m) int64, non-negative, m in (2, 4), each row sorted

    Returns
    -------
    partner : (n,) int64, ``-1`` where no other row is equal; the rows of groups of more than two point in a ring
    count : (n,) int64, size of each row's group
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
