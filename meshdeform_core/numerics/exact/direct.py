"""Exact inverse-distance sums: every target with every source, limited only by the machine's arithmetic.

The inner loop runs over sources in separate arrays, so that the compiler turns it into vector instructions; on AVX2
machines it is bound by multiplications and additions once the square root and the division are in single precision.
"""

from __future__ import annotations

import math

import numpy as np

from ...parallel import for_chunks
from ..arrays import FloatArray, Report
from ..jit import fast_kernel, inlined
from .elementary import exp, log

N_VALUES = 7
"""Values that one pass accumulates in addition to the weight; shorter sets are padded with zeros."""

_TILE = 128
_CHUNK = 2048


def weighted_sums(
    targets: FloatArray,
    sources: FloatArray,
    strength: FloatArray,
    weights: tuple[float, float, float],
    values: FloatArray,
    progress: Report | None = None,
    chunk: int = _CHUNK,
) -> FloatArray:
    """Sums over all sources of w and w * value, with w = strength (r^-a + kappa r^-b) (Sen et al. eqs. 14-16).

    Parameters
    ----------
    targets : (n, 3) float64, none of them at a source
    sources : (m, 3) float64
    strength : (m,) float64
    weights : (a, b, kappa); a = 3 or 4 with b = 5 has a loop of its own
    values : (k, m) float64
    chunk : targets per call; less than all of them only where no other loop uses the threads

    Returns
    -------
    sums : (n, 1 + k), the weight in column 0
    """
    a, b, kappa = (float(part) for part in weights)
    every = np.array([[0, len(sources)]]), np.array([[0, 1]])
    result = np.empty((len(targets), 1 + len(values)))
    for first in range(0, max(len(values), 1), N_VALUES):
        some = values[first : first + N_VALUES]
        charged = np.zeros((len(sources), 4 + N_VALUES))
        charged[:, :3], charged[:, 3], charged[:, 4 : 4 + len(some)] = sources, strength, (strength * some).T
        sums = np.zeros((len(targets), 1 + N_VALUES))

        def work(lo: int, hi: int, charged: FloatArray = charged, sums: FloatArray = sums) -> None:
            sum_groups(targets, np.array([[lo, hi]]), charged, *every, a, b, kappa, True, sums)

        for_chunks(work, len(targets), chunk, progress)
        result[:, 0] = sums[:, 0]
        result[:, 1 + first : 1 + first + len(some)] = sums[:, 1 : 1 + len(some)]
    return result


@fast_kernel
def sum_groups(targets, target_span, charged, pieces, piece_span, a, b, kappa, all_charges, out):
    """Add to ``out`` (n, 8) the sums of charge * (r^-a + kappa r^-b), for groups of targets and of sources.

    Parameters
    ----------
    targets : (n, 3)
    target_span : (m, 2) int64, first and one past the last target of each group
    charged : (s, 11) x, y, z and eight charges of the sources
    pieces : (p, 2) int64, first and one past the last source of each piece, none of them empty
    piece_span : (m, 2) int64, first and one past the last piece that acts on each group
    all_charges : whether all eight charges are summed; otherwise the first and the last one are taken as zero
    """
    # Whole exponents: r^-3 (three + four / r + five / r^2) in one vector loop.
    whole = (a == 3.0 or a == 4.0) and b == 5.0
    # Square roots take a fraction of the time of logarithms and exponentials.
    roots = a == 2.5 and b == 5.0
    # A tile of sources stays in the first-level cache while all targets are summed over it. Its size is fixed, so that
    # the compiler sees that its rows do not alias.
    tile, weight = np.empty((11, _TILE)), np.empty(_TILE)
    for group in range(target_span.shape[0]):
        piece, end = piece_span[group, 0], piece_span[group, 1]
        at = pieces[piece, 0] if piece < end else 0
        unit = three = four = five = 1.0
        if whole and piece < end and target_span[group, 0] < target_span[group, 1]:
            unit = _unit(targets, target_span[group, 0], charged, at)
            three, four = (unit**3, 0.0) if a == 3.0 else (0.0, unit**4)
            five = kappa * unit**5
        while piece < end:
            m = 0
            while piece < end and m < _TILE:
                more = min(pieces[piece, 1] - at, _TILE - m)
                for s in range(more):
                    for row in range(3):
                        tile[row, m + s] = unit * charged[at + s, row]
                    for row in range(3, 11):
                        tile[row, m + s] = charged[at + s, row]
                m += more
                at += more
                if at == pieces[piece, 1]:
                    piece += 1
                    at = pieces[min(piece, end - 1), 0]
            for t in range(target_span[group, 0], target_span[group, 1]):
                px, py, pz = unit * targets[t, 0], unit * targets[t, 1], unit * targets[t, 2]
                if not whole:
                    _weights(px, py, pz, tile, m, a, b, kappa, roots, weight)
                _add(px, py, pz, tile, m, three, four, five, whole, all_charges, weight, out, t)


@inlined
def _unit(targets, target, charged, source):
    """A power of two that scales the distances of a group to the order of one."""
    largest = 0.0
    for d in range(3):
        largest = max(largest, abs(targets[target, d] - charged[source, d]))
    return math.ldexp(1.0, -math.frexp(largest)[1])


@inlined
def _add(px, py, pz, tile, m, three, four, five, whole, all_charges, weight, out, t):
    """Contribution of a tile to one target; ``whole``: weights three r^-3 + four r^-4 + five r^-5, one vector loop.

    A root and a division in double precision would take longer than the rest of the loop. They are computed in single
    precision, to a relative error below 3e-7, and refined by two terms of the binomial series to round-off. Distances
    within a group may differ by a factor of 1e19.
    """
    a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = 0.0
    for s in range(m):
        if whole:
            dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
            square = dx * dx + dy * dy + dz * dz
            r = np.float64(np.float32(1.0) / math.sqrt(np.float32(square)))
            rest = 1.0 - square * r * r
            r += r * rest * (0.5 + 0.375 * rest)
            r2 = r * r
            w = r * r2 * (three + r * (four + five * r))
            weight[s] = w
        else:
            w = weight[s]
        a1 += w * tile[4, s]
        a2 += w * tile[5, s]
        a3 += w * tile[6, s]
        a4 += w * tile[7, s]
        a5 += w * tile[8, s]
        a6 += w * tile[9, s]
    out[t, 1] += a1
    out[t, 2] += a2
    out[t, 3] += a3
    out[t, 4] += a4
    out[t, 5] += a5
    out[t, 6] += a6
    if all_charges:
        for s in range(m):
            a0 += weight[s] * tile[3, s]
            a7 += weight[s] * tile[10, s]
        out[t, 0] += a0
        out[t, 7] += a7


@inlined
def _weights(px, py, pz, tile, m, a, b, kappa, roots, weight):
    """Weights of ``m`` sources of a tile for a target; with ``roots`` (a = 2.5, b = 5) from square roots."""
    for s in range(m):
        dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
        weight[s] = dx * dx + dy * dy + dz * dz
    for s in range(m):
        if roots:
            r = 1.0 / math.sqrt(weight[s])
            half = r * r * math.sqrt(r)
            weight[s] = half * (1.0 + kappa * half)
        else:
            log_r = 0.5 * log(weight[s])
            weight[s] = exp(-a * log_r) + kappa * exp(-b * log_r)
