"""Skeletons: a few sources of a cluster that represent all of them for distant targets.

They result from an interpolative decomposition (Cheng, Gimbutas, Martinsson & Rokhlin, SIAM J. Sci. Comput. 26, 2005)
of the basis values between the cluster's sources and proxy points around it: the charges of the other sources are
distributed among those of the skeleton. The proxy points lie on several spheres (Huang, Xing & Chow, H2Pack, ACM TOMS
47, 2020); one is not enough, as the functions are not harmonic. Skeletons of large clusters are chosen among those of
their children.
"""

from __future__ import annotations

import math

import numpy as np

from ...arrays import FloatArray
from ...exact.radial import fill_rows
from ...jit import fast_kernel
from ..tuned import SPHERES


def proxy_points(reach: float) -> FloatArray:
    """Proxy points (3, n) around a cluster of radius 1 whose skeleton is used from distance ``reach`` on."""
    return np.ascontiguousarray(np.concatenate([reach * r * _sphere(n) for r, n in SPHERES]).T)


def _sphere(n: int) -> FloatArray:
    """Points (n, 3) spread over the unit sphere (golden spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    angle = math.pi * (1 + math.sqrt(5)) * np.arange(n)
    side = np.sqrt(1 - z * z)
    return np.stack([side * np.cos(angle), side * np.sin(angle), z], axis=1)


@fast_kernel("i8, f8[:, ::1], f8[:, ::1], f8, i8[::1], f8[:, ::1]")
def decompose(kind, points, proxies, tolerance, order, share):
    """Choose a skeleton of ``points`` (n, 3) seen from ``proxies`` (3, m).

    Parameters
    ----------
    tolerance : largest error (root mean square over the proxies) of the effect of a unit charge
    order : (n,) int64, out: the points, those of the skeleton first
    share : (n, n), out: the part of the charge of the i-th other point that goes to the j-th skeleton point

    Returns
    -------
    Number of points in the skeleton.
    """
    n, m = points.shape[0], proxies.shape[1]
    values, norm = np.empty((n, m)), np.empty(n)
    fill_rows(kind, points, proxies, values)
    for i in range(n):
        order[i] = i
        norm[i] = _dot(values[i], values[i])
    # Coefficients of each row with respect to the orthonormal rows chosen so far.
    factor = np.zeros((n, n))
    limit = tolerance * tolerance * m
    rank = 0
    while rank < n:
        best = rank
        for i in range(rank + 1, n):
            if norm[order[i]] > norm[order[best]]:
                best = i
        if norm[order[best]] <= limit:
            break
        order[best], order[rank] = order[rank], order[best]
        if _choose(values, order, rank, factor, norm, limit):
            rank += 1
    _solve_shares(factor, order, rank, share)
    return rank


@fast_kernel
def _choose(values, order, rank, factor, norm, limit):
    """Normalise row ``rank`` and make later rows orthogonal to it; False if its square does not exceed ``limit``."""
    p = order[rank]
    row = values[p]
    # Orthogonalise again against the rows chosen before, as updates lose digits.
    for j in range(rank):
        s = _dot(row, values[order[j]])
        factor[p, j] += s
        _subtract(row, s, values[order[j]])
    square = _dot(row, row)
    if square <= limit:
        norm[p] = 0.0
        return False
    length = math.sqrt(square)
    factor[p, rank] = length
    for k in range(row.size):
        row[k] /= length
    for i in range(rank + 1, order.size):
        other = values[order[i]]
        s = _dot(other, row)
        factor[order[i], rank] = s
        _subtract(other, s, row)
        norm[order[i]] = _dot(other, other)
    return True


@fast_kernel
def _solve_shares(factor, order, rank, share):
    """Express the other rows by those of the skeleton: back substitution with its triangular factor."""
    for i in range(rank, order.size):
        for j in range(rank - 1, -1, -1):
            s = factor[order[i], j]
            for k in range(j + 1, rank):
                s -= share[i - rank, k] * factor[order[k], j]
            share[i - rank, j] = s / factor[order[j], j]


@fast_kernel
def _dot(a, b):
    s = 0.0
    for k in range(a.size):
        s += a[k] * b[k]
    return s


@fast_kernel
def _subtract(a, factor, b):
    for k in range(a.size):
        a[k] -= factor * b[k]
