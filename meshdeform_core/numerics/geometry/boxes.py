"""Trees of axis-parallel boxes cut at medians, and which boxes overlap.

Plain numpy, level by level: ``meshdeform info`` imports no numba, and a first run compiles nothing here.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray

Boxes = tuple[FloatArray, FloatArray]
"""Smallest and largest coordinates, (n, 3) each."""

_TOGETHER = 1 << 14
"""Pairs of boxes compared at a time, which bounds the memory."""
LEAF = 8
"""Boxes at the end of the tree that are searched one by one; a power of two."""


def levels_of(low: FloatArray, high: FloatArray) -> list[Boxes]:
    """The boxes (3, 2^l) of each level l of a balanced binary tree over boxes (n, 3) in the order of :func:`halves`.

    Box n of a level contains the boxes 2 n and 2 n + 1 of the next one; those without content are inside out.
    """
    depth = depth_of(len(low))
    found = [(_leaves(low, depth, np.inf), _leaves(high, depth, -np.inf))]
    for _ in range(depth):
        low, high = found[-1]
        found.append((np.minimum(low[:, ::2], low[:, 1::2]), np.maximum(high[:, ::2], high[:, 1::2])))
    return found[::-1]


def depth_of(count: int) -> int:
    """Number of levels below the root of a tree over so many boxes."""
    return max(0, count - 1).bit_length()


def _leaves(values: NDArray[Any], depth: int, rest: float) -> NDArray[Any]:
    leaves = np.full((values.shape[1], 1 << depth), rest, dtype=values.dtype)
    leaves[:, : len(values)] = values.T
    return leaves


def overlapping(low: FloatArray, high: FloatArray, asked: BoolArray) -> IntArray:
    """Pairs (2, m) of boxes (n, 3) with a point in common, at least one of them ``asked`` (n,); in no order.

    The boxes are in the order of :func:`halves`, at least nearly.
    """
    levels, active = levels_of(low, high), [_leaves(asked[:, None], depth_of(len(low)), False)[0]]
    for _ in levels[1:]:
        active.append(active[-1][::2] | active[-1][1::2])
    waiting: list[tuple[int, NDArray[np.int64]]] = [(0, np.zeros((2, 1), dtype=np.int64))]
    found = [np.empty((2, 0), dtype=np.int64)]
    while waiting:
        level, pairs = waiting.pop()
        if pairs.shape[1] > _TOGETHER:
            waiting.append((level, pairs[:, _TOGETHER:]))
            pairs = pairs[:, :_TOGETHER]
        (one, two), some = pairs, active[-1 - level]
        near = some.take(one) | some.take(two)
        for least, most in zip(*levels[level], strict=True):
            near &= least.take(one) <= most.take(two)
            near &= least.take(two) <= most.take(one)
        if level == len(levels) - 1:
            found.append(pairs.compress(near & (one != two), axis=1))
            continue
        first = 2 * pairs.compress(near, axis=1)
        second = first.compress(first[0] != first[1], axis=1) + [[1], [0]]
        waiting.append((level + 1, np.concatenate([first, first + [[0], [1]], first + 1, second], axis=1)))
    return np.concatenate(found, axis=1)


def overlapping_boxes(one: Boxes, two: Boxes) -> IntArray:
    """All pairs (m, 2) of a box of ``one`` and a box of ``two`` that have a point in common, in ascending order."""
    low, high = (np.concatenate([one[end], two[end]]) for end in (0, 1))
    order = halves(0.5 * (low + high))
    pairs = np.sort(order[overlapping(low[order], high[order], order < len(one[0]))], axis=0).T
    pairs = pairs[(pairs[:, 0] < len(one[0])) & (pairs[:, 1] >= len(one[0]))]
    pairs[:, 1] -= len(one[0])
    return np.asarray(pairs[np.lexsort(pairs.T[::-1])])


def halves(places: FloatArray) -> IntArray:
    """Order of places (n, 3) in which every third level of boxes of the tree is cut into eight equal numbers across
    their longest sides. To find halves at every level takes three times as long and makes searches no faster."""
    count, every = len(places), np.arange(len(places))
    order, size = every, 1 << depth_of(count)
    while size > LEAF:
        x, box, start = places[order], every // size, np.arange(0, count, size)
        low = np.minimum.reduceat(x, start)
        extent = np.maximum.reduceat(x, start) - low
        axis = extent.argmax(axis=1)
        along = (x[every, axis[box]] - low[box, axis[box]]) / np.maximum(extent.max(axis=1), 1e-300)[box]
        # Half of it, so that the places of each box precede those of the next.
        order = order[np.argsort(box + 0.5 * along)]
        size //= 8
    return order
