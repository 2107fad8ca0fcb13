"""Exact inverse-distance sums: every target with every source, at the speed of the machine's arithmetic.

The inner loop runs over sources in separate arrays, so that the compiler turns it into vector instructions; on AVX2
machines it is bound by the square root and the division, which leaves room for seven accumulated values.
"""

import math

import numpy as np

from .jit import fast_kernel
from .parallel import for_chunks

N_VALUES = 7
"""Values that one pass accumulates beside the weight; shorter sets are padded with zeros."""

_TILE = 128
_TARGETS = 64
_CHUNK = 2048


def weighted_sums(targets, sources, strength, exponents, values, progress=None):
    """Sums over all sources of w and w * value, with w = s1 r^-p1 + s2 r^-p2 (Sen et al. eqs. 14-16).

    Parameters
    ----------
    targets : (n, 3) float64, none of them at a source
    sources : (m, 3) float64
    strength : (2, m) float64, s1 and s2 of each source
    exponents : (p1, p2); (3, 5), Luke's choice, has a loop of its own
    values : (k, m) float64

    Returns
    -------
    sums : (n, 1 + k), the weight in column 0
    """
    packed = np.ascontiguousarray(np.concatenate([sources.T, strength]))
    result = np.empty((len(targets), 1 + len(values)))
    p1, p2 = (float(p) for p in exponents)
    for first in range(0, len(values), N_VALUES):
        part = np.zeros((N_VALUES, len(sources)))
        some = values[first : first + N_VALUES]
        part[: len(some)] = some
        sums = np.empty((len(targets), 1 + N_VALUES))

        def work(lo, hi, part=part, sums=sums):
            _sum_block(targets[lo:hi], packed, p1, p2, part, sums[lo:hi])

        for_chunks(work, len(targets), _CHUNK, progress)
        result[:, 0] = sums[:, 0]
        result[:, 1 + first : 1 + first + len(some)] = sums[:, 1 : 1 + len(some)]
    return result


@fast_kernel
def _sum_block(targets, packed, p1, p2, values, out):
    luke = p1 == 3.0 and p2 == 5.0
    weight = np.empty(_TILE)
    out[:] = 0.0
    m = packed.shape[1]
    # A tile of sources stays in the first-level cache while a block of targets passes over it.
    for t0 in range(0, targets.shape[0], _TARGETS):
        t1 = min(t0 + _TARGETS, targets.shape[0])
        for s0 in range(0, m, _TILE):
            s1 = min(s0 + _TILE, m)
            x, y, z = packed[0, s0:s1], packed[1, s0:s1], packed[2, s0:s1]
            c1, c2 = packed[3, s0:s1], packed[4, s0:s1]
            v0, v1, v2, v3 = values[0, s0:s1], values[1, s0:s1], values[2, s0:s1], values[3, s0:s1]
            v4, v5, v6 = values[4, s0:s1], values[5, s0:s1], values[6, s0:s1]
            for t in range(t0, t1):
                px, py, pz = targets[t, 0], targets[t, 1], targets[t, 2]
                if not luke:
                    _weights(px, py, pz, x, y, z, c1, c2, p1, p2, weight)
                a0 = a1 = a2 = a3 = a4 = a5 = a6 = a7 = 0.0
                if luke:
                    for s in range(s1 - s0):
                        dx, dy, dz = px - x[s], py - y[s], pz - z[s]
                        r = 1.0 / math.sqrt(dx * dx + dy * dy + dz * dz)
                        r2 = r * r
                        w = r * r2 * (c1[s] + c2[s] * r2)
                        a0 += w
                        a1 += w * v0[s]
                        a2 += w * v1[s]
                        a3 += w * v2[s]
                        a4 += w * v3[s]
                        a5 += w * v4[s]
                        a6 += w * v5[s]
                        a7 += w * v6[s]
                else:
                    for s in range(s1 - s0):
                        w = weight[s]
                        a0 += w
                        a1 += w * v0[s]
                        a2 += w * v1[s]
                        a3 += w * v2[s]
                        a4 += w * v3[s]
                        a5 += w * v4[s]
                        a6 += w * v5[s]
                        a7 += w * v6[s]
                out[t, 0] += a0
                out[t, 1] += a1
                out[t, 2] += a2
                out[t, 3] += a3
                out[t, 4] += a4
                out[t, 5] += a5
                out[t, 6] += a6
                out[t, 7] += a7


@fast_kernel
def _weights(px, py, pz, x, y, z, c1, c2, p1, p2, weight):
    for s in range(x.size):
        dx, dy, dz = px - x[s], py - y[s], pz - z[s]
        log_r = 0.5 * math.log(dx * dx + dy * dy + dz * dz)
        weight[s] = c1[s] * math.exp(-p1 * log_r) + c2[s] * math.exp(-p2 * log_r)
