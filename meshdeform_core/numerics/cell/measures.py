"""Shape measures of cells: Jacobians, skewness metric and volume."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray
from ..jit import kernel
from .volume import along


@kernel("f8[:, :, ::1], f8[::1], i8, i8, f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], u1[:, ::1]")
def measure_quads(x, normal, i0, i1, skew, scaled, jacobian, area, bad):
    """Measures of the cells i0 <= i < i1 of a 2-D block (na, nb, 3) whose valid cells have Jacobians along ``normal``.

    Parameters
    ----------
    skew, scaled, jacobian, area : (i1 - i0, nb - 1), out: f_skew = 4 / sum over corners of sqrt(l11 l22) / a, 0 if any
        a <= 0 (Knupp 2003); smallest corner Jacobian, divided by its two edge lengths, and plain
    bad : out, uint8, bit c set where corner c = 2 a + b at (a, b) has a Jacobian <= 0
    """
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            total, lowest, lowest_scaled, mask = 0.0, np.inf, np.inf, 0
            for c in range(4):
                a, b = c >> 1, c & 1
                u = x[i + 1, j + b] - x[i, j + b]
                v = x[i + a, j + 1] - x[i + a, j]
                det = along(normal, u, v)
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
            area[n, j] = 0.5 * along(normal, u, v)
            bad[n, j] = mask


def scattered_hexahedra(x: FloatArray, sign: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Measures of cells with corners ``x`` (m, 8, 3), corner (a, b, c) at 4 a + 2 b + c.

    ``sign`` (m,) is the handedness of the block of each cell.

    Returns
    -------
    skew : (m,) f_skew = 8 / sum over corners of (sqrt(l11 l22 l33) / a)^(2/3), 0 if any a <= 0 (Knupp 2003)
    scaled : (m,) smallest corner Jacobian divided by its three edge lengths
    jacobian : (m, 8) corner Jacobians (length^3)
    volume : (m,) exact volume of the trilinear cell
    """
    corner = np.arange(8)
    u, v, w = (x[:, corner | bit] - x[:, corner & ~bit] for bit in (4, 2, 1))
    jacobian = sign[:, None] * np.einsum("mci,mci->mc", np.cross(u, v), w)
    size = np.sqrt(np.prod([np.einsum("mci,mci->mc", e, e) for e in (u, v, w)], axis=0))
    with np.errstate(divide="ignore", invalid="ignore"):
        scaled = np.where(size > 0.0, jacobian / size, 0.0)
        terms = np.where(scaled > 0.0, np.maximum(scaled, 1e-200) ** (-2.0 / 3.0), np.inf).sum(axis=1)
    mean = np.einsum("mi,mi->m", np.cross(u.mean(axis=1), v.mean(axis=1)), w.mean(axis=1))
    # See :mod:`.inspection`.
    volume = (2.0 * sign * mean + jacobian.mean(axis=1)) / 3.0
    return np.minimum(8.0 / terms, 1.0), scaled.min(axis=1), jacobian, volume
