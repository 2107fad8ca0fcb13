"""Triangles of the cells of a surface."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import IntArray


def fans(connectivity: NDArray[Any], first: NDArray[Any], corners: NDArray[Any], strip: bool = False) -> IntArray:
    """Split polygons into triangle fans about their first corner, or triangle strips into triangles.

    Parameters
    ----------
    connectivity : node numbers of all cells, one after the other
    first, corners : (m,) index at which each cell begins, and its number of corners

    Returns
    -------
    (t, 3) node numbers; none for cells with fewer than three corners
    """
    count = np.maximum(corners - 2, 0)
    start = np.repeat(first, count)
    step = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    apex = start + step if strip else start
    return connectivity[np.stack([apex, start + step + 1, start + step + 2], axis=1)].astype(np.int64)


def grid_triangles(number: NDArray[Any]) -> IntArray:
    """Triangles of a plane of nodes, or of the six faces of a block, from its node numbers ``(ni, nj, nk)``."""
    if 1 in number.shape:
        faces = [number.squeeze(axis=number.shape.index(1))]
    else:
        faces = [np.take(number, end, axis=axis) for axis in range(3) for end in (0, -1)]
    quads = [np.stack([f[:-1, :-1], f[1:, :-1], f[1:, 1:], f[:-1, 1:]], axis=-1).reshape(-1, 4) for f in faces]
    return split_cells(np.concatenate(quads), 4)


def split_cells(cells: NDArray[Any], corners: int) -> IntArray:
    """Triangles of cells ``(m, nodes)`` whose first ``corners`` nodes are their corners."""
    m, nodes = cells.shape
    return fans(cells.ravel(), nodes * np.arange(m), np.full(m, corners))


def starts_of_list(entries: NDArray[Any]) -> IntArray:
    """Index at which each cell begins in a list ``n a b c ... n d e ...``; ends with the first that does not fit.

    Each entry is taken as the length of a jump to the next cell. The chain of jumps from the first entry is found by
    doubling: each round doubles the length of all jumps and the number of known cells.
    """
    size = len(entries)
    jump = np.append(np.arange(size) + 1 + np.clip(entries, 0, size), size)
    jump = np.minimum(jump, size)
    starts = np.zeros(1, dtype=np.int64)
    while starts[-1] < size:
        starts = np.concatenate([starts, jump[starts]])
        jump = jump[jump]
    return starts[starts < size]
