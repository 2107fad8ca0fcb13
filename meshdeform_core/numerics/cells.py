"""Shape measures of cells: Jacobians, skewness metric and volume, one pass over a block."""

import math

import numpy as np

from .jit import kernel


@kernel
def measure_hexahedra(x, sign, i0, i1, skew, scaled, jacobian, volume, bad):
    """Measures of the cells i0 <= i < i1 of a block.

    Parameters
    ----------
    x : (ni, nj, nk, 3) nodes
    sign : handedness of the block, so that good cells have positive Jacobians
    skew : (ci, cj, ck) out, f_skew = 8 / sum over corners of (sqrt(l11 l22 l33) / a)^(2/3), 0 if any a <= 0
        (Knupp 2003)
    scaled : out, smallest corner Jacobian divided by its three edge lengths
    jacobian : out, smallest corner Jacobian (length^3)
    volume : out, exact volume of the trilinear cell
    bad : out, uint8, bit c set where corner c has a Jacobian <= 0
    """
    edge = np.empty((3, 4, 3))
    square = np.empty((3, 4))
    p = np.empty((8, 3))
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            for k in range(x.shape[2] - 1):
                for c in range(8):
                    for d in range(3):
                        p[c, d] = x[i + (c >> 2), j + ((c >> 1) & 1), k + (c & 1), d]
                _edges(p, edge, square)
                total, lowest, lowest_scaled, mask = 0.0, np.inf, np.inf, 0
                for c in range(8):
                    a, b, g = c >> 2, (c >> 1) & 1, c & 1
                    u, v, w = edge[0, 2 * b + g], edge[1, 2 * a + g], edge[2, 2 * a + b]
                    det = sign * (
                        u[0] * (v[1] * w[2] - v[2] * w[1])
                        + u[1] * (v[2] * w[0] - v[0] * w[2])
                        + u[2] * (v[0] * w[1] - v[1] * w[0])
                    )
                    size = math.sqrt(square[0, 2 * b + g] * square[1, 2 * a + g] * square[2, 2 * a + b])
                    lowest = min(lowest, det)
                    lowest_scaled = min(lowest_scaled, det / size if size > 0.0 else 0.0)
                    if det > 0.0:
                        ratio = size / det
                        total += (ratio * ratio) ** (1.0 / 3.0)
                    else:
                        mask |= 1 << c
                n = i - i0
                skew[n, j, k] = 0.0 if mask else min(8.0 / total, 1.0)
                scaled[n, j, k] = lowest_scaled
                jacobian[n, j, k] = lowest
                volume[n, j, k] = sign * _hexahedron_volume(p)
                bad[n, j, k] = mask


@kernel
def _edges(p, edge, square):
    """Edge vectors along i, j, k of a cell; corner c = 4 a + 2 b + g at (i + a, j + b, k + g)."""
    for n in range(4):
        low, high = n >> 1, n & 1
        for d in range(3):
            edge[0, n, d] = p[4 + 2 * low + high, d] - p[2 * low + high, d]
            edge[1, n, d] = p[4 * low + 2 + high, d] - p[4 * low + high, d]
            edge[2, n, d] = p[4 * low + 2 * high + 1, d] - p[4 * low + 2 * high, d]
        for axis in range(3):
            e = edge[axis, n]
            square[axis, n] = e[0] * e[0] + e[1] * e[1] + e[2] * e[2]


@kernel
def _hexahedron_volume(p):
    """A third of the flux of the position through the six bilinear faces: centroid times area vector, exactly."""
    return (
        _face_flux(p, 4, 6, 7, 5)
        + _face_flux(p, 0, 1, 3, 2)
        + _face_flux(p, 2, 3, 7, 6)
        + _face_flux(p, 0, 4, 5, 1)
        + _face_flux(p, 1, 5, 7, 3)
        + _face_flux(p, 0, 2, 6, 4)
    ) / 24.0


@kernel
def _face_flux(p, a, b, c, d):
    # Relative to corner 0, so that a cell far from the origin loses no digits.
    ux, uy, uz = p[c, 0] - p[a, 0], p[c, 1] - p[a, 1], p[c, 2] - p[a, 2]
    vx, vy, vz = p[d, 0] - p[b, 0], p[d, 1] - p[b, 1], p[d, 2] - p[b, 2]
    cx = p[a, 0] + p[b, 0] + p[c, 0] + p[d, 0] - 4.0 * p[0, 0]
    cy = p[a, 1] + p[b, 1] + p[c, 1] + p[d, 1] - 4.0 * p[0, 1]
    cz = p[a, 2] + p[b, 2] + p[c, 2] + p[d, 2] - 4.0 * p[0, 2]
    return cx * (uy * vz - uz * vy) + cy * (uz * vx - ux * vz) + cz * (ux * vy - uy * vx)


@kernel
def measure_quads(x, normal, i0, i1, skew, scaled, jacobian, area, bad):
    """The same for a 2-D block (na, nb, 3) whose good cells have Jacobians along ``normal``.

    f_skew = 4 / sum over corners of sqrt(l11 l22) / a; corner c = 2 a + b at (a, b).
    """
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            total, lowest, lowest_scaled, mask = 0.0, np.inf, np.inf, 0
            for c in range(4):
                a, b = c >> 1, c & 1
                u = x[i + 1, j + b] - x[i, j + b]
                v = x[i + a, j + 1] - x[i + a, j]
                det = (
                    normal[0] * (u[1] * v[2] - u[2] * v[1])
                    + normal[1] * (u[2] * v[0] - u[0] * v[2])
                    + normal[2] * (u[0] * v[1] - u[1] * v[0])
                )
                size = math.sqrt((u[0] * u[0] + u[1] * u[1] + u[2] * u[2]) * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2]))
                lowest = min(lowest, det)
                lowest_scaled = min(lowest_scaled, det / size if size > 0.0 else 0.0)
                if det > 0.0:
                    total += size / det
                else:
                    mask |= 1 << c
            n = i - i0
            skew[n, j] = 0.0 if mask else min(4.0 / total, 1.0)
            scaled[n, j] = lowest_scaled
            jacobian[n, j] = lowest
            u = x[i + 1, j + 1] - x[i, j]
            v = x[i, j + 1] - x[i + 1, j]
            area[n, j] = 0.5 * (
                normal[0] * (u[1] * v[2] - u[2] * v[1])
                + normal[1] * (u[2] * v[0] - u[0] * v[2])
                + normal[2] * (u[0] * v[1] - u[1] * v[0])
            )
            bad[n, j] = mask
