"""Measures of cells from their corners: Jacobians, edges, f_skew, volume; hexahedra and quadrilaterals alike.

Corners are arrays (n, 8, 3), corner (a, b, c) along i, j, k at 4 a + 2 b + c, or (n, 4, 3) in a plane, corner (a, b) at
2 a + b. A *side* tells which Jacobians are positive: the handedness of the block (n,) of a hexahedron, for a
quadrilateral the unit normal (n, 3) of valid cells in index order; or one of these for all cells. The formulas also
run on a tape (:mod:`..tape`), except for :func:`measure_cells`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from ..arrays import FloatArray, IntArray

Corner = tuple[Any, list[Any]]
"""The Jacobian (n,) at a corner and the edges (n, 3) along the index axes that meet there."""


def cell_corners(values: np.ndarray) -> np.ndarray:
    """Values (n_cells, 8 or, in a plane, 4, ...) at the corners of all cells of a block, from those (ni, nj, nk, ...)
    at its nodes."""
    ends = [[slice(end, end + max(n - 1, 1)) for end in range(min(n, 2))] for n in values.shape[:3]]
    found = np.stack([values[i, j, k] for i in ends[0] for j in ends[1] for k in ends[2]], axis=3)
    return found.reshape(-1, *found.shape[3:])


def corner_steps(shapes: IntArray, axes: int) -> IntArray:
    """Steps (n, 2^axes) in the flat array of a block's nodes from the first corner of a cell to all of them.

    ``shapes`` (n, 3) are the numbers of nodes of the block of each cell, in a plane (``axes`` 2) with a single one.
    """
    along = np.stack([shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones_like(shapes[:, 0])], axis=1)
    thick = np.argsort(shapes == 1, axis=1, kind="stable")[:, :axes]
    return np.asarray(
        np.take_along_axis(along, np.sort(thick, axis=1), axis=1) @ np.indices((2,) * axes).reshape(axes, -1)
    )


def corners_and_edges(x: Any, side: Any) -> list[Corner]:
    """All corners of cells with the corners ``x``."""
    found = list[Corner]()
    bits = (4, 2, 1) if x.shape[1] == 8 else (2, 1)
    for corner in range(x.shape[1]):
        edges = [x[:, corner | bit] - x[:, corner & ~bit] for bit in bits]
        area = np.cross(edges[0], edges[1])
        if len(bits) == 3:
            found.append((side * np.einsum("ni,ni->n", area, edges[2]), edges))
        else:
            found.append((np.einsum("ni,ni->n", area, np.broadcast_to(side, area.shape)), edges))
    return found


def scaled_jacobians(corners: list[Corner]) -> Any:
    """Jacobians (n, corners) divided by the lengths of the edges; zero at collapsed edges."""
    found = []
    for jacobian, edges in corners:
        for edge in edges:
            square = np.einsum("ni,ni->n", edge, edge)
            jacobian = jacobian / np.sqrt(np.where(square > 0.0, square, 1.0))
        found.append(jacobian)
    return np.stack(found, axis=1)


def volume(corners: list[Corner], side: Any) -> Any:
    """Exact volume (n,) of trilinear cells, area of bilinear ones.

    The Jacobian at the centre and the mean of the corner Jacobians deviate from the volume of a hexahedron in opposite
    directions, the mean twice as far, as only terms quadratic in one local coordinate differ.
    """
    total, sums = corners[0][0], corners[0][1]
    for jacobian, edges in corners[1:]:
        total, sums = total + jacobian, [one + other for one, other in zip(sums, edges, strict=True)]
    if len(sums) == 2:
        return total / 4.0
    u, v, w = (each / 8.0 for each in sums)
    return total / 24.0 + (2.0 / 3.0) * side * np.einsum("ni,ni->n", np.cross(u, v), w)


class CellMeasures(NamedTuple):
    """Measures of cells (Knupp 2003).

    ``skew`` (n,): f_skew, the number of corners over the sum over them of (product of the edge lengths / J)^(2/d) in d
    dimensions, 0 if any Jacobian J is not positive; ``scaled`` (n,): the smallest J divided by its edge lengths;
    ``jacobian`` (n, 8 or 4); ``volume`` (n,), in a plane the area.
    """

    skew: FloatArray
    scaled: FloatArray
    jacobian: FloatArray
    volume: FloatArray


def measure_cells(x: FloatArray, side: Any) -> CellMeasures:
    """Measures of cells with the corners ``x``."""
    corners = corners_and_edges(x, side)
    scaled, axes = scaled_jacobians(corners), len(corners[0][1])
    with np.errstate(divide="ignore"):
        terms = np.where(scaled > 0.0, np.maximum(scaled, 1e-200) ** (-2.0 / axes), np.inf).sum(axis=1)
    jacobian = np.stack([each for each, _ in corners], axis=1)
    return CellMeasures(np.minimum(len(corners) / terms, 1.0), scaled.min(axis=1), jacobian, volume(corners, side))
