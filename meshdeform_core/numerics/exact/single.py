"""Weighted sums in single precision: twice as many numbers in a vector register, and faster roots and divisions.

Coordinates are taken relative to the targets and in units of their extent, so that a distance is wrong by less than
1e-7 of that extent however far away the origin is. Charges should be of the order of one: see :mod:`.fastsum.sums`.
"""

import math

import numpy as np

from ..jit import fast_kernel, inlined

_TILE = 128


@fast_kernel
def sum_groups_single(targets, target_span, packed, source_span, kappa, out):
    """Add to ``out`` the sums of charge * (r^-3 + kappa r^-5): as :func:`.direct.sum_groups`."""
    tile, center = np.empty((11, _TILE), np.float32), np.empty(3)
    for group in range(target_span.shape[0]):
        first, end = target_span[group, 0], source_span[group, 1]
        count = target_span[group, 1] - first
        if count == 0 or source_span[group, 0] == end:
            continue
        x = np.empty((3, count), np.float32)
        scale = _frame(targets, first, count, packed, source_span[group, 0], center)
        for d in range(3):
            for t in range(count):
                x[d, t] = np.float32((targets[first + t, d] - center[d]) / scale)
        one, k = np.float32(1.0), np.float32(kappa / (scale * scale))
        # r^-3 in units of the extent.
        back = 1.0 / (scale * scale * scale)
        for s0 in range(source_span[group, 0], end, _TILE):
            m = min(_TILE, end - s0)
            for row in range(11):
                shift, unit = (center[row], scale) if row < 3 else (0.0, 1.0)
                for s in range(m):
                    tile[row, s] = np.float32((packed[row, s0 + s] - shift) / unit)
            for t in range(count):
                px, py, pz = x[0, t], x[1, t], x[2, t]
                a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0.0)
                for s in range(m):
                    dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
                    r = one / math.sqrt(dx * dx + dy * dy + dz * dz)
                    r2 = r * r
                    w = r * r2 * (one + k * r2)
                    a0 += w * tile[3, s]
                    a1 += w * tile[4, s]
                    a2 += w * tile[5, s]
                    a3 += w * tile[6, s]
                    a4 += w * tile[7, s]
                    a5 += w * tile[8, s]
                    a6 += w * tile[9, s]
                    a7 += w * tile[10, s]
                out[first + t, 0] += back * a0
                out[first + t, 1] += back * a1
                out[first + t, 2] += back * a2
                out[first + t, 3] += back * a3
                out[first + t, 4] += back * a4
                out[first + t, 5] += back * a5
                out[first + t, 6] += back * a6
                out[first + t, 7] += back * a7


@inlined
def _frame(targets, first, count, packed, source, center):
    """Middle of the targets, into ``center``; returns their extent, or for a single one a part of the distance."""
    extent = apart = 0.0
    for d in range(3):
        low = high = targets[first, d]
        for t in range(first, first + count):
            low, high = min(low, targets[t, d]), max(high, targets[t, d])
        center[d] = 0.5 * (low + high)
        extent += (high - low) ** 2
        apart += (packed[d, source] - center[d]) ** 2
    return max(math.sqrt(extent), 1e-3 * math.sqrt(apart), 1e-300)
