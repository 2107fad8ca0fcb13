"""Sub-blocks: their nodes, and the arc-length coordinates of those inside (Sen et al. eq. 10), from 0 to 1 within each.

Rows of a table ``subs`` (n, 11) describe sub-blocks: first node (1) and shape (3) of the block, low (3) and high (3)
node of the sub-block, start (1) of its coordinates in an array laid out as :func:`arc_numbers` says.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir

from ..arrays import FloatArray, IntArray, portions, spans
from ..jit import inlined, kernel
from ..lanes import WIDTH, Array, Lanes, components, lanes

TILE = WIDTH
"""Nodes along k that are processed together, so that the data they share stay in the cache."""
_PART = 65536
# Vectors of the work array: length so far; one over the whole length, or zero for lines of zero length.
_LENGTH, _INVERSE = 0, WIDTH


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
    :func:`arc_numbers`; coordinates are uniform on lines of zero length."""
    work = np.empty(2 * WIDTH)
    for part in range(parts.shape[0]):
        n = parts[part, 0]
        si, sj = subs[n, 2] * subs[n, 3], subs[n, 3]
        corner = subs[n, 0] + subs[n, 4] * si + subs[n, 5] * sj + subs[n, 6]
        ni, nj, nk = subs[n, 7] - subs[n, 4] - 1, subs[n, 8] - subs[n, 5] - 1, subs[n, 9] - subs[n, 6] - 1
        first, last = parts[part, 2], parts[part, 3]
        if parts[part, 1] == 0:
            width = min(TILE, padded(nk) - first)
            at = subs[n, 10] + tile_start(0, 0, first, nj, nk)
            # All lines along i that cross a plane, then those along j; a tile of them together.
            for q in range(nj + ni):
                if q < nj:
                    node, step, length = corner + (q + 1) * sj + first + 1, si, ni
                    to, apart = at + 3 * q * width, 3 * nj * padded(nk)
                else:
                    node, step, length = corner + (q - nj + 1) * si + first + 1, sj, nj
                    to, apart = at + 3 * nj * (q - nj) * padded(nk) + width, 3 * width
                for k in range(WIDTH):
                    work[k] = 0.0
                for m in range(length + 1):
                    one = 3 * (node + m * step)
                    # The last edge adds to the total length only.
                    kept = width if m < length else 0
                    lengthen(points, one, one + 3 * step, 3 * (last - first), work, arc, to + m * apart, kept)
                invert(work)
                for m in range(length):
                    normalise(arc, to + m * apart, width, work, (m + 1) / (length + 1))
        else:
            for i in range(first, last):
                for j in range(nj):
                    node = corner + (i + 1) * si + (j + 1) * sj
                    for k in range(WIDTH):
                        work[k] = 0.0
                    for k0 in range(0, nk + 1, TILE):
                        width, at = min(TILE, padded(nk) - k0), 3 * (node + k0)
                        to = subs[n, 10] + tile_start(i, j, k0, nj, nk) + 2 * width
                        add_up(points, at, at + 3, 3 * min(TILE, nk + 1 - k0), work, arc, to, width)
                    invert(work)
                    for k0 in range(0, nk, TILE):
                        width = min(TILE, padded(nk) - k0)
                        to = subs[n, 10] + tile_start(i, j, k0, nj, nk) + 2 * width
                        normalise(arc, to, width, work, (k0 + 1) / (nk + 1))
                        if work[_INVERSE] == 0.0:
                            for k in range(min(TILE, nk - k0)):
                                arc[to + k] = (k0 + k + 1) / (nk + 1)


def _edge_lengths(points: Array, one: ir.Value, other: ir.Value, count: ir.Value) -> Lanes:
    """Distances between sixteen pairs of points; only ``count`` coordinates are read, the others count as zero."""
    here, there = (points.load_some_points(at, count) for at in (one, other))
    x, y, z = components([b - a for a, b in zip(here, there, strict=True)])
    return (x * x + y * y + z * z).sqrt()


@lanes
def lengthen(
    points: Array, one: ir.Value, other: ir.Value, count: ir.Value, work: Array, arc: Array, to: ir.Value,
    width: ir.Value,
) -> None:  # fmt: skip
    """Add an edge to each of sixteen lines."""
    length = work.load(ir.Constant(to.type, _LENGTH)) + _edge_lengths(points, one, other, count)
    work.store(ir.Constant(to.type, _LENGTH), length)
    arc.store_some(to, length, width)


@lanes
def add_up(
    points: Array, one: ir.Value, other: ir.Value, count: ir.Value, work: Array, arc: Array, to: ir.Value,
    width: ir.Value,
) -> None:  # fmt: skip
    """Running lengths over sixteen consecutive edges of a line; ``work`` holds the length so far, sixteen times."""
    length = work.load(ir.Constant(to.type, _LENGTH)) + _edge_lengths(points, one, other, count).running_sum()
    work.store(ir.Constant(to.type, _LENGTH), length.last())
    arc.store_some(to, length, width)


@lanes
def invert(work: Array) -> None:
    """One over the lengths; zero for lines of zero length."""
    start = ir.Constant(ir.IntType(64), 0)
    length = work.load(start, _LENGTH)
    work.store(start, (length * 0.0).below(length).choose(1.0 / length, 0.0), _INVERSE)


@lanes
def normalise(arc: Array, at: ir.Value, width: ir.Value, work: Array, uniform: Lanes) -> None:
    """Coordinates from lengths; ``uniform`` on lines of zero length."""
    inverse = work.load(ir.Constant(at.type, 0), _INVERSE)
    long = (inverse * 0.0).below(inverse)
    arc.store_some(at, long.choose(arc.load_some(at, width) * inverse, uniform), width)
