"""Types of arrays and of progress callbacks; reductions over many short rows."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from ..parallel import Nodes, for_chunks

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
KeyArray = NDArray[np.uint64]
BoolArray = NDArray[np.bool_]

Shapes = Sequence[tuple[int, int, int]] | IntArray
"""Numbers of nodes along i, j, k of blocks."""
Report = Callable[[int, int], None]
"""``report(done, total)``, called while a loop runs."""

_TOGETHER = 64
# Points reduced at a time: of arrays in files, pages are released in between.
_STRETCH = 1 << 22


def extent(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest coordinates (3,) of points (..., 3).

    Many points are reduced as one row, because numpy reduces long rows much faster than short ones.
    """
    nodes = Nodes.of(points)
    if nodes.divided:
        found = nodes.gather(extent(nodes.own) if len(nodes.own) else None)
        lows, highs = zip(*(each for each in found if each), strict=True)
        return np.min(lows, axis=0), np.max(highs, axis=0)
    rows = np.ascontiguousarray(points).reshape(-1, 3)
    if len(rows) > _STRETCH:
        ends = list[tuple[FloatArray, FloatArray]]()
        for_chunks(lambda lo, hi: ends.append(extent(rows[lo:hi])), len(rows), _STRETCH)
        lows, highs = zip(*ends, strict=True)
        return np.min(lows, axis=0), np.max(highs, axis=0)
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


def weighted_total(weights: FloatArray, rows: FloatArray) -> FloatArray:
    """Sum (k,) of ``rows`` (n, k) times their ``weights`` (n,).

    Not a matrix product, as the order in which a BLAS sums depends on the number of its threads.
    """
    found: FloatArray = np.einsum("n,nk->k", weights, rows)
    return found


def lengths(vectors: FloatArray) -> FloatArray:
    """Lengths (n,) of vectors (n, m): what ``numpy.linalg.norm`` gives, in a tenth of the time for short rows."""
    found: FloatArray = np.sqrt(np.einsum("ni,ni->n", vectors, vectors))
    return found


def spans(sizes: IntArray) -> tuple[IntArray, IntArray]:
    """For runs of the given sizes, laid end to end: the run of each item, and the item's position within that run."""
    run = np.repeat(np.arange(len(sizes)), sizes)
    start = np.cumsum(sizes) - sizes
    return run, np.arange(len(run)) - start[run]


def places_among(members: IntArray, count: int) -> IntArray:
    """Position (count,) of every number from 0 to ``count`` - 1 in ``members`` (n,), -1 for numbers not among them."""
    place = np.full(count, -1, dtype=np.int64)
    place[members] = np.arange(len(members))
    return place


def portions(sizes: IntArray, steps: IntArray) -> IntArray:
    """Divide n items of ``sizes`` (n,) into ranges of at most ``steps`` (n,) elements: rows (m, 3) item, first, end."""
    item, number = spans(-(-sizes // steps))
    first = number * steps[item]
    return np.stack([item, first, np.minimum(first + steps[item], sizes[item])], axis=1)


def runs(keys: IntArray) -> tuple[IntArray, IntArray]:
    """First (m,) and one past the last (m,) index of every run of equal ``keys`` (n,)."""
    first = np.flatnonzero(np.append(True, keys[1:] != keys[:-1])[: len(keys)])
    return first, np.append(first[1:], len(keys))[: len(first)]


def batches(sizes: IntArray, most: int) -> list[tuple[int, int]]:
    """Ranges ``lo, hi`` of items whose sizes add up to at most ``most``; a larger item is a range by itself."""
    ends = np.cumsum(sizes)
    found, lo = [], 0
    while lo < len(sizes):
        done = int(ends[lo - 1]) if lo else 0
        hi = max(int(np.searchsorted(ends, done + most, side="right")), lo + 1)
        found.append((lo, hi))
        lo = hi
    return found


def spread(sizes: IntArray, most: int, first: IntArray | None = None) -> tuple[IntArray, IntArray]:
    """At most ``most`` positions, spread evenly over each of several runs of the given sizes, both ends included.

    Returns the run of each position, and the position itself: ``numpy.linspace(first, first + size - 1,
    min(size, most))``, rounded down, where ``first`` is the first position of the run (0).
    """
    begin = np.zeros(len(sizes), dtype=np.int64) if first is None else first
    taken = np.minimum(sizes, most)
    run, number = spans(taken)
    step = (sizes - 1) / np.maximum(taken - 1, 1)
    place = (number * step[run] + begin[run]).astype(np.int64)
    last = (number == taken[run] - 1) & (number > 0)
    return run, np.where(last, begin[run] + sizes[run] - 1, place)


def medians(values: FloatArray, run: IntArray, count: int, empty: float) -> FloatArray:
    """Median (count,) of every run, ``empty`` for runs without values; ``run`` (n,) is the run of each value (n,)."""
    sizes = np.bincount(run, minlength=count)
    start = np.cumsum(sizes) - sizes
    ordered = np.append(values[np.lexsort((values, run))], empty)
    lower, upper = (ordered[np.where(sizes > 0, start + half, -1)] for half in ((sizes - 1) // 2, sizes // 2))
    return np.asarray(0.5 * (lower + upper))


def distinct_rows(keys: IntArray) -> IntArray:
    """Ascending indices of the first of each set of equal rows of ``keys`` (n, m)."""
    order = np.lexsort(keys.T)
    new = np.ones(len(order), dtype=bool)
    new[1:] = (keys[order[1:]] != keys[order[:-1]]).any(axis=1)
    return np.sort(order[new])


def distinct_pairs(pairs: IntArray) -> IntArray:
    """The different rows of pairs (n, 2) of non-negative integers, in lexicographical order."""
    if not len(pairs):
        return pairs
    base = int(pairs.max()) + 1
    # numpy.unique hashes integers, which takes longer.
    keys = np.sort(pairs[:, 0].astype(np.int64) * base + pairs[:, 1])
    new = np.append(True, keys[1:] != keys[:-1])
    return np.stack(np.divmod(keys[new], base), axis=1).astype(pairs.dtype, copy=False)
