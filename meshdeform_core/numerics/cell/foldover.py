"""The energy of a deformed grid that forbids foldover, its gradient and second derivatives, or their convex part.

At sample points of every cell (corners; in weak hexahedra also the middles of edges, faces and cell) A is the Jacobian
matrix of the map from the undeformed cell to the deformed one, D = det A, and

    f = |A|^2 / (3 chi^(2/3)) + (D^2 + 1) / (2 chi),    chi = (D + sqrt(eps^2 + D^2)) / 2

(Garanzha, Kaporin, Kudryavtseva, Protais, Ray, Sokolov: Foldover-free maps in 50 lines of code, ACM TOG 40(4), 2021,
eqs. 3 and 4 with lambda = 1). A cell in rigid motion has the minimum, 2, whatever its aspect ratio. With the
weight w of its cell (:mod:`meshdeform_core.repair.walls`), a sample has the energy

    share (w f + cubic p^3 / (1 + p / 4)) + elastic / 2 |A - A_reference|^2,    p = f - 2

where A_reference is that of the same cell in another grid. The cubic term makes the largest f count most, without
pressing first cells at walls flat where f is very large; the elastic one ties the grid to the reference.

Plane grids have :mod:`.foldover_plane`.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..jit import inlined, kernel


class Samples(NamedTuple):
    """Sample points of the reference cell.

    ``used`` (s,) number of nodes that the Jacobian matrix at each depends on, ``node`` (s, m) which ones, ``slope``
    (s, m, 3) derivatives of their shape functions. The corners come first.
    """

    used: np.ndarray
    node: np.ndarray
    slope: np.ndarray


class Unknowns(NamedTuple):
    """Of every node of a region: the ``number`` (n,) of its unknown or -1, its ``frame`` (n, d, d) with
    displacement = frame @ unknown, and whether that is the identity, ``plain`` (n,)."""

    number: np.ndarray
    frame: np.ndarray
    plain: np.ndarray


def cell_samples() -> Samples:
    """The 27 sample points of a hexahedron; node a of it is the corner (a >> 2, a >> 1 & 1, a & 1)."""
    corners = list(itertools.product((0.0, 1.0), repeat=3))
    points = corners + [p for p in itertools.product((0.0, 0.5, 1.0), repeat=3) if 0.5 in p]
    shape = len(points), len(corners)
    count, node, slope = np.zeros(shape[0], np.int64), np.zeros(shape, np.int64), np.zeros((*shape, 3))
    for s, point in enumerate(points):
        slopes = np.zeros((len(corners), 3))
        for a, corner in enumerate(corners):
            factor = [x if c else 1.0 - x for c, x in zip(corner, point, strict=True)]
            for axis in range(3):
                rest = np.prod([f for other, f in enumerate(factor) if other != axis])
                slopes[a, axis] = rest if corner[axis] else -rest
        used = np.flatnonzero(slopes.any(axis=1))
        count[s], node[s, : used.size], slope[s, : used.size] = used.size, used, slopes[used]
    return Samples(count, node, slope)


def samples_with_any(chosen: np.ndarray, samples: Samples) -> np.ndarray:
    """Sample points that depend on a ``chosen`` node (m, 8) of their cell: (m,) int64, bit s for sample point s."""
    mask = np.zeros(len(chosen), dtype=np.int64)
    for s, (used, node) in enumerate(zip(samples.used, samples.node, strict=True)):
        mask |= chosen[:, node[:used]].any(axis=1).astype(np.int64) << s
    return mask


@inlined
def _map(x, cell, start, own, count, node, slope, inverse, b, a):
    """Jacobian matrix ``a`` (3, 3) of the map at a sample point, and ``b`` (m, 3): a = sum of x_n b_n.

    ``cell`` (8,) are rows of ``x``, ``own`` (8,) those of ``start``.

    Returns its determinant.
    """
    e = a
    for d in range(3):
        for k in range(3):
            e[d, k] = 0.0
    for n in range(count):
        p = own[node[n]]
        for d in range(3):
            for k in range(3):
                e[d, k] += start[p, d] * slope[n, k]
    _invert(e, inverse)
    for n in range(count):
        for k in range(3):
            b[n, k] = slope[n, 0] * inverse[0, k] + slope[n, 1] * inverse[1, k] + slope[n, 2] * inverse[2, k]
    for d in range(3):
        for k in range(3):
            a[d, k] = 0.0
    for n in range(count):
        p = cell[node[n]]
        for d in range(3):
            for k in range(3):
                a[d, k] += x[p, d] * b[n, k]
    return (
        a[0, 0] * (a[1, 1] * a[2, 2] - a[1, 2] * a[2, 1])
        + a[0, 1] * (a[1, 2] * a[2, 0] - a[1, 0] * a[2, 2])
        + a[0, 2] * (a[1, 0] * a[2, 1] - a[1, 1] * a[2, 0])
    )


@inlined
def _invert(e, inverse):
    _cofactors(e, inverse)
    det = e[0, 0] * inverse[0, 0] + e[0, 1] * inverse[0, 1] + e[0, 2] * inverse[0, 2]
    for d in range(3):
        for k in range(d, 3):
            upper, lower = inverse[d, k], inverse[k, d]
            inverse[d, k], inverse[k, d] = lower / det, upper / det


@inlined
def _cofactors(a, k):
    """The derivative of the determinant."""
    for i in range(3):
        m, n = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            p, q = (j + 1) % 3, (j + 2) % 3
            k[i, j] = a[m, p] * a[n, q] - a[m, q] * a[n, p]


@inlined
def _square(a):
    total = 0.0
    for d in range(3):
        for k in range(3):
            total += a[d, k] * a[d, k]
    return total


@inlined
def growth(f):
    """p^3 / (1 + p / 4), p = f - 2, and its two derivatives."""
    p = f - 2.0
    q = 1.0 + 0.25 * p
    return p * p * p / q, p * p * (3.0 + 0.5 * p) / (q * q), p * (6.0 + p * (1.5 + 0.125 * p)) / (q * q * q)


@inlined
def _regular(det, eps):
    """chi and sqrt(eps^2 + D^2), without cancellation."""
    root = np.sqrt(eps * eps + det * det)
    return 0.5 * (det + root) if det > 0.0 else 0.5 * eps * eps / (root - det), root


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
    """Sum of the energy over the cells low <= c < high, smallest D, and largest f.

    Parameters
    ----------
    x, cells : (n, 3) deformed coordinates, (m, 8) their rows at the corners of cells
    start, own : (k, 3) undeformed coordinates, (m, 8) their rows
    mask : (m,) int64, bit s set where sample point s counts
    samples : see :class:`Samples`
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
            det = _map(x, cells[c], start, own[c], count[s], node[s], slope[s], inverse, b, a)
            chi, _ = _regular(det, eps)
            lowest = min(lowest, det)
            f = np.inf
            if chi > 0.0:
                f = _square(a) / 3.0 * chi ** (-2.0 / 3.0) + 0.5 * (det * det + 1.0) / chi
            highest = max(highest, f)
            one = share if s < 8 else share * weight[c, 1]
            total += one * (weight[c, 0] * f + cubic * growth(f)[0])
            if elastic > 0.0 and s < 8:
                _differ(x, reference, cells[c], count[s], node[s], b, a)
                total += 0.5 * elastic * _square(a)
    return total, lowest, highest


