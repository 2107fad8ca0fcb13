"""Sums over cells of the foldover-free energy and of its derivatives, eight cells at a time, and where the derivatives
go: the rows of a block-sparse matrix."""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...arrays import IntArray
from ...jit import inlined, kernel, record
from ...lanes import NARROW as WIDTH
from ...lanes import add_four, transpose
from .elements import GRIDS
from .hexahedra import add_between, add_corner, add_corner_energy, add_energy_between
from .plane import add_plane_corner, add_plane_energy


@record("i8[::1], f8[:, :, ::1], b1[::1]")
class Unknowns(NamedTuple):
    """The unknowns of a region's n nodes: ``number`` (n,), the unknown of each node or -1; ``frame`` (n, d, d), with
    displacement = frame @ unknown; ``plain`` (n,), whether the frame is the identity."""

    number: np.ndarray
    frame: np.ndarray
    plain: np.ndarray


def places_of_pairs(unknowns: IntArray, starts: IntArray, columns: NDArray[np.int32]) -> NDArray[np.int32]:
    """Where a matrix in the BSR format has the blocks (m, p) of pairs of the ``unknowns`` (m, 2^d) of cells, on and
    above its diagonal; -1 for pairs with one that is -1. Pairs of nodes are in ascending order."""
    n, pairs = len(starts) - 1, list(itertools.combinations_with_replacement(range(unknowns.shape[1]), 2))
    blocks = np.repeat(np.arange(n) * n, np.diff(starts))
    blocks += columns
    places = np.empty((len(unknowns), len(pairs)), np.int32)
    for pair, ends in enumerate(pairs):
        low, high = (of(*unknowns[:, ends].T) for of in (np.minimum, np.maximum))
        places[:, pair] = np.where(low < 0, -1, np.searchsorted(blocks, low * n + high))
    return places


@kernel("f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], UniTuple(f8, 5), i8[::1]")
def energy_of_cells(x, nodes, start, mask, slope, weight, reference, penalty, which):
    """Sum of the energy over the cells ``which``, their smallest D and largest f.

    Parameters
    ----------
    x, start : (n, d) deformed and undeformed coordinates
    nodes : (m, 2^d) rows of them at the corners of the cells
    mask : (m,) int64, bit s set where sample point s counts
    slope : (s, 2^d, d) see :func:`.samples.sample_slopes`
    weight : (m, 3) w of the cells, the share of their samples between corners, the factor of their elastic energy
    reference : (n, d) coordinates of the reference grid
    penalty : eps, share, cubic and elastic of the energy, and the share of its indefinite second derivatives; with
        eps = 0 the energy is infinite where D <= 0
    which : (k,) numbers of cells
    """
    samples, corners, d = slope.shape
    points, terms, sums = np.empty((GRIDS, corners, d, WIDTH)), np.empty((samples + 2, WIDTH)), np.empty((3, WIDTH))
    eps, share, cubic, elastic, _ = penalty
    sums[0, :], sums[1, :], sums[2, :] = 0.0, np.inf, 0.0
    for first in range(0, len(which), WIDTH):
        cells = which[first : first + WIDTH]
        some = _gather(x, start, reference, nodes, mask, weight, cells, points, terms)
        for s in range(samples):
            if not some >> s & 1:
                continue
            if d == 2:
                add_plane_energy(points, terms, sums, s, eps, share, cubic, elastic)
            elif s < 8:
                add_corner_energy(points, terms, slope, sums, s, eps, share, cubic, elastic)
            else:
                add_energy_between(points, terms, slope, sums, s, eps, share, cubic, 0.0)
    return sums[0].sum(), sums[1].min(), sums[2].max()


