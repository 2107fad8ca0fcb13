"""Partial removal of the components of displacements along given directions."""

import numpy as np

from .jit import kernel


@kernel("f8[:, ::1], i8[::1], f8[:, ::1], f8[:, ::1], f8")
def damp_rows(values, rows, normals, parts, least):
    """``values[r] = (I + sum_k c_k n_k n_k^T)^-1 values[r]`` for the given rows, each once; c = part / (1 - part).

    ``normals`` (k, 3) are unit vectors; ``parts`` (n, k) is the part of the component along each normal to be removed,
    from 0 (none) to 1 (all). Rows without a component larger than ``least`` remain unchanged. The inverse is built up
    normal by normal with the Sherman-Morrison formula.
    """
    size = normals.shape[0]
    way, factor = np.empty((size, 3)), np.empty(size)
    for n in range(rows.size):
        r = rows[n]
        x, y, z = values[r, 0], values[r, 1], values[r, 2]
        largest = 0.0
        for k in range(size):
            largest = max(largest, abs(normals[k, 0] * x + normals[k, 1] * y + normals[k, 2] * z))
        if not largest > least:
            continue
        for k in range(size):
            a, b, c = normals[k, 0], normals[k, 1], normals[k, 2]
            p, q, s = a, b, c
            for j in range(k):
                t = factor[j] * (way[j, 0] * a + way[j, 1] * b + way[j, 2] * c)
                p, q, s = p - t * way[j, 0], q - t * way[j, 1], s - t * way[j, 2]
            part = parts[n, k]
            rest = 1.0 - part + part * (a * p + b * q + c * s)
            # Zero where the preceding normals leave no component along this one.
            factor[k] = part / rest if rest > 1e-12 else 0.0
            way[k, 0], way[k, 1], way[k, 2] = p, q, s
            t = factor[k] * (p * x + q * y + s * z)
            values[r, 0] -= t * p
            values[r, 1] -= t * q
            values[r, 2] -= t * s
