"""Transfinite interpolation of displacements along lines and on faces (Sen et al. eq. 2).

Lines and faces are listed one after another in flat arrays: those of line n are ``start[n]`` to ``start[n + 1]``.
"""

import numpy as np

from .blend import arcs_across
from .jit import contracted_kernel, fast_kernel, kernel


@kernel
def blend_lines(d, start, nodes, arc):
    """Displacement inside lines of nodes from their two ends, in ``d`` (n, 3).

    ``nodes`` are rows of ``d``, ``arc`` their coordinates from 0 to 1.
    """
    for line in range(start.size - 1):
        first, last = nodes[start[line]], nodes[start[line + 1] - 1]
        for n in range(start[line] + 1, start[line + 1] - 1):
            for c in range(3):
                d[nodes[n], c] = d[first, c] + arc[n] * (d[last, c] - d[first, c])


@kernel
def face_coordinates(points, start, width, nodes, s, t):
    """Arc coordinates of the nodes of faces along their first and second index, into ``s`` and ``t``.

    Parameters
    ----------
    points : (n_nodes, 3)
    width : nodes along the second index of every face
    nodes : rows of ``points``
    """
    for face in range(start.size - 1):
        part = slice(start[face], start[face + 1])
        plane = points[nodes[part]].reshape((-1, width[face], 3))
        s[part] = arcs_across(plane).ravel()
        t[part] = arcs_across(plane.transpose((1, 0, 2))).T.copy().ravel()


# Rows of work arrays, three components each: coefficients of 1 and of s.
_ONE, _BY_S = 0, 3


@fast_kernel
def blend_faces(d, start, width, nodes, wanted, s, t):
    """Displacement inside faces from their four edges, in ``d`` (n, 3), where ``wanted``.

    ``nodes`` are rows of ``d``, ``s`` and ``t`` their coordinates along the first and second index of their face.
    """
    for face in range(start.size - 1):
        n = width[face]
        part = slice(start[face], start[face + 1])
        _blend_face(d, nodes[part].reshape((-1, n)), wanted[part].reshape((-1, n)), s[part], t[part])


@fast_kernel
def _blend_face(d, nodes, wanted, s, t):
    m, n = nodes.shape[0] - 1, nodes.shape[1] - 1
    across = np.empty((n, 6))
    for b in range(1, n):
        for c in range(3):
            across[b, _ONE + c] = d[nodes[0, b], c] - d[nodes[0, 0], c]
            across[b, _BY_S + c] = d[nodes[m, b], c] - d[nodes[m, 0], c] - across[b, _ONE + c]
    along_low, along_high = d[nodes[0, n]] - d[nodes[0, 0]], d[nodes[m, n]] - d[nodes[m, 0]]
    by_st = along_low - along_high
    for a in range(1, m):
        low, by_t = d[nodes[a, 0]], d[nodes[a, n]] - d[nodes[a, 0]] - along_low
        for b in range(1, n):
            if wanted[a, b]:
                at, x, y = nodes[a, b], s[a * (n + 1) + b], t[a * (n + 1) + b]
                # All three before any is written: the compiler cannot know that only d changes.
                d[at, 0], d[at, 1], d[at, 2] = (
                    _blend_node(x, y, across[b], low, by_t, by_st, 0),
                    _blend_node(x, y, across[b], low, by_t, by_st, 1),
                    _blend_node(x, y, across[b], low, by_t, by_st, 2),
                )


@contracted_kernel
def _blend_node(x, y, across, low, by_t, by_st, c):
    return low[c] + across[_ONE + c] + y * by_t[c] + x * (across[_BY_S + c] + y * by_st[c])
