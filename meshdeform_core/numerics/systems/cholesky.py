"""Rows of the inverses of small interpolation systems, many at a time.

Compiled loops instead of LAPACK, whose own threads would compete for matrices of a few hundred rows.
"""

import math

import numpy as np

from ..exact.radial import fill_rows
from ..jit import fast_kernel


@fast_kernel("i8, f8[:, ::1], f8[::1, :], f8, f8[:, ::1], f8[:, ::1]")
def invert_last(kind, points, basis, shift, b, rows):
    """The last rows of the inverse of A on the orthogonal complement of the polynomials.

    With orthonormal polynomials Q, ``B = (I - Q Q^T) A (I - Q Q^T) + t Q Q^T`` is positive definite for conditionally
    positive definite functions, and its inverse differs from the required one only by ``Q Q^T / t``.

    Parameters
    ----------
    points : (n, 3) centres in units of the support radius
    basis : (n, q) values of Q
    shift : added to the diagonal, in units of t, the largest absolute value in A (1 if that is 0)
    b : (n, n) work space
    rows : (m, n), out

    Returns
    -------
    bool
        Whether the shifted matrix is positive definite; if not, ``rows`` is not set.
    """
    fill_rows(kind, points, np.ascontiguousarray(points.T), b)
    t = _project(b, basis, shift)
    if not _factorise(b):
        return False
    _solve_last(b, rows)
    n, count = b.shape[0], rows.shape[0]
    for c in range(count):
        for q in range(basis.shape[1]):
            weight = basis[n - count + c, q] / t
            for i in range(n):
                rows[c, i] -= weight * basis[i, q]
    return True


@fast_kernel
def _project(a, basis, shift):
    """Replace symmetric A by ``(I - Q Q^T) A (I - Q Q^T) + t (Q Q^T + shift I)``; return t."""
    n, terms = basis.shape
    t = 0.0
    for i in range(n):
        for j in range(n):
            t = max(t, abs(a[i, j]))
    if t == 0.0:
        t = 1.0
    q = np.ascontiguousarray(basis.T)
    # A - Q U^T - U Q^T with U = A Q - Q (Q^T A Q + t I) / 2.
    u = np.empty((terms, n))
    for k in range(terms):
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += a[i, j] * q[k, j]
            u[k, i] = total
    inner = np.empty((terms, terms))
    for k in range(terms):
        for m in range(terms):
            total = t if k == m else 0.0
            for i in range(n):
                total += q[k, i] * u[m, i]
            inner[k, m] = 0.5 * total
    for k in range(terms):
        for m in range(terms):
            for i in range(n):
                u[k, i] -= inner[m, k] * q[m, i]
    for i in range(n):
        for k in range(terms):
            qi, ui = q[k, i], u[k, i]
            for j in range(n):
                a[i, j] -= qi * u[k, j] + ui * q[k, j]
        a[i, i] += shift * t
    return t


@fast_kernel
def _factorise(a):
    """Cholesky factor L of the lower triangle, row by row, four rows at a time; L^T fills the upper triangle."""
    n = a.shape[0]
    for i0 in range(0, n, 4):
        i1 = min(i0 + 4, n)
        if i1 - i0 == 4:
            for j in range(i0):
                s0 = s1 = s2 = s3 = 0.0
                for k in range(j):
                    x = a[j, k]
                    s0 += a[i0, k] * x
                    s1 += a[i0 + 1, k] * x
                    s2 += a[i0 + 2, k] * x
                    s3 += a[i0 + 3, k] * x
                d = 1.0 / a[j, j]
                a[i0, j] = (a[i0, j] - s0) * d
                a[i0 + 1, j] = (a[i0 + 1, j] - s1) * d
                a[i0 + 2, j] = (a[i0 + 2, j] - s2) * d
                a[i0 + 3, j] = (a[i0 + 3, j] - s3) * d
        first = i0 if i1 - i0 == 4 else 0
        for i in range(i0, i1):
            for j in range(first, i + 1):
                s = a[i, j]
                for k in range(j):
                    s -= a[i, k] * a[j, k]
                if i > j:
                    a[i, j] = s / a[j, j]
                elif s > 0.0:
                    a[i, i] = math.sqrt(s)
                else:
                    return False
    for i in range(n):
        for j in range(i):
            a[j, i] = a[i, j]
    return True


@fast_kernel
def _solve_last(a, rows):
    """Last rows of (L L^T)^-1 from :func:`_factorise`; forward substitution skips the leading zeros of unit vectors."""
    n, count = a.shape[0], rows.shape[0]
    rows[:] = 0.0
    for c in range(count):
        for i in range(n - count + c, n):
            s = 1.0 if i == n - count + c else 0.0
            for k in range(n - count + c, i):
                s -= a[i, k] * rows[c, k]
            rows[c, i] = s / a[i, i]
    for c in range(count):
        for i in range(n - 1, -1, -1):
            s = rows[c, i]
            for k in range(i + 1, n):
                s -= a[i, k] * rows[c, k]
            rows[c, i] = s / a[i, i]
