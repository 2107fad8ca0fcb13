"""The foldover-free energy of plane grids: its sum, gradient, and the convex part of its second derivatives.

Every sound corner of a quadrilateral defines a triangle of three nodes. With A the Jacobian matrix (2, 2) of the map
from the undeformed triangle to the deformed one, and D = det A,

    f = (|A|^2 + D^2 + 1) / (2 chi),    chi = (D + sqrt(eps^2 + D^2)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov: Foldover-free maps in 50 lines of code, ACM TOG 40(4), 2021,
eqs. 3 and 4 with d = 2 and lambda = 1). A triangle in rigid motion has f = 2. Its energy follows from f as in
:mod:`meshdeform_core.numerics.cell.foldover`.

Split A = C + M into a similarity C and a mirrored similarity M: |A|^2 = |C|^2 + |M|^2 and 2 D = |C|^2 - |M|^2. In this
basis the second derivatives are diagonal but for one 2 x 2 matrix, so their negative part can be removed exactly.
"""

import numpy as np

from ...arrays import FloatArray, IntArray
from ...jit import inlined, kernel
from ...lanes import NARROW as WIDTH
from .hexahedra import Unknowns, add_element
from .jacobian import growth, regular
from .nodes import transpose
from .triangles import (
    DEFORMED,
    FORCE,
    GIVEN,
    REFERENCE,
    ROWS,
    SLOPE,
    WEIGHT,
    triangle_derivatives,
)


@inlined
def plane_matrix(x, node, slope):
    """The Jacobian matrix ((a, b), (c, d)) of a triangle, returned as four numbers."""
    a = b = c = d = 0.0
    for n in range(3):
        p = node[n]
        a += x[p, 0] * slope[n, 0]
        b += x[p, 0] * slope[n, 1]
        c += x[p, 1] * slope[n, 0]
        d += x[p, 1] * slope[n, 1]
    return a, b, c, d


@kernel("f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[::1], f8[:, ::1], UniTuple(f8, 5), i8, i8")
def energy_of_triangles(x, node, slope, weight, reference, penalty, low, high):
    """Sum of the energy over the triangles low <= m < high, their smallest D and largest f.

    Parameters
    ----------
    x : (n, 2) deformed coordinates
    node, slope : (m, 3), (m, 3, 2) nodes and undeformed gradients of their shape functions
    weight : (m,) w, see :mod:`.hexahedra`
    reference, penalty : see :func:`.hexahedra.energy_of_cells`
    """
    eps, share, cubic, elastic, _ = penalty
    total, lowest, highest = 0.0, np.inf, 0.0
    for m in range(low, high):
        a, b, c, d = plane_matrix(x, node[m], slope[m])
        det = a * d - b * c
        chi, _ = regular(det, eps)
        lowest = min(lowest, det)
        f = np.inf
        if chi > 0.0:
            f = 0.5 * (a * a + b * b + c * c + d * d + det * det + 1.0) / chi
        highest = max(highest, f)
        total += share * (weight[m] * f + cubic * growth(f)[0])
        if elastic > 0.0:
            p, q, r, s = plane_matrix(reference, node[m], slope[m])
            total += 0.5 * elastic * ((a - p) ** 2 + (b - q) ** 2 + (c - r) ** 2 + (d - s) ** 2)
    return total, lowest, highest


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[::1], f8[:, ::1], UniTuple(f8, 5), i8[::1], Unknowns, Tuple((i8, "
    "i8, i8[::1], i4[::1],)), f8[:, :, ::1], f8[:, ::1]",
    Unknowns,
)
def add_triangles(x, node, slope, weight, reference, penalty, which, unknowns, rows, matrix, gradient):
    """Add the derivatives of the energy of the triangles ``which`` to rows of the gradient and of the Hessian.

    As :func:`.hexahedra.add_derivatives`, in two dimensions.
    """
    given, result, found = np.empty((GIVEN, WIDTH)), np.empty((ROWS, WIDTH)), np.empty((WIDTH, ROWS))
    work, (eps, share, cubic, elastic, exact) = np.empty((3, 3)), penalty
    result[...] = 0.0
    for first in range(0, len(which), WIDTH):
        used = min(WIDTH, len(which) - first)
        for lane in range(WIDTH):
            m = which[first + min(lane, used - 1)]
            given[WEIGHT, lane] = weight[m]
            for n in range(3):
                for d in range(2):
                    given[DEFORMED + 2 * n + d, lane] = x[node[m, n], d]
                    given[REFERENCE + 2 * n + d, lane] = reference[node[m, n], d]
                    given[SLOPE + 2 * n + d, lane] = slope[m, n, d]
        triangle_derivatives(given, result, eps, share, cubic, elastic, exact)
        for row in range(0, ROWS, WIDTH):
            transpose(result, row, found, ROWS)
        for lane in range(used):
            add_element(node, which[first + lane], 3, 2, found, lane, FORCE, work, unknowns, rows, matrix, gradient)


def excess_of_triangles(x: FloatArray, node: IntArray, slope: FloatArray, healthy: float, eps: float) -> FloatArray:
    """max(0, log(f / healthy)) of every triangle (m,)."""
    a, b, c, d = np.einsum("mni,mnk->ikm", x[node], slope).reshape(4, -1)
    det = a * d - b * c
    root = np.sqrt(eps * eps + det * det)
    # As :func:`.jacobian.regular`.
    up = det > 0.0
    chi = np.where(up, 0.5 * (det + root), 0.5 * eps * eps / np.where(up, 1.0, root - det))
    f = 0.5 * (a * a + b * b + c * c + d * d + det * det + 1.0) / chi
    return np.asarray(np.log(np.maximum(f / healthy, 1.0)))


def corner_triangles(
    start: FloatArray, cells: IntArray, sign: FloatArray, tolerance: float
) -> tuple[IntArray, FloatArray, IntArray]:
    """Triangles at the sound corners of quadrilaterals: nodes (t, 3), gradients of shape functions (t, 3, 2), as in
    :func:`energy_of_triangles`, and the cell (t,) of each.

    A corner is sound if its undeformed Jacobian has the ``sign`` (m,) of the cell and is more than ``tolerance`` of the
    product of its edges.

    Parameters
    ----------
    start : (n, 2) undeformed coordinates
    cells : (m, 4) nodes; node a of a cell is the corner (a >> 1, a & 1)
    """
    corner = np.arange(4)
    node = np.stack([cells, cells[:, corner ^ 2], cells[:, corner ^ 1]], axis=2)
    # Both edges point along ascending indices, at whichever end of them the corner is.
    along = np.stack([np.where(corner & 2, -1.0, 1.0), np.where(corner & 1, -1.0, 1.0)])
    u, v = (along[n][:, None] * (start[node[..., n + 1]] - start[node[..., 0]]) for n in range(2))
    det = u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
    size = np.sqrt((u * u).sum(axis=-1) * (v * v).sum(axis=-1))
    cell, at = np.nonzero(sign[:, None] * det > tolerance * size)
    u, v, det = u[cell, at], v[cell, at], det[cell, at][:, None]
    one = along[0, at][:, None] * np.stack([v[:, 1], -v[:, 0]], axis=1) / det
    two = along[1, at][:, None] * np.stack([-u[:, 1], u[:, 0]], axis=1) / det
    return node[cell, at], np.stack([-one - two, one, two], axis=1), cell
