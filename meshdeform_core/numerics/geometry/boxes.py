"""A tree of axis-parallel boxes along a space-filling curve, and which boxes overlap.

Plain numpy, level by level: ``meshdeform info`` imports no numba, and a first run compiles nothing here.
"""

from __future__ import annotations

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray, KeyArray

Boxes = tuple[FloatArray, FloatArray]
"""Smallest and largest coordinates, (n, 3) each."""

_TOGETHER = 1 << 16
"""Pairs of boxes compared at a time, which bounds the memory."""


class BoxTree:
    """A balanced binary tree over places, whose boxes may change: it remains efficient while neighbours stay such.

    Box n of level l contains the boxes 2 n and 2 n + 1 of level l + 1; those of the last level hold one place each, in
    the order of the curve.

    Attributes
    ----------
    order : (n,) the places along the curve
    depth : number of levels below the root
    """

    def __init__(self, places: FloatArray):
        self.order = _curve(places)
        self.depth = max(0, len(places) - 1).bit_length()

    def levels(self, low: FloatArray, high: FloatArray) -> list[Boxes]:
        """Boxes (3, 2^l) of all levels l from those (n, 3) of the places; boxes without places are inside out."""
        found = [(self._leaves(low, np.inf), self._leaves(high, -np.inf))]
        for _ in range(self.depth):
            low, high = found[-1]
            found.append((np.minimum(low[:, ::2], low[:, 1::2]), np.maximum(high[:, ::2], high[:, 1::2])))
        return found[::-1]

    def _leaves(self, values: NDArray[Any], rest: float) -> NDArray[Any]:
        leaves = np.full((values.shape[1], 1 << self.depth), rest, dtype=values.dtype)
        leaves[:, : len(values)] = values.T[:, self.order]
        return leaves

    def overlapping(self, low: FloatArray, high: FloatArray, asked: BoolArray) -> IntArray:
        """Pairs (m, 2) of different boxes (n, 3) with a point in common, at least one of them ``asked`` (n,).

        The smaller number comes first; rows are not sorted.
        """
        if len(low) < 2:
            return np.empty((0, 2), dtype=np.int64)
        levels, active = self.levels(low, high), [self._leaves(asked[:, None], False)[0]]
        for _ in range(self.depth):
            active.append(active[-1][::2] | active[-1][1::2])
        root = np.zeros(1, dtype=np.int64)
        waiting, found = [(0, root, root)], [np.empty((0, 2), dtype=np.int64)]
        while waiting:
            level, a, b = waiting.pop()
            if len(a) > _TOGETHER:
                waiting.append((level, a[_TOGETHER:], b[_TOGETHER:]))
                a, b = a[:_TOGETHER], b[:_TOGETHER]
            some, (least, most) = active[self.depth - level], levels[level]
            a, b = _chosen(some[a] | some[b], a, b)
            for axis in range(3):
                meet = (least[axis][a] <= most[axis][b]) & (least[axis][b] <= most[axis][a])
                a, b = _chosen(meet, a, b)
            if level == self.depth:
                pairs = self.order[np.stack(_chosen(a != b, a, b), axis=1)]
                found.append(np.sort(pairs, axis=1))
                continue
            both = np.concatenate([2 * a, 2 * a, 2 * a + 1, (2 * a + 1)[a != b]])
            other = np.concatenate([2 * b, 2 * b + 1, 2 * b + 1, (2 * b)[a != b]])
            waiting.append((level + 1, both, other))
        return np.concatenate(found)


def _chosen(some: BoolArray, *arrays: IntArray) -> list[IntArray]:
    return [array[some] for array in arrays]


def overlapping_boxes(one: Boxes, two: Boxes) -> IntArray:
    """All pairs (m, 2) of a box of ``one`` and a box of ``two`` that have a point in common, in ascending order."""
    low, high = (np.concatenate([one[end], two[end]]) for end in (0, 1))
    first = np.arange(len(low)) < len(one[0])
    pairs = BoxTree(0.5 * (low + high)).overlapping(low, high, first)
    pairs = pairs[(pairs[:, 0] < len(one[0])) & (pairs[:, 1] >= len(one[0]))]
    pairs[:, 1] -= len(one[0])
    return np.asarray(pairs[np.lexsort(pairs.T[::-1])])


def _curve(places: FloatArray) -> IntArray:
    """Order of places (n, 3) along a space-filling (Morton) curve, on a lattice refined where they are dense."""
    if not len(places):
        return np.empty(0, dtype=np.int64)
    key = places - np.median(places, axis=0)
    key /= 1e-3 * max(float(np.median(np.maximum(key.max(axis=1), -key.min(axis=1)))), 1e-300)
    np.arcsinh(key, out=key)
    key -= key.min(axis=0)
    most = max(float(key.max()), 1e-300)
    key *= (1 << 21) - 1
    key /= most
    return np.argsort(_morton(key.astype(np.uint64)))


def _morton(index: KeyArray) -> KeyArray:
    """Bits of three numbers (n, 3) below 2^21 interleaved."""
    spread = (
        (32, 0x1F00000000FFFF),
        (16, 0x1F0000FF0000FF),
        (8, 0x100F00F00F00F00F),
        (4, 0x10C30C30C30C30C3),
        (2, 0x1249249249249249),
    )
    parts = []
    for axis in range(3):
        x = index[:, axis]
        for shift, mask in spread:
            x = (x | x << np.uint64(shift)) & np.uint64(mask)
        parts.append(x << np.uint64(axis))
    return reduce(np.bitwise_or, parts)
