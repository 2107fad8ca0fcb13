"""Which rank holds which nodes of a grid: consecutive pieces of blocks, with about equally many nodes."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..numerics.arrays import IntArray, Shapes
from ..numerics.pieces import pieces
from ..parallel import Nodes, Ranks


def points_among(shapes: Shapes, ranks: Ranks) -> Any:
    """Uninitialised coordinates (n_nodes, 3) of blocks of these shapes, of which every rank holds its part."""
    bounds = bounds_of(shapes, ranks.count)
    return Nodes.new(ranks, bounds, (int(bounds[-1]), 3))


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


def face_bounds(shapes: Shapes, count: int) -> IntArray:
    """Flat indices (count + 1,) between which each of several ranks sets up the nodes on block faces.

    About equally many for each, whoever holds their coordinates, as every rank has those of all nodes near block faces.
    """
    size = np.array(shapes, dtype=np.int64)
    nodes = size.prod(axis=1)
    on_faces = nodes - np.maximum(size - 2, 0).prod(axis=1)
    # In the first and the last plane of a block, all nodes are on faces; in those between, equally many are.
    plane = np.minimum(size[:, 1] * size[:, 2], nodes // 2)
    begin, done = np.cumsum(nodes) - nodes, np.cumsum(on_faces) - on_faces
    rows = np.stack([begin, begin + plane, begin + nodes - plane], axis=1)
    faces = np.stack([done, done + plane, done + on_faces - plane], axis=1)
    wanted = np.linspace(0, on_faces.sum(), count + 1)
    bounds = np.interp(wanted, np.append(faces, on_faces.sum()), np.append(rows, nodes.sum())).astype(np.int64)
    bounds[-1] = nodes.sum()
    return bounds
