"""Products with the second derivatives of the foldover-free energy of hexahedra, and those of its onset.

For derivatives of its minimum, see :mod:`meshdeform_core.repair.derivative`; arguments as in :mod:`.hexahedra`.
"""

from __future__ import annotations

import numpy as np

from ...jit import inlined, kernel
from .hexahedra import coefficients
from .jacobian import cofactors, distortion, inner, jacobian, mapping, regular
from .samples import Samples


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], Samples, f8[:, ::1], UniTuple(f8, 5), f8[:, ::1], "
    "f8, f8[::1], f8[:, ::1], f8[::1]",
    Samples,
)
def products_of_cells(x, cells, start, own, mask, samples, weight, penalty, change, d_share, d_between, out, g_between):
    """Add to ``out`` (n, 3) the change of the energy's gradient for a ``change`` (n, 3) of ``x``, ``d_share`` of the
    share of all samples, and ``d_between`` (m,) of the share of each cell's samples between corners.

    Returns the change, for ``change`` alone, of the derivative of the energy with respect to the share of all samples,
    and writes into ``g_between`` (m,) that with respect to the share of the samples between corners: the transposes.
    """
    count, node, slope = samples
    eps, share, cubic, elastic, _ = penalty
    inverse, b, a, k = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 3))
    t, turned, force = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    g_share = 0.0
    for c in range(len(cells)):
        g_between[c] = 0.0
        for s in range(count.size):
            if not mask[c] >> s & 1:
                continue
            m = count[s]
            det = mapping(x, cells[c], start, own[c], m, node[s], slope[s], inverse, b, a)
            cofactors(a, k)
            u, v, w, p, q, r = coefficients(inner(a, a), det, eps, weight[c, 0], cubic, 1.0)
            jacobian(change, cells[c], m, node[s], b, t)
            between = 1.0 if s < 8 else weight[c, 1]
            part = d_share * between + (0.0 if s < 8 else share * d_between[c])
            ta, tk = inner(t, a), inner(t, k)
            _turned_cofactors(a, t, turned)
            stiff = elastic * weight[c, 2] if s < 8 else 0.0
            for d in range(3):
                for e in range(3):
                    force[d, e] = (
                        share
                        * between
                        * (w * t[d, e] + v * turned[d, e] + (p * ta + q * tk) * a[d, e] + (q * ta + r * tk) * k[d, e])
                        + part * (u * a[d, e] + v * k[d, e])
                        + stiff * t[d, e]
                    )
            for n in range(m):
                here = cells[c, node[s, n]]
                for d in range(3):
                    out[here, d] += force[d, 0] * b[n, 0] + force[d, 1] * b[n, 1] + force[d, 2] * b[n, 2]
            along = u * ta + v * tk
            g_share += between * along
            if s >= 8:
                g_between[c] += share * along
    return g_share


@inlined
def _turned_cofactors(a, t, result):
    """The change of the cofactors of ``a`` for a change ``t``."""
    for i in range(3):
        m, n = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            result[i, j] = t[m, p] * a[n, q] + a[m, p] * t[n, q] - t[m, q] * a[n, p] - a[m, q] * t[n, p]


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], Samples, f8, f8, f8, f8[:, ::1], f8[::1], f8[::1], "
    "f8[:, ::1]",
    Samples,
)
def slopes_of_cells(x, cells, start, own, mask, samples, healthy, norm, eps, change, gradient, d_excess, out):
    """Derivative of :func:`.hexahedra.excess_of_cells`, and its transpose.

    Writes the change ``d_excess`` (m,) for a ``change`` (n, 3) of ``x``, and adds to ``out`` (n, 3) the gradient with
    respect to ``x`` that follows from the ``gradient`` (m,) with respect to the excesses.
    """
    count, node, slope = samples
    inverse, b, a, k = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 3))
    t, f = np.empty((3, 3)), np.empty(count.size)
    for c in range(len(cells)):
        d_excess[c] = 0.0
        largest = total = 0.0
        for s in range(count.size):
            f[s] = 0.0
            if mask[c] >> s & 1:
                det = mapping(x, cells[c], start, own[c], count[s], node[s], slope[s], inverse, b, a)
                chi, _ = regular(det, eps)
                f[s] = distortion(a, det, chi)
                largest = max(largest, np.log(f[s] / healthy))
        if largest == 0.0:
            continue
        for s in range(count.size):
            if f[s] > healthy:
                total += (np.log(f[s] / healthy) / largest) ** norm
        for s in range(count.size):
            if f[s] <= healthy:
                continue
            det = mapping(x, cells[c], start, own[c], count[s], node[s], slope[s], inverse, b, a)
            cofactors(a, k)
            u, v, _, _, _, _ = coefficients(inner(a, a), det, eps, 1.0, 0.0, 1.0)
            part = (np.log(f[s] / healthy) / largest) ** (norm - 1.0) * total ** (1.0 / norm - 1.0) / f[s]
            jacobian(change, cells[c], count[s], node[s], b, t)
            d_excess[c] += part * (u * inner(t, a) + v * inner(t, k))
            for n in range(count[s]):
                here = cells[c, node[s, n]]
                for d in range(3):
                    for e in range(3):
                        out[here, d] += gradient[c] * part * (u * a[d, e] + v * k[d, e]) * b[n, e]
