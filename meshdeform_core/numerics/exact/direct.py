"""Inverse-distance sums: every target with every source, in one loop for single and double precision.

The inner loop runs over sources in separate arrays, so that the compiler turns it into vector instructions; on AVX2
machines it is bound by multiplications and additions once the square root and the division are in single precision.
"""

from __future__ import annotations

import math

import numpy as np
from numba import types
from numba.extending import overload

from ...parallel import for_chunks
from ..arrays import FloatArray, IntArray, Report
from ..jit import fast_kernel, inlined
from .basis import exp, log

N_VALUES = 7
"""Values that one pass accumulates in addition to the weight; shorter sets are padded with zeros."""
DOUBLE, SINGLE = np.empty(0), np.empty(0, np.float32)
"""Precision of :func:`sum_whole`: to round-off, or to about 1e-5."""

# A tile of sources stays in the first-level cache while all targets are summed over it. Its size is fixed, so that the
# compiler sees that its rows do not alias.
_TILE = 256
_CHUNK = 2048
# Sum of the inverse fourth powers of distances, in units of the extent, above which single precision is not enough:
# there the fifth power is wrong by a tenth, and it overflows at distances below 1e-8.
_CLOSE = 2.0**68


def weighted_sums(
    targets: FloatArray,
    sources: FloatArray,
    strength: FloatArray,
    weights: tuple[float, float, float],
    values: FloatArray,
    progress: Report | None = None,
    chunk: int = _CHUNK,
) -> FloatArray:
    """Sums (n, 1 + k) over all sources of w and w * value, with w = strength (r^-a + kappa r^-b) (Sen et al. eqs.
    14-16).

    None of the targets (n, 3) is at a source (m, 3); ``strength`` is (m,), ``values`` (k, m), ``weights`` a, b, kappa;
    ``chunk`` targets are summed at a time, fewer than all only where no other loop uses the threads.
    """
    a, b, kappa = (float(part) for part in weights)
    every, result = (np.array([[0, len(sources)]]), np.array([[0, 1]])), np.empty((len(targets), 1 + len(values)))
    sources = np.ascontiguousarray(sources)
    for first in range(0, max(len(values), 1), N_VALUES):
        some = values[first : first + N_VALUES]
        charges = np.zeros((len(sources), 1 + N_VALUES))
        charges[:, 0], charges[:, 1 : 1 + len(some)] = strength, (strength * some).T
        sums = np.zeros((len(targets), 1 + N_VALUES))

        def work(lo: int, hi: int, charges: FloatArray = charges, sums: FloatArray = sums) -> None:
            sum_groups(targets, np.array([[lo, hi]]), sources, charges, *every, a, b, kappa, True, sums)

        for_chunks(work, len(targets), chunk, progress)
        result[:, 0] = sums[:, 0]
        result[:, 1 + first : 1 + first + len(some)] = sums[:, 1 : 1 + len(some)]
    return result


def sum_groups(
    targets: FloatArray, target_span: IntArray, sources: FloatArray, charges: FloatArray, pieces: IntArray,
    piece_span: IntArray, a: float, b: float, kappa: float, all_charges: bool, out: FloatArray,
) -> None:  # fmt: skip
    """Add to ``out`` (n, 8) the sums of charge * (r^-a + kappa r^-b), for groups of targets (n, 3) and pieces of
    sources (s, 3) with charges (s, 8).

    Spans have the first and one past the last: target of each of m groups, source of each of p pieces, none of them
    empty, piece that acts on each group. Without ``all_charges`` the first and the last charge are taken as zero.
    """
    groups = targets, target_span, sources, charges, pieces, piece_span
    if (a == 3.0 or a == 4.0) and b == 5.0:
        sum_whole(*groups, a, kappa, all_charges, DOUBLE, out)
    else:
        _sum_any(*groups, a, b, kappa, out)


@fast_kernel
def _sum_any(targets, target_span, sources, charges, pieces, piece_span, a, b, kappa, out):
    """:func:`sum_groups` for any exponents, in double precision, of all charges."""
    # Square roots take a fraction of the time of logarithms and exponentials.
    roots = a == 2.5 and b == 5.0
    tile, weight = np.empty((11, _TILE)), np.empty(_TILE)
    for group in range(target_span.shape[0]):
        for piece in range(piece_span[group, 0], piece_span[group, 1]):
            for first in range(pieces[piece, 0], pieces[piece, 1], _TILE):
                m = min(_TILE, pieces[piece, 1] - first)
                for s in range(m):
                    for d in range(3):
                        tile[d, s] = sources[first + s, d]
                    for c in range(8):
                        tile[3 + c, s] = charges[first + s, c]
                for t in range(target_span[group, 0], target_span[group, 1]):
                    for s in range(m):
                        dx, dy, dz = targets[t, 0] - tile[0, s], targets[t, 1] - tile[1, s], targets[t, 2] - tile[2, s]
                        weight[s] = dx * dx + dy * dy + dz * dz
                    for s in range(m):
                        if roots:
                            r = 1.0 / math.sqrt(weight[s])
                            half = r * r * math.sqrt(r)
                            weight[s] = half * (1.0 + kappa * half)
                        else:
                            log_r = 0.5 * log(weight[s])
                            weight[s] = exp(-a * log_r) + kappa * exp(-b * log_r)
                    for c in range(8):
                        total = 0.0
                        for s in range(m):
                            total += weight[s] * tile[3 + c, s]
                        out[t, c] += total


