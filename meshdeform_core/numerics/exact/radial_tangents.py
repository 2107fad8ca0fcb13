"""Derivatives of sums of radial basis functions with respect to the positions of targets and centres."""

from __future__ import annotations

import math

from ..jit import inlined, kernel


@inlined
def _slope(kind, r2):
    """phi'(r) / r of a basis function, see :data:`.basis.BASES`, at a squared distance above zero."""
    if kind == 0:
        return math.log(r2) + 1.0
    if r2 >= 1.0:
        return 0.0
    r = math.sqrt(r2)
    if kind == 1:
        return -2.0 * (1.0 - r) / r
    if kind == 2:
        return -20.0 * (1.0 - r) ** 3
    if kind == 3:
        return 220.0 / 3.0 + 20.0 * math.log(r2) - 120.0 * r + 60.0 * r2 - 40.0 / 3.0 * r * r2
    if kind == 4:
        return -60.0 - 90.0 * r * (1.0 + math.log(r2)) + 180.0 * r2 - 30.0 * r * r2
    return -40.0 + 240.0 * r + 120.0 * r2 * (math.log(r2) - 1.0) - 80.0 * r * r2


@kernel
def add_radial_tangents(kind, x, dx, y, dy, coefficients, out):
    """Add to ``out`` (n, 3) the change of the sums for changes ``dx`` (n, 3) of the targets and ``dy`` (m, 3) of the
    centres.

    ``x`` (n, 3) and ``y`` (m, 3) are in units of the support radius; ``coefficients`` (m, 3) are fixed.
    """
    for t in range(x.shape[0]):
        for j in range(y.shape[0]):
            r2 = along = 0.0
            for d in range(3):
                apart = x[t, d] - y[j, d]
                r2 += apart * apart
                along += apart * (dx[t, d] - dy[j, d])
            if r2 > 0.0:
                along *= _slope(kind, r2)
                for d in range(3):
                    out[t, d] += along * coefficients[j, d]


@kernel
def add_radial_gradients(kind, x, y, coefficients, gradient, of_x, of_y):
    """Transpose of :func:`add_radial_tangents`: add to ``of_x`` (n, 3) and ``of_y`` (m, 3) the gradients that follow
    from the ``gradient`` (n, 3) of the sums."""
    for t in range(x.shape[0]):
        for j in range(y.shape[0]):
            r2 = weight = 0.0
            for d in range(3):
                r2 += (x[t, d] - y[j, d]) ** 2
                weight += gradient[t, d] * coefficients[j, d]
            if r2 > 0.0:
                weight *= _slope(kind, r2)
                for d in range(3):
                    of_x[t, d] += weight * (x[t, d] - y[j, d])
                    of_y[j, d] -= weight * (x[t, d] - y[j, d])
