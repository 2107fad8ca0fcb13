"""Shape measures of cells: Jacobians, skewness metric and volume, one pass over a block."""

from __future__ import annotations

import math

import numpy as np

from ..arrays import FloatArray
from ..exact.elementary import cube_root
from ..jit import inlined, kernel
from .volume import along, twelve_volumes

# Rows of the work array of a line of cells: coordinates of the four lines of nodes around it (3 r + axis for the line
# r = 2 a + b at i + a, j + b), area vectors of the corners between the lines, squared edge lengths multiplied, results.
_AREA, _SQUARE, _SKEW, _SCALED, _JACOBIAN, _VOLUME, _BAD, _ROWS = 12, 24, 28, 29, 30, 31, 32, 33
# Nodes of a line that are worked on at a time: all rows together stay in the first-level cache.
_TILE = 80
_TINY, _HUGE = 1e-300, 1e150


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
    # A single array of fixed size: the compiler sees that its rows do not alias.
    work = np.empty((_ROWS, _TILE))
    cells = x.shape[2] - 1
    for i in range(i0, i1):
        for j in range(x.shape[1] - 1):
            for k0 in range(0, cells, _TILE - 1):
                count = min(_TILE - 1, cells - k0)
                for r in range(4):
                    line = x[i + (r >> 1), j + (r & 1), k0 : k0 + count + 1]
                    for k in range(count + 1):
                        for d in range(3):
                            work[3 * r + d, k] = line[k, d]
                _corner_areas(work, count + 1)
                _cell_measures(work, count, sign)
                n = i - i0
                for k in range(count):
                    skew[n, j, k0 + k] = work[_SKEW, k]
                    scaled[n, j, k0 + k] = work[_SCALED, k]
                    jacobian[n, j, k0 + k] = work[_JACOBIAN, k]
                    volume[n, j, k0 + k] = work[_VOLUME, k]
                    bad[n, j, k0 + k] = np.uint8(work[_BAD, k])


@inlined
def _corner_areas(work, count):
    """Area vectors at the nodes of the four lines: cross products of the edges along i and j."""
    # The lines are written out: a loop over them would prevent vectorisation of the loop over k.
    for k in range(count):
        # r = 2 a + b: along i from line b to line 2 + b, along j from line 2 a to line 2 a + 1.
        _area(work, k, 0, 0, 6, 0, 3)
        _area(work, k, 1, 3, 9, 0, 3)
        _area(work, k, 2, 0, 6, 6, 9)
        _area(work, k, 3, 3, 9, 6, 9)


@inlined
def _area(work, k, r, i0, i1, j0, j1):
    """Area vector of the edges between rows i0, i1 and rows j0, j1 at node k of line r."""
    ux, uy, uz = _difference(work, i1, k, i0, k)
    vx, vy, vz = _difference(work, j1, k, j0, k)
    work[_AREA + 3 * r, k] = uy * vz - uz * vy
    work[_AREA + 3 * r + 1, k] = uz * vx - ux * vz
    work[_AREA + 3 * r + 2, k] = ux * vy - uy * vx
    work[_SQUARE + r, k] = (ux * ux + uy * uy + uz * uz) * (vx * vx + vy * vy + vz * vz)


@inlined
def _cell_measures(work, count, sign):
    """The results of every cell from its eight corners, line by line."""
    for k in range(count):
        work[_SKEW, k], work[_BAD, k] = 0.0, 0.0
        work[_JACOBIAN, k], work[_SCALED, k] = np.inf, np.inf
        work[_VOLUME, k] = sign * _twelve_volumes(work, k) / 12.0
    # One loop for all four lines, or a loop over them, would not be vectorised.
    _add_corners(work, count, sign, 0)
    _add_corners(work, count, sign, 1)
    _add_corners(work, count, sign, 2)
    _add_corners(work, count, sign, 3)
    for k in range(count):
        work[_SKEW, k] = min(8.0 / work[_SKEW, k], 1.0) if work[_JACOBIAN, k] > 0.0 else 0.0


