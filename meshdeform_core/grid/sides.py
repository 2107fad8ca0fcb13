"""Block sides: their unique node numbers, and the end planes of a grid that is one cell thick."""

from __future__ import annotations

import numpy as np

from .blocks import Grid, IntArray
from .parts import Shape, Side
from .topology import Topology, side_nodes


def side_numbers(grid: Grid, topology: Topology, block: int, side: Side) -> IntArray:
    """Unique node numbers of a block side, shaped along ``side.tangential``."""
    u, v = np.indices([grid.shapes[block][axis] for axis in side.tangential])
    return topology.quads.numbers_at(np.full(u.shape, 6 * block + side), u, v)


def end_planes(grid: Grid, topology: Topology) -> list[int]:
    """Block sides (``6 * block + side``) between which the whole grid is one cell thick; empty if it is not.

    A block that is one cell thick between outside faces in two directions counts as thin in the direction in which its
    neighbours are; if these leave it open, there are no end planes.
    """
    thin = []
    for block, shape in enumerate(grid.shapes):
        thin.append(_thin_axes(shape, topology, block))
        if not thin[-1]:
            return []
    if all(len(axes) == 1 for axes in thin):
        return _sides(thin)
    across = [{axis: _edges_across(grid, topology, b, axis) for axis in axes} for b, axes in enumerate(thin)]
    left = set(range(grid.n_blocks))
    known: IntArray = np.empty(0, dtype=np.int64)
    while decided := [block for block in left if len(across[block]) == 1]:
        left -= set(decided)
        known = np.concatenate([known, *(edges for block in decided for edges in across[block].values())])
        for block in left:
            across[block] = {axis: edges for axis, edges in across[block].items() if np.isin(edges, known).any()}
    return [] if left else _sides([list(axes) for axes in across])


def _sides(thin: list[list[int]]) -> list[int]:
    return [6 * block + side for block, axes in enumerate(thin) for axis in axes for side in (2 * axis, 2 * axis + 1)]


def _thin_axes(shape: Shape, topology: Topology, block: int) -> list[int]:
    """Index directions in which a block is one cell thick, with only outside faces at both ends."""
    return [
        axis
        for axis in range(3)
        if shape[axis] == 2
        and all(topology.external[topology.quads.of_side(block, Side(2 * axis + end))].all() for end in (0, 1))
    ]


def _edges_across(grid: Grid, topology: Topology, block: int, axis: int) -> IntArray:
    """A number for each edge that crosses a block which is one cell thick along ``axis``."""
    ends = [topology.numbers_of(side_nodes(grid, block, Side(2 * axis + end)).ravel()) for end in (0, 1)]
    edges: IntArray = np.minimum(*ends) * topology.n_unique + np.maximum(*ends)
    return edges
