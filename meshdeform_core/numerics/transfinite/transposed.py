"""Transposes of the loops of transfinite interpolation: gradients of inner nodes are passed on to the boundary.

Arguments as in :mod:`.blend` and :mod:`.faces`; ``g`` holds gradients with respect to displacements.
Those of nodes that the forward loop fills are passed on and set to zero.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from .arcs import TILE, padded, tile_start


@kernel("f8[:, ::1], f8[::1], i8[:, ::1]")
def blend_transposed(g, arc, subs):
    """Transpose of :func:`.blend.blend_slabs` for whole sub-blocks: faces minus edges plus corners, node by node."""
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
                        _spread(g, corner, index, high, x)


@inlined
def _spread(g, corner, index, high, x):
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


@kernel("f8[:, ::1], i8[::1], i8[::1], f8[::1]")
def lines_transposed(g, start, nodes, arc):
    """Transpose of :func:`.faces.blend_lines`, last line first."""
    for line in range(start.size - 2, -1, -1):
        first, last = nodes[start[line]], nodes[start[line + 1] - 1]
        for n in range(start[line] + 1, start[line + 1] - 1):
            for c in range(3):
                value = g[nodes[n], c]
                g[nodes[n], c] = 0.0
                g[first, c] += (1.0 - arc[n]) * value
                g[last, c] += arc[n] * value


@kernel("f8[:, ::1], i8[::1], i8[::1], i8[::1], b1[::1], f8[::1], f8[::1]")
def faces_transposed(g, start, width, nodes, wanted, s, t):
    """Transpose of :func:`.faces.blend_faces`, last face first."""
    for face in range(start.size - 2, -1, -1):
        at, n = start[face], width[face] - 1
        m = (start[face + 1] - at) // (n + 1) - 1
        top = at + m * (n + 1)
        for a in range(1, m):
            row = at + a * (n + 1)
            for b in range(1, n):
                if not wanted[row + b]:
                    continue
                x, y, node = s[row + b], t[row + b], nodes[row + b]
                for c in range(3):
                    value = g[node, c]
                    g[node, c] = 0.0
                    g[nodes[row], c] += (1.0 - y) * value
                    g[nodes[row + n], c] += y * value
                    g[nodes[at + b], c] += (1.0 - x) * value
                    g[nodes[top + b], c] += x * value
                    g[nodes[at], c] -= (1.0 - x) * (1.0 - y) * value
                    g[nodes[at + n], c] -= (1.0 - x) * y * value
                    g[nodes[top], c] -= x * (1.0 - y) * value
                    g[nodes[top + n], c] -= x * y * value
