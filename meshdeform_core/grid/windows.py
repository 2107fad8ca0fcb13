"""Sets of face quads as rectangles of nodes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .blocks import Shape, Side, Window


def windows_of_quads(shape: Shape, block: int, side: Side, quads: NDArray[np.bool_]) -> list[Window]:
    """Rectangles that cover exactly the marked quads of a block face.

    Rows of marked quads are cut into runs, and equal runs of successive rows become one rectangle.

    Parameters
    ----------
    shape : of the block, in nodes
    quads : bool, the face's cells along ``side.tangential`` (one cell across the plane of a 2-D grid)
    """
    steps = np.diff(np.pad(quads, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, start = np.nonzero(steps == 1)
    stop = np.nonzero(steps == -1)[1]
    order = np.lexsort((row, stop, start))
    row, start, stop = row[order], start[order], stop[order]
    first = np.ones(len(row), bool)
    first[1:] = (start[1:] != start[:-1]) | (stop[1:] != stop[:-1]) | (row[1:] != row[:-1] + 1)
    begins = np.flatnonzero(first)
    lasts = np.append(begins[1:], len(row))[: len(begins)] - 1
    a, b = side.tangential
    # In a 2-D grid a face has one node, not two, across the single plane.
    more_a, more_b = int(shape[a] > 1), int(shape[b] > 1)
    return [
        Window(
            block,
            side,
            (int(row[begin]), int(start[begin])),
            (int(row[last]) + more_a, int(stop[begin]) - 1 + more_b),
        )
        for begin, last in zip(begins, lasts, strict=True)
    ]
