"""Lists and copies of the nodes of sub-blocks; the table ``subs`` of sub-blocks is described in :mod:`.arcs`."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray, spans


def inner_numbers(subs: IntArray) -> IntArray:
    """Number of nodes inside each sub-block; along an axis one node thick, in 2-D, that node counts as inside."""
    across = subs[:, 7:10] - subs[:, 4:7]
    return np.asarray(np.where(across > 0, across - 1, 1).prod(axis=1))


def box_numbers(subs: IntArray) -> IntArray:
    """Number of nodes of each sub-block, including its faces."""
    return np.asarray((subs[:, 7:10] - subs[:, 4:7] + 1).prod(axis=1))


def box_nodes(subs: IntArray, inside: bool = False) -> IntArray:
    """Flat indices of the nodes of sub-blocks, or of those inside, one sub-block after the other."""
    low, count = subs[:, 4:7], subs[:, 7:10] - subs[:, 4:7] + 1
    if inside:
        low, count = low + (count > 1), np.where(count > 1, count - 2, 1)
    sub, place = spans(count.prod(axis=1))
    rest, k = np.divmod(place, count[sub, 2])
    i, j = np.divmod(rest, count[sub, 1])
    first = subs[:, 0] + (low[:, 0] * subs[:, 2] + low[:, 1]) * subs[:, 3] + low[:, 2]
    return np.asarray(first[sub] + (i * subs[sub, 2] + j) * subs[sub, 3] + k)


def apart(points: FloatArray, subs: IntArray) -> tuple[FloatArray, IntArray]:
    """Copies (n, 3) of the coordinates of sub-blocks, each turned into a block, and the table that describes them."""
    table, ends = subs.copy(), np.append(0, np.cumsum(box_numbers(subs)))
    copies = np.empty((ends[-1], 3))
    for row, lo, hi in zip(subs.tolist(), ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        start, *shape = row[:4]
        block = points[start : start + shape[0] * shape[1] * shape[2]].reshape(*shape, 3)
        some = block[tuple(slice(a, b + 1) for a, b in zip(row[4:7], row[7:10], strict=True))]
        copies[lo:hi].reshape(some.shape)[...] = some
    table[:, 0] = ends[:-1]
    table[:, 7:10] -= subs[:, 4:7]
    table[:, 1:4], table[:, 4:7] = table[:, 7:10] + 1, 0
    return copies, table
