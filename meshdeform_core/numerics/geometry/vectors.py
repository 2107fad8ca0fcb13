"""Unit vectors, and area vectors of faces."""

from __future__ import annotations

import numpy as np

from ..arrays import FloatArray


def unit(vectors: FloatArray) -> FloatArray:
    """Vectors (..., m) scaled to length 1; zero ones stay."""
    size = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return np.asarray(vectors / np.where(size > 0.0, size, 1.0))


def doubled_areas(corners: FloatArray) -> FloatArray:
    """Twice the area vectors (n, 3) of quads (n, 4, 3): the products of their diagonals."""
    found: FloatArray = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    return found


def face_sizes(corners: FloatArray) -> FloatArray:
    """Areas (n,) of quads (n, 4, 3), or lengths of edges (n, 2, 3)."""
    if corners.shape[1] == 2:
        length: FloatArray = np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1)
        return length
    area: FloatArray = 0.5 * np.linalg.norm(doubled_areas(corners), axis=1)
    return area
