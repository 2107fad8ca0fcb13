"""Is the Jacobian of a cell positive everywhere? Its Bernstein coefficients prove it, one pass over a block.

The Jacobian of a trilinear hexahedron is a polynomial of degree 2 in each coordinate. Its 27 coefficients in the basis
of Bernstein bound it, the corner ones are its values at the corners, and halving the cell brings the others nearer to
values (Johnen, Weill & Remacle: Robust and efficient validation of the linear hexahedral element, Procedia Engineering
203, 2017, arXiv 1706.01613). With u, v, w the edges along i, j, k, at corners (b, c), (a, c), (a, b), a coefficient is
a mean of triple products u x v . w.
"""

import numpy as np

from .jit import inlined, kernel

# Rows of the work array of a line of cells: coordinates of the four lines of nodes around it (3 r + axis for the line
# r = 2 a + b at i + a, j + b), area vectors of the corners on a plane of nodes and those between two planes, corner
# Jacobians before and after (2 r + c), results.
_AREA, _BETWEEN, _BEFORE, _AFTER, _LOW, _HIGH, _RATIO, _ROWS = 12, 24, 36, 44, 52, 53, 54, 55
_TILE = 60
COLLAPSED = 1e-10
"""Corners below this share of the largest corner Jacobian of the undeformed cell are collapsed: no ratio is taken."""
_ROUND_OFF = 1e-14
_DEPTH = 10


@kernel
def judge_hexahedra(before, x, sign, i0, i1, proved, ratio):
    """Proof and smallest relative Jacobian of the cells i0 <= i < i1 of a block.

    Parameters
    ----------
    before, x : (ni, nj, nk, 3) nodes undeformed and deformed
    sign : handedness of the block
    proved : (ci, cj, ck) out, bool: all coefficients are positive. False says nothing, see :func:`decide`
    ratio : out, float32, smallest corner Jacobian relative to the undeformed one; infinite without any
    """
    work = np.empty((_ROWS, _TILE))
    cells = x.shape[2] - 1
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            for k0 in range(0, cells, _TILE - 1):
                count = min(_TILE - 1, cells - k0)
                _load(before, work, i, j, k0, count)
                _corners(work, count, sign, _BEFORE)
                _load(x, work, i, j, k0, count)
                _corners(work, count, sign, _AFTER)
                _ratios(work, count)
                _coefficients(work, count, sign)
                for k in range(count):
                    proved[i - i0, j, k0 + k] = work[_LOW, k] > _ROUND_OFF * work[_HIGH, k]
                    ratio[i - i0, j, k0 + k] = work[_RATIO, k]


@inlined
def _load(x, work, i, j, k0, count):
    for r in range(4):
        line = x[i + (r >> 1), j + (r & 1), k0 : k0 + count + 1]
        for k in range(count + 1):
            for d in range(3):
                work[3 * r + d, k] = line[k, d]


@inlined
def _corners(work, count, sign, to):
    """Area vectors u x v at all nodes of the four lines, and the corner Jacobians of the cells."""
    for k in range(count + 1):
        _cross(work, _AREA, k, 0, 6, 0, 3)
        _cross(work, _AREA + 3, k, 3, 9, 0, 3)
        _cross(work, _AREA + 6, k, 0, 6, 6, 9)
        _cross(work, _AREA + 9, k, 3, 9, 6, 9)
    for k in range(count):
        _two_corners(work, k, sign, 0, to)
        _two_corners(work, k, sign, 1, to + 2)
        _two_corners(work, k, sign, 2, to + 4)
        _two_corners(work, k, sign, 3, to + 6)


@inlined
def _two_corners(work, k, sign, r, to):
    x, y, z = _along(work, 3 * r, k)
    n = _AREA + 3 * r
    work[to, k] = sign * (work[n, k] * x + work[n + 1, k] * y + work[n + 2, k] * z)
    work[to + 1, k] = sign * (work[n, k + 1] * x + work[n + 1, k + 1] * y + work[n + 2, k + 1] * z)


@inlined
def _cross(work, to, k, i0, i1, j0, j1):
    """Area vector of the edges between rows i0, i1 and rows j0, j1 at node k."""
    ux, uy, uz = _across(work, i0, i1, k)
    vx, vy, vz = _across(work, j0, j1, k)
    work[to, k], work[to + 1, k], work[to + 2, k] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx


@inlined
def _across(work, one, two, k):
    return work[two, k] - work[one, k], work[two + 1, k] - work[one + 1, k], work[two + 2, k] - work[one + 2, k]


@inlined
def _along(work, row, k):
    return (
        work[row, k + 1] - work[row, k],
        work[row + 1, k + 1] - work[row + 1, k],
        work[row + 2, k + 1] - work[row + 2, k],
    )


@inlined
def _ratios(work, count):
    for k in range(count):
        work[_HIGH, k], work[_RATIO, k] = 0.0, np.inf
    for r in range(_BEFORE, _AFTER):
        for k in range(count):
            work[_HIGH, k] = max(work[_HIGH, k], work[r, k])
    for r in range(_BEFORE, _AFTER):
        for k in range(count):
            old = work[r, k]
            sound = old > COLLAPSED * work[_HIGH, k]
            ratio = work[r + _AFTER - _BEFORE, k] / (old if sound else 1.0)
            work[_RATIO, k] = min(work[_RATIO, k], ratio if sound else np.inf)


