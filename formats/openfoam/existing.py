"""The existing mesh of a case, and the correspondence of its points with the nodes of the grid."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, IntArray
from meshdeform_core.grid.topology import RELATIVE_TOLERANCE, Topology, find_topology
from meshdeform_core.parallel import empty
from meshdeform_core.wording import vector

from ..plausible import LARGEST
from ..unstructured.numbering import point_numbers
from .poly_mesh.lists import read_points

_DIGITS = 1e-6
"""Tolerance relative to the largest coordinate: points are written with six digits unless a case requests more."""
_MOST = 0.1
"""Largest tolerance relative to the local edge, however few digits the points have."""


def points_file(mesh: Path) -> Path | None:
    """The file of the points in a polyMesh folder, if there is one."""
    return next((mesh / name for name in ("points", "points.gz") if (mesh / name).is_file()), None)


def with_points_of(grid: Grid, path: Path) -> tuple[Grid, IntArray]:
    """The grid with the points of a mesh that was generated from it, and the point number of every node (n_nodes,).

    Raises
    ------
    FormatError
        When a point is not where a node of the grid is, or the numbers of points differ.
    """
    topology = find_topology(grid)
    number, nodes = point_numbers(grid, topology)
    points = read_points(path, len(nodes))
    if len(points) != len(nodes):
        raise FormatError(
            f"{path} has {len(points):,} points, the blocks of {grid.path} have {len(nodes):,} nodes; "
            "expected a mesh that blockMesh made of it"
        )
    strange = np.flatnonzero(~(np.abs(points) <= LARGEST).all(axis=1))
    if strange.size:
        raise FormatError(
            f"{path}: point {strange[0]} is {vector(points[strange[0]])}; expected finite coordinates up to {LARGEST:g}"
        )
    own = grid.points[nodes]
    gap, found = scipy.spatial.cKDTree(points).query(own)
    edge = _edges(grid, topology, nodes)
    allowed = np.minimum(np.maximum(RELATIVE_TOLERANCE * edge, _DIGITS * np.abs(own).max()), _MOST * edge)
    far = gap > allowed
    if far.any():
        worst = int(np.argmax(gap - allowed))
        raise FormatError(
            f"{path}: {int(far.sum())} points are not where the blocks of {grid.path} have nodes; the nearest one to "
            f"{grid.node_label(int(nodes[worst]))} = {vector(own[worst])} is {gap[worst]:.3g} away. Run blockMesh, or "
            "restore the undeformed points"
        )
    if len(np.unique(found)) < len(found):
        raise FormatError(f"{path}: two nodes of {grid.path} are nearest to one point; give it more digits")
    numbering: NDArray[Any] = np.asarray(found[number], dtype=np.int64)
    placed = dataclasses.replace(grid, points=empty(grid.points.shape))

    def put(block: int) -> None:
        placed.block(block)[...] = points[grid.block(block, numbering)]

    placed.fill(put)
    return placed, numbering


def _edges(grid: Grid, topology: Topology, nodes: IntArray) -> np.ndarray:
    """The shortest edge (n,) at nodes; of those inside blocks, along the indices of the block."""
    shortest = np.full(grid.n_nodes, np.inf)
    for block in range(grid.n_blocks):
        x, own = grid.block(block), grid.block(block, shortest)
        for axis in range(3):
            length = np.linalg.norm(np.diff(x, axis=axis), axis=-1)
            length[length == 0] = np.inf
            for part in (slice(None, -1), slice(1, None)):
                view = np.moveaxis(own, axis, 0)[part]
                np.minimum(view, np.moveaxis(length, axis, 0), out=view)
    found = shortest[nodes]
    found[: topology.n_unique] = topology.edge
    return found
