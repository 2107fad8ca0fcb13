"""Where the derivatives of elements go: the rows of the unknowns in a block-sparse matrix."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...jit import inlined, record


@record("i8[::1], f8[:, :, ::1], b1[::1]")
class Unknowns(NamedTuple):
    """The unknowns of a region's n nodes: ``number`` (n,), the unknown of each node or -1; ``frame`` (n, d, d), with
    displacement = frame @ unknown; ``plain`` (n,), whether the frame is the identity."""

    number: np.ndarray
    frame: np.ndarray
    plain: np.ndarray


@inlined
def add_element(nodes, c, corners, d, found, lane, force, work, unknowns, rows, matrix, gradient):
    """Add the derivatives of an element to the rows of its unknowns; see :func:`.hexahedra.add_derivatives`.

    ``nodes[c]`` are its ``corners``, in ``d`` dimensions; ``found[lane]``: the second derivatives (d, d) for pairs of
    nodes in ascending order, from the entry ``force`` on the first ones (m, d); ``work`` (3, 3) is room.
    """
    number, frame, plain = unknowns
    first = 0
    for n in range(corners):
        here = nodes[c, n]
        row = number[here]
        if row >= rows[0] and row < rows[1]:
            for i in range(d):
                for k in range(d):
                    gradient[row, i] += frame[here, k, i] * found[lane, force + d * n + k]
        for o in range(n, corners):
            there = nodes[c, o]
            column = number[there]
            if row >= 0 and column >= 0:
                if not (plain[here] and plain[there]):
                    _turn(frame, here, there, d, found, lane, first, work)
                at = _place_of(row, column, rows)
                if at >= 0:
                    for i in range(d):
                        for k in range(d):
                            matrix[at, i, k] += found[lane, first + d * i + k]
                at = _place_of(column, row, rows) if n != o else -1
                if at >= 0:
                    for i in range(d):
                        for k in range(d):
                            matrix[at, i, k] += found[lane, first + d * k + i]
            first += d * d


@inlined
def _turn(frame, one, two, d, found, lane, first, work):
    """``B = F^T B G`` for the matrix B (d, d) of numbers of ``found`` and the frames F, G of nodes ``one``, ``two``."""
    for i in range(d):
        for k in range(d):
            work[i, k] = 0.0
            for e in range(d):
                work[i, k] += frame[one, e, i] * found[lane, first + d * e + k]
    for i in range(d):
        for k in range(d):
            total = 0.0
            for e in range(d):
                total += work[i, e] * frame[two, e, k]
            found[lane, first + d * i + k] = total


@inlined
def _place_of(row, column, rows):
    """Where the block of a row and a column is, -1 if the row is not one of ``rows``."""
    first, last, starts, columns = rows
    if row < first or row >= last:
        return -1
    low, high = starts[row], starts[row + 1]
    while high - low > 1:
        middle = (low + high) // 2
        if columns[middle] <= column:
            low = middle
        else:
            high = middle
    return low - starts[first]
