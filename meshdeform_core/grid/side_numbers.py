"""Unique node numbers of block sides, from the corners of their face quads: much faster than looking up every node."""

from __future__ import annotations

import numpy as np

from .blocks import Grid, IntArray, Side
from .topology import Topology, in_index_order


def side_numbers(grid: Grid, topology: Topology, block: int, side: Side) -> IntArray:
    """Unique node numbers of a block side, shaped along ``side.tangential``."""
    shape = grid.shapes[block]
    counts = tuple(shape[axis] for axis in side.tangential)
    corners = topology.quads.corners[topology.quads.of_side(block, side)]
    if not in_index_order(side, counts, grid.dimension, int(topology.handedness[block])):
        corners = corners[:, ::-1]
    if grid.dimension == 2:
        return np.append(corners[:, 0], corners[-1:, 1]).reshape(counts)
    low, right, far, up = corners.T.reshape(4, counts[0] - 1, counts[1] - 1)
    numbers = np.empty(counts, dtype=np.int64)
    numbers[:-1, :-1], numbers[-1, :-1], numbers[:-1, -1], numbers[-1, -1] = low, right[-1], up[:, -1], far[-1, -1]
    return numbers
