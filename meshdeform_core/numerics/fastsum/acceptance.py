"""Which clusters of sources are far enough: functions of distance and the errors of interpolating them over boxes."""

import math
from typing import NamedTuple

import numpy as np

from ..basis import BASES
from ..jit import kernel


class Kernel(NamedTuple):
    """A function of distance: a radial basis function by its number, or r^-a + kappa r^-b for ``basis`` -1.

    Attributes
    ----------
    basis : see :data:`.basis.BASES`; distances are in units of the support radius
    compact : the basis function vanishes from distance 1 on
    """

    basis: int
    compact: bool
    a: float
    b: float
    kappa: float


def inverse_powers(a, b, kappa):
    """Kernel r^-a + kappa r^-b of inverse distance weighting."""
    return Kernel(-1, False, float(a), float(b), float(kappa))


def radial_basis(kind):
    """Kernel of a radial basis function by its number."""
    return Kernel(kind, kind != BASES["tps"], 0.0, 0.0, 0.0)


@kernel
def weight(distance2, function):
    """Weight of inverse distance weighting for a squared distance."""
    r = math.sqrt(distance2)
    return r**-function.a + function.kappa * r**-function.b


@kernel
def square(x, i):
    """Squared length of row ``i`` of (n, 3). Rows as views would count references, which takes longer than this."""
    return x[i, 0] ** 2 + x[i, 1] ** 2 + x[i, 2] ** 2


@kernel
def distance2(x, i, y, j):
    """Squared distance of two rows."""
    return (x[i, 0] - y[j, 0]) ** 2 + (x[i, 1] - y[j, 1]) ** 2 + (x[i, 2] - y[j, 2]) ** 2


@kernel
def error_on_box(boxes, b, tree, c, raw, function):
    """Error that a cluster of unit strength causes when it acts on the interpolation points of box ``b``.

    ``raw`` clusters act with their sources, others with their interpolation points. Infinite where they are too near,
    or where the rim of a compact function passes through.
    """
    distance = math.sqrt(distance2(boxes.center, b, tree.center, c))
    radius, extent = math.sqrt(square(boxes.half, b)), math.sqrt(square(tree.half, c))
    near = distance <= extent or (not raw and distance <= radius)
    if near or (function.compact and distance + radius + extent > 1.0):
        return np.inf
    error = _error(boxes.half, boxes.per_side, b, distance - extent, distance, function)
    if raw:
        return error
    return max(error, _error(tree.half, tree.per_side, c, distance, distance, function))


@kernel
def error_on_nodes(boxes, b, tree, c, raw, function):
    """Error that a cluster of unit strength causes when its interpolation points act on any nodes in box ``b``."""
    distance = math.sqrt(distance2(boxes.center, b, tree.center, c))
    radius, extent = math.sqrt(square(boxes.half, b)), math.sqrt(square(tree.half, c))
    if raw or distance <= radius or (function.compact and distance + radius + extent > 1.0):
        return np.inf
    return _error(tree.half, tree.per_side, c, distance - radius, distance - radius, function)


@kernel
def out_of_reach(boxes, b, tree, c, function):
    """Whether no node in box ``b`` is in the support of the cluster's sources."""
    if not function.compact:
        return False
    reach = 1.0 + math.sqrt(square(boxes.half, b)) + math.sqrt(square(tree.half, c))
    return distance2(boxes.center, b, tree.center, c) >= reach * reach


@kernel
def _error(half, count, b, gap, distance, function):
    """Error of interpolating the function over a box: its shape judged at ``gap``, its size at ``distance``."""
    if function.basis >= 0:
        return _radial_error(function.basis, half, count, b, gap)
    ratio = function.kappa * gap ** (function.a - function.b)
    steep = ratio / (1.0 + ratio)
    error = 0.0
    if steep < 0.99:
        error += (1.0 - steep) * _power_error(half, count, b, gap, function.a)
    if steep > 0.01:
        error += steep * _power_error(half, count, b, gap, function.b)
    return error * weight(distance * distance, function)


@kernel
def _longest(half, b):
    return max(half[b, 0], half[b, 1], half[b, 2])


@kernel
def _nearest_reach(half, b, distance):
    """Distance of a source from the sides of a box, plus its longest half width: a source off a corner is nearer."""
    return distance - (math.sqrt(square(half, b)) - _longest(half, b))


@kernel
def _power_error(half, count, b, distance, power):
    """Error of interpolating r^-power over a box, for a source at ``distance`` from its middle, relative to its value.

    Leading Taylor term beyond the interpolation order in each direction, times its growth towards the nearest side;
    calibrated against computed errors: 1 to 3 times too large, never too small by more than 2.
    """
    longest = _longest(half, b)
    reach = _nearest_reach(half, b, distance)
    if reach <= longest * 1.05:
        return np.inf
    total = 0.0
    for d in range(3):
        n, x = count[b, d], half[b, d] / reach
        term = 2.0 * (x * 0.5) ** n
        # Binomial coefficient (n + power - 1 choose n).
        for k in range(1, int(power)):
            term *= (n + k) / k
        total += term
    growth = 1.0 - longest / reach
    return total / growth**power


@kernel
def _radial_error(basis, half, count, b, distance):
    """Error of interpolating a radial basis function over a box inside its support, for a source at ``distance``.

    The function's singular part at the origin decides: r^2 log r, r or r^3 (numbers of :data:`.basis.BASES`). The
    remaining polynomial is exact from five points on.
    """
    longest = _longest(half, b)
    reach = _nearest_reach(half, b, distance)
    if reach <= longest * 1.05:
        return np.inf
    if basis == 0:
        power, factor = 2.0, 1.0
    elif basis == 1:
        power, factor = 1.0, 0.5
    elif basis == 2:
        power, factor = 3.0, 15.0
    elif basis == 3:
        power, factor = 2.0, 20.0
    else:
        power, factor = 3.0, 60.0
    growth = 1.0 / (1.0 - longest / reach)
    total = 0.0
    for d in range(3):
        n, x = count[b, d], half[b, d] / reach
        term = (x * 0.5) ** n * factor * growth ** max(n - power, 0.0)
        total += 4.0 * term / (n * (n - 1) * (n - 2)) if n > 2 and power == 2.0 else term
    return total * reach**power