@kernel(
    "f8[:, ::1], i8[:, ::1], f8[:, ::1], i8[::1], f8[:, :, ::1], f8[:, ::1], f8[:, ::1], UniTuple(f8, 5), "
    "i8[::1], i4[:, ::1], Unknowns, UniTuple(i8, 3), f8[:, :, ::1], f8[:, ::1]",
    Unknowns,
)
def add_derivatives(
    x, nodes, start, mask, slope, weight, reference, penalty, which, places, unknowns, rows, matrix, gradient
):
    """Add the derivatives of the energy of cells to rows of the gradient and of the Hessian.

    Parameters
    ----------
    x, ..., which : as of :func:`energy_of_cells`, with the cells that touch the rows
    places : of the blocks, see :func:`places_of_pairs`
    unknowns : see :class:`Unknowns`
    rows : first row, one past the last row, the number of the first block in them
    matrix : (n_blocks, d, d), the blocks of these rows as in the BSR format; those below the diagonal are left out
    gradient : (n_unknowns, d), of which only these rows are written
    """
    samples, corners, d = slope.shape
    points, terms, work = np.empty((GRIDS, corners, d, WIDTH)), np.empty((samples + 2, WIDTH)), np.empty((3, 3))
    # Second derivatives (d, d) for pairs of corners in ascending order, after them the first ones (corners, d).
    size = d * d * (corners * (corners + 1) // 2) + corners * d
    size += -size % WIDTH
    result, found = np.empty((size, WIDTH)), np.empty((WIDTH, size))
    eps, share, cubic, elastic, exact = penalty
    for first in range(0, len(which), WIDTH):
        cells = which[first : first + WIDTH]
        some = _gather(x, start, reference, nodes, mask, weight, cells, points, terms)
        result[...] = 0.0
        for s in range(samples):
            if not some >> s & 1:
                continue
            if d == 2:
                add_plane_corner(points, terms, result, s, eps, share, cubic, elastic, exact)
            elif s < 8:
                add_corner(points, terms, slope, result, s, eps, share, cubic, elastic, exact)
            else:
                add_between(points, terms, slope, result, s, eps, share, cubic, 0.0, exact)
        for row in range(0, size, WIDTH):
            transpose(result, found, row * WIDTH, row, size)
        for lane in range(len(cells)):
            # Of known size, loops are unrolled.
            if d == 2:
                _add_cell(nodes, places, cells[lane], 4, 2, found, lane, work, unknowns, rows, matrix, gradient)
            else:
                _add_cell(nodes, places, cells[lane], 8, 3, found, lane, work, unknowns, rows, matrix, gradient)


@inlined
def _gather(x, start, reference, nodes, mask, weight, cells, points, terms):
    """Fill ``points`` with the corners of up to eight ``cells`` in three grids, and the rows of ``terms``: the share of
    the energy at their sample points, 0 where these do not count, w, and the factor of the elastic energy.

    Lanes that are left have the last cell, without sample points. Returns which points count in any cell.
    """
    some, samples = 0, len(terms) - 2
    for lane in range(WIDTH):
        c = cells[min(lane, len(cells) - 1)]
        for n in range(points.shape[1]):
            for d in range(points.shape[2]):
                points[0, n, d, lane] = x[nodes[c, n], d]
                points[1, n, d, lane] = start[nodes[c, n], d]
                points[2, n, d, lane] = reference[nodes[c, n], d]
        counts = mask[c] if lane < len(cells) else 0
        for s in range(samples):
            terms[s, lane] = float(counts >> s & 1) * (1.0 if s < nodes.shape[1] else weight[c, 1])
        terms[samples, lane], terms[samples + 1, lane] = weight[c, 0], weight[c, 2]
        some |= counts
    return some


@inlined
def _add_cell(nodes, places, c, corners, d, found, lane, work, unknowns, rows, matrix, gradient):
    """Add the derivatives of a cell, row ``lane`` of ``found``, to the rows of its unknowns; see
    :func:`add_derivatives`.

    ``nodes[c]`` are its ``corners``, in ``d`` dimensions; ``work`` (3, 3) is room.
    """
    number, frame, plain = unknowns
    pair, force = 0, d * d * (corners * (corners + 1) // 2)
    for n in range(corners):
        here = nodes[c, n]
        row = number[here]
        if row >= rows[0] and row < rows[1]:
            for i in range(d):
                for k in range(d):
                    gradient[row, i] += frame[here, k, i] * found[lane, force + d * n + k]
        for o in range(n, corners):
            at, first, there = places[c, pair] - rows[2], d * d * pair, nodes[c, o]
            pair += 1
            if at < 0 or at >= len(matrix):
                continue
            if not (plain[here] and plain[there]):
                _turn(frame, here, there, d, found, lane, first, work)
            if row <= number[there]:
                _add_block(matrix, at, found, lane, first, d)
            # Two nodes with the same unknown have both blocks on the diagonal.
            if row > number[there] or (n != o and row == number[there]):
                for i in range(d):
                    for k in range(i):
                        one, two = first + d * i + k, first + d * k + i
                        found[lane, one], found[lane, two] = found[lane, two], found[lane, one]
                _add_block(matrix, at, found, lane, first, d)


@inlined
def _add_block(matrix, at, found, lane, first, d):
    for n in range(0, d * d - 3, 4):
        add_four(matrix, d * d * at + n, found, lane * found.shape[1] + first + n)
    if d == 3:
        matrix[at, 2, 2] += found[lane, first + 8]


@inlined
def _turn(frame, one, two, d, found, lane, first, work):
    """``B = F^T B G`` for the matrix B (d, d) of numbers of ``found`` and the frames F, G of nodes ``one``, ``two``."""
    for i in range(d):
        for k in range(d):
            work[i, k] = 0.0
            for e in range(d):
                work[i, k] += frame[one, e, i] * found[lane, first + d * e + k]
    for i in range(d):
        for k in range(d):
            total = 0.0
            for e in range(d):
                total += work[i, e] * frame[two, e, k]
            found[lane, first + d * i + k] = total
