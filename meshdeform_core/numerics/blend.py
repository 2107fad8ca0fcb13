"""Transfinite interpolation of displacements with arc-length coordinates (Sen et al. eqs. 1-10).

A block is cut at index planes into sub-blocks whose faces are known; each interior is blended from its six faces. The
coordinates run from 0 to 1 within every sub-block. Cuts are index arrays from 0 to n - 1.
"""

import numpy as np

from .jit import fast_kernel, kernel


@kernel
def arc_coordinates(points, cuts_i, cuts_j, cuts_k, out):
    """Normalised arc lengths (eq. 10) along i, j, k within each sub-block, into ``out`` (ni, nj, nk, 3).

    A line without length (collapsed edge) gets a uniform coordinate.
    """
    ni, nj, nk = points.shape[0], points.shape[1], points.shape[2]
    for j in range(nj):
        for k in range(nk):
            _line(points[:, j, k], cuts_i, out[:, j, k, 0])
    for i in range(ni):
        for k in range(nk):
            _line(points[i, :, k], cuts_j, out[i, :, k, 1])
    for i in range(ni):
        for j in range(nj):
            _line(points[i, j], cuts_k, out[i, j, :, 2])


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


@fast_kernel
def blend_block(d, arc, i0, i1, j0, j1, k0, k1):
    """Displacement of the interior of one sub-block from its faces, in place (eqs. 1, 3-9).

    Parameters
    ----------
    d : (ni, nj, nk, 3), known on the faces of the sub-block i0..i1, j0..j1, k0..k1
    arc : (ni, nj, nk, 3) from :func:`arc_coordinates`
    """
    for i in range(i0 + 1, i1):
        for j in range(j0 + 1, j1):
            for k in range(k0 + 1, k1):
                x1, y1, z1 = arc[i, j, k, 0], arc[i, j, k, 1], arc[i, j, k, 2]
                x0, y0, z0 = 1.0 - x1, 1.0 - y1, 1.0 - z1
                for c in range(3):
                    # Each face minus half-shared edges plus corners, nested so that every value is read once.
                    low = d[i0, j, k, c] - y0 * d[i0, j0, k, c] - y1 * d[i0, j1, k, c]
                    high = d[i1, j, k, c] - y0 * d[i1, j0, k, c] - y1 * d[i1, j1, k, c]
                    along_i = x0 * low + x1 * high
                    low = d[i, j0, k, c] - z0 * d[i, j0, k0, c] - z1 * d[i, j0, k1, c]
                    high = d[i, j1, k, c] - z0 * d[i, j1, k0, c] - z1 * d[i, j1, k1, c]
                    along_j = y0 * low + y1 * high
                    low = d[i, j, k0, c] - x0 * d[i0, j, k0, c] - x1 * d[i1, j, k0, c]
                    high = d[i, j, k1, c] - x0 * d[i0, j, k1, c] - x1 * d[i1, j, k1, c]
                    along_k = z0 * low + z1 * high
                    bottom = x0 * (y0 * d[i0, j0, k0, c] + y1 * d[i0, j1, k0, c]) + x1 * (
                        y0 * d[i1, j0, k0, c] + y1 * d[i1, j1, k0, c]
                    )
                    top = x0 * (y0 * d[i0, j0, k1, c] + y1 * d[i0, j1, k1, c]) + x1 * (
                        y0 * d[i1, j0, k1, c] + y1 * d[i1, j1, k1, c]
                    )
                    d[i, j, k, c] = along_i + along_j + along_k + z0 * bottom + z1 * top


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
