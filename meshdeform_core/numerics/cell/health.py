"""Cells that are sheared or stretched far: one pass over blocks, before anything of a repair is built.

f is that of :mod:`.foldover` or, in a plane, of :mod:`.foldover.plane`, at corners. The map from the undeformed corner
is the sum of e_k g_k^T, with the deformed edges e_k and the reciprocals g_k of the undeformed ones.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel

# f within round-off of the limit counts as unhealthy; the repair then decides.
_BELOW = 1.0 - 1e-9


@kernel("f8[:, :, :, ::1], f8[:, :, :, ::1], f8[::1], f8, f8, f8, b1[:, :, ::1]")
def mark_unhealthy(x, start, normal, healthy, eps, tolerance, marks):
    """Fill ``marks`` (ci, cj, ck): the cells of a block with a corner where f is more than ``healthy``.

    Deformed and undeformed nodes are (ni, nj, nk, 3); in a plane one of the first three is 1, and its unit normal (3,)
    takes the place of an edge. Corners whose undeformed Jacobian is at most the part ``tolerance`` of the product of
    their edges do not count.
    """
    edge, base, dual = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    si, sj, sk = min(x.shape[0] - 1, 1), min(x.shape[1] - 1, 1), min(x.shape[2] - 1, 1)
    flat = 4 * (1 - si) + 2 * (1 - sj) + (1 - sk)
    for i in range(marks.shape[0]):
        for j in range(marks.shape[1]):
            for k in range(marks.shape[2]):
                marks[i, j, k] = False
                for corner in range(8):
                    if corner & flat:
                        continue
                    a, b, c = i + si * (corner >> 2), j + sj * (corner >> 1 & 1), k + sk * (corner & 1)
                    for d in range(3):
                        edge[0, d] = x[i + si, b, c, d] - x[i, b, c, d] + (1 - si) * normal[d]
                        edge[1, d] = x[a, j + sj, c, d] - x[a, j, c, d] + (1 - sj) * normal[d]
                        edge[2, d] = x[a, b, k + sk, d] - x[a, b, k, d] + (1 - sk) * normal[d]
                        base[0, d] = start[i + si, b, c, d] - start[i, b, c, d] + (1 - si) * normal[d]
                        base[1, d] = start[a, j + sj, c, d] - start[a, j, c, d] + (1 - sj) * normal[d]
                        base[2, d] = start[a, b, k + sk, d] - start[a, b, k, d] + (1 - sk) * normal[d]
                    _cofactors(base, dual)
                    before, size, norm = 0.0, 1.0, 0.0
                    for d in range(3):
                        before += base[0, d] * dual[0, d]
                        size *= base[d, 0] * base[d, 0] + base[d, 1] * base[d, 1] + base[d, 2] * base[d, 2]
                    if before * before <= tolerance * tolerance * size:
                        continue
                    for d in range(3):
                        for p in range(3):
                            entry = edge[0, d] * dual[0, p] + edge[1, d] * dual[1, p] + edge[2, d] * dual[2, p]
                            norm += entry * entry
                    norm /= before * before
                    _cofactors(edge, dual)
                    det = (edge[0, 0] * dual[0, 0] + edge[0, 1] * dual[0, 1] + edge[0, 2] * dual[0, 2]) / before
                    root = np.sqrt(eps * eps + det * det)
                    chi = 0.5 * (det + root) if det > 0.0 else 0.5 * eps * eps / (root - det)
                    if flat:
                        # The normal, which remains, adds one to the square of the norm.
                        sound = 0.5 * (norm + det * det) <= healthy * _BELOW * chi
                    else:
                        # f = norm chi^(-2/3) / 3 + (det^2 + 1) / (2 chi), compared without the root, which took half
                        # the time.
                        room, shape = healthy * _BELOW - 0.5 * (det * det + 1.0) / chi, norm / 3.0
                        sound = room > 0.0 and shape * shape * shape <= room * room * room * chi * chi
                    if not sound:
                        marks[i, j, k] = True
                        break


@inlined
def _cofactors(a, k):
    """Cofactors ``k`` (3, 3) of ``a``."""
    for i in range(3):
        m, n = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            k[i, j] = a[m, p] * a[n, q] - a[m, q] * a[n, p]
