"""Transfinite interpolation of displacements with arc-length coordinates (Sen et al. eqs. 1, 3-10).

Blocks are cut at index planes into sub-blocks whose faces are known; each interior is blended from its six faces. The
coordinates run from 0 to 1 within every sub-block. A table ``subs`` (n, 11) lists sub-blocks: first node and shape of
the block, low and high node of the sub-block, start of its arc coordinates, see :func:`arc_numbers`.
"""

import numpy as np

from .jit import contracted_kernel, fast_kernel, inlined, kernel

# Nodes along k and lines along j that are filled together: what they share stays in the cache.
_TILE, _LINES = 16, 64


@inlined
def _padded(count):
    """The next multiple of four, the numbers in a vector register: no loop along k ends with single numbers."""
    return -(-count // 4) * 4


@inlined
def _block(values, sub):
    """Values (n_nodes, 3) of the block of a sub-block, (ni, nj, nk, 3)."""
    ni, nj, nk = sub[1], sub[2], sub[3]
    return values[sub[0] : sub[0] + ni * nj * nk].reshape((ni, nj, nk, 3))


@inlined
def _ends(sub):
    """Low and high node of a sub-block."""
    return (sub[4], sub[5], sub[6]), (sub[7], sub[8], sub[9])


def arc_numbers(subs):
    """How many numbers the arc coordinates of each sub-block take.

    They are kept for interior nodes, in the order of use: for every plane along i tiles along k, for every line of a
    tile the coordinates along i of its nodes, then those along j, then those along k, each padded to vectors.
    """
    inside = np.maximum(subs[:, 7:10] - subs[:, 4:7] - 1, 0)
    return 3 * inside[:, 0] * inside[:, 1] * (-(-inside[:, 2] // 4) * 4)


@inlined
def _arc_at(i, j, k, axis, nj, nk):
    """Where the coordinate along ``axis`` of interior node (i, j, k), counted from 0, of nj nk in a plane, lies."""
    first = k - k % _TILE
    width = min(_TILE, _padded(nk) - first)
    return 3 * (nj * (i * _padded(nk) + first) + j * width) + axis * width + k - first


@kernel
def arc_coordinates(points, subs, first, last, arc):
    """Normalised arc lengths (eq. 10) of the interior nodes of sub-blocks.

    A line without length (collapsed edge) gets a uniform coordinate.

    Parameters
    ----------
    points : (n_nodes, 3) of all blocks
    first, last : which to compute: item 3 n + axis is those of sub-block n along i, j or k
    arc : where to put them, see :func:`arc_numbers`
    """
    for item in range(first, last):
        axis, sub = item % 3, subs[item // 3]
        (ia, ja, ka), (ib, jb, kb) = _ends(sub)
        x, out = _block(points, sub)[ia : ib + 1, ja : jb + 1, ka : kb + 1], arc[sub[10] :]
        for a in range(1, jb - ja if axis == 0 else ib - ia):
            if axis == 0:
                plane = arcs_across(x[:, a, 1:-1])[1:-1]
            elif axis == 1:
                plane = arcs_across(x[a, :, 1:-1])[1:-1]
            else:
                plane = np.ascontiguousarray(arcs_across(x[a, 1:-1].transpose((1, 0, 2)))[1:-1].T)
            for m in range(plane.shape[0]):
                i, j = (m, a - 1) if axis == 0 else (a - 1, m)
                for k in range(0, plane.shape[1], _TILE):
                    at, part = _arc_at(i, j, k, axis, jb - ja - 1, kb - ka - 1), plane[m, k : k + _TILE]
                    out[at : at + part.size] = part


@kernel
def arcs_across(x):
    """Arc coordinates (m, n) along the first index of a plane of nodes (m, n, 3), all lines together."""
    last = x.shape[0] - 1
    out = np.zeros(x.shape[:2])
    for m in range(1, last + 1):
        for n in range(x.shape[1]):
            dx, dy, dz = x[m, n, 0] - x[m - 1, n, 0], x[m, n, 1] - x[m - 1, n, 1], x[m, n, 2] - x[m - 1, n, 2]
            out[m, n] = out[m - 1, n] + np.sqrt(dx * dx + dy * dy + dz * dz)
    for m in range(1, last + 1):
        # The total comes last: until then it is needed.
        for n in range(x.shape[1]):
            total = out[last, n]
            out[m, n] = out[m, n] / total if total > 0.0 else m / last
    return out


# Rows of work arrays, three components each: coefficients of 1, y, x, x y, and results.
_ONE, _BY_Y, _BY_X, _BY_XY, _OUT = 0, 3, 6, 9, 12


@kernel
def blend_slabs(d, arc, subs, slabs):
    """Fill slabs of sub-blocks, see :func:`_blend_slab`.

    Parameters
    ----------
    d : (n_nodes, 3) of all blocks
    arc : arc coordinates, see :func:`arc_numbers`
    slabs : (m, 3) row in ``subs`` and planes i0 <= i < i1
    """
    for n in range(slabs.shape[0]):
        sub = subs[slabs[n, 0]]
        low, high = _ends(sub)
        _blend_slab(_block(d, sub), arc[sub[10] :], low, high, slabs[n, 1], slabs[n, 2])


@fast_kernel
def _blend_slab(d, arc, low, high, i0, i1):
    """Displacement of planes of the interior of one sub-block from its faces, in place (eqs. 1, 3-9).

    With G the blending of the i and j faces at the node's arc coordinates x, y, z, the displacement is
    ``G + (1 - z) (d - G)(k low) + z (d - G)(k high)``. G is bilinear in x and y. The i faces make up its coefficients
    along a line of nodes, the same in all planes; the j faces add to those of 1 and y.

    Parameters
    ----------
    d : (ni, nj, nk, 3), known on the faces of the sub-block between the nodes ``low`` and ``high``
    arc : arc coordinates of the sub-block
    i0, i1 : planes i0 <= i < i1 of the interior
    """
    (ia, ja, ka), (ib, jb, kb) = low, high
    lines, slopes, sides = np.zeros((_LINES, 15, _TILE)), np.zeros((_LINES, 12)), np.zeros((6, _TILE))
    js, ends = slice(ja, jb + 1), slice(ka, kb + 1, kb - ka)
    for k0 in range(ka + 1, kb, _TILE):
        tile = slice(k0, min(k0 + _TILE, kb))
        for j0 in range(ja + 1, jb, _LINES):
            part = slice(j0, min(j0 + _LINES, jb))
            faces, edges = (d[ia, js, tile], d[ib, js, tile]), (d[ia, js, ends], d[ib, js, ends])
            _prepare_lines(faces, edges, j0 - ja, part.stop - ja, lines, slopes)
            for i in range(i0, i1):
                at = _arc_at(i - ia - 1, j0 - ja - 1, k0 - ka - 1, 0, jb - ja - 1, kb - ka - 1)
                faces, edges = (d[i, ja, tile], d[i, jb, tile]), (d[i, ja, ends], d[i, jb, ends])
                _blend_lines(faces, edges, d[i, part, ends], arc[at:], lines, slopes, sides, d[i, part, tile])


@inlined
def _prepare_lines(faces, edges, first, last, lines, slopes):
    """Coefficients along lines first <= j < last from two i ``faces`` (nj, n, 3) and their ``edges`` (nj, 2, 3).

    ``lines`` gets them less those at the low end of the line, ``slopes`` those at the low end less the high end.
    """
    for j in range(first, last):
        line, slope = lines[j - first], slopes[j - first]
        for c in range(3):
            a0, a1, a2, a3 = _coefficients(edges, j, 0, c)
            b0, b1, b2, b3 = _coefficients(edges, j, 1, c)
            slope[_ONE + c], slope[_BY_Y + c], slope[_BY_X + c], slope[_BY_XY + c] = a0 - b0, a1 - b1, a2 - b2, a3 - b3
            for k in range(faces[0].shape[1]):
                e0, e1, e2, e3 = _coefficients(faces, j, k, c)
                line[_ONE + c, k], line[_BY_Y + c, k] = e0 - a0, e1 - a1
                line[_BY_X + c, k], line[_BY_XY + c, k] = e2 - a2, e3 - a3


@inlined
def _coefficients(faces, j, k, c):
    """Of 1, y, x, x y at line j in the blending of two i faces (nj, n, 3), less their edges at both ends of j."""
    low, high = faces
    end = low.shape[0] - 1
    first, second = low[j, k, c] - low[0, k, c], high[j, k, c] - high[0, k, c]
    along_low, along_high = low[end, k, c] - low[0, k, c], high[end, k, c] - high[0, k, c]
    return first, -along_low, second - first, along_low - along_high


@inlined
def _blend_lines(faces, edges, ends, arc, lines, slopes, sides, out):
    """Lines (m, n, 3) of a plane i from two j ``faces`` (n, 3), their ``edges`` (2, 3) and own ``ends`` (m, 2, 3)."""
    low, high = faces
    count = out.shape[1]
    width = _padded(count)
    for c in range(3):
        for k in range(count):
            sides[_ONE + c, k] = low[k, c]
            sides[_BY_Y + c, k] = high[k, c] - low[k, c] + edges[0][0, c] - edges[1][0, c]
    for n in range(out.shape[0]):
        line, start = lines[n], 3 * width * n
        along_i, along_j, along_k = arc[start:], arc[start + width :], arc[start + 2 * width :]
        ends0 = _at_ends(ends[n], edges, slopes[n], 0)
        ends1 = _at_ends(ends[n], edges, slopes[n], 1)
        ends2 = _at_ends(ends[n], edges, slopes[n], 2)
        for k in range(width):
            # Components by name, a loop over them would keep this one scalar; coordinates once, before any is written.
            x, y, z = along_i[k], along_j[k], along_k[k]
            line[_OUT, k] = _blend_node(x, y, z, line, sides, k, 0, ends0)
            line[_OUT + 1, k] = _blend_node(x, y, z, line, sides, k, 1, ends1)
            line[_OUT + 2, k] = _blend_node(x, y, z, line, sides, k, 2, ends2)
        for k in range(count):
            out[n, k, 0], out[n, k, 1], out[n, k, 2] = line[_OUT, k], line[_OUT + 1, k], line[_OUT + 2, k]


@contracted_kernel
def _at_ends(ends, edges, slope, c):
    """What the ends of a line add to the coefficient of 1, and the coefficients of z, y z, x z, x y z."""
    low, high = edges
    one = ends[0, c] - low[0, c]
    by_z = ends[1, c] - low[1, c] - one + slope[_ONE + c]
    by_yz = low[1, c] - high[1, c] - low[0, c] + high[0, c] + slope[_BY_Y + c]
    return one, by_z, by_yz, slope[_BY_X + c], slope[_BY_XY + c]


@contracted_kernel
def _blend_node(x, y, z, line, sides, k, c, ends):
    one = line[_ONE + c, k] + sides[_ONE + c, k] + ends[0] + z * ends[1]
    by_y = line[_BY_Y + c, k] + sides[_BY_Y + c, k] + z * ends[2]
    by_x = line[_BY_X + c, k] + z * ends[3]
    by_xy = line[_BY_XY + c, k] + z * ends[4]
    return one + y * by_y + x * (by_x + y * by_xy)
