"""Shape of cells, and how it changes between neighbours along grid lines."""

import math

import numpy as np

from ..jit import inlined, kernel

ASPECT, GROWTH, NONORTHOGONALITY, SKEWNESS = 0, 1, 2, 3


@kernel
def measure_shape(x, resolved, worst, place, total, count, cells):
    """Extremes and sums of four measures over the cells of a block.

    Parameters
    ----------
    x : (ni, nj, nk, 3) nodes, at least two along every axis
    resolved : (3,) 1 along index axes with more than one cell; the other axes do not enter the ratios
    worst : (4,) in and out: largest aspect ratio, growth ratio, non-orthogonality (degrees), skewness
    place : (4, 3) in and out, the cell of each extreme; for measures between two cells, the first one
    total, count : (4,) in and out, for the means
    cells : (ni - 1, nj - 1, nk - 1, 4) in and out, largest value of every cell; not filled if it is empty
    """
    size, other = np.empty(3), np.empty(3)
    center, beyond, face, area = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    found, each = np.empty(4), cells.size > 0
    for i in range(x.shape[0] - 1):
        for j in range(x.shape[1] - 1):
            for k in range(x.shape[2] - 1):
                _cell(x, i, j, k, center, size)
                low, high = math.inf, 0.0
                for a in range(3):
                    if resolved[a]:
                        low, high = min(low, size[a]), max(high, size[a])
                found[0] = _ratio(high, low)
                _note(worst, place, total, count, 0, found[0], i, j, k)
                if each:
                    cells[i, j, k, 0] = found[0]
                for a in range(3):
                    n = (i + (a == 0), j + (a == 1), k + (a == 2))
                    if n[a] >= x.shape[a] - 1:
                        continue
                    _cell(x, n[0], n[1], n[2], beyond, other)
                    found[1] = _ratio(max(size[a], other[a]), min(size[a], other[a]))
                    _face(x, n, a, face, area)
                    found[2], found[3] = _across(center, beyond, face, area)
                    for m in range(1, 4):
                        _note(worst, place, total, count, m, found[m], i, j, k)
                        if each:
                            cells[i, j, k, m] = max(cells[i, j, k, m], found[m])
                            cells[n[0], n[1], n[2], m] = max(cells[n[0], n[1], n[2], m], found[m])


@inlined
def _note(worst, place, total, count, m, value, i, j, k):
    total[m] += value
    count[m] += 1
    if value > worst[m]:
        worst[m] = value
        place[m, 0], place[m, 1], place[m, 2] = i, j, k


@inlined
def _ratio(high, low):
    """Ratio of two lengths; 1, which counts for nothing, where the smaller one is collapsed."""
    return high / low if low > 0.0 and low < math.inf else 1.0


@inlined
def _cell(x, i, j, k, center, size):
    """Mean of the corners and mean edge length along every index axis."""
    for d in range(3):
        center[d], size[d] = 0.0, 0.0
    for a in range(2):
        for b in range(2):
            for d in range(3):
                center[d] += 0.25 * (x[i + a, j + b, k, d] + x[i + a, j + b, k + 1, d]) * 0.5
            size[0] += 0.25 * _length(x, i, j + a, k + b, i + 1, j + a, k + b)
            size[1] += 0.25 * _length(x, i + a, j, k + b, i + a, j + 1, k + b)
            size[2] += 0.25 * _length(x, i + a, j + b, k, i + a, j + b, k + 1)


@inlined
def _length(x, i, j, k, p, q, r):
    return math.sqrt((x[p, q, r, 0] - x[i, j, k, 0]) ** 2 + (x[p, q, r, 1] - x[i, j, k, 1]) ** 2
                     + (x[p, q, r, 2] - x[i, j, k, 2]) ** 2)  # fmt: skip


@inlined
def _face(x, n, a, center, area):
    """Centre and area vector of the face at the lower end of cell n along axis a."""
    b, c = (a + 1) % 3, (a + 2) % 3
    pb, pc = (b == 0, b == 1, b == 2), (c == 0, c == 1, c == 2)
    i, j, k = n[0], n[1], n[2]
    u, v = np.empty(3), np.empty(3)
    for d in range(3):
        p00, p10 = x[i, j, k, d], x[i + pb[0], j + pb[1], k + pb[2], d]
        p01 = x[i + pc[0], j + pc[1], k + pc[2], d]
        p11 = x[i + pb[0] + pc[0], j + pb[1] + pc[1], k + pb[2] + pc[2], d]
        center[d] = 0.25 * (p00 + p10 + p01 + p11)
        u[d], v[d] = p11 - p00, p01 - p10
    area[0], area[1], area[2] = u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]


@inlined
def _across(center, beyond, face, area):
    """Angle (degrees) between the line joining two cell centres and the normal of their common face; skewness there.

    Skewness: distance between the intersection of that line with the face and the centre of the face, relative to the
    length of the line.
    """
    dot, along, square, normal = 0.0, 0.0, 0.0, 0.0
    for d in range(3):
        step = beyond[d] - center[d]
        dot += step * area[d]
        along += (face[d] - center[d]) * area[d]
        square += step * step
        normal += area[d] * area[d]
    if dot == 0.0 or square == 0.0 or normal == 0.0:
        return 0.0, 0.0
    share, miss = along / dot, 0.0
    for d in range(3):
        miss += (face[d] - center[d] - share * (beyond[d] - center[d])) ** 2
    cosine = min(abs(dot) / math.sqrt(square * normal), 1.0)
    return math.degrees(math.acos(cosine)), math.sqrt(miss / square)