@inlined
def _add_corners(work, count, sign, r):
    """Add the corners on line r to the results of each cell; free of branches, so that it is vectorised."""
    n = _AREA + 3 * r
    for k in range(count):
        wx, wy, wz = _difference(work, 3 * r, k + 1, 3 * r, k)
        length = wx * wx + wy * wy + wz * wz
        near = sign * (work[n, k] * wx + work[n + 1, k] * wy + work[n + 2, k] * wz)
        far = sign * (work[n, k + 1] * wx + work[n + 1, k + 1] * wy + work[n + 2, k + 1] * wz)
        near_square, far_square = work[_SQUARE + r, k] * length, work[_SQUARE + r, k + 1] * length
        scaled = min(near / math.sqrt(max(near_square, _TINY)), far / math.sqrt(max(far_square, _TINY)))
        mask = (0.0 if near > 0.0 else 1.0) + (0.0 if far > 0.0 else 2.0)
        work[_SKEW, k] += _skewness(near, near_square) + _skewness(far, far_square)
        work[_JACOBIAN, k] = min(work[_JACOBIAN, k], min(near, far))
        work[_SCALED, k] = min(work[_SCALED, k], scaled)
        work[_BAD, k] += mask * float(1 << 2 * r)


@inlined
def _skewness(jacobian, square):
    """(l11 l22 l33 / a^2)^(1/3) of a corner; meaningless where the Jacobian a is not positive."""
    return cube_root(min(square / max(jacobian * jacobian, _TINY), _HUGE))


@inlined
def _difference(p, row, k, other, n):
    return p[row, k] - p[other, n], p[row + 1, k] - p[other + 1, n], p[row + 2, k] - p[other + 2, n]


@inlined
def _twelve_volumes(p, k):
    """Twelve times the exact volume of a cell."""
    # Corner (a, b, g) is at k + g in the rows from 3 (2 a + b); diagonals towards the corner (1, 1, 1).
    ax, ay, az = p[9, k + 1] - p[6, k], p[10, k + 1] - p[7, k], p[11, k + 1] - p[8, k]
    bx, by, bz = p[9, k + 1] - p[3, k], p[10, k + 1] - p[4, k], p[11, k + 1] - p[5, k]
    cx, cy, cz = p[9, k + 1] - p[0, k + 1], p[10, k + 1] - p[1, k + 1], p[11, k + 1] - p[2, k + 1]
    # Diagonals from the corner (0, 0, 0).
    dx, dy, dz = p[3, k + 1] - p[0, k], p[4, k + 1] - p[1, k], p[5, k + 1] - p[2, k]
    ex, ey, ez = p[6, k + 1] - p[0, k], p[7, k + 1] - p[1, k], p[8, k + 1] - p[2, k]
    fx, fy, fz = p[9, k] - p[0, k], p[10, k] - p[1, k], p[11, k] - p[2, k]
    return twelve_volumes(ax, ay, az, bx, by, bz, cx, cy, cz, dx, dy, dz, ex, ey, ez, fx, fy, fz)


@kernel
def measure_quads(x, normal, i0, i1, skew, scaled, jacobian, area, bad):
    """As :func:`measure_hexahedra`, for a 2-D block (na, nb, 3) whose valid cells have Jacobians along ``normal``.

    f_skew = 4 / sum over corners of sqrt(l11 l22) / a; corner c = 2 a + b at (a, b).
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
    """Measures of separate cells with corners ``x`` (m, 8, 3), corner (a, b, c) at 4 a + 2 b + c.

    ``sign`` (m,) is the handedness of the block of each cell.

    Returns
    -------
    skew, scaled : (m,) as :func:`measure_hexahedra`
    jacobian : (m, 8) corner Jacobians
    volume : (m,)
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
