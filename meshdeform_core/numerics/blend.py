"""Transfinite interpolation of displacements with arc-length coordinates (Sen et al. eqs. 1-10).

A block is cut at index planes into sub-blocks whose faces are known; each interior is blended from its six faces. The
coordinates run from 0 to 1 within every sub-block. Cuts are index arrays from 0 to n - 1.
"""

import numpy as np

from .jit import fast_kernel, inlined, kernel


@kernel
def arcs_along_i(points, cuts, j0, j1, out):
    """Normalised arc lengths (eq. 10) along i within each sub-block, for the lines j0 <= j < j1.

    Parameters
    ----------
    points : (ni, nj, nk, 3)
    cuts : node indices where sub-blocks end, first and last node included
    out : (ni, nj, nk, 3), component 0; a line without length (collapsed edge) gets a uniform coordinate
    """
    for j in range(j0, j1):
        _arcs_across(points[:, j], cuts, out[:, j, :, 0])


@kernel
def arcs_along_j_and_k(points, cuts_j, cuts_k, i0, i1, out):
    """The same along j and k, for the planes i0 <= i < i1, into components 1 and 2."""
    for i in range(i0, i1):
        _arcs_across(points[i], cuts_j, out[i, :, :, 1])
        for j in range(points.shape[1]):
            _line(points[i, j], cuts_k, out[i, j, :, 2])


@kernel
def _arcs_across(x, cuts, out):
    """Arc coordinates along the first index of a plane (m, n, 3): all lines together, in the order of memory."""
    out[0] = 0.0
    for c in range(cuts.size - 1):
        first, last = cuts[c], cuts[c + 1]
        for m in range(first + 1, last + 1):
            for n in range(x.shape[1]):
                dx, dy, dz = x[m, n, 0] - x[m - 1, n, 0], x[m, n, 1] - x[m - 1, n, 1], x[m, n, 2] - x[m - 1, n, 2]
                start = out[m - 1, n] if m > first + 1 else 0.0
                out[m, n] = start + np.sqrt(dx * dx + dy * dy + dz * dz)
        for m in range(first + 1, last + 1):
            # The total comes last: until then it is needed.
            for n in range(x.shape[1]):
                total = out[last, n]
                if total > 0.0:
                    out[m, n] = out[m, n] / total
                else:
                    out[m, n] = (m - first) / (last - first)


@kernel
def _line(x, cuts, out):
    """Arc coordinate along one grid line; a cut belongs to the segment that it ends."""
    out[0] = 0.0
    for c in range(cuts.size - 1):
        first, last = cuts[c], cuts[c + 1]
        total = 0.0
        for n in range(first + 1, last + 1):
            dx, dy, dz = x[n, 0] - x[n - 1, 0], x[n, 1] - x[n - 1, 1], x[n, 2] - x[n - 1, 2]
            total += np.sqrt(dx * dx + dy * dy + dz * dz)
            out[n] = total
        for n in range(first + 1, last + 1):
            out[n] = out[n] / total if total > 0.0 else (n - first) / (last - first)


# Nodes along j and k that are filled together: what they share stays in the cache.
_LINES, _TILE = 16, 64
# Rows of work arrays, three components each: coefficients of 1, y1, x1, x1 y1; j faces, arc coordinates, results.
_ONE, _BY_Y, _BY_X, _BY_XY = 0, 3, 6, 9
_SIDE, _ACROSS, _ARC, _OUT = 0, 3, 6, 9


@kernel
def blend_slabs(d, arc, slabs):
    """Fill slabs of sub-blocks, see :func:`_blend_slab`.

    Parameters
    ----------
    d, arc : (n_nodes, 3) of all blocks
    slabs : (n, 12) first node and shape of the block; low and high node of the sub-block; planes i0 <= i < i1
    """
    for n in range(slabs.shape[0]):
        start, ni, nj, nk = slabs[n, 0], slabs[n, 1], slabs[n, 2], slabs[n, 3]
        shape, end = (ni, nj, nk, 3), start + ni * nj * nk
        low, high = (slabs[n, 4], slabs[n, 5], slabs[n, 6]), (slabs[n, 7], slabs[n, 8], slabs[n, 9])
        block, coordinates = d[start:end].reshape(shape), arc[start:end].reshape(shape)
        _blend_slab(block, coordinates, low, high, slabs[n, 10], slabs[n, 11])