@fast_kernel("f8[:, ::1], i8[:, ::1], f8[:, ::1], f8[:, ::1], i8[:, ::1], i8[:, ::1], f8, f8, b1, f8[::1], f8[:, ::1]")
def sum_whole(targets, target_span, sources, charges, pieces, piece_span, a, kappa, all_charges, precision, out):
    """:func:`sum_groups` for a = 3 or 4 with b = 5: r^-3 (three + four / r + five / r^2) in one vector loop.

    ``precision`` is :data:`DOUBLE` or :data:`SINGLE`, with twice as many numbers per vector register. Coordinates are
    then relative to the targets and in units of their extent, so that a distance is wrong by less than 1e-7 of that
    extent however far away the origin is; distances below 1e-5 of it are computed in double precision. Charges should
    be of the order of one.
    """
    tile, weight = np.empty((11, _TILE), precision.dtype), np.empty(_TILE, precision.dtype)
    # Of this precision: coordinates of a target, factors of r^-3, r^-4 and r^-5, zero.
    own, center, row = np.empty(7, precision.dtype), np.empty(3), np.empty(_TILE, np.int64)
    own[6] = 0.0
    for group in range(target_span.shape[0]):
        first, last, piece, end = (
            target_span[group, 0],
            target_span[group, 1],
            piece_span[group, 0],
            piece_span[group, 1],
        )
        if first == last or piece == end:
            continue
        at = pieces[piece, 0]
        unit = _frame(precision, targets, first, last, sources, at, center)
        # Factors of r^-3, r^-4 and r^-5, with r in units of the extent, and the common factor of the sums.
        first_power, last_power = 1.0 if a == 3.0 else unit, kappa * unit * unit
        # Dividing by the larger of the two keeps the weights of all distances that are not close finite.
        largest = math.ldexp(1.0, math.frexp(max(first_power, last_power))[1])
        own[3], own[4] = (first_power / largest, 0.0) if a == 3.0 else (0.0, first_power / largest)
        own[5] = last_power / largest
        back = unit * unit * unit * largest
        three, four, five, zero = own[3], own[4], own[5], own[6]
        while piece < end:
            m = 0
            while piece < end and m < _TILE:
                more = min(pieces[piece, 1] - at, _TILE - m)
                for s in range(more):
                    row[m + s] = at + s
                    for d in range(3):
                        tile[d, m + s] = unit * (sources[at + s, d] - center[d])
                    for c in range(8):
                        tile[3 + c, m + s] = charges[at + s, c]
                m += more
                at += more
                if at == pieces[piece, 1]:
                    piece += 1
                    at = pieces[min(piece, end - 1), 0]
            for t in range(first, last):
                for d in range(3):
                    own[d] = unit * (targets[t, d] - center[d])
                px, py, pz = own[0], own[1], own[2]
                a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = close = zero
                for s in range(m):
                    dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
                    r = _inverse_root(dx * dx + dy * dy + dz * dz)
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
                if close > _CLOSE:
                    _add_in_double(targets, t, sources, charges, row, m, a, kappa, all_charges, out)
                    continue
                out[t, 1] += back * a1
                out[t, 2] += back * a2
                out[t, 3] += back * a3
                out[t, 4] += back * a4
                out[t, 5] += back * a5
                out[t, 6] += back * a6
                if all_charges:
                    for s in range(m):
                        a0 += weight[s] * tile[3, s]
                        a7 += weight[s] * tile[10, s]
                    out[t, 0] += back * a0
                    out[t, 7] += back * a7


def _inverse_root(square):
    """One over the root of a square, in its precision."""
    raise NotImplementedError


@overload(_inverse_root, inline="always")
def _inverse_root_of(square):
    def single(square):
        return np.float32(1.0) / math.sqrt(square)

    def double(square):
        # A root and a division in double precision would take longer than the rest of the loop. They are computed in
        # single precision, to a relative error below 3e-7, and refined by two terms of the binomial series to
        # round-off. Distances within a group may differ by a factor of 1e19.
        r = np.float64(np.float32(1.0) / math.sqrt(np.float32(square)))
        rest = 1.0 - square * r * r
        return r + r * rest * (0.5 + 0.375 * rest)

    return single if square == types.float32 else double


def _frame(precision, targets, first, last, sources, source, center):
    """Store the origin of a group in ``center`` and return the factor that scales its distances to the order of one."""
    raise NotImplementedError


@overload(_frame)
def _frame_of(precision, targets, first, last, sources, source, center):
    def single(precision, targets, first, last, sources, source, center):
        # The middle of the targets, and their extent or, for one target, a part of its distance.
        extent = apart = 0.0
        for d in range(3):
            low = high = targets[first, d]
            for t in range(first, last):
                low, high = min(low, targets[t, d]), max(high, targets[t, d])
            center[d] = 0.5 * (low + high)
            extent += (high - low) ** 2
            apart += (sources[source, d] - center[d]) ** 2
        return 1.0 / max(math.sqrt(extent), 1e-3 * math.sqrt(apart), 1e-300)

    def double(precision, targets, first, last, sources, source, center):
        largest = 0.0
        for d in range(3):
            center[d] = 0.0
            largest = max(largest, abs(targets[first, d] - sources[source, d]))
        return math.ldexp(1.0, -math.frexp(largest)[1])

    return single if precision.dtype == types.float32 else double


@inlined
def _add_in_double(targets, target, sources, charges, row, m, a, kappa, all_charges, out):
    """Contribution of ``m`` sources, those of the numbers ``row``, to one target."""
    low, high = (0, 8) if all_charges else (1, 7)
    for s in range(m):
        square = 0.0
        for d in range(3):
            square += (targets[target, d] - sources[row[s], d]) ** 2
        r = 1.0 / math.sqrt(square)
        w = (r * r * r if a == 3.0 else r * r * r * r) + kappa * r * r * r * r * r
        for c in range(low, high):
            out[target, c] += w * charges[row[s], c]
