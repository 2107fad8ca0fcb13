"""Check that a grid has an extent in all its dimensions."""

from __future__ import annotations

import numpy as np

from ..errors import GridError
from ..numerics.arrays import extent
from .blocks import Grid

_SMALLEST = 1e-100
_FLAT = 1e-14
_SAMPLE = 100_000


def require_extent(grid: Grid) -> None:
    """Refuse a grid whose nodes are all at one point, on one line or, in 3-D, in one plane.

    Raises
    ------
    GridError
        With the extent of the nodes.
    """
    some = grid.points[:: max(1, grid.n_nodes // _SAMPLE)]
    low, high = extent(grid.points)
    size = float((high - low).max())
    if not size > _SMALLEST:
        raise GridError(f"all nodes lie within {size:.3g} of {low.tolist()}; expected a grid with a larger extent")
    spread = np.linalg.svd((some - 0.5 * (low + high)) / size, compute_uv=False)
    rank = int((spread > _FLAT * spread[0]).sum())
    if rank < grid.dimension:
        shape = {1: "on a line", 2: "in a plane"}[rank]
        raise GridError(f"all nodes of the {grid.dimension}-D grid lie {shape}; expected cells with a volume")