@inlined
def _coefficients(g, det, eps, weight, cubic, exact):
    """Derivatives of the energy of one sample, g = |A|^2, but for the elastic term: gradient u A + v K, Hessian
    w I + p A A^T + q (A K^T + K A^T) + r K K^T with the cofactors K, and v times the derivative of K.

    Without ``exact``, in the 2 x 2 matrix of second derivatives along A and D the entry of D is raised until it has no
    negative eigenvalue, and the derivative of K is to be left out.
    """
    chi, root = _regular(det, eps)
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
    unknowns : (number (n,), frame (n, 3, 3), plain (n,)) of every node: its unknown or -1, and how it follows it,
        ``d = frame @ u``, the identity where ``plain``
    rows : (first row, one past the last row, start (n_unknowns + 1,) of each row of blocks, columns of all of them)
    matrix : (n_blocks, 3, 3) in the sense of BSR, those of the given rows; gradient : (n_unknowns, 3), only these
        rows are written
    """
    count, node, slope = samples
    eps, share, cubic, elastic, exact = penalty
    inverse, b, a, k = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3)), np.empty((3, 3))
    difference, turn = np.zeros((3, 3)), np.empty(3)
    along, across, left, right = np.empty((8, 3)), np.empty((8, 3)), np.empty((8, 3)), np.empty((8, 3))
    force, block = np.empty((8, 3)), np.empty((8, 8, 3, 3))
    for c in which:
        force[...] = 0.0
        block[...] = 0.0
        for s in range(count.size):
            if not mask[c] >> s & 1:
                continue
            m = count[s]
            det = _map(x, cells[c], start, own[c], m, node[s], slope[s], inverse, b, a)
            _cofactors(a, k)
            one = share if s < 8 else share * weight[c, 1]
            stiff = elastic if s < 8 else 0.0
            u, v, w, p, q, r = _coefficients(_square(a), det, eps, one * weight[c, 0], one * cubic, exact)
            if stiff > 0.0:
                _differ(x, reference, cells[c], m, node[s], b, difference)
            for n in range(m):
                at = node[s, n]
                for d in range(3):
                    ab = a[d, 0] * b[n, 0] + a[d, 1] * b[n, 1] + a[d, 2] * b[n, 2]
                    kb = k[d, 0] * b[n, 0] + k[d, 1] * b[n, 1] + k[d, 2] * b[n, 2]
                    along[n, d], across[n, d] = ab, kb
                    left[n, d], right[n, d] = p * ab + q * kb, q * ab + r * kb
                    force[at, d] += u * ab + v * kb
                    if stiff > 0.0:
                        for e in range(3):
                            force[at, d] += stiff * difference[d, e] * b[n, e]
            for n in range(m):
                for o in range(n, m):
                    here = block[node[s, n], node[s, o]]
                    dot = (w + stiff) * (b[n, 0] * b[o, 0] + b[n, 1] * b[o, 1] + b[n, 2] * b[o, 2])
                    for d in range(3):
                        for e in range(3):
                            here[d, e] += left[n, d] * along[o, e] + right[n, d] * across[o, e]
                        here[d, d] += dot
                    if exact:
                        # The derivative of the cofactors: v times the matrix of a cross product.
                        x0 = v * (b[n, 1] * b[o, 2] - b[n, 2] * b[o, 1])
                        x1 = v * (b[n, 2] * b[o, 0] - b[n, 0] * b[o, 2])
                        x2 = v * (b[n, 0] * b[o, 1] - b[n, 1] * b[o, 0])
                        for d in range(3):
                            turn[d] = a[d, 0] * x0 + a[d, 1] * x1 + a[d, 2] * x2
                        here[0, 1] += turn[2]
                        here[1, 0] -= turn[2]
                        here[1, 2] += turn[0]
                        here[2, 1] -= turn[0]
                        here[2, 0] += turn[1]
                        here[0, 2] -= turn[1]
        _add_cell(cells[c], force, block, unknowns, rows, matrix, gradient)


@inlined
def _add_cell(cell, force, block, unknowns, rows, matrix, gradient):
    """Add the gradient ``force`` (8, 3) and the Hessian ``block`` (8, 8, 3, 3) of a cell to the rows that have its
    unknowns. The nodes of every sample point ascend, so that only the blocks above the diagonal are filled."""
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
def sound_samples(start, cells, samples, sign, tolerance):
    """Sample points at which undeformed cells are sound: (m,) int64, bit s for sample point s.

    The determinant there has the ``sign`` (m,) of the cell and is more than ``tolerance`` of the product of the edges.
    """
    count, node, slope = samples
    e = np.empty((3, 3))
    mask = np.zeros(len(cells), dtype=np.int64)
    for c in range(len(cells)):
        for s in range(count.size):
            for d in range(3):
                for k in range(3):
                    e[d, k] = 0.0
            for n in range(count[s]):
                p = cells[c, node[s, n]]
                for d in range(3):
                    for k in range(3):
                        e[d, k] += start[p, d] * slope[s, n, k]
            det = (
                e[0, 0] * (e[1, 1] * e[2, 2] - e[1, 2] * e[2, 1])
                + e[0, 1] * (e[1, 2] * e[2, 0] - e[1, 0] * e[2, 2])
                + e[0, 2] * (e[1, 0] * e[2, 1] - e[1, 1] * e[2, 0])
            )
            size = 1.0
            for k in range(3):
                size *= np.sqrt(e[0, k] * e[0, k] + e[1, k] * e[1, k] + e[2, k] * e[2, k])
            if sign[c] * det > tolerance * size:
                mask[c] |= 1 << s
    return mask


@kernel
def excess_of_cells(x, start, cells, mask, samples, healthy, norm, eps):
    """Of every cell (m,), the norm over its sample points of log(f / healthy) where that is positive."""
    count, node, slope = samples
    inverse, b, a = np.empty((3, 3)), np.empty((8, 3)), np.empty((3, 3))
    result = np.empty(len(cells))
    for c in range(len(cells)):
        total = 0.0
        for s in range(count.size):
            if mask[c] >> s & 1:
                det = _map(x, cells[c], start, cells[c], count[s], node[s], slope[s], inverse, b, a)
                chi, _ = _regular(det, eps)
                f = _square(a) / 3.0 * chi ** (-2.0 / 3.0) + 0.5 * (det * det + 1.0) / chi
                if f > healthy:
                    total += np.log(f / healthy) ** norm
        result[c] = total ** (1.0 / norm)
    return result


@kernel
def shortest_edges(start, cells, pairs):
    """The shortest edge (n,) at every node of ``start`` (n, d), of the ``pairs`` (p, 2) of nodes of ``cells`` (m, k);
    edges without length do not count."""
    result = np.full(len(start), np.inf)
    for c in range(len(cells)):
        for n in range(len(pairs)):
            p, q = cells[c, pairs[n, 0]], cells[c, pairs[n, 1]]
            square = 0.0
            for d in range(start.shape[1]):
                square += (start[p, d] - start[q, d]) ** 2
            if square > 0.0:
                result[p], result[q] = min(result[p], np.sqrt(square)), min(result[q], np.sqrt(square))
    return result
