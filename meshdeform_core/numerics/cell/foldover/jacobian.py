"""Jacobian matrices (3, 3) of maps of a cell, and functions of them."""

from __future__ import annotations

import numpy as np

from ...jit import inlined


@inlined
def jacobian(x, cell, count, node, slope, a):
    """The Jacobian matrix ``a`` at a sample point: the sum of x_n slope_n over ``count`` of its nodes.

    ``cell`` (8,): rows of ``x`` (n, 3) at the corners; ``node`` (m,): the corners summed over; ``slope`` (m, 3):
    derivatives of their shape functions.
    """
    for d in range(3):
        for k in range(3):
            a[d, k] = 0.0
    for n in range(count):
        p = cell[node[n]]
        for d in range(3):
            for k in range(3):
                a[d, k] += x[p, d] * slope[n, k]


@inlined
def mapping(x, cell, start, own, count, node, slope, inverse, b, a):
    """Jacobian matrix ``a`` of the map from an undeformed cell, and ``b`` (m, 3): a = sum of x_n b_n.

    ``cell`` (8,) are rows of ``x``, ``own`` (8,) those of ``start``.

    Returns its determinant.
    """
    jacobian(start, own, count, node, slope, a)
    _invert(a, inverse)
    for n in range(count):
        for k in range(3):
            b[n, k] = slope[n, 0] * inverse[0, k] + slope[n, 1] * inverse[1, k] + slope[n, 2] * inverse[2, k]
    jacobian(x, cell, count, node, b, a)
    return determinant(a)


@inlined
def determinant(a):
    """Determinant of a matrix (3, 3)."""
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        + a[0, 1] * (a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@inlined
def _invert(e, inverse):
    cofactors(e, inverse)
    det = e[0, 0] * inverse[0, 0] + e[0, 1] * inverse[0, 1] + e[0, 2] * inverse[0, 2]
    for d in range(3):
        for k in range(d, 3):
            upper, lower = inverse[d, k], inverse[k, d]
            inverse[d, k], inverse[k, d] = lower / det, upper / det


@inlined
def cofactors(a, k):
    """Cofactors ``k`` (3, 3) of ``a``: the derivative of its determinant."""
    for i in range(3):
        m, n = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            k[i, j] = a[m, p] * a[n, q] - a[m, q] * a[n, p]


@inlined
def inner(a, b):
    """The sum of the products of the entries of ``a`` and ``b``."""
    total = 0.0
    for d in range(3):
        for k in range(3):
            total += a[d, k] * b[d, k]
    return total


@inlined
def distortion(a, det, chi):
    """f, defined in :mod:`meshdeform_core.numerics.cell.foldover`, of a map with the Jacobian matrix ``a``."""
    return inner(a, a) / 3.0 * chi ** (-2.0 / 3.0) + 0.5 * (det * det + 1.0) / chi


@inlined
def growth(f):
    """p^3 / (1 + p / 4), p = f - 2, and its two derivatives."""
    p = f - 2.0
    q = 1.0 + 0.25 * p
    return p * p * p / q, p * p * (3.0 + 0.5 * p) / (q * q), p * (6.0 + p * (1.5 + 0.125 * p)) / (q * q * q)


@inlined
def slopes(g, det, chi, root, h):
    """f of a sample and its derivatives; g = |A|^2, ``chi`` and ``root`` as from :func:`regular`, ``h`` chi^(-2/3).

    The gradient is u A + v K with the cofactors K of A, the Hessian w I + q (A K^T + K A^T) + r K K^T plus v times the
    derivative of K. Returns f, u, v, w, q, r, and the least r for which the Hessian without the last term is convex.
    """
    h1 = -2.0 / 3.0 * h / root
    h2 = 2.0 / 3.0 * h * (2.0 / 3.0 + det / root) / (root * root)
    whole = det * det + 1.0
    q1 = (2.0 * det - whole / root) / chi
    q2 = (2.0 - 2.0 * det / root + whole * det / (root * root * root)) / chi - q1 / root
    f, u, q = g * h / 3.0 + 0.5 * whole / chi, 2.0 / 3.0 * h, 2.0 / 3.0 * h1
    return f, u, g * h1 / 3.0 + 0.5 * q1, u, q, g * h2 / 3.0 + 0.5 * q2, 2.0 / 3.0 * h1 * h1 / h * g


@inlined
def slopes_of_triangle(g, det, chi, root):
    """f, df/dg, df/dD, d2f/(dg dD) and d2f/dD2 with g = |A|^2; d2f/dg2 is zero."""
    f = 0.5 * (g + det * det + 1.0) / chi
    d_det = det / chi - f / root
    second = 1.0 / chi - 2.0 * det / (chi * root) + f * (1.0 + det / root) / (root * root)
    return f, 0.5 / chi, d_det, -0.5 / (chi * root), second


@inlined
def combined(u, v, w, q, r, one, two):
    """u, v, w, p, q, r as from :func:`slopes` of a function of f with the derivatives ``one`` and ``two``; p is the
    factor of A A^T in the Hessian."""
    return u * one, v * one, w * one, two * u * u, q * one + two * u * v, r * one + two * v * v


@inlined
def regular(det, eps):
    """chi and sqrt(eps^2 + D^2), computed without cancellation."""
    root = np.sqrt(eps * eps + det * det)
    return 0.5 * (det + root) if det > 0.0 else 0.5 * eps * eps / (root - det), root
