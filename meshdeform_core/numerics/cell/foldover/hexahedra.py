"""The energy of hexahedra and its derivatives."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ...jit import inlined, kernel
from .jacobian import cofactors, distortion, growth, inner, mapping, regular


class Unknowns(NamedTuple):
    """The unknowns of a region's n nodes: ``number`` (n,), the unknown of each node or -1; ``frame`` (n, d, d), with
    displacement = frame @ unknown; ``plain`` (n,), whether the frame is the identity."""

    number: np.ndarray
    frame: np.ndarray
    plain: np.ndarray


@inlined
def _differ(x, reference, cell, count, node, b, e):
    """The Jacobian matrix ``e`` (3, 3) of the difference of two maps at a sample point."""
    for d in range(3):
        for k in range(3):
            e[d, k] = 0.0
    for n in range(count):
        p = cell[node[n]]
        for d in range(3):
            for k in range(3):
                e[d, k] += (x[p, d] - reference[p, d]) * b[n, k]


@kernel
def energy_of_cells(x, cells, start, own, mask, samples, weight, reference, penalty, low, high):
    """Sum of the energy over the cells low <= c < high, their smallest D and largest f.

    Parameters
    ----------
    x, cells : (n, 3) deformed coordinates; (m, 8) rows of ``x`` at the corners of the cells
    start, own : (k, 3) undeformed coordinates; (m, 8) rows of ``start`` at the corners of the cells
    mask : (m,) int64, bit s set where sample point s counts
    samples : see :class:`.samples.Samples`
    weight : (m, 2) w of the cells, and the share of their samples between corners
    reference : (n, 3) coordinates of the reference grid
    penalty : eps, share, cubic and elastic of the energy, whether second derivatives are exact; with eps = 0 the energy
        is infinite where D <= 0
    """
    count, node, slope = samples
    eps, share, cubic, elastic, _ = penalty
    inverse, b, a = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3))
    total, lowest, highest = 0.0, np.inf, 0.0
    for c in range(low, high):
        for s in range(count.size):
            if not mask[c] >> s & 1:
                continue
            det = mapping(x, cells[c], start, own[c], count[s], node[s], slope[s], inverse, b, a)
            chi, _ = regular(det, eps)
            lowest = min(lowest, det)
            f = np.inf
            if chi > 0.0:
                f = distortion(a, det, chi)
            highest = max(highest, f)
            one = share if s < 8 else share * weight[c, 1]
            total += one * (weight[c, 0] * f + cubic * growth(f)[0])
            if elastic > 0.0 and s < 8:
                _differ(x, reference, cells[c], count[s], node[s], b, a)
                total += 0.5 * elastic * inner(a, a)
    return total, lowest, highest


@inlined
def coefficients(g, det, eps, weight, cubic, exact):
    """Derivatives of the energy of one sample without its elastic term; g = |A|^2, K are the cofactors of A.

    The gradient is u A + v K, the Hessian w I + p A A^T + q (A K^T + K A^T) + r K K^T plus v times the derivative of K.
    Without ``exact`` the derivative of K is left out, and the entry of D in the 2 x 2 matrix of second derivatives
    along A and D is raised until no eigenvalue is negative.
    """
    chi, root = regular(det, eps)
    h = chi ** (-2.0 / 3.0)
    h1 = -2.0 / 3.0 * h / root
    h2 = 2.0 / 3.0 * h * (2.0 / 3.0 + det / root) / (root * root)
    whole = det * det + 1.0
    q1 = (2.0 * det - whole / root) / chi
    q2 = (2.0 - 2.0 * det / root + whole * det / (root * root * root)) / chi - q1 / root
    f = g * h / 3.0 + 0.5 * whole / chi
    u, v = 2.0 * h / 3.0, g * h1 / 3.0 + 0.5 * q1
    w, q, r = u, 2.0 * h1 / 3.0, g * h2 / 3.0 + 0.5 * q2
    if not exact:
        r = max(r, 2.0 / 3.0 * h1 * h1 / h * g)
    _, one, two = growth(f)
    one, two = weight + cubic * one, cubic * two
    return u * one, v * one, w * one, two * u * u, q * one + two * u * v, r * one + two * v * v


@kernel
def add_derivatives(
    x, cells, start, own, mask, samples, weight, reference, penalty, which, unknowns, rows, matrix, gradient
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
    count, node, slope = samples
    eps, share, cubic, elastic, exact = penalty
    inverse, b, a, k = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 3))
    difference = np.zeros((3, 3))
    along, across, left, right = np.empty((8, 3)), np.empty((8, 3)), np.empty((8, 3)), np.empty((8, 3))
    force, block = np.empty((8, 3)), np.empty((8, 8, 3, 3))
    for c in which:
        force[...] = 0.0
        block[...] = 0.0
        for s in range(count.size):
            if not mask[c] >> s & 1:
                continue
            m = count[s]
            det = mapping(x, cells[c], start, own[c], m, node[s], slope[s], inverse, b, a)
            cofactors(a, k)
            one = share if s < 8 else share * weight[c, 1]
            stiff = elastic if s < 8 else 0.0
            u, v, w, p, q, r = coefficients(inner(a, a), det, eps, one * weight[c, 0], one * cubic, exact)
            if stiff > 0.0:
                _differ(x, reference, cells[c], m, node[s], b, difference)
            for n in range(m):
                _multiply(a, b[n], along[n])
                _multiply(k, b[n], across[n])
                for d in range(3):
                    ab, kb = along[n, d], across[n, d]
                    left[n, d], right[n, d] = p * ab + q * kb, q * ab + r * kb
                    force[node[s, n], d] += u * ab + v * kb
                    if stiff > 0.0:
                        for e in range(3):
                            force[node[s, n], d] += stiff * difference[d, e] * b[n, e]
            for n in range(m):
                for o in range(n, m):
                    pair = n, o, node[s, n], node[s, o]
                    _add_pair(pair, w + stiff, v if exact else 0.0, a, b, left, right, along, across, block)
        _add_cell(cells[c], force, block, unknowns, rows, matrix, gradient)


@inlined
def _multiply(a, b, result):
    for d in range(3):
        result[d] = a[d, 0] * b[0] + a[d, 1] * b[1] + a[d, 2] * b[2]


@inlined
def _add_pair(pair, factor, v, a, b, left, right, along, across, block):
    """Add to ``block[i, j]`` the second derivatives of a sample with respect to its nodes n and o, the corners i and j.

    They are ``factor`` b_n . b_o I + left_n along_o^T + right_n across_o^T, and ``v`` times the derivative of the
    cofactors of ``a``, the matrix of the cross product with a (b_n x b_o). ``pair`` is n, o, i, j. Scalars instead of
    slices and loops save a fifth of the time of all second derivatives.
    """
    n, o, i, j = pair
    b0, b1, b2, c0, c1, c2 = b[n, 0], b[n, 1], b[n, 2], b[o, 0], b[o, 1], b[o, 2]
    dot = factor * (b0 * c0 + b1 * c1 + b2 * c2)
    x0, x1, x2 = v * (b1 * c2 - b2 * c1), v * (b2 * c0 - b0 * c2), v * (b0 * c1 - b1 * c0)
    t0 = a[0, 0] * x0 + a[0, 1] * x1 + a[0, 2] * x2
    t1 = a[1, 0] * x0 + a[1, 1] * x1 + a[1, 2] * x2
    t2 = a[2, 0] * x0 + a[2, 1] * x1 + a[2, 2] * x2
    l0, l1, l2, r0, r1, r2 = left[n, 0], left[n, 1], left[n, 2], right[n, 0], right[n, 1], right[n, 2]
    p0, p1, p2, q0, q1, q2 = along[o, 0], along[o, 1], along[o, 2], across[o, 0], across[o, 1], across[o, 2]
    block[i, j, 0, 0] += l0 * p0 + r0 * q0 + dot
    block[i, j, 0, 1] += l0 * p1 + r0 * q1 + t2
    block[i, j, 0, 2] += l0 * p2 + r0 * q2 - t1
    block[i, j, 1, 0] += l1 * p0 + r1 * q0 - t2
    block[i, j, 1, 1] += l1 * p1 + r1 * q1 + dot
    block[i, j, 1, 2] += l1 * p2 + r1 * q2 + t0
    block[i, j, 2, 0] += l2 * p0 + r2 * q0 + t1
    block[i, j, 2, 1] += l2 * p1 + r2 * q1 - t0
    block[i, j, 2, 2] += l2 * p2 + r2 * q2 + dot


@inlined
def _add_cell(cell, force, block, unknowns, rows, matrix, gradient):
    """Add the gradient ``force`` (8, 3) and the Hessian ``block`` (8, 8, 3, 3) of a cell to the rows of its unknowns.

    Only blocks on and above the diagonal are filled, as the nodes of every sample point ascend.
    """
    number, frame, plain = unknowns
    first, last, starts, columns = rows
    part, work = np.empty((3, 3)), np.empty((3, 3))
    for n in range(8):
        here = cell[n]
        row = number[here]
        if row < first or row >= last:
            continue
        for d in range(3):
            if plain[here]:
                gradient[row, d] += force[n, d]
            else:
                for e in range(3):
                    gradient[row, d] += frame[here, e, d] * force[n, e]
        for o in range(8):
            there = cell[o]
            if number[there] < 0:
                continue
            for d in range(3):
                for e in range(3):
                    part[d, e] = block[n, o, d, e] if n <= o else block[o, n, e, d]
            if not (plain[here] and plain[there]):
                _turn(frame[here], frame[there], part, work)
            at = _find(columns, starts[row], starts[row + 1], number[there]) - starts[first]
            for d in range(3):
                for e in range(3):
                    matrix[at, d, e] += part[d, e]


@inlined
def _turn(one, two, block, work):
    """``block = one^T block two``."""
    for d in range(3):
        for e in range(3):
            work[d, e] = one[0, d] * block[0, e] + one[1, d] * block[1, e] + one[2, d] * block[2, e]
    for d in range(3):
        for e in range(3):
            block[d, e] = work[d, 0] * two[0, e] + work[d, 1] * two[1, e] + work[d, 2] * two[2, e]


@inlined
def _find(columns, low, high, wanted):
    """Position of ``wanted`` in the ascending ``columns[low:high]``."""
    while high - low > 1:
        middle = (low + high) // 2
        if columns[middle] <= wanted:
            low = middle
        else:
            high = middle
    return low


@kernel
def excess_of_cells(x, cells, start, own, mask, samples, healthy, norm, eps):
    """``norm``-norm of max(0, log(f / healthy)) over the sample points of each cell (m,)."""
    count, node, slope = samples
    inverse, b, a = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3))
    result = np.empty(len(cells))
    for c in range(len(cells)):
        total = 0.0
        for s in range(count.size):
            if mask[c] >> s & 1:
                det = mapping(x, cells[c], start, own[c], count[s], node[s], slope[s], inverse, b, a)
                chi, _ = regular(det, eps)
                f = distortion(a, det, chi)
                if f > healthy:
                    total += np.log(f / healthy) ** norm
        result[c] = total ** (1.0 / norm)
    return result
