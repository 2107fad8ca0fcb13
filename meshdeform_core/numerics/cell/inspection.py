"""Shape and validity of hexahedra: one pass over a block in single precision, which leaves doubtful cells undecided.

Edges are differences in double precision, rounded once; everything else is relative to the edges of the cell itself, so
that the measures of cells without nearly flat corners have relative errors of about 1e-6 at any distance from the
origin. Cells that are nearly flat, collapsed, of extreme size or not proved positive inside are left open for
:mod:`.measures` and :mod:`.positivity`, which work in double precision.

**Proof.** The Jacobian J of a trilinear hexahedron is quadratic along each index. Along a, with u, v, w the edges along
a, b, c, its second difference is 2 det(u, T_ab, T_ac), where T_ab is the difference of two opposite edges of a face
(its twist). The middle one of the three Bernstein coefficients along a is therefore the mean of the outer two minus
half this second difference. As means of products are bounded by products of the largest lengths, every coefficient is
at least

    min over corners of J - (|u| |T_ab| |T_ac| + |v| |T_ab| |T_bc| + |w| |T_ac| |T_bc|) / 2

with the largest length of each kind. Where this is positive, J is positive everywhere.

**Rounding.** The comparison is made in single precision, with quotients and roots that the processor estimates and
refines once (``arcp``, ``afn``), and is still a proof, because its margin exceeds the rounding errors. An edge is
rounded twice, by 6e-8 of its length each time, and a product of three edges errs by less than 1e-6 of the product of
their lengths. Corners where J is below 0.01 of that product (``_FLAT``) are never decided here: the smallest J errs by
less than 1e-4 of itself. Twists, differences of two edges, are raised by ``_ROUNDING`` of the longest edge; the rest
are relative errors below 1e-5 of the products, estimates included. Together this is a fifth of the margin by which the
smallest J must outweigh the twists (``_MARGIN``). Comparisons with not-a-number fail. Every other cell is left open and
decided in double precision. The measures that are only reported (f_skew, ratios) do not enter the verdict.
"""

from __future__ import annotations

import numpy as np

from ..jit import inlined, kernel
from ..lanes import WIDTH
from .formulas import (
    ALONG_I,
    ALONG_J,
    ALONG_K,
    BIN_ROW,
    BINS,
    CELLS,
    CHANGE,
    COUNTS,
    GRID,
    LONGEST,
    NODES,
    OPEN,
    PLANE,
    POINTS,
    RATIO,
    RESULTS,
    SCALED,
    SCALED_BEFORE,
    SKEW,
    SKEW_BEFORE,
    N,
    answer,
    collect,
    compare_cells,
    edges,
    measure,
    move,
    skewness,
)  # fmt: skip

__all__ = ["CHANGE", "RATIO", "SCALED", "SCALED_BEFORE", "SKEW", "SKEW_BEFORE", "inspect_hexahedra"]