@fast_kernel
def _blend_slab(d, arc, low, high, i0, i1):
    """Displacement of planes of the interior of one sub-block from its faces, in place (eqs. 1, 3-9).

    With G the blending of the i and j faces at the node's arc coordinates x1, y1, and z0 = 1 - z1, the displacement is
    ``G + z0 (d - G)(k low) + z1 (d - G)(k high)``. G is bilinear in x1 and y1.

    Parameters
    ----------
    d : (ni, nj, nk, 3), known on the faces of the sub-block between the nodes ``low`` and ``high``
    arc : (ni, nj, nk, 3) arc coordinates
    i0, i1 : planes i0 <= i < i1 of the interior
    """
    (ia, ja, ka), (ib, jb, kb) = low, high
    # Components in rows of their own and of a length known to the compiler: vector code.
    faces, work = np.empty((_LINES, 12, _TILE)), np.empty((12, _TILE))
    ends, line_ends = np.empty((_LINES, 12, 2)), np.empty((12, 2))
    both = slice(ka, kb + 1, kb - ka)
    for k0 in range(ka + 1, kb, _TILE):
        tile = slice(k0, min(k0 + _TILE, kb))
        for j0 in range(ja + 1, jb, _LINES):
            j1 = min(j0 + _LINES, jb)
            for j in range(j0, j1):
                _between_i_faces(d[ia, :, tile], d[ib, :, tile], ja, j, jb, faces[j - j0])
                _between_i_faces(d[ia, :, both], d[ib, :, both], ja, j, jb, ends[j - j0])
            for i in range(i0, i1):
                _sides(d[i, ja, tile], d[i, jb, tile], work)
                for j in range(j0, j1):
                    _line_ends(d[i, j], d[i, ja], d[i, jb], ka, kb, ends[j - j0], line_ends)
                    _blend_line(arc[i, j, tile], faces[j - j0], line_ends, work, d[i, j, tile])


@inlined
def _between_i_faces(low, high, ja, j, jb, out):
    """Coefficients of line j in the blending of two i faces (nj, n, 3), less their edges at ja and jb."""
    for k in range(low.shape[1]):
        for c in range(3):
            first, second = low[j, k, c] - low[ja, k, c], high[j, k, c] - high[ja, k, c]
            along_low, along_high = low[jb, k, c] - low[ja, k, c], high[jb, k, c] - high[ja, k, c]
            out[_ONE + c, k], out[_BY_Y + c, k] = first, -along_low
            out[_BY_X + c, k], out[_BY_XY + c, k] = second - first, along_low - along_high


@inlined
def _sides(low, high, work):
    """A line on the low j face and the difference to the one on the high j face."""
    for k in range(low.shape[0]):
        for c in range(3):
            work[_SIDE + c, k], work[_ACROSS + c, k] = low[k, c], high[k, c] - low[k, c]


@inlined
def _line_ends(line, low, high, ka, kb, ends, out):
    """Coefficients of d - G at the low end of a line along k, and high end less low end."""
    for c in range(3):
        out[_ONE + c, 0] = line[ka, c] - low[ka, c] - ends[_ONE + c, 0]
        out[_ONE + c, 1] = line[kb, c] - low[kb, c] - ends[_ONE + c, 1] - out[_ONE + c, 0]
        out[_BY_Y + c, 0] = low[ka, c] - high[ka, c] - ends[_BY_Y + c, 0]
        out[_BY_Y + c, 1] = low[kb, c] - high[kb, c] - ends[_BY_Y + c, 1] - out[_BY_Y + c, 0]
        out[_BY_X + c, 0], out[_BY_XY + c, 0] = -ends[_BY_X + c, 0], -ends[_BY_XY + c, 0]
        out[_BY_X + c, 1] = ends[_BY_X + c, 0] - ends[_BY_X + c, 1]
        out[_BY_XY + c, 1] = ends[_BY_XY + c, 0] - ends[_BY_XY + c, 1]


