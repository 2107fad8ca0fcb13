"""Cells beyond the onset of repairs, found without loading any loop of a repair."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, IntArray
from ..numerics.cell.health import mark_unhealthy
from ..parallel import Nodes
from ..quality import Original
from .tuned import COLLAPSED, HEALTHY, SOFT


def unhealthy_cells(original: Original, points: FloatArray, most: float = HEALTHY) -> IntArray:
    """Numbers (m,) of the cells of all ranks with a corner whose f is more than ``most``."""
    grid, found = original.grid, [np.empty(0, dtype=np.int64)]
    normal = np.zeros(3) if original.normal is None else original.normal
    for each in (points, grid.points):
        grid.hold_neighbours(each)
    for block, (ni, _, _) in enumerate(grid.shapes):
        x, start = (grid.in_planes(block, each, 1) for each in (points, grid.points))
        if not len(x) or (len(x) == 1 and ni > 1):
            continue
        marks = np.empty([max(n - 1, 1) for n in x.shape[:3]], dtype=bool)
        mark_unhealthy(x, start, normal, most, SOFT, COLLAPSED, marks)
        _, cj, ck = grid.cell_shapes[block]
        found.append(int(grid.cell_offsets[block]) + grid.planes(block).start * cj * ck + np.flatnonzero(marks))
    return np.concatenate(Nodes.of(points).gather(np.concatenate(found)))
