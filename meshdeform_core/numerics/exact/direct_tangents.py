"""Derivatives of exact inverse-distance sums with respect to targets, sources, charges and kappa.

The sums are those of charge * (r^-a + kappa r^-b) at targets x over sources y; dx and dy are changes of x and y.
Charges and positions of sources have a row per component, so that the loops over sources are vectorised.
"""

from __future__ import annotations

import math

import numpy as np

from ..jit import fast_kernel, inlined
from .elementary import exp, log

_TILE = 128
# Rows of work arrays.
_WEIGHT, _FAR, _SLOPE = 0, 1, 2


@inlined
def _weights(px, py, pz, tile, m, a, b, kappa, work):
    """Fill ``work`` for ``m`` sources: w = r^-a + kappa r^-b, r^-b, and (dw/dr) / r."""
    for s in range(m):
        dx, dy, dz = px - tile[0, s], py - tile[1, s], pz - tile[2, s]
        work[_SLOPE, s] = dx * dx + dy * dy + dz * dz
    # Whole exponents need no logarithms, and roots in single precision are refined, as in :mod:`.direct`.
    if (a == 3.0 or a == 4.0) and b == 5.0:
        three, four = (1.0, 0.0) if a == 3.0 else (0.0, 1.0)
        unit = math.ldexp(1.0, -(math.frexp(work[_SLOPE, 0])[1] // 2))
        square_unit = unit * unit
        for s in range(m):
            scaled = square_unit * work[_SLOPE, s]
            r = np.float64(np.float32(1.0) / math.sqrt(np.float32(scaled)))
            rest = 1.0 - scaled * r * r
            r = unit * (r + r * rest * (0.5 + 0.375 * rest))
            square = r * r
            one, other = square * r * (three + four * r), square * square * r
            work[_WEIGHT, s], work[_FAR, s] = one + kappa * other, other
            work[_SLOPE, s] = -(a * one + b * kappa * other) * square
    else:
        for s in range(m):
            log_r = -0.5 * log(work[_SLOPE, s])
            one, other = exp(a * log_r), exp(b * log_r)
            work[_WEIGHT, s], work[_FAR, s] = one + kappa * other, other
            work[_SLOPE, s] = -(a * one + b * kappa * other) / work[_SLOPE, s]


@inlined
def _load(rows, first, m, tile):
    """Copy a tile of some rows; its indices are known not to be negative, which vectorisation requires."""
    for d in range(rows.shape[0]):
        for s in range(m):
            tile[d, s] = rows[d, first + s]


@fast_kernel
def add_tangents(x, dx, y, dy, charges, changes, a, b, kappa, d_kappa, sums, out):
    """Add to ``out`` (n, c) the change of the sums at targets.

    Parameters
    ----------
    x, dx : (n, 3) targets and their change
    y, dy : (3, m) sources and their change
    charges, changes : (c, m) of the sources
    d_kappa : change of kappa
    sums : (n, c) to which the sums themselves are added
    """
    # Arrays of a fixed size: the compiler sees that their rows do not alias.
    work, tile, moved = np.empty((3, _TILE)), np.empty((3, _TILE)), np.empty((3, _TILE))
    own, other = np.empty((charges.shape[0], _TILE)), np.empty((charges.shape[0], _TILE))
    for first in range(0, y.shape[1], _TILE):
        m = min(_TILE, y.shape[1] - first)
        _load(y, first, m, tile)
        _load(dy, first, m, moved)
        _load(charges, first, m, own)
        _load(changes, first, m, other)
        for t in range(x.shape[0]):
            px, py, pz, ex, ey, ez = x[t, 0], x[t, 1], x[t, 2], dx[t, 0], dx[t, 1], dx[t, 2]
            _weights(px, py, pz, tile, m, a, b, kappa, work)
            for s in range(m):
                along = (px - tile[0, s]) * (ex - moved[0, s]) + (py - tile[1, s]) * (ey - moved[1, s])
                along += (pz - tile[2, s]) * (ez - moved[2, s])
                work[_SLOPE, s] = work[_SLOPE, s] * along + d_kappa * work[_FAR, s]
            for c in range(charges.shape[0]):
                value = total = 0.0
                for s in range(m):
                    value += work[_WEIGHT, s] * own[c, s]
                    total += work[_SLOPE, s] * own[c, s] + work[_WEIGHT, s] * other[c, s]
                sums[t, c] += value
                out[t, c] += total


@fast_kernel
def add_gradients(x, y, charges, a, b, kappa, gradient, of_x, of_y, of_charges):
    """Transpose of :func:`add_tangents`: add gradients that follow from the ``gradient`` (n, c) of the sums.

    Adds to ``of_x``, ``of_y`` and ``of_charges``, shaped like x, y and charges; returns the gradient of kappa.
    """
    work, tile, along, gain = np.empty((3, _TILE)), np.empty((3, _TILE)), np.empty(_TILE), np.empty((3, _TILE))
    own, rest = np.empty((charges.shape[0], _TILE)), np.empty((charges.shape[0], _TILE))
    of_kappa = 0.0
    for first in range(0, y.shape[1], _TILE):
        m = min(_TILE, y.shape[1] - first)
        _load(y, first, m, tile)
        _load(charges, first, m, own)
        rest[:] = 0.0
        for s in range(m):
            gain[0, s] = gain[1, s] = gain[2, s] = 0.0
        for t in range(x.shape[0]):
            px, py, pz = x[t, 0], x[t, 1], x[t, 2]
            _weights(px, py, pz, tile, m, a, b, kappa, work)
            for s in range(m):
                along[s] = 0.0
            for c in range(charges.shape[0]):
                g = gradient[t, c]
                for s in range(m):
                    along[s] += g * own[c, s]
                for s in range(m):
                    rest[c, s] += g * work[_WEIGHT, s]
            total0 = total1 = total2 = 0.0
            for s in range(m):
                of_kappa += along[s] * work[_FAR, s]
                part = along[s] * work[_SLOPE, s]
                g0, g1, g2 = part * (px - tile[0, s]), part * (py - tile[1, s]), part * (pz - tile[2, s])
                total0, total1, total2 = total0 + g0, total1 + g1, total2 + g2
                gain[0, s] -= g0
                gain[1, s] -= g1
                gain[2, s] -= g2
            of_x[t, 0] += total0
            of_x[t, 1] += total1
            of_x[t, 2] += total2
        for d in range(3):
            for s in range(m):
                of_y[d, first + s] += gain[d, s]
        for c in range(charges.shape[0]):
            for s in range(m):
                of_charges[c, first + s] += rest[c, s]
    return of_kappa