@inlined
def _blend_line(arc, faces, ends, work, out):
    count = arc.shape[0]
    for k in range(count):
        work[_ARC, k], work[_ARC + 1, k], work[_ARC + 2, k] = arc[k, 0], arc[k, 1], arc[k, 2]
    # By name: a loop over the components would keep the loop over k scalar.
    _blend_component(faces, ends, work, count, 0)
    _blend_component(faces, ends, work, count, 1)
    _blend_component(faces, ends, work, count, 2)
    for k in range(count):
        out[k, 0], out[k, 1], out[k, 2] = work[_OUT, k], work[_OUT + 1, k], work[_OUT + 2, k]


@inlined
def _blend_component(faces, ends, work, count, c):
    p0, p1, p2, p3 = ends[_ONE + c, 0], ends[_BY_Y + c, 0], ends[_BY_X + c, 0], ends[_BY_XY + c, 0]
    q0, q1, q2, q3 = ends[_ONE + c, 1], ends[_BY_Y + c, 1], ends[_BY_X + c, 1], ends[_BY_XY + c, 1]
    for k in range(count):
        x, y, z = work[_ARC, k], work[_ARC + 1, k], work[_ARC + 2, k]
        one = faces[_ONE + c, k] + work[_SIDE + c, k] + p0 + z * q0
        by_y = faces[_BY_Y + c, k] + work[_ACROSS + c, k] + p1 + z * q1
        by_x = faces[_BY_X + c, k] + p2 + z * q2
        by_xy = faces[_BY_XY + c, k] + p3 + z * q3
        work[_OUT + c, k] = one + y * by_y + x * (by_x + y * by_xy)


@fast_kernel
def blend_plane(d, s, t):
    """Displacement of the interior of a plane (na, nb, 3) from its four edges, in place (eq. 2).

    ``s`` and ``t`` (na, nb) are the arc coordinates along the first and second index.
    """
    m, n = d.shape[0] - 1, d.shape[1] - 1
    for a in range(1, m):
        for b in range(1, n):
            s1, t1 = s[a, b], t[a, b]
            s0, t0 = 1.0 - s1, 1.0 - t1
            for c in range(3):
                across = s0 * (d[0, b, c] - t0 * d[0, 0, c] - t1 * d[0, n, c])
                across += s1 * (d[m, b, c] - t0 * d[m, 0, c] - t1 * d[m, n, c])
                d[a, b, c] = across + t0 * d[a, 0, c] + t1 * d[a, n, c]


@fast_kernel
def blend_face(d, nodes, unknown, s, t):
    """The same for a part of a face, ``nodes`` (na, nb) in ``d`` (n, 3), in place where ``unknown`` holds."""
    m, n = nodes.shape[0] - 1, nodes.shape[1] - 1
    c00, c0n, cm0, cmn = d[nodes[0, 0]], d[nodes[0, n]], d[nodes[m, 0]], d[nodes[m, n]]
    for a in range(1, m):
        left, right = d[nodes[a, 0]], d[nodes[a, n]]
        for b in range(1, n):
            if not unknown[a, b]:
                continue
            low, high, at = nodes[0, b], nodes[m, b], nodes[a, b]
            s1, t1 = s[a, b], t[a, b]
            s0, t0 = 1.0 - s1, 1.0 - t1
            for c in range(3):
                across = s0 * (d[low, c] - t0 * c00[c] - t1 * c0n[c]) + s1 * (d[high, c] - t0 * cm0[c] - t1 * cmn[c])
                d[at, c] = across + t0 * left[c] + t1 * right[c]


def plane_coordinates(points):
    """Arc coordinates s, t (na, nb) along both indices of a plane of nodes (na, nb, 3)."""
    coordinates = []
    for axis in (0, 1):
        length = np.linalg.norm(np.diff(points, axis=axis), axis=2)
        start = np.zeros_like(np.take(length, [0], axis=axis))
        arc = np.concatenate([start, np.cumsum(length, axis=axis)], axis=axis)
        total = np.take(arc, [-1], axis=axis)
        shape = [-1, 1] if axis == 0 else [1, -1]
        uniform = np.linspace(0.0, 1.0, points.shape[axis]).reshape(shape)
        coordinates.append(np.where(total > 0, arc / np.where(total > 0, total, 1.0), uniform))
    return coordinates
