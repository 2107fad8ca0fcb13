"""Is the Jacobian of a cell positive everywhere? Its Bernstein coefficients prove it, one pass over a block.

The Jacobian of a trilinear hexahedron is a polynomial of degree 2 in each coordinate. Its 27 coefficients in the basis
of Bernstein bound it, the corner ones are its values at the corners, and halving the cell brings the others nearer to
values (Johnen, Weill & Remacle: Robust and efficient validation of the linear hexahedral element, Procedia Engineering
203, 2017, arXiv 1706.01613). With u, v, w the edges along i, j, k, at corners (b, c), (a, c), (a, b), a coefficient is
a mean of triple products u x v . w.
"""

import numpy as np

from ..jit import inlined, kernel

# Rows of the work array of a line of cells: coordinates of the four lines of nodes around it (3 r + axis for the line
# r = 2 a + b at i + a, j + b), area vectors of the corners on a plane of nodes and those between two planes, corner
# Jacobians before and after (2 r + c), results, a coefficient,
# edges along the lines.
_AREA, _BETWEEN, _BEFORE, _AFTER, _LOW, _HIGH, _RATIO, _SUM, _EDGE, _ROWS = 12, 24, 36, 44, 52, 53, 54, 55, 56, 68
_TILE = 56
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
                for time in range(2):
                    _load(before if time == 0 else x, work, i, j, k0, count)
                    _corners(work, count, sign, _BEFORE if time == 0 else _AFTER)
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


# Rows are computed in loops over lines and not by name: they compile in a tenth of the time and become the same vector
# code. The edges along i and j that begin on line r are those of the rows of lines r & 1 and 2 + (r & 1), and of lines
# r & 2 and (r & 2) + 1.
@inlined
def _corners(work, count, sign, to):
    """Area vectors u x v at all nodes of the four lines, and the corner Jacobians of the cells."""
    for r in range(4):
        u, v, n = 3 * (r & 1), 3 * (r & 2), _AREA + 3 * r
        for k in range(count + 1):
            ux, uy, uz = work[u + 6, k] - work[u, k], work[u + 7, k] - work[u + 1, k], work[u + 8, k] - work[u + 2, k]
            vx, vy, vz = work[v + 3, k] - work[v, k], work[v + 4, k] - work[v + 1, k], work[v + 5, k] - work[v + 2, k]
            work[n, k], work[n + 1, k], work[n + 2, k] = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in range(count):
            for d in range(3):
                work[_EDGE + 3 * r + d, k] = work[3 * r + d, k + 1] - work[3 * r + d, k]
        for c in range(2):
            w, row = _EDGE + 3 * r, to + 2 * r + c
            for k in range(count):
                m = k + (c & 1)
                area = work[n, m] * work[w, k] + work[n + 1, m] * work[w + 1, k] + work[n + 2, m] * work[w + 2, k]
                work[row, k] = sign * area


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


# Coefficients that are no corners are sums of products of the area vector at one line and the edge along another, taken
# in pairs: the four edges of a plane of nodes, and its middle, which is two pairs. Between the planes also the edges
# that join corners, where a pair is twice the same.
_EDGES = (((0, 1), (1, 0)), ((0, 2), (2, 0)), ((1, 3), (3, 1)), ((2, 3), (3, 2)))
_MIDDLE = (((0, 3), (3, 0)), ((1, 2), (2, 1)))
_UPRIGHT = (((0, 0), (0, 0)), ((1, 1), (1, 1)), ((2, 2), (2, 2)), ((3, 3), (3, 3)))
# Rows of area vector and edge of both products, which of the two nodes, whether the sum goes on with the next pair.
_PAIRS = np.array(
    [
        (area + 3 * one, _EDGE + 3 * two, area + 3 * three, _EDGE + 3 * four, shift, number == len(_EDGES))
        for area, shift, upright in ((_AREA, 0, ()), (_AREA, 1, ()), (_BETWEEN, 0, _UPRIGHT))
        for number, ((one, two), (three, four)) in enumerate(_EDGES + _MIDDLE + upright)
    ],
    dtype=np.int64,
)


@inlined
def _coefficients(work, count, sign):
    """Smallest coefficient of each cell, not divided by the number of its terms, and largest corner Jacobian."""
    for r in range(4):
        # u at node k times v at node k + 1 plus the reverse.
        u, v, n = 3 * (r & 1), 3 * (r & 2), _BETWEEN + 3 * r
        for k in range(count):
            ux, uy, uz = work[u + 6, k] - work[u, k], work[u + 7, k] - work[u + 1, k], work[u + 8, k] - work[u + 2, k]
            qx, qy, qz = work[v + 3, k] - work[v, k], work[v + 4, k] - work[v + 1, k], work[v + 5, k] - work[v + 2, k]
            m = k + 1
            px, py, pz = work[u + 6, m] - work[u, m], work[u + 7, m] - work[u + 1, m], work[u + 8, m] - work[u + 2, m]
            vx, vy, vz = work[v + 3, m] - work[v, m], work[v + 4, m] - work[v + 1, m], work[v + 5, m] - work[v + 2, m]
            work[n, k] = uy * vz - uz * vy + py * qz - pz * qy
            work[n + 1, k] = uz * vx - ux * vz + pz * qx - px * qz
            work[n + 2, k] = ux * vy - uy * vx + px * qy - py * qx
    for k in range(count):
        work[_LOW, k], work[_HIGH, k] = np.inf, 0.0
    for r in range(_AFTER, _LOW):
        for k in range(count):
            work[_LOW, k] = min(work[_LOW, k], work[r, k])
            work[_HIGH, k] = max(work[_HIGH, k], work[r, k])
    for k in range(count):
        work[_SUM, k] = 0.0
    for m in range(_PAIRS.shape[0]):
        n, w, p, q, c = _PAIRS[m, 0], _PAIRS[m, 1], _PAIRS[m, 2], _PAIRS[m, 3], _PAIRS[m, 4]
        # c & 1 and not c: an index that might be negative would keep the loop scalar.
        for k in range(count):
            m1 = k + (c & 1)
            one = work[n, m1] * work[w, k] + work[n + 1, m1] * work[w + 1, k] + work[n + 2, m1] * work[w + 2, k]
            two = work[p, m1] * work[q, k] + work[p + 1, m1] * work[q + 1, k] + work[p + 2, m1] * work[q + 2, k]
            work[_SUM, k] += sign * (one + two)
        if _PAIRS[m, 5] == 0:
            for k in range(count):
                work[_LOW, k] = min(work[_LOW, k], work[_SUM, k])
                work[_SUM, k] = 0.0


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
