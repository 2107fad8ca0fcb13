"""Types of arrays and of what reports progress; reductions over many short rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KeyArray = NDArray[np.uint64]
BoolArray = NDArray[np.bool_]

Shapes = Sequence[tuple[int, int, int]] | IntArray
"""Numbers of nodes along i, j, k of blocks."""
Report = Callable[[int, int], None]
"""``report(done, total)``, called while a loop runs."""

_TOGETHER = 64


def extent(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates (3,) of points (..., 3).

    Many points side by side form a row: numpy reduces long rows much faster than short ones.
    """
    rows = np.ascontiguousarray(points).reshape(-1, 3)
    even = len(rows) // _TOGETHER * _TOGETHER
    long, rest = rows[:even].reshape(-1, 3 * _TOGETHER), rows[even:]
    if even:
        low, high = (extreme(long, axis=0).reshape(-1, 3) for extreme in (np.min, np.max))
        return np.concatenate([low, rest]).min(axis=0), np.concatenate([high, rest]).max(axis=0)
    return rest.min(axis=0), rest.max(axis=0)


def total(points: FloatArray) -> FloatArray:
    """Sum (3,) of points (n, 3), with long rows as in :func:`extent`."""
    even = len(points) // _TOGETHER * _TOGETHER
    rows = np.ascontiguousarray(points[:even]).reshape(-1, 3 * _TOGETHER)
    return np.asarray(rows.sum(axis=0).reshape(-1, 3).sum(axis=0) + points[even:].sum(axis=0))


def lengths(vectors: FloatArray) -> FloatArray:
    """Lengths (n,) of vectors (n, m): what ``numpy.linalg.norm`` gives, in a tenth of the time for short rows."""
    return np.asarray(np.sqrt(np.einsum("ni,ni->n", vectors, vectors)))


def distinct_pairs(pairs: IntArray) -> IntArray:
    """The different rows of pairs (n, 2) of non-negative integers, in lexicographical order."""
    if not len(pairs):
        return pairs
    base = int(pairs.max()) + 1
    # numpy's own search for distinct integers hashes them, which takes longer.
    keys = np.sort(pairs[:, 0] * base + pairs[:, 1])
    new = np.append(True, keys[1:] != keys[:-1])
    return np.stack(np.divmod(keys[new], base), axis=1)
