"""Measures of cells from their corners: Jacobians, edges, f_skew, volume; hexahedra and quadrilaterals alike.

Corners are arrays (n, 8, 3), corner (a, b, c) along i, j, k at 4 a + 2 b + c, or (n, 4, 3) in a plane, corner (a, b) at
2 a + b. A *side* tells which Jacobians are positive: the handedness of the block (n,) of a hexahedron, for a
quadrilateral the unit normal (n, 3) of valid cells in index order; or one of these for all cells. The formulas also
run on a tape (:mod:`..tape`), except for :func:`measure_cells`.

:func:`decide` proves that the Jacobian of a cell is positive everywhere, by its Bernstein coefficients.
The Jacobian of a trilinear hexahedron is a polynomial of degree 2 in each coordinate. Its 27 coefficients in the
Bernstein basis bound it, those at the corners are its values there, and halving the cell brings the others closer to
its values (Johnen, Weill & Remacle: Robust and efficient validation of the linear hexahedral element, Procedia
Engineering 203, 2017, arXiv 1706.01613). With u, v, w the edges along i, j, k, at corners (b, c), (a, c), (a, b), a
coefficient is a mean of triple products u x v . w.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray, IntArray
from ..geometry.vectors import cross, dot

COLLAPSED = 1e-10
"""Corners below this share of the largest corner Jacobian of the undeformed cell are collapsed: no ratio is taken."""
_DEPTH = 10
_TOGETHER = 1 << 12
"""Cells, or parts of them, judged at a time, which bounds the memory."""

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


def decide(before: FloatArray, x: FloatArray, sign: FloatArray) -> NDArray[np.int8]:
    """Which hexahedra have become invalid: (m,) int8, 0 valid, 1 Jacobian not positive inside, 2 negative volume.

    Only the volume is judged if the undeformed Jacobian is already negative somewhere. Coefficients that vanish in the
    undeformed cell, next to collapsed edges, do not count. Corners are (m, 8, 3), corner (a, b, c) at 4 a + 2 b + c;
    ``sign`` (m,) is the handedness.
    """
    failed = np.zeros(len(x), dtype=np.int8)
    for lo in range(0, len(x), _TOGETHER):
        some = slice(lo, lo + _TOGETHER)
        new, old = _bernstein(x[some], sign[some]), _bernstein(before[some], sign[some])
        zero = np.abs(old) <= COLLAPSED * np.abs(old).max(axis=(1, 2, 3), keepdims=True)
        left = np.flatnonzero(~_positive(new, zero))
        new, old = new[left], old[left]
        # The mean of the coefficients is the volume.
        gone = (old.sum(axis=(1, 2, 3)) > 0.0) & (new.sum(axis=(1, 2, 3)) <= 0.0)
        failed[lo + left] = np.where(_positive(old, zero[left]), 1, np.where(gone, 2, 0))
    return failed


def _bernstein(x: FloatArray, sign: FloatArray) -> FloatArray:
    """The 27 coefficients (m, 3, 3, 3) of cells with corners ``x`` (m, 8, 3)."""
    # Component by component, as numpy is slow on axes of length 3.
    x = np.ascontiguousarray(np.moveaxis(x, 0, -1))
    found = np.zeros((3, 3, 3, x.shape[-1]))
    for p in range(4):
        u = x[4 + p] - x[p]
        for q in range(4):
            v = x[4 * (q >> 1) + 2 + (q & 1)] - x[4 * (q >> 1) + (q & 1)]
            area = cross(u, v)
            for r in range(4):
                w = x[2 * r + 1] - x[2 * r]
                # u at (j, k) = p, v at (i, k) = q, w at (i, j) = r.
                i, j, k = (q >> 1) + (r >> 1), (p >> 1) + (r & 1), (p & 1) + (q & 1)
                terms = (2 if i == 1 else 1) * (2 if j == 1 else 1) * (2 if k == 1 else 1)
                found[i, j, k] += sign * dot(area, w) / terms
    return np.ascontiguousarray(np.moveaxis(found, -1, 0))


def _positive(b: FloatArray, zero: BoolArray) -> BoolArray:
    """Whether coefficients (m, 3, 3, 3) prove positivity; those in ``zero`` vanish by construction and do not count."""
    proved: BoolArray = np.asarray(np.where(zero, np.inf, b).min(axis=(1, 2, 3), initial=np.inf) > 0.0)
    # Next to a collapsed edge subdivision is not exact: all coefficients must be positive.
    owner = np.flatnonzero(~proved & ~zero.any(axis=(1, 2, 3)))
    proved[owner] = True
    waiting = [(0, owner, b[owner])]
    while waiting:
        level, owner, parts = waiting.pop()
        if len(parts) > _TOGETHER:
            waiting.append((level, owner[_TOGETHER:], parts[_TOGETHER:]))
            owner, parts = owner[:_TOGETHER], parts[:_TOGETHER]
        negative = (parts[:, ::2, ::2, ::2] <= 0.0).any(axis=(1, 2, 3))
        open_ = ~(parts > 0.0).all(axis=(1, 2, 3))
        proved[owner[negative | open_ & (level == _DEPTH - 1)]] = False
        left = open_ & proved[owner]
        owner, parts = owner[left], parts[left]
        if len(parts):
            for axis in (1, 2, 3):
                # Coefficients on both halves along an axis, by de Casteljau's algorithm.
                first, middle, last = np.moveaxis(parts, axis, 0)
                center = 0.25 * (first + 2.0 * middle + last)
                low = np.stack([first, 0.5 * (first + middle), center], axis=axis)
                parts = np.concatenate([low, np.stack([center, 0.5 * (middle + last), last], axis=axis)])
            waiting.append((level + 1, np.tile(owner, 8), parts))
    return proved
