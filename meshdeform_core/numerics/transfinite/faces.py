"""Transfinite interpolation of displacements along lines and on faces (Sen et al. eq. 2), and its transpose.

Faces are rectangles of nodes, stored consecutively in flat arrays, C-ordered: face n has the entries ``start[n]`` to
``start[n + 1]`` and ``width[n]`` nodes along its second index; a line is a face of width 1.
"""

import math

import numpy as np

from ..jit import kernel


@kernel("f8[:, ::1], i8[::1], i8[::1], i8[::1], f8[::1], f8[::1]")
def face_coordinates(points, start, width, nodes, s, t):
    """Arc coordinates of the nodes of faces, rows of ``points`` (n_nodes, 3), along their first and second index, into
    ``s`` and ``t``; they are uniform on lines of zero length."""
    for face in range(start.size - 1):
        height = (start[face + 1] - start[face]) // width[face]
        for line in range(width[face] + height):
            if line < width[face]:
                arc, first, step, count = s, start[face] + line, width[face], height
            else:
                arc, first, step, count = t, start[face] + (line - width[face]) * width[face], 1, width[face]
            total, arc[first] = 0.0, 0.0
            for m in range(1, count):
                p, q = nodes[first + m * step], nodes[first + (m - 1) * step]
                dx, dy, dz = points[p, 0] - points[q, 0], points[p, 1] - points[q, 1], points[p, 2] - points[q, 2]
                total += math.sqrt(dx * dx + dy * dy + dz * dz)
                arc[first + m * step] = total
            for m in range(1, count):
                at = first + m * step
                arc[at] = arc[at] / total if total > 0.0 else m / (count - 1)


@kernel("f8[:, ::1], i8[::1], i8[::1], i8[::1], b1[::1], f8[::1], f8[::1], b1")
def blend_faces(d, start, width, nodes, wanted, s, t, transposed):
    """Fill the ``wanted`` rows of ``d`` (n, 3), the displacement inside faces, from the edges of each face: edges less
    corners; inside lines from their ends.

    ``nodes`` are rows of ``d``, ``s`` and ``t`` their coordinates along the first and second index of their face.
    ``transposed``: ``d`` holds gradients, which are passed on from inside the faces, the last one first, to their
    edges; inside they become zero.
    """
    known, weight, faces = np.empty(8, np.int64), np.empty(8), start.size - 1
    for number in range(faces):
        face = faces - 1 - number if transposed else number
        at, n = start[face], width[face] - 1
        m = (start[face + 1] - at) // (n + 1) - 1
        top, count = at + m * (n + 1), 8 if n else 2
        known[0], known[1], known[2], known[3] = nodes[at], nodes[top], nodes[at + n], nodes[top + n]
        for a in range(1, m):
            row = at + a * (n + 1)
            known[4], known[5] = nodes[row], nodes[row + n]
            for b in range(min(n, 1), max(n, 1)):
                if not wanted[row + b]:
                    continue
                x, y, node = s[row + b], t[row + b], nodes[row + b]
                weight[0], weight[1] = 1.0 - x, x
                if n:
                    known[6], known[7] = nodes[at + b], nodes[top + b]
                    weight[4], weight[5], weight[6], weight[7] = 1.0 - y, y, 1.0 - x, x
                    weight[0], weight[2] = -(1.0 - x) * (1.0 - y), -(1.0 - x) * y
                    weight[1], weight[3] = -x * (1.0 - y), -x * y
                for c in range(3):
                    value = d[node, c] if transposed else 0.0
                    d[node, c] = 0.0
                    for e in range(count):
                        if transposed:
                            d[known[e], c] += weight[e] * value
                        else:
                            value += weight[e] * d[known[e], c]
                    if not transposed:
                        d[node, c] = value
