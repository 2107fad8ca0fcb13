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

from ...jit import inlined, kernel
from .jacobian import growth, regular


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


@inlined
def slopes_of_triangle(g, det, chi, root):
    """f, df/dg, df/dD, d2f/(dg dD) and d2f/dD2 with g = |A|^2; d2f/dg2 is zero."""
    f = 0.5 * (g + det * det + 1.0) / chi
    d_det = det / chi - f / root
    second = 1.0 / chi - 2.0 * det / (chi * root) + f * (1.0 + det / root) / (root * root)
    return f, 0.5 / chi, d_det, -0.5 / (chi * root), second


@kernel
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


@inlined
def _spectrum(c, m, u, v, gg, gd, dd, lowest, values, vectors):
    """Eigenvalues (4,), at least ``lowest``, and eigenvectors (4, 4) of the second derivatives.

    ``c`` (2,) and ``m`` (2,) are coordinates of the two parts of A; ``u`` is twice the derivative along g = |A|^2,
    ``v`` the one along D; ``gg``, ``gd``, ``dd`` are the second derivatives.
    """
    cc, mm = np.sqrt(c[0] * c[0] + c[1] * c[1]), np.sqrt(m[0] * m[0] + m[1] * m[1])
    c0, c1 = (c[0] / cc, c[1] / cc) if cc > 0.0 else (1.0, 0.0)
    m0, m1 = (m[0] / mm, m[1] / mm) if mm > 0.0 else (1.0, 0.0)
    one = u + v + cc * cc * (4.0 * gg + 4.0 * gd + dd)
    two = u - v + mm * mm * (4.0 * gg - 4.0 * gd + dd)
    mixed = cc * mm * (4.0 * gg - dd)
    half = 0.5 * (one - two)
    radius = np.sqrt(half * half + mixed * mixed)
    middle = 0.5 * (one + two)
    # The eigenvector of the larger eigenvalue in the plane spanned by the unit vectors along C and M.
    p, q = (half + radius, mixed) if half >= 0.0 else (mixed, radius - half)
    size = np.sqrt(p * p + q * q)
    p, q = (p / size, q / size) if size > 0.0 else (1.0, 0.0)
    values[0], values[1] = max(u + v, lowest), max(u - v, lowest)
    values[2], values[3] = max(middle + radius, lowest), max(middle - radius, lowest)
    vectors[0, 0], vectors[0, 1], vectors[0, 2], vectors[0, 3] = -c1, c0, 0.0, 0.0
    vectors[1, 0], vectors[1, 1], vectors[1, 2], vectors[1, 3] = 0.0, 0.0, -m1, m0
    vectors[2, 0], vectors[2, 1], vectors[2, 2], vectors[2, 3] = p * c0, p * c1, q * m0, q * m1
    vectors[3, 0], vectors[3, 1], vectors[3, 2], vectors[3, 3] = -q * c0, -q * c1, p * m0, p * m1


@kernel
def add_triangles(x, node, slope, weight, reference, penalty, which, unknowns, rows, matrix, gradient):
    """Add the derivatives of the energy of the triangles ``which`` to rows of the gradient and of the Hessian.

    As :func:`.hexahedra.add_derivatives`, in two dimensions.
    """
    eps, share, cubic, elastic, exact = penalty
    half, lowest = np.sqrt(0.5), -np.inf if exact else -elastic
    c, m, values, vectors = np.empty(2), np.empty(2), np.empty(4), np.empty((4, 4))
    turned, force = np.empty((3, 4, 2)), np.empty((3, 2))
    for at in which:
        a00, a01, a10, a11 = plane_matrix(x, node[at], slope[at])
        det = a00 * a11 - a01 * a10
        chi, root = regular(det, eps)
        f, dg, dd, gd, ddd = slopes_of_triangle(a00 * a00 + a01 * a01 + a10 * a10 + a11 * a11, det, chi, root)
        _, one, two = growth(f)
        one = share * (weight[at] + cubic * one)
        two = share * cubic * two
        c[0], c[1], m[0], m[1] = half * (a00 + a11), half * (a10 - a01), half * (a00 - a11), half * (a01 + a10)
        u, v = 2.0 * dg * one, dd * one
        gg, gd, ddd = two * dg * dg, one * gd + two * dg * dd, one * ddd + two * dd * dd
        _spectrum(c, m, u, v, gg, gd, ddd, lowest, values, vectors)
        for i in range(4):
            values[i] += elastic
        p00, p01, p10, p11 = plane_matrix(reference, node[at], slope[at])
        e00, e01, e10, e11 = elastic * (a00 - p00), elastic * (a01 - p01), elastic * (a10 - p10), elastic * (a11 - p11)
        for n in range(3):
            b0, b1 = slope[at, n, 0], slope[at, n, 1]
            force[n, 0] = u * (a00 * b0 + a01 * b1) + v * (a11 * b0 - a10 * b1) + e00 * b0 + e01 * b1
            force[n, 1] = u * (a10 * b0 + a11 * b1) + v * (a00 * b1 - a01 * b0) + e10 * b0 + e11 * b1
            for i in range(4):
                e = vectors[i]
                turned[n, i, 0] = half * ((e[0] + e[2]) * b0 + (e[3] - e[1]) * b1)
                turned[n, i, 1] = half * ((e[1] + e[3]) * b0 + (e[0] - e[2]) * b1)
        _add_triangle(node[at], force, values, turned, unknowns, rows, matrix, gradient)


