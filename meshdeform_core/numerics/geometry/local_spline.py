"""Local interpolation of scattered data: a thin plate spline through the nearest points of each target.

The spline r^2 ln r with a linear polynomial (Duchon 1977) passes through the data and reproduces linear functions.
Directions in which the neighbours do not extend, such as the normal of a flat surface, have no linear term.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import BoolArray, FloatArray, IntArray

_FLAT = 1e-6
_NEIGHBOURS = 16
"""Number of points that determine a spline."""
_SEARCHED = 4
"""This many times the number of points of a spline are searched to find both sides of a thin body."""
_FEWEST = 6
"""Smallest number of points for each side."""
_OPPOSITE = -0.5
"""Largest cosine between the normals of opposite sides of a thin body."""
_STRETCH, _VARIATION = 1.5, 0.1
"""The sides move differently if values differ between them by more than the first factor times the slope along the
sides times the distance, plus the second factor times the variation along the sides."""
_CHUNK = 4096


def local_spline(
    points: FloatArray, values: FloatArray, targets: FloatArray, normals: tuple[FloatArray, FloatArray] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Values (k, c) at ``targets`` (k, 3) from those (n, c) at distinct ``points`` (n, 3), and the distance (k,) to the
    nearest point.

    With ``normals`` of the surface at the points (n, 3) and at the targets (k, 3): if the nearest points include some
    on the opposite side of a thin body, and that side moves differently, only those on the target's own side are used.
    """
    count = min(_NEIGHBOURS, len(points))
    distance, near = scipy.spatial.cKDTree(points).query(targets, k=count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    if normals is not None:
        near = _of_own_side(points, values, targets, near, normals)
    result = np.empty((len(targets), values.shape[1]))
    for first in range(0, len(targets), _CHUNK):
        rows = slice(first, first + _CHUNK)
        result[rows] = _splines(points[near[rows]], values[near[rows]], targets[rows])
    # Targets at data points take their values exactly, without the round-off of the solution.
    same = distance[:, 0] == 0.0
    result[same] = values[near[same, 0]]
    return result, distance[:, 0]


def _of_own_side(
    points: FloatArray, values: FloatArray, targets: FloatArray, near: IntArray, normals: tuple[FloatArray, FloatArray]
) -> IntArray:
    """``near`` (k, m), restricted to the target's own side where the opposite side moves differently."""
    sides, facing = normals
    mixed = np.flatnonzero((np.einsum("kmd,kd->km", sides[near], facing) < _OPPOSITE).any(axis=1))
    if not mixed.size:
        return near
    count = near.shape[1]
    _, wide = scipy.spatial.cKDTree(points).query(targets[mixed], k=min(_SEARCHED * count, len(points)))
    cosine = np.einsum("kmd,kd->km", sides[wide], facing[mixed])
    own, other = _first(wide, cosine > 0.0, count), _first(wide, cosine < _OPPOSITE, count)
    enough = np.minimum((cosine > 0.0).sum(axis=1), (cosine < _OPPOSITE).sum(axis=1)) >= min(_FEWEST, count)
    apart = np.empty(len(own), dtype=bool)
    for first in range(0, len(own), _CHUNK):
        rows = slice(first, first + _CHUNK)
        # Whether values differ more between the two sides than along each side.
        slope, spread = 0.0, 0.0
        for side in (own[rows], other[rows]):
            distance, change = _between(points, side, side), _between(values, side, side)
            steepness = np.divide(change, distance, out=np.zeros_like(change), where=distance > 0)
            slope = np.maximum(slope, steepness.max(axis=(1, 2), keepdims=True))
            spread = np.maximum(spread, change.max(axis=(1, 2), keepdims=True))
        allowed = _STRETCH * slope * _between(points, own[rows], other[rows]) + _VARIATION * spread
        apart[rows] = (_between(values, own[rows], other[rows]) > allowed).any(axis=(1, 2))
    arm = np.linalg.norm(points[own] - targets[mixed, None], axis=2)
    within = arm[:, 0] <= np.linalg.norm(points[own[:, min(4, count - 1)]] - points[own[:, 0]], axis=1)
    chosen = enough & apart & within
    result = near.copy()
    result[mixed[chosen]] = own[chosen]
    return result


def _between(values: FloatArray, one: IntArray, other: IntArray) -> FloatArray:
    """Distances (k, m, m) between the rows ``one`` (k, m) and ``other`` (k, m) of ``values``."""
    return np.asarray(np.linalg.norm(values[one][:, :, None] - values[other][:, None], axis=3))


def _first(near: IntArray, wanted: BoolArray, count: int) -> IntArray:
    """The first ``count`` of the wanted points in every row; the nearest is repeated where there are fewer."""
    order = np.argsort(~wanted, axis=1, kind="stable")[:, :count]
    chosen = np.take_along_axis(near, order, axis=1)
    return np.where(np.take_along_axis(wanted, order, axis=1), chosen, chosen[:, :1])


def _splines(points: FloatArray, values: FloatArray, targets: FloatArray) -> FloatArray:
    """One spline per target through its own ``points`` (k, m, 3) with ``values`` (k, m, c)."""
    middle = points.mean(axis=1, keepdims=True)
    size = np.linalg.norm(points - middle, axis=2).max(axis=1)[:, None, None]
    size = np.where(size > 0, size, 1.0)
    arm, target = (points - middle) / size, (targets[:, None] - middle) / size
    _, spread, axes = np.linalg.svd(arm, full_matrices=False)
    spread = np.pad(spread, ((0, 0), (0, 3 - spread.shape[1])))
    axes = np.pad(axes, ((0, 0), (0, 3 - axes.shape[1]), (0, 0)))
    kept = spread > _FLAT * spread[:, :1]
    terms = _terms(arm, axes, kept)
    count, q = terms.shape[1:]
    system = np.zeros((len(points), count + q, count + q))
    system[:, :count, :count] = _thin_plate(arm, arm)
    system[:, :count, count:] = terms
    system[:, count:, :count] = terms.transpose(0, 2, 1)
    # Omitted terms have the coefficient 0.
    left_out = np.pad(~kept, ((0, 0), (1, 0)))
    system[:, count + np.arange(q), count + np.arange(q)] = left_out
    right = np.pad(values, ((0, 0), (0, q), (0, 0)))
    try:
        coefficients = np.asarray(np.linalg.solve(system, right), dtype=np.float64)
        # By least squares where the neighbours do not determine all terms.
        residual = np.abs(system @ coefficients - right).max(axis=(1, 2))
        poor = ~(residual <= 1e-9 * np.abs(right).max(axis=(1, 2)))
        if poor.any():
            coefficients[poor] = np.linalg.pinv(system[poor], rcond=1e-12) @ right[poor]
    except np.linalg.LinAlgError:
        coefficients = np.linalg.pinv(system) @ right
    basis = np.concatenate([_thin_plate(target, arm), _terms(target, axes, kept)], axis=2)
    return (basis @ coefficients)[:, 0]


def _terms(arm: FloatArray, axes: FloatArray, kept: BoolArray) -> FloatArray:
    """The linear polynomial (k, m, 4) in the principal directions, zero for omitted directions."""
    linear = (arm @ axes.transpose(0, 2, 1)) * kept[:, None, :]
    return np.concatenate([np.ones((*arm.shape[:2], 1)), linear], axis=2)


def _thin_plate(a: FloatArray, b: FloatArray) -> FloatArray:
    r2 = ((a[:, :, None] - b[:, None]) ** 2).sum(axis=3)
    return 0.5 * r2 * np.log(np.where(r2 > 0, r2, 1.0))
