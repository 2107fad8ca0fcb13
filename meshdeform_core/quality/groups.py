"""Invalid cells grouped by location: cells that touch each other form a group, also across blocks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..boundary import Boundary
from ..grid import FloatArray, Grid, IntArray, Shape
from ..grid.topology import Topology
from ..numerics.geometry.coincidence import connected_rows
from .listed import nearest_patches
from .measures.cells import corner_nodes, places

MAX_GROUPS = 20


@dataclass(frozen=True)
class InvalidGroup:
    """Invalid cells that share nodes.

    Attributes
    ----------
    cells : number of cells
    blocks : names of the blocks they lie in
    box : lowest and highest coordinates of the deformed cells
    center : mean of the centres of the deformed cells
    block, ijk : the worst cell (1-based), that with the smallest Jacobian relative to the undeformed one
    nearest_patch : the moving boundary nearest to the worst cell in the undeformed grid
    """

    cells: int
    blocks: tuple[str, ...]
    box: tuple[tuple[float, ...], tuple[float, ...]]
    center: tuple[float, ...]
    block: str
    ijk: Shape
    nearest_patch: str = ""


def group_cells(
    grid: Grid, topology: Topology, boundary: Boundary | None, after: FloatArray, cells: IntArray, ratio: np.ndarray
) -> tuple[InvalidGroup, ...]:
    """The groups of ``cells`` (numbers), the largest first, at most ``MAX_GROUPS``.

    Parameters
    ----------
    after : coordinates of the deformed grid (n_nodes, 3)
    ratio : (n_cells,) smallest relative Jacobian of every cell
    """
    if cells.size == 0:
        return ()
    block, ijk = places(grid, cells)
    nodes = corner_nodes(grid, block, ijk)
    _, local = np.unique(_unique(topology, nodes), return_inverse=True)
    part = connected_rows(local.reshape(nodes.shape), int(local.max()) + 1)
    order = np.argsort(-np.bincount(part), kind="stable")[:MAX_GROUPS]
    worst = [members[int(np.argmin(ratio[cells[members]]))] for members in (np.flatnonzero(part == n) for n in order)]
    before = grid.points[nodes[worst]].mean(axis=1)
    near = nearest_patches(grid, topology, boundary, before)
    return tuple(
        _group(grid, after, block, ijk, nodes, np.flatnonzero(part == n), at, patch)
        for n, at, patch in zip(order, worst, near, strict=True)
    )


def _group(
    grid: Grid, after: FloatArray, block: IntArray, ijk: IntArray, nodes: IntArray, members: IntArray, worst: int,
    patch: str,
) -> InvalidGroup:  # fmt: skip
    x = after[nodes[members]]
    box = tuple(x.min(axis=(0, 1)).tolist()), tuple(x.max(axis=(0, 1)).tolist())
    i, j, k = (int(n) + 1 for n in ijk[worst])
    return InvalidGroup(
        len(members),
        tuple(grid.names[b] for b in np.unique(block[members])),
        box,
        tuple(x.mean(axis=(0, 1)).tolist()),
        grid.names[block[worst]],
        (i, j, k),
        patch,
    )


def _unique(topology: Topology, nodes: IntArray) -> IntArray:
    """``nodes`` with coincident ones replaced by the first of them."""
    at = np.minimum(np.searchsorted(topology.face_nodes, nodes), len(topology.face_nodes) - 1)
    shared = topology.face_nodes[at] == nodes
    return np.where(shared, topology.first[topology.number[at]], nodes)
