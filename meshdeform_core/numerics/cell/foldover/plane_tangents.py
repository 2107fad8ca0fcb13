"""Products with the second derivatives of the foldover-free energy of plane grids, and those of its onset.

Arguments as in :mod:`.plane`; see :mod:`.tangents`.
"""

from ...jit import kernel
from .jacobian import growth, regular, slopes_of_triangle
from .plane import plane_matrix


@kernel("f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8[::1], UniTuple(f8, 5), f8[:, ::1], f8, f8[:, ::1]")
def products_of_triangles(x, node, slope, weight, penalty, change, d_share, out):
    """Add to ``out`` (n, 2) the change of the energy's gradient for a ``change`` (n, 2) of ``x`` and ``d_share`` of the
    share.

    Returns the transpose with respect to the share, as :func:`.tangents.products_of_cells`.
    """
    eps, share, cubic, elastic, _ = penalty
    g_share = 0.0
    for at in range(node.shape[0]):
        a, b, c, d = plane_matrix(x, node[at], slope[at])
        p, q, r, s = plane_matrix(change, node[at], slope[at])
        det = a * d - b * c
        chi, root = regular(det, eps)
        f, dg, dd, gd, ddd = slopes_of_triangle(a * a + b * b + c * c + d * d, det, chi, root)
        _, one, two = growth(f)
        one, two = weight[at] + cubic * one, cubic * two
        # Changes of g and D, and of the derivatives of the energy along g and D.
        tg, td = 2.0 * (a * p + b * q + c * r + d * s), d * p - c * q - b * r + a * s
        t_f = dg * tg + dd * td
        u, v = one * dg, one * dd
        du, dv = two * t_f * dg + one * gd * td, two * t_f * dd + one * (gd * tg + ddd * td)
        along = one * t_f
        g_share += along
        uu, vv = share * du + d_share * u, share * dv + d_share * v
        u, v = share * u, share * v
        # The force is 2 u A + v K with the cofactors K = (d, -c; -b, a).
        e00 = 2.0 * (u * p + uu * a) + v * s + vv * d + elastic * p
        e01 = 2.0 * (u * q + uu * b) - v * r - vv * c + elastic * q
        e10 = 2.0 * (u * r + uu * c) - v * q - vv * b + elastic * r
        e11 = 2.0 * (u * s + uu * d) + v * p + vv * a + elastic * s
        for n in range(3):
            here, b0, b1 = node[at, n], slope[at, n, 0], slope[at, n, 1]
            out[here, 0] += e00 * b0 + e01 * b1
            out[here, 1] += e10 * b0 + e11 * b1
    return g_share


@kernel("f8[:, ::1], i8[:, ::1], f8[:, :, ::1], f8, f8, f8[:, ::1], f8[::1], f8[::1], f8[:, ::1]")
def slopes_of_triangles(x, node, slope, healthy, eps, change, gradient, d_excess, out):
    """Derivatives of :func:`.plane.excess_of_triangles`, as :func:`.tangents.slopes_of_cells`."""
    for at in range(node.shape[0]):
        d_excess[at] = 0.0
        a, b, c, d = plane_matrix(x, node[at], slope[at])
        det = a * d - b * c
        chi, root = regular(det, eps)
        f, dg, dd, _, _ = slopes_of_triangle(a * a + b * b + c * c + d * d, det, chi, root)
        if f <= healthy:
            continue
        p, q, r, s = plane_matrix(change, node[at], slope[at])
        d_excess[at] = (2.0 * dg * (a * p + b * q + c * r + d * s) + dd * (d * p - c * q - b * r + a * s)) / f
        part = gradient[at] / f
        e00, e01 = part * (2.0 * dg * a + dd * d), part * (2.0 * dg * b - dd * c)
        e10, e11 = part * (2.0 * dg * c - dd * b), part * (2.0 * dg * d + dd * a)
        for n in range(3):
            here, b0, b1 = node[at, n], slope[at, n, 0], slope[at, n, 1]
            out[here, 0] += e00 * b0 + e01 * b1
            out[here, 1] += e10 * b0 + e11 * b1
