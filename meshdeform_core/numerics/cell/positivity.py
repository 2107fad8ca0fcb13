"""Proof that the Jacobian of a cell is positive everywhere, by its Bernstein coefficients.

The Jacobian of a trilinear hexahedron is a polynomial of degree 2 in each coordinate. Its 27 coefficients in the
Bernstein basis bound it, those at the corners are its values there, and halving the cell brings the others closer to
its values (Johnen, Weill & Remacle: Robust and efficient validation of the linear hexahedral element, Procedia
Engineering 203, 2017, arXiv 1706.01613). With u, v, w the edges along i, j, k, at corners (b, c), (a, c), (a, b), a
coefficient is a mean of triple products u x v . w.
"""

import numpy as np
from numpy.typing import NDArray

from ..arrays import BoolArray, FloatArray
from ..geometry.vectors import cross, dot

COLLAPSED = 1e-10
"""Corners below this share of the largest corner Jacobian of the undeformed cell are collapsed: no ratio is taken."""
_DEPTH = 10
_TOGETHER = 1 << 12
"""Cells, or parts of them, judged at a time, which bounds the memory."""


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
