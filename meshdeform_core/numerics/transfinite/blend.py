"""Transfinite interpolation of displacements with arc-length coordinates (Sen et al. eqs. 1, 3-10).

Blocks are cut at index planes into sub-blocks whose faces are known; each interior is blended from its six faces. The
coordinates and the table ``subs`` of sub-blocks are those of :mod:`.arcs`.
"""

from __future__ import annotations

import numpy as np

from ..jit import fast_kernel, inlined, kernel
from .arcs import TILE, padded, tile_start

# Number of neighbouring k lines that are filled together, so that the data they share stay in the cache.
_LINES = 64


# Rows of work arrays, three components each: coefficients of 1, y, x, x y, and results.
_ONE, _BY_Y, _BY_X, _BY_XY, _OUT = 0, 3, 6, 9, 12


@fast_kernel("f8[:, ::1], f8[::1], i8[:, ::1], i8[:, ::1]")
def blend_slabs(d, arc, subs, slabs):
    """Fill planes of the interior of sub-blocks from their faces, in place (eqs. 1, 3-9).

    With G the blending of the i and j faces at the node's arc coordinates x, y, z, the displacement is
    ``G + (1 - z) (d - G)(k low) + z (d - G)(k high)``. G is bilinear in x and y. Its coefficients along a k line follow
    from the i faces and are the same in all i planes; the j faces contribute to those of 1 and y.

    Parameters
    ----------
    d : (n_nodes, 3) of all blocks, known on the faces of the sub-blocks
    arc : arc coordinates, see :func:`.arcs.arc_numbers`
    slabs : (m, 3) row in ``subs`` and planes i0 <= i < i1 of the block
    """
    lines, slopes, sides = np.empty((_LINES, 15, TILE)), np.empty((_LINES, 12)), np.empty((6, TILE))
    # Vectors extend beyond the last node; the values there are not used, but must be finite.
    for k in range(TILE):
        for row in range(15):
            for line in range(_LINES):
                lines[line, row, k] = 0.0
        for row in range(6):
            sides[row, k] = 0.0
    for n in range(slabs.shape[0]):
        sub = subs[slabs[n, 0]]
        si, sj = sub[2] * sub[3], sub[3]
        corner = sub[0] + sub[4] * si + sub[5] * sj + sub[6]
        nj, nk = sub[8] - sub[5] - 1, sub[9] - sub[6] - 1
        for k0 in range(0, nk, TILE):
            count = min(TILE, nk - k0)
            for j0 in range(0, nj, _LINES):
                j1 = min(j0 + _LINES, nj)
                _prepare_lines(d, sub, corner, j0, j1, k0, count, lines, slopes)
                for i in range(slabs[n, 1] - sub[4], slabs[n, 2] - sub[4]):
                    plane, at = corner + i * si, sub[10] + tile_start(i - 1, j0, k0, nj, nk)
                    _blend_lines(d, plane, sj, (nj + 1) * sj, nk + 1, j0, j1, k0, count, arc, at, lines, slopes, sides)


@inlined
def _prepare_lines(d, sub, corner, j0, j1, k0, count, lines, slopes):
    """Coefficients along interior lines j0 <= j < j1 from the two i faces, and at the ends of the lines.

    ``lines`` gets the coefficients minus those at the low end of the line; ``slopes`` those at the low end minus those
    at the high end.
    """
    sj, up = sub[3], (sub[7] - sub[4]) * sub[2] * sub[3]
    end, high = (sub[8] - sub[5]) * sj, sub[9] - sub[6]
    for j in range(j0, j1):
        line = j - j0
        row = corner + (j + 1) * sj
        for c in range(3):
            a0, a1, a2, a3 = _coefficients(d, row, corner, corner + end, up, c)
            b0, b1, b2, b3 = _coefficients(d, row + high, corner + high, corner + end + high, up, c)
            slopes[line, _ONE + c], slopes[line, _BY_Y + c] = a0 - b0, a1 - b1
            slopes[line, _BY_X + c], slopes[line, _BY_XY + c] = a2 - b2, a3 - b3
            for k in range(count):
                at = k0 + 1 + k
                e0, e1, e2, e3 = _coefficients(d, row + at, corner + at, corner + end + at, up, c)
                lines[line, _ONE + c, k], lines[line, _BY_Y + c, k] = e0 - a0, e1 - a1
                lines[line, _BY_X + c, k], lines[line, _BY_XY + c, k] = e2 - a2, e3 - a3


@inlined
def _coefficients(d, node, low, high, up, c):
    """Coefficients of 1, y, x, x y at a node of the low i face: both i faces blended, minus their edges at both j ends.

    ``low`` and ``high`` are the ends of the node's line along j, ``up`` is the step to the other face.
    """
    first, second = d[node, c] - d[low, c], d[node + up, c] - d[low + up, c]
    along_low, along_high = d[high, c] - d[low, c], d[high + up, c] - d[low + up, c]
    return first, -along_low, second - first, along_low - along_high


