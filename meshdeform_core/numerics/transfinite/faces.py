"""Transfinite interpolation of displacements along lines and on faces (Sen et al. eq. 2).

Lines and faces are stored consecutively in flat arrays: line n has the entries ``start[n]`` to ``start[n + 1]``.
"""

import math

import numpy as np

from ..jit import fast_kernel, inlined, kernel


@kernel("f8[:, ::1], i8[::1], i8[::1], f8[::1]")
def blend_lines(d, start, nodes, arc):
    """Fill rows of ``d`` (n, 3), the displacement inside lines of nodes, from the two ends of each line.

    ``nodes`` are rows of ``d``; ``arc`` are their arc coordinates, from 0 to 1.
    """
    for line in range(start.size - 1):
        first, last = nodes[start[line]], nodes[start[line + 1] - 1]
        for n in range(start[line] + 1, start[line + 1] - 1):
            for c in range(3):
                d[nodes[n], c] = d[first, c] + arc[n] * (d[last, c] - d[first, c])


@kernel("f8[:, ::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1]")
def face_coordinates(points, start, width, nodes, s, t):
    """Arc coordinates of the nodes of faces along their first and second index, into ``s`` and ``t``.

    Parameters
    ----------
    points : (n_nodes, 3)
    width : nodes along the second index of every face
    nodes : rows of ``points``
    """
    for face in range(start.size - 1):
        count = (start[face + 1] - start[face]) // width[face]
        for m in range(width[face]):
            _arcs(points, nodes, start[face] + m, width[face], count, s)
        for m in range(count):
            _arcs(points, nodes, start[face] + m * width[face], 1, width[face], t)


@inlined
def _arcs(points, nodes, first, step, count, arc):
    """Arc coordinates of ``count`` nodes, every ``step``-th from ``first`` on; uniform on lines of zero length."""
    total = 0.0
    arc[first] = 0.0
    for m in range(1, count):
        p, q = nodes[first + m * step], nodes[first + (m - 1) * step]
        dx, dy, dz = points[p, 0] - points[q, 0], points[p, 1] - points[q, 1], points[p, 2] - points[q, 2]
        total += math.sqrt(dx * dx + dy * dy + dz * dz)
        arc[first + m * step] = total
    for m in range(1, count):
        at = first + m * step
        arc[at] = arc[at] / total if total > 0.0 else m / (count - 1)


# Rows of work arrays, three components each: coefficients of 1 and of s.
_ONE, _BY_S = 0, 3


@fast_kernel("f8[:, ::1], i8[::1], i8[::1], i8[::1], b1[::1], f8[::1], f8[::1]")
def blend_faces(d, start, width, nodes, wanted, s, t):
    """Fill the ``wanted`` rows of ``d`` (n, 3), the displacement inside faces, from the four edges of each face.

    ``nodes`` are rows of ``d``, ``s`` and ``t`` their coordinates along the first and second index of their face.
    """
    across, low, by_t, by_st = np.empty((_widest(width), 6)), np.empty(3), np.empty(3), np.empty(3)
    for face in range(start.size - 1):
        at, n = start[face], width[face] - 1
        m = (start[face + 1] - at) // (n + 1) - 1
        _blend_face(d, at, m, n, nodes, wanted, s, t, across, low, by_t, by_st)


@inlined
def _widest(width):
    widest = 0
    for n in width:
        widest = max(widest, n)
    return widest


@inlined
def _blend_face(d, start, m, n, nodes, wanted, s, t, across, low, by_t, by_st):
    corner, top = nodes[start], nodes[start + m * (n + 1)]
    side, far = nodes[start + n], nodes[start + m * (n + 1) + n]
    for b in range(1, n):
        first, last = nodes[start + b], nodes[start + m * (n + 1) + b]
        for c in range(3):
            across[b, _ONE + c] = d[first, c] - d[corner, c]
            across[b, _BY_S + c] = d[last, c] - d[top, c] - across[b, _ONE + c]
    for c in range(3):
        by_st[c] = d[side, c] - d[corner, c] - (d[far, c] - d[top, c])
    for a in range(1, m):
        row = start + a * (n + 1)
        first, last = nodes[row], nodes[row + n]
        for c in range(3):
            low[c], by_t[c] = d[first, c], d[last, c] - d[first, c] - (d[side, c] - d[corner, c])
        for b in range(1, n):
            if wanted[row + b]:
                at, x, y = nodes[row + b], s[row + b], t[row + b]
                for c in range(3):
                    d[at, c] = low[c] + across[b, _ONE + c] + y * by_t[c] + x * (across[b, _BY_S + c] + y * by_st[c])
