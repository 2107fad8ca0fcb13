"""Which face quads are shared: the quad on the other side of every interface."""

from __future__ import annotations

import numpy as np

from ...numerics.arrays import BoolArray, IntArray
from ...numerics.geometry.coincidence import equal_rows, integers
from ...parallel import Ranks, Route, collected

_MATCHED = 1_000_000
"""Unique nodes whose quads are compared at a time, which bounds the memory; more of them in large grids."""
_PASSES = 16
"""At most so many times are all quads searched for those to be compared."""
COLLAPSED = -2
EXTERNAL = -1


def partners(ranks: Ranks, corners: IntArray, shared: BoolArray) -> tuple[IntArray, int]:
    """Partner of every quad, ``EXTERNAL`` or ``COLLAPSED``, and the number of quads that more than two blocks share.

    Each rank compares the quads of a range of smallest corners.

    Parameters
    ----------
    corners : (n_quads, 2 or 4) unique nodes; all ranks have all of them
    shared : (n_unique,) nodes that several blocks have in common; only quads whose corners are shared, all but one for
        collapsed ones, need to be compared, and only with those that have the same smallest corner
    """
    low, high = (len(corners) * (ranks.number + end) // ranks.count for end in range(2))
    smallest = _smallest_corners(corners[low:high], shared)
    candidates = np.flatnonzero(smallest < len(shared)).astype(integers(len(corners)))
    smallest = smallest[candidates]
    route = Route(ranks, smallest.astype(np.int64) * ranks.count // max(len(shared), 1))
    found, crowded = _searched(corners, route.there(candidates + low), route.there(smallest))
    partner = np.full(high - low, EXTERNAL, dtype=integers(len(corners)))
    partner[candidates] = route.back(found)
    return collected(ranks, partner), sum(ranks.gather([crowded]))


def _smallest_corners(corners: IntArray, shared: BoolArray) -> IntArray:
    """Smallest corner of every quad, ``len(shared)`` for those that cannot have a partner."""
    smallest = np.full(len(corners), len(shared), dtype=corners.dtype)
    count = np.zeros(len(corners), dtype=np.int8)
    for column in corners.T:
        count += shared[column]
        np.minimum(smallest, column, out=smallest)
    smallest[count < (3 if corners.shape[1] == 4 else 2)] = len(shared)
    return smallest


def _searched(corners: IntArray, quads: IntArray, smallest: IntArray) -> tuple[IntArray, int]:
    """Partners of some ``quads`` (n,), ascending, a range of their ``smallest`` corners (n,) at a time."""
    partner = np.full(len(quads), EXTERNAL, dtype=quads.dtype)
    if not len(quads):
        return partner, 0
    first, last = int(smallest.min()), int(smallest.max()) + 1
    crowded, step = 0, max(_MATCHED, -(-(last - first) // _PASSES))
    for low in range(first, last, step):
        some = np.flatnonzero((smallest >= low) & (smallest < low + step))
        found, more = _partners_of(corners[quads[some]])
        partner[some] = np.where(found >= 0, quads[some[np.maximum(found, 0)]], found)
        crowded += more
    return partner, crowded


def _partners_of(corners: IntArray) -> tuple[IntArray, int]:
    rows = np.sort(corners, axis=1)
    distinct = 1 + np.count_nonzero(np.diff(rows, axis=1), axis=1)
    collapsed = distinct < (3 if rows.shape[1] == 4 else 2)
    triangles = (distinct == 3) & (rows.shape[1] == 4)
    if triangles.any():
        # On the other side, the same triangle may repeat another corner: keep three corners and pad.
        repeated = np.argmax(np.diff(rows[triangles], axis=1) == 0, axis=1)
        some = rows[triangles]
        some[np.arange(len(some)), repeated] = rows.max() + 1
        rows[triangles] = np.sort(some, axis=1)
    live = np.flatnonzero(~collapsed)
    partner = np.full(len(rows), COLLAPSED, dtype=np.int64)
    matched, count = equal_rows(rows[live])
    partner[live] = np.where(matched >= 0, live[matched], EXTERNAL)
    return partner, int(np.count_nonzero(count > 2))
