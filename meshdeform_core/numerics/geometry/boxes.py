"""Which of many axis-parallel boxes overlap; plain numpy, as ``meshdeform info`` must start fast without numba."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray, spans
from .coincidence import mixed

Boxes = tuple[FloatArray, FloatArray]
"""Smallest and largest coordinates, (n, 3) each."""

_FINEST = 20
"""Boxes smaller than 2^-20 times the largest one are treated as if they had that size."""


def overlapping_boxes(one: Boxes, two: Boxes) -> IntArray:
    """All pairs (m, 2) of a box of ``one`` and a box of ``two`` that have a point in common, in ascending order.

    The boxes of each size, to within a factor of two, are entered into the cells of a raster of that width, together
    with all smaller boxes of the other set; each touches at most eight cells. The cost is that of sorting times the
    number of different sizes, whatever the arrangement of the boxes.
    """
    if not (len(one[0]) and len(two[0])):
        return np.empty((0, 2), dtype=np.int64)
    sizes = [(high - low).max(axis=1) for low, high in (one, two)]
    largest = max(float(size.max()) for size in sizes) or 1.0
    finest = np.frexp(largest)[1] - _FINEST
    levels = [np.maximum(np.frexp(size)[1], finest) for size in sizes]
    origin = np.minimum(one[0].min(axis=0), two[0].min(axis=0))
    found = []
    for level in np.unique(np.concatenate(levels)):
        width = float(np.ldexp(1.0, int(level)))
        same, finer = levels[0] == level, levels[1] <= level
        found.append(_in_raster(one, two, np.flatnonzero(same), np.flatnonzero(finer), origin, width))
        finer, same = levels[0] < level, levels[1] == level
        found.append(_in_raster(one, two, np.flatnonzero(finer), np.flatnonzero(same), origin, width))
    pairs = np.concatenate(found)
    return pairs[np.lexsort(pairs.T[::-1])]


def _in_raster(one: Boxes, two: Boxes, mine: IntArray, theirs: IntArray, origin: FloatArray, width: float) -> IntArray:
    """The overlapping pairs of boxes ``mine`` of one set and ``theirs`` of the other, none wider than a cell."""
    if not (mine.size and theirs.size):
        return np.empty((0, 2), dtype=np.int64)
    cell, a = _registered(one, mine, origin, width)
    other, b = _registered(two, theirs, origin, width)
    keys = mixed(other)
    order = np.argsort(keys)
    other, b, keys = other[order], b[order], keys[order]
    wanted = mixed(cell)
    lower = np.searchsorted(keys, wanted)
    run, place = spans(np.searchsorted(keys, wanted, side="right") - lower)
    at = lower[run] + place
    low, high = np.maximum(one[0][a[run]], two[0][b[at]]), np.minimum(one[1][a[run]], two[1][b[at]])
    # Report each pair once, in the cell that contains the lowest corner of their intersection.
    once = (low <= high) & (cell[run] == other[at]) & (_cell(low, origin, width) == cell[run])
    kept = np.flatnonzero(once.all(axis=1))
    return np.stack([a[run[kept]], b[at[kept]]], axis=1)


def _cell(points: FloatArray, origin: FloatArray, width: float) -> IntArray:
    return np.asarray(np.floor((points - origin) / width).astype(np.int64))


def _registered(boxes: Boxes, some: IntArray, origin: FloatArray, width: float) -> tuple[IntArray, IntArray]:
    """All pairs of a raster cell (m, 3) and the number (m,) of a box of ``some`` that touches it."""
    low, high = (_cell(x[some], origin, width) for x in boxes)
    extent = high - low + 1
    run, place = spans(extent.prod(axis=1))
    i, rest = np.divmod(place, extent[run, 1] * extent[run, 2])
    j, k = np.divmod(rest, extent[run, 2])
    return low[run] + np.stack([i, j, k], axis=1), some[run]
