"""Pairs of points closer than the smaller of their own tolerances; equal rows of integers.

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
    if len(points) > _MANY:
        # Points whose nearest neighbour is within their tolerance, which holds for both points of any close pair. The
        # keys of many points are dense: sweeping all of them would compare each with hundreds of others.
        # Imported late: the format readers import this module and must start fast.
        import scipy

        tree = scipy.spatial.cKDTree(points, balanced_tree=False, compact_nodes=False)
        bound = float(tolerance.max(initial=0.0)) * (1.0 + 1e-9)
        distance, _ = tree.query(points, k=2, distance_upper_bound=bound, workers=thread_count())
        chosen = np.flatnonzero(distance[:, 1] <= tolerance * (1.0 + 1e-9))
        return chosen[_sweep_in_order(points[chosen], tolerance[chosen])]
    return _sweep_in_order(points, tolerance)


def _sweep_in_order(points: FloatArray, tolerance: FloatArray) -> IntArray:
    key = generic_key(points)
    order = np.argsort(key)
    return order[pairs_in_order(key[order], points[order], tolerance[order])]


def pairs_in_order(key: FloatArray, points: FloatArray, tolerance: FloatArray) -> IntArray:
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


def connected_rows(rows: IntArray, count: int) -> IntArray:
    """Number (n,) of the connected part of every row (n, m) of numbers below ``count``: those with a common number."""
    n = len(rows)
    pairs = np.stack([np.repeat(np.arange(n), rows.shape[1]), rows.ravel()], axis=1, dtype=np.int64)
    pairs[:, 1] += n
    return np.asarray(np.unique(connected_components(n + count, pairs)[:n], return_inverse=True)[1])
