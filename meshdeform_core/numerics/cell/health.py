"""Cells that are sheared or stretched far: one pass over blocks, before anything of a repair is built.

f is that of :mod:`.foldover`, at corners. The map from the undeformed corner is X R with the edges X of the deformed
one and the reciprocal edges R of the undeformed one, so that its norm is the trace of the product of their Gram
matrices.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel

# f within round-off of the limit counts as unhealthy; the repair then decides.
_BELOW = 1.0 - 1e-9


@inlined
def _chi(det, eps):
    """(D + sqrt(eps^2 + D^2)) / 2 without cancellation."""
    root = np.sqrt(eps * eps + det * det)
    return 0.5 * (det + root) if det > 0.0 else 0.5 * eps * eps / (root - det)


@kernel("f8[:, :, :, ::1], f8[:, :, :, ::1], f8, f8, f8, b1[:, :, ::1]")
def mark_unhealthy(x, start, healthy, eps, tolerance, marks):
    """Mark the hexahedra of a block with a corner where f is more than ``healthy``.

    Parameters
    ----------
    x, start : (ni, nj, nk, 3) deformed and undeformed nodes
    tolerance : corners whose undeformed Jacobian is at most this part of the product of their edges do not count
    marks : (ni - 1, nj - 1, nk - 1) bool, filled
    """
    edge, base, dual = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            for k in range(x.shape[2] - 1):
                marks[i, j, k] = False
                for corner in range(8):
                    a, b, c = i + (corner >> 2), j + (corner >> 1 & 1), k + (corner & 1)
                    for d in range(3):
                        edge[0, d] = x[i + 1, b, c, d] - x[i, b, c, d]
                        edge[1, d] = x[a, j + 1, c, d] - x[a, j, c, d]
                        edge[2, d] = x[a, b, k + 1, d] - x[a, b, k, d]
                        base[0, d] = start[i + 1, b, c, d] - start[i, b, c, d]
                        base[1, d] = start[a, j + 1, c, d] - start[a, j, c, d]
                        base[2, d] = start[a, b, k + 1, d] - start[a, b, k, d]
                    before, size = _reciprocal(base, dual)
                    if abs(before) <= tolerance * size:
                        continue
                    det = _determinant(edge) / before
                    norm = 0.0
                    for m in range(3):
                        for n in range(3):
                            norm += _dot(edge, m, edge, n) * _dot(dual, m, dual, n)
                    chi = _chi(det, eps)
                    # f = shape chi^(-2/3) + (det^2 + 1) / (2 chi), compared without the root, which took half the time.
                    shape = norm / (before * before) / 3.0
                    room = healthy * _BELOW - 0.5 * (det * det + 1.0) / chi
                    if not (room > 0.0 and shape * shape * shape <= room * room * room * chi * chi):
                        marks[i, j, k] = True
                        break


@kernel("f8[:, :, ::1], f8[:, :, ::1], f8, f8, f8, b1[:, ::1]")
def mark_unhealthy_plane(x, start, healthy, eps, tolerance, marks):
    """As :func:`mark_unhealthy`, for the quadrilaterals of a plane block (ni, nj, 3)."""
    edge, base = np.empty((2, 3)), np.empty((2, 3))
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            marks[i, j] = False
            for corner in range(4):
                a, b = i + (corner >> 1), j + (corner & 1)
                for d in range(3):
                    edge[0, d], edge[1, d] = x[i + 1, b, d] - x[i, b, d], x[a, j + 1, d] - x[a, j, d]
                    base[0, d], base[1, d] = start[i + 1, b, d] - start[i, b, d], start[a, j + 1, d] - start[a, j, d]
                uu, uv, vv = _dot(base, 0, base, 0), _dot(base, 0, base, 1), _dot(base, 1, base, 1)
                square = uu * vv - uv * uv
                if square <= tolerance * tolerance * uu * vv:
                    continue
                # The scalar product of the normals, by Lagrange's identity.
                det = _dot(edge, 0, base, 0) * _dot(edge, 1, base, 1) - _dot(edge, 0, base, 1) * _dot(edge, 1, base, 0)
                det /= square
                norm = vv * _dot(edge, 0, edge, 0) - 2.0 * uv * _dot(edge, 0, edge, 1) + uu * _dot(edge, 1, edge, 1)
                f = 0.5 * (norm / square + det * det + 1.0) / _chi(det, eps)
                if not f <= healthy * _BELOW:
                    marks[i, j] = True
                    break


@inlined
def _determinant(a):
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        + a[0, 1] * (a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@kernel
def _reciprocal(e, dual):
    """Cross products of the rows of ``e`` in ``dual``; returns the determinant, and the product of the lengths."""
    size = 1.0
    for m in range(3):
        u, v = (m + 1) % 3, (m + 2) % 3
        for d in range(3):
            p, q = (d + 1) % 3, (d + 2) % 3
            dual[m, d] = e[u, p] * e[v, q] - e[u, q] * e[v, p]
        size *= np.sqrt(_dot(e, m, e, m))
    return e[0, 0] * dual[0, 0] + e[0, 1] * dual[0, 1] + e[0, 2] * dual[0, 2], size


@kernel
def _dot(e, m, f, n):
    return e[m, 0] * f[n, 0] + e[m, 1] * f[n, 1] + e[m, 2] * f[n, 2]
