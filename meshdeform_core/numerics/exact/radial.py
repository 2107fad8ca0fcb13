"""Exact sums and matrices of radial basis functions: every target with every centre."""

from __future__ import annotations

import numpy as np

from ...parallel import for_chunks
from ..arrays import FloatArray
from ..jit import fast_kernel
from .basis import apply_basis

_TILE = 256
_TARGETS = 64
_CHUNK = 1024


def radial_sums(kind: int, targets: FloatArray, centres: FloatArray, coefficients: FloatArray) -> FloatArray:
    """Sums (n, 3) of coefficient * phi(distance) over all centres (m, 3), eq. 11 without its polynomial.

    Targets (n, 3) and centres are in units of the support radius, coefficients (m, 3); ``kind`` is a number of
    :data:`.basis.BASES`.
    """
    packed = np.ascontiguousarray(np.concatenate([centres.T, coefficients.T]))
    sums = np.zeros((len(targets), 3))

    def work(lo: int, hi: int) -> None:
        radial_block(kind, targets[lo:hi], packed, packed.shape[1], sums[lo:hi])

    for_chunks(work, len(targets), _CHUNK)
    return sums


def radial_matrix(kind: int, targets: FloatArray, centres: FloatArray) -> FloatArray:
    """Basis values (n, m) between targets (n, 3) and centres (m, 3), in units of the support radius."""
    matrix = np.empty((len(targets), len(centres)))
    columns = np.ascontiguousarray(centres.T)

    def work(lo: int, hi: int) -> None:
        fill_rows(kind, targets[lo:hi], columns, matrix[lo:hi])

    for_chunks(work, len(targets), 64)
    return matrix


@fast_kernel("i8, f8[:, ::1], f8[:, ::1], i8, f8[:, ::1]")
def radial_block(kind, targets, packed, n, out):
    """Add to ``out`` (t, 3) the sums of coefficient * phi over ``n`` packed centres: x, y, z, coefficients in rows.

    ``packed`` is a whole array and not a slice: the loops need rows that are known to be contiguous.
    """
    value = np.empty(_TILE)
    for t0 in range(0, targets.shape[0], _TARGETS):
        for s0 in range(0, n, _TILE):
            s1 = min(s0 + _TILE, n)
            x, y, z = packed[0, s0:s1], packed[1, s0:s1], packed[2, s0:s1]
            c0, c1, c2 = packed[3, s0:s1], packed[4, s0:s1], packed[5, s0:s1]
            for t in range(t0, min(t0 + _TARGETS, targets.shape[0])):
                _squared_distances(targets[t, 0], targets[t, 1], targets[t, 2], x, y, z, value)
                apply_basis(kind, value, s1 - s0)
                a0 = a1 = a2 = 0.0
                for s in range(s1 - s0):
                    a0 += value[s] * c0[s]
                    a1 += value[s] * c1[s]
                    a2 += value[s] * c2[s]
                out[t, 0] += a0
                out[t, 1] += a1
                out[t, 2] += a2


@fast_kernel("i8, f8[:, ::1], f8[:, ::1], f8[:, ::1]")
def fill_rows(kind, targets, columns, out):
    """Basis values (n, m) between targets (n, 3) and centres given as columns (3, m), into ``out``."""
    x, y, z = columns[0], columns[1], columns[2]
    for t in range(targets.shape[0]):
        _squared_distances(targets[t, 0], targets[t, 1], targets[t, 2], x, y, z, out[t])
        apply_basis(kind, out[t], x.size)


@fast_kernel
def _squared_distances(px, py, pz, x, y, z, out):
    for s in range(x.size):
        dx, dy, dz = px - x[s], py - y[s], pz - z[s]
        out[s] = dx * dx + dy * dy + dz * dz
