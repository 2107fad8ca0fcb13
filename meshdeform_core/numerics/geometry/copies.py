"""Which points coincide: exact copies first, then pairs closer than the smaller of their own tolerances.

Plain numpy (``meshdeform info`` must start fast and imports no numba).
"""

from __future__ import annotations

import numpy as np

from ..arrays import BoolArray, FloatArray, IntArray
from .coincidence import ascending, connected_components, generic_key, integers, pairs_in_order

_WINDOW = 500_000
"""Points searched at a time, which bounds the memory."""


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
    return numbered_by_first(coincident_copies(points, tolerance)[0])[0]


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
    """Coincidence, as in :func:`coincident_groups`, of ``points`` (n, 3) with the tolerances ``relative * edge`` (n,).

    Returns
    -------
    first, least : (n,) for each point, the smallest number and the smallest edge of all that coincide with it
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
    pairs = _close_groups(keys, order, group, new, points, relative * edge)
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


def _close_groups(
    keys: FloatArray, order: IntArray, group: IntArray, new: BoolArray, points: FloatArray, tolerance: FloatArray
) -> IntArray:
    """Pairs (m, 2), ascending each, of close groups of equal points, which ``new`` ones begin, along their ``keys``.

    A window at a time; it extends beyond its own groups as far as their tolerances reach. The smaller tolerance of a
    pair counts, so that those of the others do not matter.
    """
    found, lo = [np.empty((0, 2), dtype=np.int64)], 0
    while lo < len(keys):
        end = min(lo + _WINDOW, len(keys))
        own = int(np.searchsorted(keys, keys[end - 1], side="right"))
        reach = keys[own - 1] + 1.01 * float(tolerance[order[lo:own]].max(initial=0.0))
        hi = int(np.searchsorted(keys, reach, side="right"))
        first, members = np.flatnonzero(new[lo:hi]), order[lo:hi]
        largest = np.maximum.reduceat(tolerance[members], first)
        pairs = int(group[lo]) + pairs_in_order(keys[lo:hi][first], points[members[first]], largest)
        found.append(pairs[pairs[:, 0] <= group[own - 1]])
        lo = own
    return np.concatenate(found)
