"""Exact inverse-distance sums: every target with every source, at the speed of the machine's arithmetic.

The inner loop runs over sources in separate arrays, so that the compiler turns it into vector instructions; on AVX2
machines it is bound by the square root and the division, which leaves room for eight accumulated columns.
"""

from __future__ import annotations

import math

import numpy as np

from ...parallel import for_chunks
from ..arrays import FloatArray, Report
from ..jit import fast_kernel
from .elementary import exp, log

N_VALUES = 7
"""Values that one pass accumulates beside the weight; shorter sets are padded with zeros."""

_TILE = 128
_TARGETS = 64
_CHUNK = 2048


def weighted_sums(
    targets: FloatArray,
    sources: FloatArray,
    strength: FloatArray,
    weights: tuple[float, float, float],
    values: FloatArray,
    progress: Report | None = None,
) -> FloatArray:
    """Sums over all sources of w and w * value, with w = strength (r^-a + kappa r^-b) (Sen et al. eqs. 14-16).

    Parameters
    ----------
    targets : (n, 3) float64, none of them at a source
    sources : (m, 3) float64
    strength : (m,) float64
    weights : (a, b, kappa); a = 3, b = 5, Luke's choice, has a loop of its own
    values : (k, m) float64

    Returns
    -------
    sums : (n, 1 + k), the weight in column 0
    """
    a, b, kappa = (float(part) for part in weights)
    result = np.empty((len(targets), 1 + len(values)))
    for first in range(0, len(values), N_VALUES):
        some = values[first : first + N_VALUES]
        packed = np.zeros((4 + N_VALUES, len(sources)))
        packed[:3], packed[3], packed[4 : 4 + len(some)] = sources.T, strength, strength * some
        sums = np.zeros((len(targets), 1 + N_VALUES))

        def work(lo: int, hi: int, packed: FloatArray = packed, sums: FloatArray = sums) -> None:
            sum_block(targets[lo:hi], packed, packed.shape[1], a, b, kappa, sums[lo:hi])

        for_chunks(work, len(targets), _CHUNK, progress)
        result[:, 0] = sums[:, 0]
        result[:, 1 + first : 1 + first + len(some)] = sums[:, 1 : 1 + len(some)]
    return result


@fast_kernel
def sum_block(targets, packed, n, a, b, kappa, out):
    """Add to ``out`` the sums of charge * (r^-a + kappa r^-b) over ``n`` sources: x, y, z and eight charges in rows.

    ``packed`` is a whole array and not a slice: the loops need rows that are known to be contiguous.
    """
    luke = a == 3.0 and b == 5.0
    weight = np.empty(_TILE)
    # A tile of sources stays in the first-level cache while a block of targets passes over it.
    for t0 in range(0, targets.shape[0], _TARGETS):
        t1 = min(t0 + _TARGETS, targets.shape[0])
        for s0 in range(0, n, _TILE):
            s1 = min(s0 + _TILE, n)
            if luke:
                _add_luke(targets, t0, t1, packed, s0, s1, kappa, out)
            else:
                for t in range(t0, t1):
                    _weights(targets[t], packed, s0, s1, a, b, kappa, weight)
                    _add(packed, s0, s1, weight, out[t])


@fast_kernel
def _add_luke(targets, t0, t1, packed, s0, s1, kappa, out):
    """Some targets and one tile of sources, weights r^-3 + kappa r^-5: everything in one vector loop."""
    x, y, z = packed[0, s0:s1], packed[1, s0:s1], packed[2, s0:s1]
    q0, q1, q2, q3 = packed[3, s0:s1], packed[4, s0:s1], packed[5, s0:s1], packed[6, s0:s1]
    q4, q5, q6, q7 = packed[7, s0:s1], packed[8, s0:s1], packed[9, s0:s1], packed[10, s0:s1]
    for t in range(t0, t1):
        px, py, pz = targets[t, 0], targets[t, 1], targets[t, 2]
        a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = 0.0
        for s in range(s1 - s0):
            dx, dy, dz = px - x[s], py - y[s], pz - z[s]
            r = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            r2 = r * r
            w = r * r2 * (1.0 + kappa * r2)
            a0 += w * q0[s]
            a1 += w * q1[s]
            a2 += w * q2[s]
            a3 += w * q3[s]
            a4 += w * q4[s]
            a5 += w * q5[s]
            a6 += w * q6[s]
            a7 += w * q7[s]
        out[t, 0] += a0
        out[t, 1] += a1
        out[t, 2] += a2
        out[t, 3] += a3
        out[t, 4] += a4
        out[t, 5] += a5
        out[t, 6] += a6
        out[t, 7] += a7


@fast_kernel
def _weights(target, packed, s0, s1, a, b, kappa, weight):
    x, y, z = packed[0, s0:s1], packed[1, s0:s1], packed[2, s0:s1]
    px, py, pz = target
    if a == 2.5 and b == 5.0:
        # As in plane grids: square roots take a fraction of the time of logarithms and exponentials.
        for s in range(s1 - s0):
            dx, dy, dz = px - x[s], py - y[s], pz - z[s]
            r = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
            half = r * r * math.sqrt(r)
            weight[s] = half * (1.0 + kappa * half)
        return
    for s in range(s1 - s0):
        dx, dy, dz = px - x[s], py - y[s], pz - z[s]
        log_r = 0.5 * log(dx * dx + dy * dy + dz * dz)
        weight[s] = exp(-a * log_r) + kappa * exp(-b * log_r)


@fast_kernel
def _add(packed, s0, s1, weight, out):
    for k in range(8):
        charge = packed[3 + k, s0:s1]
        total = 0.0
        for s in range(s1 - s0):
            total += weight[s] * charge[s]
        out[k] += total
