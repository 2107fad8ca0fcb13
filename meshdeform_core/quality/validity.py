"""The quick question: which cells became invalid?"""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..planes import plane_normal
from ..topology import Topology
from .cells import measure_grid


def newly_invalid(grid: Grid, after: FloatArray, topology: Topology) -> IntArray:
    """Cells with a corner Jacobian that is positive in ``grid`` and <= 0 with coordinates ``after`` (n_nodes, 3).

    Returns their numbers, counted block after block, C-ordered within each block.
    """
    normal = plane_normal(grid)
    both = zip(*(measure_grid(grid, x, topology.handedness, normal) for x in (grid.points, after)), strict=True)
    found, start = [], 0
    for old, new in both:
        found.append(start + np.flatnonzero(new.bad & ~old.bad))
        start += new.bad.size
    return np.concatenate(found)
