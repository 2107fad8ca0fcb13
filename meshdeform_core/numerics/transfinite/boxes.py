"""Lists and copies of the nodes of sub-blocks; the table ``subs`` of sub-blocks is described in :mod:`.arcs`."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray, IntArray
from ..jit import inlined, kernel
from ..rows import take_rows


def inner_numbers(subs: IntArray) -> IntArray:
    """Number of nodes inside each sub-block; along an axis one node thick, in 2-D, that node counts as inside."""
    across = subs[:, 7:10] - subs[:, 4:7]
    return np.asarray(np.where(across > 0, across - 1, 1).prod(axis=1))


def box_numbers(subs: IntArray) -> IntArray:
    """Number of nodes of each sub-block, including its faces."""
    return np.asarray((subs[:, 7:10] - subs[:, 4:7] + 1).prod(axis=1))


def box_nodes(subs: IntArray, inside: bool = False) -> IntArray:
    """Flat indices of the nodes of sub-blocks, or of those inside, one sub-block after the other."""
    numbers = inner_numbers(subs) if inside else box_numbers(subs)
    nodes = np.empty(int(numbers.sum()), dtype=np.int64)
    _list_nodes(subs, inside, nodes)
    return nodes


def apart(points: FloatArray, subs: IntArray) -> tuple[FloatArray, IntArray]:
    """Copies (n, 3) of the coordinates of sub-blocks, each turned into a block, and the table that describes them."""
    nodes, table = box_nodes(subs), subs.copy()
    copies = np.empty((len(nodes), 3))
    take_rows(points, nodes, copies)
    numbers = box_numbers(subs)
    table[:, 0] = np.cumsum(numbers) - numbers
    table[:, 7:10] -= subs[:, 4:7]
    table[:, 1:4], table[:, 4:7] = table[:, 7:10] + 1, 0
    return copies, table


@inlined
def inner(low, high):
    """First inner node along an index and one past the last."""
    return (low + 1, high) if high > low else (low, low + 1)


@kernel
def _list_nodes(subs, inside, nodes):
    at = 0
    for n in range(subs.shape[0]):
        i0, i1 = subs[n, 4], subs[n, 7] + 1
        j0, j1 = subs[n, 5], subs[n, 8] + 1
        k0, k1 = subs[n, 6], subs[n, 9] + 1
        if inside:
            i0, i1 = inner(subs[n, 4], subs[n, 7])
            j0, j1 = inner(subs[n, 5], subs[n, 8])
            k0, k1 = inner(subs[n, 6], subs[n, 9])
        for i in range(i0, i1):
            for j in range(j0, j1):
                node = subs[n, 0] + (i * subs[n, 2] + j) * subs[n, 3]
                for k in range(k0, k1):
                    nodes[at] = node + k
                    at += 1
