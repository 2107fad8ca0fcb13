"""Local interpolation of scattered data: a thin plate spline through the nearest points of each target.

The spline r^2 ln r with a linear polynomial (Duchon 1977) passes through the data and reproduces linear functions.
Directions in which the neighbours do not spread, such as the normal of a flat surface, have no linear term.
"""

from __future__ import annotations

import numpy as np
import scipy

from ..arrays import BoolArray, FloatArray

_FLAT = 1e-6
_CHUNK = 4096


def local_spline(
    points: FloatArray, values: FloatArray, targets: FloatArray, neighbours: int = 16
) -> tuple[FloatArray, FloatArray]:
    """Values at ``targets`` (k, 3) from those (n, c) at distinct ``points`` (n, 3).

    Returns
    -------
    interpolated : (k, c)
    distance : (k,) to the nearest point
    """
    count = min(neighbours, len(points))
    distance, near = scipy.spatial.cKDTree(points).query(targets, k=count)
    distance, near = distance.reshape(-1, count), near.reshape(-1, count)
    result = np.empty((len(targets), values.shape[1]))
    for first in range(0, len(targets), _CHUNK):
        rows = slice(first, first + _CHUNK)
        result[rows] = _splines(points[near[rows]], values[near[rows]], targets[rows])
    # Round-off of the solution must not move what the table gives exactly.
    same = distance[:, 0] == 0.0
    result[same] = values[near[same, 0]]
    return result, distance[:, 0]


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
    # A term that is left out has the coefficient 0.
    left_out = np.pad(~kept, ((0, 0), (1, 0)))
    system[:, count + np.arange(q), count + np.arange(q)] = left_out
    right = np.pad(values, ((0, 0), (0, q), (0, 0)))
    coefficients = _solved(system, right)
    basis = np.concatenate([_thin_plate(target, arm), _terms(target, axes, kept)], axis=2)
    return (basis @ coefficients)[:, 0]


def _terms(arm: FloatArray, axes: FloatArray, kept: BoolArray) -> FloatArray:
    """The linear polynomial (k, m, 4) in the principal directions, zero in those left out."""
    linear = (arm @ axes.transpose(0, 2, 1)) * kept[:, None, :]
    return np.concatenate([np.ones((*arm.shape[:2], 1)), linear], axis=2)


def _thin_plate(a: FloatArray, b: FloatArray) -> FloatArray:
    r2 = ((a[:, :, None] - b[:, None]) ** 2).sum(axis=3)
    return 0.5 * r2 * np.log(np.where(r2 > 0, r2, 1.0))


def _solved(system: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions of small systems; least squares where neighbours are so placed that a term is not determined."""
    try:
        solution: FloatArray = np.asarray(np.linalg.solve(system, right), dtype=np.float64)
    except np.linalg.LinAlgError:
        return np.linalg.pinv(system) @ right
    residual = np.abs(system @ solution - right).max(axis=(1, 2))
    poor = ~(residual <= 1e-9 * np.abs(right).max(axis=(1, 2)))
    if poor.any():
        solution[poor] = np.linalg.pinv(system[poor], rcond=1e-12) @ right[poor]
    return solution