@kernel(
    "f8[:, :, :, ::1], f8[:, :, :, ::1], b1, b1, f8, f8, i8, i8, f4[:, :, :, ::1], b1[:, :, ::1], f8[:, ::1], "
    "i8[:, ::1]",
)
def inspect_hexahedra(before, x, compare, both, sign, scale, i0, i1, out, is_open, sums, counts):
    """Measures of the cells i0 <= i < i1 of a block.

    Parameters
    ----------
    before, x : (ni, nj, nk, 3) nodes undeformed and deformed
    compare : whether ``before`` is another grid; otherwise RATIO and CHANGE are one
    both : whether SKEW and SCALED are wanted of ``before`` too, if it is another grid
    sign : handedness of the block
    scale : one over the size of a cell (1 / length); cells of 1e-10 to 1e10 times that size are judged at once
    out : (4 or with both 6, i1 - i0, cj, ck) float32, out: SKEW f_skew (see :mod:`.measures`), SCALED smallest scaled
        corner Jacobian, RATIO smallest corner Jacobian relative to the undeformed one, CHANGE volume relative to the
        undeformed one; SKEW_BEFORE, SCALED_BEFORE
    is_open : (i1 - i0, cj, ck) bool, out: cells neither proved sound nor measured, left to the double-precision pass
    sums : (2, 2), added to: sums of 1 / f_skew and of f_skew over the cells that are not open, after and before
    counts : (2, 20), added to: histogram of the f_skew of these cells, equal bins of [0, 1]
    """
    # One-dimensional arrays without views: numba counts references to views with atomic operations.
    points, e = np.zeros(4 * POINTS), np.ones(2 * GRID, np.float32)
    t, r = np.empty(2 * CELLS, np.float32), np.empty((RESULTS + 1) * N, np.float32)
    inside, total, bins = np.empty(N, np.float32), np.zeros(4 * WIDTH), np.zeros(2 * COUNTS, np.int32)
    single, signed = np.float32(scale), np.float32(sign * scale)
    cj, ck = x.shape[1] - 1, x.shape[2] - 1
    left = 1 if compare else 0
    step = -(-ck // -(-ck // LONGEST))
    for k0 in range(0, ck, step):
        width = min(ck - k0, step) + 1
        height = max(min(NODES // width, cj + 1), 2)
        for j0 in range(0, cj, height - 1):
            rows = min(cj - j0 + 1, height)
            _mark(inside, rows, width)
            for i in range(i0, i1 + 1):
                here, last = PLANE * N * (i & 1), PLANE * N * (1 - (i & 1))
                for g in range(left + 1):
                    new, old, to = (2 * g + (i & 1)) * POINTS, (2 * g + 1 - (i & 1)) * POINTS, g * GRID
                    _load(x if g == 0 else before, i, j0, k0, rows, width, points, new)
                    if i > i0:
                        _edges(points, old, new, e, to + ALONG_I * N, rows * width, signed)
                    _edges(points, new, new + 3 * width, e, to + ALONG_J * N + here, (rows - 1) * width, single)
                    _edges(points, new, new + 3, e, to + ALONG_K * N + here, rows * width - 1, single)
                if i > i0:
                    for m in range(0, (rows - 1) * width - 1, WIDTH):
                        if compare:
                            at = m + GRID
                            measure(e, at, at + last, at + here, width, t, CELLS)
                        compare_cells(e, m, m + last, m + here, width, t, 0, CELLS if compare else 0, r)
                        for g in range(left + 1 if both else 1):
                            skewness(t, g * CELLS)
                            collect(t, g * CELLS, r, m, 4 * g * N, inside, total, 2 * g * WIDTH, bins, g * COUNTS)
                    _copy(r, i - 1 - i0, j0, k0, rows - 1, width, out, is_open, 6 if both and compare else 4)
    _add_lanes(total, bins, sums, counts)


@inlined
def _add_lanes(total, bins, sums, counts):
    """Add the sums and histograms of all lanes."""
    for g in range(2):
        for n in range(WIDTH):
            sums[g, 0] += total[2 * g * WIDTH + n]
            sums[g, 1] += total[2 * g * WIDTH + WIDTH + n]
            for b in range(BINS):
                counts[g, b] += bins[g * COUNTS + n * BIN_ROW + b]


@inlined
def _mark(inside, rows, width):
    """Set ``inside`` to one at nodes of a window that are the low corner of a cell: all but the last of every row."""
    for m in range(N):
        inside[m] = 0.0
    for j in range(rows - 1):
        for k in range(width - 1):
            inside[j * width + k] = 1.0


@inlined
def _load(x, i, j0, k0, rows, width, points, to):
    for j in range(rows):
        start = ((i * x.shape[1] + j0 + j) * x.shape[2] + k0) * 3
        for n in range(0, 3 * width, WIDTH):
            move(x, start + n, points, to + 3 * j * width + n, 3 * width - n)


@inlined
def _edges(points, one, other, e, to, count, scale):
    """Edges between the points from the numbers ``one`` and ``other`` on."""
    for m in range(0, count, WIDTH):
        edges(points, one + 3 * m, other + 3 * m, e, to + m, scale)


@inlined
def _copy(r, i, j0, k0, rows, width, out, is_open, kinds):
    """Results of a window's cells."""
    for j in range(rows):
        at, start = j * width, (i * out.shape[2] + j0 + j) * out.shape[3] + k0
        for k in range(0, width - 1, WIDTH):
            for kind in range(kinds):
                to = kind * out.shape[1] * out.shape[2] * out.shape[3] + start + k
                move(r, kind * N + at + k, out, to, width - 1 - k)
            answer(r, OPEN * N + at + k, is_open, start + k, width - 1 - k)
