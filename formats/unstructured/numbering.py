"""Numbers of the points of unstructured meshes."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Grid, IntArray
from meshdeform_core.grid.topology import Topology


def point_numbers(grid: Grid, topology: Topology) -> tuple[NDArray[Any], IntArray]:
    """The point of every block node (n_nodes,), and the block node of every point (n_points,)."""
    number = np.full(grid.n_nodes, -1, dtype=np.int64)
    number[topology.face_nodes] = topology.number
    interior = np.flatnonzero(number < 0)
    number[interior] = topology.n_unique + np.arange(len(interior))
    return number, np.concatenate([topology.first, interior])
