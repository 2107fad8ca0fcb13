"""Whether all corners of hexahedra are healthy: one pass over blocks, before any neighbourhood is built."""

from __future__ import annotations

import numpy as np

from ..jit import kernel
from .foldover.jacobian import determinant, regular

# f within round-off of the limit counts as unhealthy; the repair then decides.
_BELOW = 1.0 - 1e-9


@kernel
def all_healthy(x, start, healthy, eps, tolerance):
    """Whether f at all corners of the cells of a block is at most ``healthy``.

    f is that of :func:`.foldover.hexahedra.excess_of_cells`. The map from the undeformed corner is X R with the edges X
    of the deformed one and the reciprocal edges R of the undeformed one, so that its norm is the trace of the product
    of their Gram matrices.

    Parameters
    ----------
    x, start : (ni, nj, nk, 3) deformed and undeformed nodes
    tolerance : corners whose undeformed Jacobian is at most this part of the product of their edges do not count
    """
    edge, base, dual = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            for k in range(x.shape[2] - 1):
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
                    det = determinant(edge) / before
                    norm = 0.0
                    for m in range(3):
                        for n in range(3):
                            norm += _dot(edge, m, n) * _dot(dual, m, n)
                    chi, _ = regular(det, eps)
                    # f = shape chi^(-2/3) + (det^2 + 1) / (2 chi), compared without the root, which took half the time.
                    shape = norm / (before * before) / 3.0
                    room = healthy * _BELOW - 0.5 * (det * det + 1.0) / chi
                    if not (room > 0.0 and shape * shape * shape <= room * room * room * chi * chi):
                        return False
    return True


@kernel
def _reciprocal(e, dual):
    """Cross products of the rows of ``e`` in ``dual``; returns the determinant, and the product of the lengths."""
    size = 1.0
    for m in range(3):
        u, v = (m + 1) % 3, (m + 2) % 3
        for d in range(3):
            p, q = (d + 1) % 3, (d + 2) % 3
            dual[m, d] = e[u, p] * e[v, q] - e[u, q] * e[v, p]
        size *= np.sqrt(_dot(e, m, m))
    return e[0, 0] * dual[0, 0] + e[0, 1] * dual[0, 1] + e[0, 2] * dual[0, 2], size


@kernel
def _dot(e, m, n):
    return e[m, 0] * e[n, 0] + e[m, 1] * e[n, 1] + e[m, 2] * e[n, 2]
