"""The energy of hexahedra and its derivatives."""

from __future__ import annotations

import numpy as np

from ...jit import inlined, kernel
from ...lanes import NARROW as WIDTH
from .assembly import Unknowns, add_element
from .corners import (
    BETWEEN,
    DEFORMED,
    ENERGY,
    GRIDS,
    HELD,
    HIGHEST,
    LOWEST,
    REFERENCE,
    SUMS,
    TERMS,
    UNDEFORMED,
    WEIGHT,
    add_corner_derivatives,
    add_corner_energy,
    add_energy_between,
    derivatives_between,
)
from .nodes import FORCE, PARTS, ROWS, add_to_pair, transpose, turn_to_node


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], UniTuple(f8, 5), "
    "i8, i8"
)
def energy_of_cells(x, cells, start, own, mask, slope, weight, reference, penalty, low, high):
    """Sum of the energy over the cells low <= c < high, their smallest D and largest f.

    Parameters
    ----------
    x, cells : (n, 3) deformed coordinates; (m, 8) rows of ``x`` at the corners of the cells
    start, own : (k, 3) undeformed coordinates; (m, 8) rows of ``start`` at the corners of the cells
    mask : (m,) int64, bit s set where sample point s counts
    slope : (27, 8, 3) see :func:`.samples.sample_slopes`
    weight : (m, 3) w of the cells, the share of their samples between corners, the factor of their elastic energy
    reference : (n, 3) coordinates of the reference grid
    penalty : eps, share, cubic and elastic of the energy, and the share of its indefinite second derivatives; with
        eps = 0 the energy is infinite where D <= 0
    """
    points, terms, sums = np.empty((GRIDS, 8, 3, WIDTH)), np.empty((TERMS, WIDTH)), np.empty((SUMS, WIDTH))
    eps, share, cubic, elastic, _ = penalty
    for lane in range(WIDTH):
        sums[ENERGY, lane], sums[LOWEST, lane], sums[HIGHEST, lane] = 0.0, np.inf, 0.0
    for first in range(low, high, WIDTH):
        some = 0
        for lane in range(WIDTH):
            c = min(first + lane, high - 1)
            _gather(x, cells[c], start, own[c], reference, points, lane)
            some |= _weigh(mask[c] if first + lane < high else 0, weight, c, terms, lane)
        for s in range(8):
            add_corner_energy(points, terms, sums, s, eps, share, cubic, elastic)
        for s in range(8, len(slope)):
            if some >> s & 1:
                add_energy_between(points, terms, slope, sums, s, eps, share, cubic)
    total, lowest, highest = 0.0, np.inf, 0.0
    for lane in range(WIDTH):
        total += sums[ENERGY, lane]
        lowest, highest = min(lowest, sums[LOWEST, lane]), max(highest, sums[HIGHEST, lane])
    return total, lowest, highest


@inlined
def _gather(x, cell, start, own, reference, points, lane):
    """The corners of a cell in three grids."""
    for n in range(8):
        for d in range(3):
            points[DEFORMED, n, d, lane] = x[cell[n], d]
            points[UNDEFORMED, n, d, lane] = start[own[n], d]
            points[REFERENCE, n, d, lane] = reference[cell[n], d]


@inlined
def _weigh(mask, weight, c, terms, lane):
    """Which sample points of a cell count, and its weights; returns the mask."""
    for s in range(27):
        terms[s, lane] = float(mask >> s & 1)
    terms[WEIGHT, lane], terms[BETWEEN, lane], terms[HELD, lane] = weight[c, 0], weight[c, 1], weight[c, 2]
    return mask


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[:, ::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], UniTuple(f8, 5), "
    "i8[::1], Unknowns, Tuple((i8, i8, i8[::1], i4[::1],)), f8[:, :, ::1], f8[:, ::1]",
    Unknowns,
)
def add_derivatives(
    x, cells, start, own, mask, slope, weight, reference, penalty, which, unknowns, rows, matrix, gradient
):
    """Add the derivatives of the energy of the cells ``which`` to rows of the gradient and of the Hessian.

    Parameters
    ----------
    which : (k,) cells that touch the rows
    unknowns : see :class:`Unknowns`
    rows : first row, one past the last row, start (n_unknowns + 1,) of each row of blocks, columns of all blocks
    matrix : (n_blocks, 3, 3), the blocks of these rows as in the BSR format
    gradient : (n_unknowns, 3), of which only these rows are written
    """
    points, terms, parts = np.empty((GRIDS, 8, 3, WIDTH)), np.empty((TERMS, WIDTH)), np.empty((PARTS, WIDTH))
    result, cell, work = np.empty((ROWS, WIDTH)), np.empty((WIDTH, ROWS)), np.empty((3, 3))
    eps, share, cubic, elastic, exact = penalty
    for first in range(0, len(which), WIDTH):
        used, some = min(WIDTH, len(which) - first), 0
        for lane in range(WIDTH):
            c = which[first + min(lane, used - 1)]
            _gather(x, cells[c], start, own[c], reference, points, lane)
            some |= _weigh(mask[c] if lane < used else 0, weight, c, terms, lane)
        result[...] = 0.0
        for s in range(8):
            add_corner_derivatives(points, terms, result, s, eps, share, cubic, elastic, exact)
        for s in range(8, len(slope)):
            if some >> s & 1:
                derivatives_between(points, terms, slope, parts, s, eps, share, cubic, exact)
                for n in range(8):
                    if _enters(slope, s, n):
                        turn_to_node(slope, parts, result, s, n)
                        for o in range(n, 8):
                            if _enters(slope, s, o):
                                add_to_pair(slope, parts, result, s, n, o)
        for row in range(0, ROWS, WIDTH):
            transpose(result, row, cell, ROWS)
        for lane in range(used):
            add_element(cells, which[first + lane], 8, 3, cell, lane, FORCE, work, unknowns, rows, matrix, gradient)


@inlined
def _enters(slope, s, n):
    """Whether the map at a sample point depends on a node."""
    return slope[s, n, 0] != 0.0 or slope[s, n, 1] != 0.0 or slope[s, n, 2] != 0.0
