"""Bricks and regions of target nodes, built once per undeformed grid; :mod:`.tree` does the same for sources."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from ....parallel import for_chunks, rows_at
from ...arrays import BoolArray, FloatArray, IntArray
from ...jit import inlined, kernel
from ...pieces import pieces
from ..tuned import REGION
from .boxes import Boxes, extents, fit_boxes, make_boxes


class Bricks(NamedTuple):
    """Target nodes in compact groups that follow the grid's own order.

    Attributes
    ----------
    start : (b + 1,) start of each brick in ``targets``
    targets : (n,) flat node indices
    boxes : around the targets of each brick
    """

    start: np.ndarray
    targets: np.ndarray
    boxes: Boxes


class Regions(NamedTuple):
    """Groups of neighbouring bricks for which the same clusters of sources are far.

    Attributes
    ----------
    first : (g + 1,) number of each region's first brick
    boxes : around the targets and the interpolation points of the bricks of each region
    """

    first: np.ndarray
    boxes: Boxes


def build_bricks(
    points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray, order: int, capacity: int
) -> tuple[Bricks, IntArray]:
    """Cut the index range of every piece of a block into bricks of at most about ``capacity`` targets, in regions.

    Index ranges are halved along the direction in which they are longest in space, so that bricks are compact although
    cells are stretched. A region is such a range with about ``REGION`` bricks. Pieces are those of :mod:`...pieces`, so
    bricks do not depend on which other parts of the grid are evaluated, or held by this rank.

    Parameters
    ----------
    points : (n_nodes, 3)
    shapes : (n_blocks, 3) int64, nodes
    offsets : (n_blocks + 1,) int64
    flat : (n,) the target nodes, ascending

    Returns
    -------
    bricks : :class:`Bricks`
    first : (g + 1,) number of each region's first brick
    """
    block, low, high = pieces(shapes).T
    rows = offsets[block] + np.stack([low, high]) * shapes[block, 1:].prod(axis=1)
    begin, end = np.searchsorted(flat, rows)
    found = np.flatnonzero(end > begin)
    cuts: dict[int, tuple[IntArray, IntArray, IntArray]] = {}

    def cut(number: int, _: int) -> None:
        one = found[number]
        (first, last), shape = rows[:, one], (high[one] - low[one], *shapes[block[one], 1:])
        mask = np.zeros(last - first, dtype=bool)
        mask[flat[begin[one] : end[one]] - first] = True
        inside = int(end[one] - begin[one])
        volume = capacity * mask.size / inside
        cuts[number] = _cut_box(points[first:last].reshape(*shape, 3), mask.reshape(shape), inside, volume)

    for_chunks(cut, len(found), 1)
    starts, firsts, targets = [np.zeros(1, np.int64)], [np.zeros(1, np.int64)], [np.empty(0, np.int64)]
    for number in sorted(cuts):
        start, first, own = cuts[number]
        firsts.append(first[1:] + firsts[-1][-1])
        starts.append(start[1:] + starts[-1][-1])
        targets.append(own + rows[0, found[number]])
    start, every = np.concatenate(starts), np.concatenate(targets)
    return make_bricks(points, start, every, order), np.concatenate(firsts)


def make_bricks(points: FloatArray, start: IntArray, targets: IntArray, order: int) -> Bricks:
    """Bricks of ``targets`` that begin at ``start`` (b + 1,), with up to ``order`` interpolation points per side."""
    return Bricks(start, targets, make_boxes(*fit_boxes(points, targets, spans(start)), order))


def make_regions(points: FloatArray, bricks: Bricks, first: IntArray, order: int) -> Regions:
    """Regions that begin with the bricks ``first`` (g + 1,)."""
    inner = bricks.boxes
    center, axes, half = fit_boxes(inner.proxies, np.arange(len(inner.proxies)), spans(inner.proxy[first]))
    # The boxes enclose the targets too.
    low, high = extents(points, bricks.targets, spans(bricks.start[first]), center, axes)
    return Regions(first, make_boxes(center, axes, np.maximum(half, np.maximum(-low, high)), order))


def spans(start: IntArray) -> IntArray:
    """Rows (m, 2) of the first and one past the last index of groups that begin at ``start`` (m + 1,)."""
    return np.stack([start[:-1], start[1:]], axis=1)


def _cut_box(x: FloatArray, mask: BoolArray, count: int, capacity: float) -> tuple[IntArray, IntArray, IntArray]:
    starts, firsts = np.zeros(count + 1, dtype=np.int64), np.zeros(count + 1, dtype=np.int64)
    targets = np.empty(count, dtype=np.int64)
    # Per box: first and last index along each axis, and whether it lies in a region.
    box = np.zeros((4096, 7), dtype=np.int64)
    box[0, 1:6:2] = mask.shape
    pieces, regions = _cut_boxes(x, mask, capacity, box, starts, firsts, targets)
    return starts[: pieces + 1].copy(), firsts[: regions + 1].copy(), targets


@kernel
def _cut_boxes(x, mask, capacity, box, starts, firsts, targets):
    """Halve the first of ``box`` and fill the others with its parts; returns the number of bricks and of regions."""
    at, previous = np.empty(3, np.int64), np.empty(3)
    depth = 1
    pieces = regions = used = 0
    while depth:
        depth -= 1
        b = box[depth]
        size = (b[1] - b[0]) * (b[3] - b[2]) * (b[5] - b[4])
        if b[6] == 0 and size <= REGION * capacity:
            b[6] = 1
            if firsts[regions] < pieces:
                regions += 1
                firsts[regions] = pieces
        if size > capacity:
            axis = longest_side(x, b, at, previous)
            middle = (b[2 * axis] + b[2 * axis + 1]) // 2
            for n in range(7):
                box[depth + 1, n] = b[n]
            box[depth + 1, 2 * axis + 1] = middle
            b[2 * axis] = middle
            depth += 2
            continue
        before, used = used, list_targets(mask, b, targets, used)
        if used > before:
            pieces += 1
            starts[pieces] = used
    if firsts[regions] < pieces:
        regions += 1
        firsts[regions] = pieces
    return pieces, regions


@inlined
def list_targets(mask, b, targets, used):
    """Append the nodes of an index box where ``mask`` holds to the first ``used`` targets; returns how many there are
    then."""
    for i in range(b[0], b[1]):
        for j in range(b[2], b[3]):
            for k in range(b[4], b[5]):
                if mask[i, j, k]:
                    targets[used] = (i * mask.shape[1] + j) * mask.shape[2] + k
                    used += 1
    return used


@inlined
def longest_side(x, b, at, previous):
    """Index axis along which an index box is longest: mean length of its edges, taken through their quarter points."""
    best, axis = -1.0, 0
    for a in range(3):
        lo, hi = b[2 * a], b[2 * a + 1] - 1
        if hi == lo:
            continue
        total = 0.0
        for corner in range(4):
            other = 0
            for d in range(3):
                if d != a:
                    at[d] = b[2 * d] if (corner >> other) & 1 == 0 else b[2 * d + 1] - 1
                    other += 1
            for quarter in range(5):
                at[a] = lo + (hi - lo) * quarter // 4
                length = 0.0
                for d in range(3):
                    here = x[at[0], at[1], at[2], d]
                    length += (here - previous[d]) ** 2
                    previous[d] = here
                if quarter:
                    total += math.sqrt(length)
        if total > best:
            best, axis = total, a
    return axis


def node_sizes(points: FloatArray, shapes: IntArray, offsets: IntArray, flat: IntArray) -> FloatArray:
    """Length (n,) of the shortest edge at the nodes ``flat`` of a grid; edges of zero length, at poles, are ignored."""
    block = np.searchsorted(offsets, flat, side="right") - 1
    rest, shape = flat - offsets[block], shapes[block]
    size = np.full(len(flat), np.inf)
    for axis, step in enumerate((shape[:, 1] * shape[:, 2], shape[:, 2], np.ones_like(rest))):
        at = rest // step % shape[:, axis]
        for way in (-1, 1):
            inside = (at + way >= 0) & (at + way < shape[:, axis])
            one = flat[inside]
            edge = np.linalg.norm(rows_at(points, one + way * step[inside]) - rows_at(points, one), axis=1)
            size[inside] = np.minimum(size[inside], np.where(edge > 0.0, edge, np.inf))
    return size
