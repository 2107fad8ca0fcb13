"""Blocks cut at planes of nodes: into pieces, and into the sub-blocks of the methods."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .arrays import IntArray, Shapes, spans

_CELLS = 16
"""Cells between two planes at which a block may be divided: those of sub-blocks in large grids."""
_NODES = 1 << 17
"""Least number of nodes of a piece, if its block has so many."""


def pieces(shapes: Shapes) -> IntArray:
    """Rows (n, 3) block, first and one past the last plane i of the pieces of blocks with these ``shapes`` in nodes.

    Planes i, because the nodes of consecutive ones are consecutive rows of arrays with a row per node. The pieces
    follow from the shapes alone, because they decide the last bits of results.
    """
    ends = [_ends(int(ni), int(nj) * int(nk)) for ni, nj, nk in shapes]
    block, _ = spans(np.array([len(each) - 1 for each in ends]))
    first = np.concatenate([each[:-1] for each in ends])
    last = np.concatenate([each[1:] for each in ends])
    return np.stack([block, first, last], axis=1)


@lru_cache(maxsize=1024)
def _ends(planes: int, nodes: int) -> IntArray:
    """First plane of every piece of a block with so many planes of so many nodes, and the number of planes."""
    cuts = even_cuts(planes, _CELLS)
    together = max(-(-_NODES // (_CELLS * nodes)), 1)
    count = max((len(cuts) - 1) // together, 1)
    ends = cuts[np.round(np.linspace(0, len(cuts) - 1, count + 1)).astype(np.int64)]
    ends[-1] = planes
    return ends


def even_cuts(n: int, most: int, least: int = 1) -> IntArray:
    """Numbers of the planes, both ends included, at which ``n`` planes of nodes are cut into parts of at most ``most``
    cells; 0 cuts nothing. There are at least ``least`` parts.
    """
    if n == 1:
        return np.zeros(1, dtype=np.int64)
    cells = n - 1
    parts = max(-(-cells // most) if most else 1, least)
    # The same planes seen from either end: an odd number of cells has no middle plane to cut at.
    parts += cells % 2 == 1 and parts % 2 == 0
    return np.round(np.linspace(0, n - 1, parts + 1)).astype(np.int64)
