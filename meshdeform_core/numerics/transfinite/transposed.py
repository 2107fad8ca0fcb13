"""Transpose of transfinite interpolation, for derivatives: a module of its own, as few runs need its loop compiled."""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from .arcs import TILE, padded, tile_start


@kernel("f8[:, ::1], f8[::1], i8[:, ::1]")
def blend_transposed(g, arc, subs):
    """Transpose of :func:`.blend.blend_slabs` for whole sub-blocks: faces minus edges plus corners, node by node.

    Gradients ``g`` (n_nodes, 3) of the nodes inside are passed on to the faces and set to zero.
    """
    x, high, index = np.empty(3), np.empty(3, np.int64), np.empty(3, np.int64)
    for n in range(subs.shape[0]):
        sub = subs[n]
        si, sj = sub[2] * sub[3], sub[3]
        corner = sub[0] + sub[4] * si + sub[5] * sj + sub[6]
        ni, nj, nk = sub[7] - sub[4] - 1, sub[8] - sub[5] - 1, sub[9] - sub[6] - 1
        high[0], high[1], high[2] = (ni + 1) * si, (nj + 1) * sj, nk + 1
        for i in range(ni):
            for k0 in range(0, nk, TILE):
                width = padded(min(TILE, nk - k0))
                for j in range(nj):
                    at = sub[10] + tile_start(i, 0, k0, nj, nk) + 3 * width * j
                    for k in range(k0, min(k0 + TILE, nk)):
                        x[0], x[1], x[2] = arc[at + k - k0], arc[at + width + k - k0], arc[at + 2 * width + k - k0]
                        index[0], index[1], index[2] = (i + 1) * si, (j + 1) * sj, k + 1
                        _spread_to_faces(g, corner, index, high, x)


@inlined
def _spread_to_faces(g, corner, index, high, x):
    """Pass the gradient of one node on to 26 nodes on the faces."""
    node = corner + index[0] + index[1] + index[2]
    a, b, c = g[node, 0], g[node, 1], g[node, 2]
    g[node, 0] = g[node, 1] = g[node, 2] = 0.0
    # Per direction: inside, low side, high side.
    for p in range(3):
        wp = 1.0 if p == 0 else (1.0 - x[0] if p == 1 else x[0])
        ip = index[0] if p == 0 else (0 if p == 1 else high[0])
        for q in range(3):
            wq = 1.0 if q == 0 else (1.0 - x[1] if q == 1 else x[1])
            iq = index[1] if q == 0 else (0 if q == 1 else high[1])
            for r in range(3):
                sides = (p > 0) + (q > 0) + (r > 0)
                if sides == 0:
                    continue
                wr = 1.0 if r == 0 else (1.0 - x[2] if r == 1 else x[2])
                ir = index[2] if r == 0 else (0 if r == 1 else high[2])
                w = wp * wq * wr * (-1.0 if sides == 2 else 1.0)
                to = corner + ip + iq + ir
                g[to, 0] += w * a
                g[to, 1] += w * b
                g[to, 2] += w * c
