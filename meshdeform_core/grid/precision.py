"""Coordinates as a file will hold them."""

from __future__ import annotations

import numpy as np

from ..parallel import Nodes
from .blocks import FloatArray


def rounded(points: FloatArray, precision: str) -> FloatArray:
    """Coordinates (n_nodes, 3) rounded to ``precision``; returned as they are for ``float64``."""
    if precision != "float32":
        return points
    result: FloatArray = Nodes.of(points).like(3)
    Nodes.of(result).each(lambda rows: np.copyto(result[rows], points[rows].astype(np.float32)))
    return result