@inlined
def _blend_lines(d, plane, sj, end, far, j0, j1, k0, count, arc, start, lines, slopes, sides):
    """Fill lines j0 <= j < j1 of an i plane from its two j sides and the ends of the lines.

    ``plane`` is the node at the low ends of j and k, ``end`` the step to the other j side, ``far`` the step to the
    other end of a line, ``start`` the start of the coordinates.
    """
    width = padded(count)
    low, high = d[plane + k0 + 1 :], d[plane + end + k0 + 1 :]
    for c in range(3):
        edge = d[plane, c] - d[plane + end, c]
        for k in range(count):
            sides[_ONE + c, k] = low[k, c]
            sides[_BY_Y + c, k] = high[k, c] - low[k, c] + edge
    for n in range(j1 - j0):
        row, at = plane + (j0 + n + 1) * sj, start + 3 * width * n
        # Views that begin at zero: indices that might be negative prevent vectorisation of the loop over k, as would a
        # loop over components.
        along_i, along_j, along_k = arc[at:], arc[at + width :], arc[at + 2 * width :]
        p0, p1, p2, p3, p4 = _at_ends(d, row, plane, end, far, slopes, n, 0)
        q0, q1, q2, q3, q4 = _at_ends(d, row, plane, end, far, slopes, n, 1)
        r0, r1, r2, r3, r4 = _at_ends(d, row, plane, end, far, slopes, n, 2)
        for k in range(width):
            x, y, z = along_i[k], along_j[k], along_k[k]
            lines[n, _OUT, k] = _blend_node(x, y, z, lines, n, sides, k, 0, p0, p1, p2, p3, p4)
            lines[n, _OUT + 1, k] = _blend_node(x, y, z, lines, n, sides, k, 1, q0, q1, q2, q3, q4)
            lines[n, _OUT + 2, k] = _blend_node(x, y, z, lines, n, sides, k, 2, r0, r1, r2, r3, r4)
        out = d[row + k0 + 1 :]
        for k in range(count):
            out[k, 0], out[k, 1], out[k, 2] = lines[n, _OUT, k], lines[n, _OUT + 1, k], lines[n, _OUT + 2, k]


@inlined
def _at_ends(d, row, plane, end, far, slopes, n, c):
    """Contributions of the ends of a line: to the coefficient of 1, and those of z, y z, x z and x y z."""
    one = d[row, c] - d[plane, c]
    by_z = d[row + far, c] - d[plane + far, c] - one + slopes[n, _ONE + c]
    by_yz = d[plane + far, c] - d[plane + end + far, c] - d[plane, c] + d[plane + end, c] + slopes[n, _BY_Y + c]
    return one, by_z, by_yz, slopes[n, _BY_X + c], slopes[n, _BY_XY + c]


@inlined
def _blend_node(x, y, z, lines, n, sides, k, c, one, by_z, by_yz, by_xz, by_xyz):
    p = lines[n, _ONE + c, k] + sides[_ONE + c, k] + one + z * by_z
    q = lines[n, _BY_Y + c, k] + sides[_BY_Y + c, k] + z * by_yz
    r = lines[n, _BY_X + c, k] + z * by_xz
    s = lines[n, _BY_XY + c, k] + z * by_xyz
    return p + y * q + x * (r + y * s)


@kernel("f8[:, ::1], f8[::1], i8[:, ::1]")
def blend_transposed(g, arc, subs):
    """Transpose of :func:`blend_slabs` for whole sub-blocks: faces minus edges plus corners, node by node.

    Gradients ``g`` (n_nodes, 3) of the nodes inside are passed on to the faces and set to zero.
    """
    x, high, index = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(subs.shape[0]):
        sub = subs[n]
        si, sj = sub[2] * sub[3], sub[3]
        corner = sub[0] + sub[4] * si + sub[5] * sj + sub[6]
        ni, nj, nk = sub[7] - sub[4] - 1, sub[8] - sub[5] - 1, sub[9] - sub[6] - 1
        high[0], high[1], high[2] = (ni + 1) * si, (nj + 1) * sj, nk + 1
        for i in range(ni):
            for k0 in range(0, nk, TILE):
                width = padded(min(TILE, nk - k0))
                for j in range(nj):
                    at = sub[10] + tile_start(i, 0, k0, nj, nk) + 3 * width * j
                    for k in range(k0, min(k0 + TILE, nk)):
                        x[0], x[1], x[2] = arc[at + k - k0], arc[at + width + k - k0], arc[at + 2 * width + k - k0]
                        index[0], index[1], index[2] = (i + 1) * si, (j + 1) * sj, k + 1
                        _spread(g, corner, index, high, x)


@inlined
def _spread(g, corner, index, high, x):
    """Pass the gradient of one node on to 26 nodes on the faces."""
    node = corner + index[0] + index[1] + index[2]
    a, b, c = g[node, 0], g[node, 1], g[node, 2]
    g[node, 0] = g[node, 1] = g[node, 2] = 0.0
    # Per direction: inside, low side, high side.
    for p in range(3):
        wp = 1.0 if p == 0 else (1.0 - x[0] if p == 1 else x[0])
        ip = index[0] if p == 0 else (0 if p == 1 else high[0])
        for q in range(3):
            wq = 1.0 if q == 0 else (1.0 - x[1] if q == 1 else x[1])
            iq = index[1] if q == 0 else (0 if q == 1 else high[1])
            for r in range(3):
                sides = (p > 0) + (q > 0) + (r > 0)
                if sides == 0:
                    continue
                wr = 1.0 if r == 0 else (1.0 - x[2] if r == 1 else x[2])
                ir = index[2] if r == 0 else (0 if r == 1 else high[2])
                w = wp * wq * wr * (-1.0 if sides == 2 else 1.0)
                to = corner + ip + iq + ir
                g[to, 0] += w * a
                g[to, 1] += w * b
                g[to, 2] += w * c
