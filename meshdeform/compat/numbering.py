"""Numbers of nodes: zones in the order of the file, i fastest, as solvers count them."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.errors import GridError
from meshdeform_core.grid import Grid, IntArray


def rows_of_file(grid: Grid, numbers: IntArray) -> IntArray:
    """Rows of ``grid.points`` of nodes (n,) numbered in the order of the file, i fastest in each zone."""
    zone = np.searchsorted(grid.offsets, numbers, side="right") - 1
    ni, nj, nk = np.asarray(grid.shapes, dtype=np.int64).T
    k, rest = np.divmod(numbers - grid.offsets[zone], (ni * nj)[zone])
    j, i = np.divmod(rest, ni[zone])
    return np.asarray(grid.offsets[zone] + (i * nj[zone] + j) * nk[zone] + k)


def rows_of_freedoms(grid: Grid, indices: ArrayLike) -> IntArray:
    """Rows of ``grid.points`` from degrees of freedom (3 n,): three, x y z, for every node.

    Raises
    ------
    GridError
        When they are not whole numbers, not x, y and z of one node after another, or beyond the grid.
    """
    freedoms = np.asarray(indices)
    if freedoms.size == 0:
        return np.empty(0, dtype=np.int64)
    if freedoms.ndim != 1 or freedoms.dtype.kind not in "iu" or len(freedoms) % 3:
        raise GridError(
            f"indices are {freedoms.shape} {freedoms.dtype}; expected whole numbers (3 n,): x, y, z of n nodes"
        )
    nodes = freedoms[::3].astype(np.int64) // 3
    if not np.array_equal(freedoms.reshape(-1, 3), 3 * nodes[:, None] + np.arange(3)):
        raise GridError("indices are not x, y, z (3 m, 3 m + 1, 3 m + 2) of one node after another")
    if nodes.min() < 0 or nodes.max() >= grid.n_nodes:
        raise GridError(
            f"indices of the nodes {nodes.min()} to {nodes.max()}; the grid has {grid.n_nodes}, numbered from 0"
        )
    return rows_of_file(grid, nodes)
