"""Weighted sums in single precision: twice as many numbers per vector register, and faster roots and divisions.

Coordinates are taken relative to the targets and in units of their extent, so that a distance is wrong by less than
1e-7 of that extent however far away the origin is. Distances below 1e-5 of the extent are computed in double precision.
Charges should be of the order of one, see :mod:`.fastsum.weighted.sums`.
"""

import math

import numpy as np

from ..jit import fast_kernel, inlined

# Every tile ends with sums over the lanes of a vector: tiles are as long as the first-level cache allows.
_TILE = 512
# Inverse fourth power of the distance, in units of the extent, above which single precision is not enough: there the
# fifth power is wrong by a tenth, and it overflows at distances below 1e-8.
_CLOSE = 2.0**68


@fast_kernel
def sum_groups_single(targets, target_span, charged, pieces, piece_span, a, kappa, all_charges, out):
    """Add to ``out`` the sums of charge * (r^-a + kappa r^-5), a = 3 or 4: as :func:`.direct.sum_groups`.

    Without ``all_charges`` the first and the last charge are taken as zero.
    """
    # The sums over a tile stay here: in a function of their own, the compiler orders the additions differently.
    tile, weight, center = np.empty((11, _TILE), np.float32), np.empty(_TILE, np.float32), np.empty(3)
    row, limit, one = np.empty(_TILE, np.int64), np.float32(_CLOSE), np.float32(1.0)
    for group in range(target_span.shape[0]):
        first, piece, end = target_span[group, 0], piece_span[group, 0], piece_span[group, 1]
        count = target_span[group, 1] - first
        if count == 0 or piece == end:
            continue
        at = pieces[piece, 0]
        scale = _frame(targets, first, count, charged, at, center)
        unit = 1.0 / scale
        x = _relative(targets, first, count, center, unit)
        three, four, five, back = _factors(a, kappa, unit)
        while piece < end:
            m, piece, at = _load(charged, pieces, piece, end, at, center, unit, tile, row)
            for t in range(count):
                px, py, pz = x[0, t], x[1, t], x[2, t]
                a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = np.float32(0.0)
                close = np.float32(0.0)
                for s in range(m):
                    dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
                    r = one / math.sqrt(dx * dx + dy * dy + dz * dz)
                    r2 = r * r
                    # A sum, unlike a minimum, is vectorised.
                    close += r2 * r2
                    w = r * r2 * (three + r * (four + five * r))
                    weight[s] = w
                    a1 += w * tile[4, s]
                    a2 += w * tile[5, s]
                    a3 += w * tile[6, s]
                    a4 += w * tile[7, s]
                    a5 += w * tile[8, s]
                    a6 += w * tile[9, s]
                if close > limit:
                    _add_in_double(targets, first + t, charged, row, m, a, kappa, all_charges, out)
                    continue
                _add_six(out, first + t, back, a1, a2, a3, a4, a5, a6)
                if all_charges:
                    for s in range(m):
                        a0 += weight[s] * tile[3, s]
                        a7 += weight[s] * tile[10, s]
                    out[first + t, 0] += back * a0
                    out[first + t, 7] += back * a7


@inlined
def _factors(a, kappa, unit):
    """Factors of r^-3, r^-4 and r^-5 with r in units of the extent, and the common factor of the sums."""
    first_power, last_power = 1.0 if a == 3.0 else unit, kappa * unit * unit
    # Dividing by the larger of the two keeps the weights of all distances that are not close finite.
    largest = max(first_power, last_power)
    three, four = (first_power / largest, 0.0) if a == 3.0 else (0.0, first_power / largest)
    return np.float32(three), np.float32(four), np.float32(last_power / largest), unit * unit * unit * largest


@inlined
def _add_six(out, target, back, a1, a2, a3, a4, a5, a6):
    out[target, 1] += back * a1
    out[target, 2] += back * a2
    out[target, 3] += back * a3
    out[target, 4] += back * a4
    out[target, 5] += back * a5
    out[target, 6] += back * a6


@inlined
def _add_in_double(targets, target, charged, row, m, a, kappa, all_charges, out):
    """Contribution of ``m`` sources, the rows ``row`` of ``charged``, to one target."""
    low, high = (0, 8) if all_charges else (1, 7)
    for s in range(m):
        square = 0.0
        for d in range(3):
            square += (targets[target, d] - charged[row[s], d]) ** 2
        r = 1.0 / math.sqrt(square)
        w = (r * r * r if a == 3.0 else r * r * r * r) + kappa * r * r * r * r * r
        for c in range(low, high):
            out[target, c] += w * charged[row[s], 3 + c]


@inlined
def _relative(targets, first, count, center, unit):
    """Coordinates (3, count) of targets, in single precision."""
    x = np.empty((3, count), np.float32)
    for d in range(3):
        for t in range(count):
            x[d, t] = np.float32((targets[first + t, d] - center[d]) * unit)
    return x


@inlined
def _load(charged, pieces, piece, end, at, center, unit, tile, row):
    """Fill ``tile`` with sources from row ``at`` of ``piece`` on, and ``row`` with their numbers.

    Returns how many they are, and where the next tile begins.
    """
    m = 0
    while piece < end and m < _TILE:
        more = min(pieces[piece, 1] - at, _TILE - m)
        for s in range(more):
            row[m + s] = at + s
            for d in range(3):
                tile[d, m + s] = np.float32((charged[at + s, d] - center[d]) * unit)
            for c in range(3, 11):
                tile[c, m + s] = np.float32(charged[at + s, c])
        m += more
        at += more
        if at == pieces[piece, 1]:
            piece += 1
            at = pieces[min(piece, end - 1), 0]
    return m, piece, at


@inlined
def _frame(targets, first, count, charged, source, center):
    """Store the middle of the targets in ``center``; return their extent, or for one target a part of its distance."""
    extent = apart = 0.0
    for d in range(3):
        low = high = targets[first, d]
        for t in range(first, first + count):
            low, high = min(low, targets[t, d]), max(high, targets[t, d])
        center[d] = 0.5 * (low + high)
        extent += (high - low) ** 2
        apart += (charged[source, d] - center[d]) ** 2
    return max(math.sqrt(extent), 1e-3 * math.sqrt(apart), 1e-300)
