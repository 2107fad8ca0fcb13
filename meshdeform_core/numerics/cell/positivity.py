"""Proof that the Jacobian of a cell is positive everywhere, by its Bernstein coefficients.

The Jacobian of a trilinear hexahedron is a polynomial of degree 2 in each coordinate. Its 27 coefficients in the
Bernstein basis bound it, those at the corners are its values there, and halving the cell brings the others closer to
its values (Johnen, Weill & Remacle: Robust and efficient validation of the linear hexahedral element, Procedia
Engineering 203, 2017, arXiv 1706.01613). With u, v, w the edges along i, j, k, at corners (b, c), (a, c), (a, b), a
coefficient is a mean of triple products u x v . w.
"""

import numpy as np

from ..jit import inlined, kernel
from .volume import along

COLLAPSED = 1e-10
"""Corners below this share of the largest corner Jacobian of the undeformed cell are collapsed: no ratio is taken."""
_DEPTH = 10


@kernel
def judge_quads(before, x, normal, i0, i1, ratio):
    """Smallest ratio of a corner Jacobian to the undeformed one, per quadrilateral; infinite without a sound corner.

    ``before`` and ``x`` (na, nb, 3) are the nodes, ``normal`` is the orientation of valid cells. A cell whose corner
    Jacobians are positive is valid everywhere, as its Jacobian is linear along every grid line.
    """
    old, new = np.empty(4), np.empty(4)
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            for c in range(4):
                old[c] = _quad_corner(before, normal, i, j, c >> 1, c & 1)
                new[c] = _quad_corner(x, normal, i, j, c >> 1, c & 1)
            ratio[i - i0, j] = np.inf
            for c in range(4):
                if old[c] > COLLAPSED * old.max():
                    ratio[i - i0, j] = min(ratio[i - i0, j], new[c] / old[c])


@inlined
def _quad_corner(x, normal, i, j, a, b):
    u, v = x[i + 1, j + b] - x[i, j + b], x[i + a, j + 1] - x[i + a, j]
    return along(normal, u, v)


@kernel
def decide(before, x, sign):
    """Which hexahedra have become invalid: (m,) int8, 0 valid, 1 Jacobian not positive inside, 2 negative volume.

    Only the volume is judged if the undeformed Jacobian is already negative somewhere. Coefficients that vanish in the
    undeformed cell, next to collapsed edges, do not count.

    Parameters
    ----------
    before, x : (m, 8, 3) corners, corner (a, b, c) at 4 a + 2 b + c
    sign : (m,) handedness
    """
    failed = np.zeros(len(x), dtype=np.int8)
    old, new = np.empty((3, 3, 3)), np.empty((3, 3, 3))
    zero = np.empty((3, 3, 3), dtype=np.bool_)
    stack = np.empty((8 * _DEPTH, 3, 3, 3))
    for m in range(len(x)):
        _bernstein(x[m], sign[m], new)
        _bernstein(before[m], sign[m], old)
        largest = np.abs(old).max()
        for n in range(27):
            zero.flat[n] = abs(old.flat[n]) <= COLLAPSED * largest
        if _positive(new, zero, stack):
            continue
        # The mean of the coefficients is the volume.
        if _positive(old, zero, stack):
            failed[m] = 1
        elif old.sum() > 0.0 and new.sum() <= 0.0:
            failed[m] = 2
    return failed


@kernel
def _bernstein(x, sign, b):
    """The 27 coefficients of a cell with corners ``x`` (8, 3)."""
    b[...] = 0.0
    for p in range(4):
        u = x[4 + p] - x[p]
        for q in range(4):
            v = x[4 * (q >> 1) + 2 + (q & 1)] - x[4 * (q >> 1) + (q & 1)]
            x0, y0, z0 = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]
            for r in range(4):
                w = x[2 * r + 1] - x[2 * r]
                # u at (j, k) = p, v at (i, k) = q, w at (i, j) = r.
                i, j, k = (q >> 1) + (r >> 1), (p >> 1) + (r & 1), (p & 1) + (q & 1)
                terms = (2 if i == 1 else 1) * (2 if j == 1 else 1) * (2 if k == 1 else 1)
                b[i, j, k] += sign * (x0 * w[0] + y0 * w[1] + z0 * w[2]) / terms


@kernel
def _positive(b, zero, stack):
    """Whether the coefficients ``b`` prove positivity; those in ``zero`` vanish by construction and do not count."""
    lowest = np.inf
    for n in range(27):
        if not zero.flat[n]:
            lowest = min(lowest, b.flat[n])
    if lowest > 0.0 or zero.all():
        return lowest > 0.0
    if zero.any():
        # Next to a collapsed edge subdivision is not exact: all coefficients must be positive.
        return False
    stack[0] = b
    depth = np.zeros(len(stack), dtype=np.int64)
    top = 1
    while top:
        top -= 1
        part, level = stack[top].copy(), depth[top]
        for n in range(8):
            if part[2 * (n >> 2), 2 * (n >> 1 & 1), 2 * (n & 1)] <= 0.0:
                return False
        if part.min() > 0.0:
            continue
        if level == _DEPTH - 1:
            return False
        for n in range(8):
            _half(part, n >> 2, n >> 1 & 1, n & 1, stack[top])
            depth[top] = level + 1
            top += 1
    return True


@inlined
def _half(b, i, j, k, out):
    """Coefficients on one of the eight halves in each direction, by de Casteljau's algorithm."""
    out[...] = b
    for p in range(3):
        for q in range(3):
            _split(out[:, p, q], i)
    for p in range(3):
        for q in range(3):
            _split(out[p, :, q], j)
    for p in range(3):
        for q in range(3):
            _split(out[p, q, :], k)


@inlined
def _split(line, upper):
    first, middle, last = line[0], line[1], line[2]
    center = 0.25 * (first + 2.0 * middle + last)
    if upper:
        line[0], line[1] = center, 0.5 * (middle + last)
    else:
        line[1], line[2] = 0.5 * (first + middle), center