@inlined
def _coefficients(work, count, sign):
    """Smallest coefficient of each cell, not divided by the number of its terms, and largest corner Jacobian."""
    for k in range(count):
        _mixed(work, _BETWEEN, k, 0, 6, 0, 3)
        _mixed(work, _BETWEEN + 3, k, 3, 9, 0, 3)
        _mixed(work, _BETWEEN + 6, k, 0, 6, 6, 9)
        _mixed(work, _BETWEEN + 9, k, 3, 9, 6, 9)
    for k in range(count):
        work[_LOW, k], work[_HIGH, k] = np.inf, 0.0
    for r in range(_AFTER, _LOW):
        for k in range(count):
            work[_LOW, k] = min(work[_LOW, k], work[r, k])
            work[_HIGH, k] = max(work[_HIGH, k], work[r, k])
    for k in range(count):
        work[_LOW, k] = min(work[_LOW, k], _lowest_on_plane(work, _AREA, k, 0, sign))
    for k in range(count):
        work[_LOW, k] = min(work[_LOW, k], _lowest_on_plane(work, _AREA, k, 1, sign))
    for k in range(count):
        corners = min(
            min(sign * _triple(work, _BETWEEN, k, 0, 0, 0), sign * _triple(work, _BETWEEN, k, 0, 1, 1)),
            min(sign * _triple(work, _BETWEEN, k, 0, 2, 2), sign * _triple(work, _BETWEEN, k, 0, 3, 3)),
        )
        work[_LOW, k] = min(work[_LOW, k], min(corners, _lowest_on_plane(work, _BETWEEN, k, 0, sign)))


@inlined
def _mixed(work, to, k, i0, i1, j0, j1):
    """u at node k times v at node k + 1 plus the reverse."""
    ux, uy, uz = _across(work, i0, i1, k)
    vx, vy, vz = _across(work, j0, j1, k + 1)
    px, py, pz = _across(work, i0, i1, k + 1)
    qx, qy, qz = _across(work, j0, j1, k)
    work[to, k] = uy * vz - uz * vy + py * qz - pz * qy
    work[to + 1, k] = uz * vx - ux * vz + pz * qx - px * qz
    work[to + 2, k] = ux * vy - uy * vx + px * qy - py * qx


@inlined
def _triple(work, area, k, shift, at, line):
    """The area vector at line ``at`` of node k + shift times the edge along a line."""
    x, y, z = _along(work, 3 * line, k)
    n = area + 3 * at
    return work[n, k + shift] * x + work[n + 1, k + shift] * y + work[n + 2, k + shift] * z


@inlined
def _lowest_on_plane(work, area, k, shift, sign):
    """Smallest coefficient that belongs to an edge or the middle of a plane of area vectors."""
    one = _triple(work, area, k, shift, 0, 1) + _triple(work, area, k, shift, 1, 0)
    two = _triple(work, area, k, shift, 0, 2) + _triple(work, area, k, shift, 2, 0)
    three = _triple(work, area, k, shift, 1, 3) + _triple(work, area, k, shift, 3, 1)
    four = _triple(work, area, k, shift, 2, 3) + _triple(work, area, k, shift, 3, 2)
    middle = _triple(work, area, k, shift, 0, 3) + _triple(work, area, k, shift, 3, 0)
    middle += _triple(work, area, k, shift, 1, 2) + _triple(work, area, k, shift, 2, 1)
    edges = min(min(sign * one, sign * two), min(sign * three, sign * four))
    return min(edges, sign * middle)


@kernel
def judge_quads(before, x, normal, i0, i1, ratio):
    """Smallest corner Jacobian of quadrilaterals relative to the undeformed one; see :func:`judge_hexahedra`.

    ``before`` and ``x`` (na, nb, 3), ``normal`` the side that good cells look to. Where all corners are positive, the
    cell is: the Jacobian is linear along every grid line.
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
    return (
        normal[0] * (u[1] * v[2] - u[2] * v[1])
        + normal[1] * (u[2] * v[0] - u[0] * v[2])
        + normal[2] * (u[0] * v[1] - u[1] * v[0])
    )


@kernel
def decide(before, x, sign):
    """Which hexahedra that were sound are not any more: (m,) int8, 0 if sound, 1 if negative inside, 2 if by volume.

    Where the undeformed Jacobian is negative somewhere only the volume is judged. Coefficients that vanish in the
    undeformed cell, beside collapsed edges, do not count.

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
    """Is the polynomial with coefficients ``b`` positive, but where coefficients in ``zero`` vanish by construction?"""
    lowest = np.inf
    for n in range(27):
        if not zero.flat[n]:
            lowest = min(lowest, b.flat[n])
    if lowest > 0.0 or zero.all():
        return lowest > 0.0
    if zero.any():
        # Beside a collapsed edge no subdivision is exact; positive coefficients are asked for.
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