@inlined
def _add_triangle(node, force, values, turned, unknowns, rows, matrix, gradient):
    """Add the gradient ``force`` (3, 2) and the Hessian of a triangle to the rows that have its unknowns.

    The Hessian is the sum over i of values_i turned_i turned_i^T; ``turned`` (3, 4, 2) is overwritten.
    """
    number, frame, plain = unknowns
    first, last, starts, columns = rows
    for n in range(3):
        p = node[n]
        if not plain[p]:
            for i in range(4):
                y0, y1 = turned[n, i, 0], turned[n, i, 1]
                turned[n, i, 0] = frame[p, 0, 0] * y0 + frame[p, 1, 0] * y1
                turned[n, i, 1] = frame[p, 0, 1] * y0 + frame[p, 1, 1] * y1
    for n in range(3):
        p = node[n]
        row = number[p]
        if row < first or row >= last:
            continue
        if plain[p]:
            gradient[row, 0] += force[n, 0]
            gradient[row, 1] += force[n, 1]
        else:
            gradient[row, 0] += frame[p, 0, 0] * force[n, 0] + frame[p, 1, 0] * force[n, 1]
            gradient[row, 1] += frame[p, 0, 1] * force[n, 0] + frame[p, 1, 1] * force[n, 1]
        for o in range(3):
            column = number[node[o]]
            if column < 0:
                continue
            place = starts[row]
            while columns[place] != column:
                place += 1
            place -= starts[first]
            for i in range(4):
                y0, y1 = values[i] * turned[n, i, 0], values[i] * turned[n, i, 1]
                matrix[place, 0, 0] += y0 * turned[o, i, 0]
                matrix[place, 0, 1] += y0 * turned[o, i, 1]
                matrix[place, 1, 0] += y1 * turned[o, i, 0]
                matrix[place, 1, 1] += y1 * turned[o, i, 1]


@kernel
def excess_of_triangles(x, node, slope, healthy, eps):
    """max(0, log(f / healthy)) of every triangle (m,)."""
    result = np.zeros(len(node))
    for m in range(len(node)):
        a, b, c, d = plane_matrix(x, node[m], slope[m])
        det = a * d - b * c
        chi, _ = regular(det, eps)
        f = 0.5 * (a * a + b * b + c * c + d * d + det * det + 1.0) / chi
        if f > healthy:
            result[m] = np.log(f / healthy)
    return result


@kernel
def corner_triangles(start, cells, sign, tolerance, node, slope, cell):
    """Triangles at the sound corners of quadrilaterals; returns their number.

    A corner is sound if its undeformed Jacobian has the ``sign`` (m,) of the cell and is more than ``tolerance`` of the
    product of its edges.

    Parameters
    ----------
    start : (n, 2) undeformed coordinates
    cells : (m, 4) nodes; node a of a cell is the corner (a >> 1, a & 1)
    node, slope, cell : (4 m, 3), (4 m, 3, 2), (4 m,), out: as in :func:`energy_of_triangles`, and the cell of each
        triangle
    """
    count = 0
    for c in range(len(cells)):
        for s in range(4):
            # Both edges point along ascending indices, at whichever end of them the corner is.
            p, q, r = cells[c, s], cells[c, s ^ 2], cells[c, s ^ 1]
            i, j = (1.0 if s < 2 else -1.0), (1.0 if s % 2 == 0 else -1.0)
            ux, uy = i * (start[q, 0] - start[p, 0]), i * (start[q, 1] - start[p, 1])
            vx, vy = j * (start[r, 0] - start[p, 0]), j * (start[r, 1] - start[p, 1])
            det = ux * vy - uy * vx
            if sign[c] * det <= tolerance * np.sqrt((ux * ux + uy * uy) * (vx * vx + vy * vy)):
                continue
            node[count, 0], node[count, 1], node[count, 2] = p, q, r
            slope[count, 1, 0], slope[count, 1, 1] = i * vy / det, -i * vx / det
            slope[count, 2, 0], slope[count, 2, 1] = -j * uy / det, j * ux / det
            slope[count, 0, 0] = -slope[count, 1, 0] - slope[count, 2, 0]
            slope[count, 0, 1] = -slope[count, 1, 1] - slope[count, 2, 1]
            cell[count] = c
            count += 1
    return count
