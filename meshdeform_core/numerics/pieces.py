"""Blocks cut at planes of nodes: into pieces, and into the sub-blocks of the methods."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from .arrays import IntArray, Shapes, spans

_CELLS = 16
"""Cells between two planes at which a block may be divided: as many as sub-blocks have in large grids."""
_NODES = 1 << 17
"""Smallest number of nodes in a piece, if its block has that many."""


def pieces(shapes: Shapes) -> IntArray:
    """Pieces of blocks with these ``shapes`` in nodes: rows (n, 3) of block, first and one past the last i plane.

    Blocks are cut along i because consecutive i planes are consecutive rows of arrays with a row per node. The pieces
    follow from the shapes alone, as they determine the last bits of results.
    """
    ends = [_ends(int(ni), int(nj) * int(nk)) for ni, nj, nk in shapes]
    block, _ = spans(np.array([len(each) - 1 for each in ends]))
    first = np.concatenate([each[:-1] for each in ends])
    last = np.concatenate([each[1:] for each in ends])
    return np.stack([block, first, last], axis=1)


def bounds_of(shapes: Shapes, count: int) -> IntArray:
    """First row (count + 1,) of each of several ranks, and the number of all rows: the largest part is as small as it
    can be."""
    if count == 1:
        return np.array([0, sum(map(math.prod, shapes))], dtype=np.int64)
    block, first, last = pieces(shapes).T
    ends = np.append(0, np.cumsum((last - first) * np.prod(shapes, axis=1)[block] // np.array(shapes)[block, 0]))
    few, many = -(-int(ends[-1]) // count), int(ends[-1])
    while few < many:
        most = (few + many) // 2
        few, many = (few, most) if _dealt(ends, most, count)[-1] == ends[-1] else (most + 1, many)
    return _dealt(ends, many, count)


def _dealt(ends: IntArray, most: int, count: int) -> IntArray:
    """First rows if no rank takes more than ``most`` rows; pieces that are left over remain beyond the last one."""
    found = [0]
    for _ in range(count):
        found.append(int(ends[np.searchsorted(ends, found[-1] + most, side="right") - 1]))
    return np.array(found)


@lru_cache(maxsize=1024)
def _ends(planes: int, nodes: int) -> IntArray:
    """First plane of every piece of a block of ``planes`` planes with ``nodes`` nodes each, and the end of the last."""
    cuts = even_cuts(planes, _CELLS)
    together = max(-(-_NODES // (_CELLS * nodes)), 1)
    count = max((len(cuts) - 1) // together, 1)
    ends = cuts[np.round(np.linspace(0, len(cuts) - 1, count + 1)).astype(np.int64)]
    ends[-1] = planes
    return ends


def even_cuts(n: int, most: int, least: int = 1) -> IntArray:
    """Planes, both ends included, at which ``n`` planes of nodes are cut into parts of at most ``most`` cells.

    There are at least ``least`` parts; ``most`` = 0 sets no limit.
    """
    if n == 1:
        return np.zeros(1, dtype=np.int64)
    cells = n - 1
    parts = max(-(-cells // most) if most else 1, least)
    # The cuts must be the same counted from either end: an odd number of cells has no middle plane to cut at.
    parts += cells % 2 == 1 and parts % 2 == 0
    return np.round(np.linspace(0, n - 1, parts + 1)).astype(np.int64)
