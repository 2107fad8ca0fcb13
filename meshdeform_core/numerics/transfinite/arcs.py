"""Sub-blocks: their nodes, and the arc-length coordinates of those inside (Sen et al. eq. 10), from 0 to 1 within each.

Rows of a table ``subs`` (n, 11) describe sub-blocks: first node (1) and shape (3) of the block, low (3) and high (3)
node of the sub-block, start (1) of its coordinates in an array laid out as :func:`arc_numbers` says.
"""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray, IntArray, portions, spans
from ..jit import inlined, kernel
from ..lanes import WIDTH

TILE = WIDTH
"""Nodes along k that are processed together, so that the data they share stay in the cache."""
_PART = 65536


@inlined
def padded(count):
    """``count`` rounded up to a multiple of four, the width of a vector register, so that loops have no scalar end."""
    return (count + 3) // 4 * 4


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


def arc_numbers(subs: IntArray) -> IntArray:
    """Length of the arc-coordinate array of each sub-block.

    Coordinates of interior nodes are stored in the order of use: for every i plane, for every tile along k, for every
    line of the tile, the coordinates along i of its nodes, then along j, then along k, each padded to whole vectors.
    """
    inside = np.maximum(subs[:, 7:10] - subs[:, 4:7] - 1, 0)
    return 3 * inside[:, 0] * inside[:, 1] * (-(-inside[:, 2] // 4) * 4)


def arc_parts(subs: IntArray) -> IntArray:
    """Units of work (m, 4) that threads share: sub-block, kind, from, to.

    Kind 0: the coordinates along i and j of nodes from .. to along k; kind 1: those along k of i planes from .. to.
    """
    inside = np.maximum(subs[:, 7:10] - subs[:, 4:7] - 1, 0)
    planes = np.maximum(_PART // np.maximum(inside[:, 1] * inside[:, 2], 1), 1)
    both = portions(inside[:, 2], np.full(len(subs), TILE)), portions(inside[:, 0], planes)
    parts = np.concatenate([np.insert(part, 1, kind, axis=1) for kind, part in enumerate(both)])
    return np.asarray(parts[np.argsort(parts[:, 0], kind="stable")])


@inlined
def tile_start(i, j, first, nj, nk):
    """Start of the coordinates of line (i, j), counted from 0, of the tile that begins at k = ``first``.

    A plane has nj lines of nk interior nodes.
    """
    return 3 * (nj * (i * padded(nk) + first) + j * min(TILE, padded(nk) - first))


@kernel("f8[:, ::1], i8[:, ::1], i8[:, ::1], f8[::1]")
def arc_coordinates(points, subs, parts, arc):
    """Normalised arc lengths of the nodes inside sub-blocks, by ``parts``, rows of :func:`arc_parts`, into ``arc``, see
    :func:`arc_numbers`; coordinates are uniform on lines of zero length, and zero where they are padded."""
    total = np.empty(TILE)
    for part in range(parts.shape[0]):
        n = parts[part, 0]
        si, sj = subs[n, 2] * subs[n, 3], subs[n, 3]
        corner = subs[n, 0] + subs[n, 4] * si + subs[n, 5] * sj + subs[n, 6]
        ni, nj, nk = subs[n, 7] - subs[n, 4] - 1, subs[n, 8] - subs[n, 5] - 1, subs[n, 9] - subs[n, 6] - 1
        first, last = parts[part, 2], parts[part, 3]
        if parts[part, 1] == 0:
            width, count = min(TILE, padded(nk) - first), last - first
            at = subs[n, 10] + tile_start(0, 0, first, nj, nk)
            # All lines along i that cross a plane, then those along j; a tile of them together.
            for q in range(nj + ni):
                if q < nj:
                    node, step, length = corner + (q + 1) * sj + first + 1, si, ni
                    to, apart = at + 3 * q * width, 3 * nj * padded(nk)
                else:
                    node, step, length = corner + (q - nj + 1) * si + first + 1, sj, nj
                    to, apart = at + 3 * nj * (q - nj) * padded(nk) + width, 3 * width
                total[:] = 0.0
                for m in range(length + 1):
                    for k in range(count):
                        one = node + m * step + k
                        total[k] += _distance(points, one, one + step)
                    # The last edge adds to the total length only.
                    for k in range(width if m < length else 0):
                        arc[to + m * apart + k] = total[k]
                for k in range(count):
                    total[k] = 1.0 / total[k] if total[k] > 0.0 else 0.0
                for m in range(length):
                    for k in range(count):
                        place = to + m * apart + k
                        arc[place] = arc[place] * total[k] if total[k] > 0.0 else (m + 1) / (length + 1)
        else:
            for i in range(first, last):
                for j in range(nj):
                    node, length = corner + (i + 1) * si + (j + 1) * sj, 0.0
                    for k in range(nk + 1):
                        length += _distance(points, node + k, node + k + 1)
                    inverse, length = 1.0 / length if length > 0.0 else 0.0, 0.0
                    for k0 in range(0, nk, TILE):
                        width = min(TILE, padded(nk) - k0)
                        to = subs[n, 10] + tile_start(i, j, k0, nj, nk) + 2 * width
                        for k in range(width):
                            place = node + k0 + k
                            arc[to + k] = 0.0
                            if k0 + k < nk:
                                length += _distance(points, place, place + 1)
                                arc[to + k] = length * inverse if inverse > 0.0 else (k0 + k + 1) / (nk + 1)


@inlined
def _distance(points, one, other):
    """Distance between two rows of ``points`` (n, 3)."""
    x, y, z = points[other, 0] - points[one, 0], points[other, 1] - points[one, 1], points[other, 2] - points[one, 2]
    return math.sqrt(x * x + y * y + z * z)
