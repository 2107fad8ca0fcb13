"""Weights of cells in a repair: cells near walls follow the wall, and boundary layers keep their heights.

With equal weights, the minimum of the energy concentrates shear at a rotating wall (in a ring, like 1 / r^2), where
first cells would lose nine tenths of their height. Weights that decay with a high power of distance reverse that.

Where a grid is squeezed, the largest distortion is smallest if all cells share it, boundary layers included. Thin cells
therefore have larger weights, also at fixed walls; this costs little, as they take up little space.
"""

from __future__ import annotations

import itertools
import math

import numpy as np

from ...grid import FloatArray, IntArray
from ..tuned import CRAMPED, FALL, FIRST, GROWTH, HEAVIEST, REACH, ROOM, SHARE, STEEP, THIN

FARTHEST = math.ceil(REACH / SHARE)
"""Distances beyond this many cells need not be distinguished."""


def nearness(layers: np.ndarray, largest: int) -> tuple[FloatArray, float]:
    """Distance (n,) of nodes from walls relative to the reach of walls, at most 1, and that of walls themselves.

    ``layers`` (n,) are the distances in cells, more than FARTHEST where no wall is that near, ``largest`` the largest
    distance in the grid up to that.
    """
    reach = max(1.0, min(REACH, SHARE * largest))
    return np.minimum((layers + 1.0) / reach, 1.0), 1.0 / reach


def weigh(share: FloatArray, first: float, start: FloatArray, cells: IntArray) -> FloatArray:
    """Weights (m,) of ``cells`` (m, k) with undeformed node coordinates ``start`` (n, d); ``share`` (m, k) is the
    :func:`nearness` of their nodes, ``first`` that of nodes on walls."""
    near = share.min(axis=1)
    thin = np.clip((_aspect_ratio(start, cells) / THIN) ** GROWTH, 1.0, HEAVIEST)
    # The layer, from 1 at walls.
    layer, reach = np.where(near < 1.0, near / first, np.inf), 1.0 / first
    rigid = FIRST * reach * min(1.0, reach / ROOM) ** CRAMPED
    return np.asarray(np.maximum.reduce([near**-FALL, rigid / layer**STEEP, thin]))


def _aspect_ratio(start: FloatArray, cells: IntArray) -> FloatArray:
    """Longest over shortest edge of cells (m,); collapsed edges do not count."""
    shortest, longest = np.full(len(cells), np.inf), np.zeros(len(cells))
    corners = cells.shape[1]
    for one, step in itertools.product(range(corners), (1, 2, 4)):
        if one & step or step >= corners:
            continue
        length = np.linalg.norm(start[cells[:, one | step]] - start[cells[:, one]], axis=1)
        np.maximum(longest, length, out=longest)
        np.minimum(shortest, length, out=shortest, where=length > 0.0)
    return longest / shortest
