"""Shape and soundness of hexahedra, one pass over a block, in single precision; a second look for the doubtful ones.

Edges are differences in double precision, rounded once; everything else is relative to the edges of the cell itself, so
that the figures of cells without nearly flat corners are right to some 1e-6 wherever they lie. Cells that are nearly
flat, collapsed, of extreme size or not proved positive inside are left open for :mod:`.measures` and
:mod:`.positivity`, which work in double precision.

**Proof.** The Jacobian J of a trilinear hexahedron is quadratic along each index. Along a, with u, v, w the edges along
a, b, c, its second difference is 2 det(u, T_ab, T_ac), where T_ab is the difference of two opposite edges of a face
(its twist). The middle Bernstein coefficient of the three along a is therefore the mean of the outer ones less half of
it, and, as means of products are bounded by products of the largest lengths, every coefficient is at least

    min over corners of J - (|u| |T_ab| |T_ac| + |v| |T_ab| |T_bc| + |w| |T_ac| |T_bc|) / 2

with the largest length of each kind. Where this is positive J is positive everywhere.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from ..jit import inlined, single_kernel

# Nodes of a window of a plane, flat along j and k: its rows together stay in the second-level cache.
_N = 768
_WIDTH = 128
# Rows of a grid: edges along i from the last plane to this one, along j and k in both planes; each x, y, z, 1 / length.
_ROWS = 20
SKEW, SCALED, RATIO, CHANGE, SKEW_BEFORE, SCALED_BEFORE = 0, 1, 2, 3, 4, 5
# Rows of results: smallest scaled corner, smallest corner Jacobian, f_skew, volume; for every line of the cell both
# corner Jacobians, and scaled.
_KINDS = 20


def _rows(count: int) -> np.uint64:
    # Unsigned: an index that might be negative would keep loops scalar.
    return np.uint64(count * _N)


_1, _2, _3, _4, _5, _6, _7, _8, _12 = (_rows(n) for n in (*range(1, 9), 12))
_NEXT = np.uint64(1)
_ONE, _ZERO, _HALF, _EIGHT, _TWENTY = (np.float32(v) for v in (1.0, 0.0, 0.5, 8.0, 20.0))
# Corners flatter than this, in terms of sin of the angle, have a second look; so do those that cannot be.
_FLAT, _IMPOSSIBLE = np.float32(0.01), np.float32(1.001)
_TINY, _SPREAD = np.float32(1e-33), np.float32(1e-6)
# Rounding of a twist relative to the edges; of corners and products relative to the smallest corner.
_ROUNDING, _MARGIN = np.float32(2e-7), np.float32(0.999)
_THIRD, _GUESS = np.float32(1 / 3), np.float32(1419967116.0)
_A1, _A2, _A3, _A4, _A5 = (np.float32(v) for v in (1 / 3, 2 / 9, 14 / 81, 35 / 243, 91 / 729))
_MEAN, _EIGHTH, _HUGE = np.float32(2 / 3 / 64), np.float32(1 / 8), np.float32(1e38)


@intrinsic
def _bits(typing_context, value):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.IntType(32))

    return types.int32(types.float32), generate


@intrinsic
def _from_bits(typing_context, value):
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.bitcast(arguments[0], ir.FloatType())

    return types.float32(types.int32), generate


@single_kernel
def inspect_hexahedra(before, x, compare, both, sign, scale, i0, i1, out, is_open, sums, counts):
    """Figures of the cells i0 <= i < i1 of a block.

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
    is_open : (i1 - i0, cj, ck) bool, out: neither proved sound nor measured, look again
    sums : (2, 2) added to: sums of 1 / f_skew and of f_skew, of the cells that are not open, after and before
    counts : (2, 20) added to: these cells by f_skew, in equal bins of [0, 1]
    """
    points, e, t = (
        np.empty((2, 2, 3 * _N)),
        np.empty((2, _ROWS * _N), np.float32),
        np.empty((3, _KINDS * _N), np.float32),
    )
    cj, ck = x.shape[1] - 1, x.shape[2] - 1
    left = 1 if compare else 0
    for k0 in range(0, ck, _WIDTH):
        width = min(ck - k0, _WIDTH) + 1
        height = _N // width
        for j0 in range(0, cj, height - 1):
            rows = min(cj - j0 + 1, height)
            cells = np.uint64((rows - 1) * width - 1)
            for i in range(i0, i1 + 1):
                for g in range(left + 1):
                    new, old = points[g, i & 1], points[g, 1 - (i & 1)]
                    _load(x if g == 0 else before, i, j0, k0, rows, width, new)
                    _edges(new, old, e[g], rows * width, width, np.float32(sign * scale), np.float32(scale))
                    if i > i0:
                        _corners(e[g], t[g], cells, np.uint64(width))
                        if both or g == 0:
                            _skewness(t[g], cells)
                if i > i0:
                    _judge(e[0], t[0], t[left], t[2], cells, np.uint64(width))
                    for g in range(left + 1 if both else 1):
                        _collect(t[g], t[2], i - 1 - i0, j0, k0, rows - 1, width, out, 4 * g, sums[g], counts[g])
                    _copy(t[2], i - 1 - i0, j0, k0, rows - 1, width, out, is_open)


@inlined
def _load(x, i, j0, k0, rows, width, points):
    for j in range(rows):
        for k in range(width):
            for d in range(3):
                points[j * width + d * _N + k] = x[i, j0 + j, k0 + k, d]


@inlined
def _edges(new, old, e, n, width, signed, scale):
    """Edges of the window in single precision; those of the last plane along j and k move to its rows."""
    for row in range(4, 20, 8):
        a = row * _N
        for m in range(4 * _N):
            e[a + m] = e[a + 4 * _N + m]
    for kind in range(3):
        # Along i from the last plane, along j and k within this one.
        one, shift, out, count, factor = new, 1, 16 * _N, n - 1, scale
        if kind == 0:
            one, shift, out, count, factor = old, 0, 0, n, signed
        elif kind == 1:
            shift, out, count = width, 8 * _N, n - width
        for m in range(count):
            to = m + shift
            dx = np.float32(new[to] - one[m]) * factor
            dy = np.float32(new[to + _N] - one[_N + m]) * factor
            dz = np.float32(new[to + 2 * _N] - one[2 * _N + m]) * factor
            e[out + m], e[out + _N + m], e[out + 2 * _N + m] = dx, dy, dz
            e[out + 3 * _N + m] = _ONE / math.sqrt(dx * dx + dy * dy + dz * dz)


@inlined
def _corners(e, t, cells, width):
    """Corner Jacobians, as they are and for edges of length one, the smallest of each and the volume of every cell."""
    for m in range(cells):
        t[m], t[m + _1], t[m + _2] = _ONE, _HUGE, _ZERO
    for line in range(4):
        a, b = np.uint64(line >> 1) * _4, np.uint64(line & 1) * width
        row = np.uint64(line) * _4 + _4
        for m in range(cells):
            u, v, w = b + m, _4 + a + m, _12 + a + b + m
            near, near_scaled = _corner(e, u, v, w)
            far, far_scaled = _corner(e, u + _NEXT, v + _NEXT, w)
            to = row + m
            t[to], t[to + _1], t[to + _2], t[to + _3] = near, far, near_scaled, far_scaled
        # In a loop of its own: for too many rows in one the compiler does not see that they are apart.
        for m in range(cells):
            to = row + m
            t[m] = min(t[m], min(t[to + _2], t[to + _3]))
            t[m + _1] = min(t[m + _1], min(t[to], t[to + _1]))
            t[m + _2] += t[to] + t[to + _1]
    # The Jacobian of the mean edges, and the mean of those of the corners, which is the volume and three times as far
    # from it on the other side as the first: only the squares of each local coordinate contribute to both.
    for m in range(cells):
        u, v, w = m, _4 + m, _12 + m
        ux, uy, uz = _sum(e, u, u + _NEXT, u + width, u + width + _NEXT)
        vx, vy, vz = _sum(e, v, v + _NEXT, v + _4, v + _4 + _NEXT)
        wx, wy, wz = _sum(e, w, w + width, w + _4, w + width + _4)
        t[m + _3] = _MEAN * _triple(ux, uy, uz, vx, vy, vz, wx, wy, wz) + _THIRD * _EIGHTH * t[m + _2]


@inlined
def _corner(e, u, v, w):
    """Jacobian of a corner, and the same for edges of length one; zero where that is no number below one."""
    ux, uy, uz = e[u], e[u + _1], e[u + _2]
    vx, vy, vz = e[v], e[v + _1], e[v + _2]
    wx, wy, wz = e[w], e[w + _1], e[w + _2]
    jacobian = _triple(ux, uy, uz, vx, vy, vz, wx, wy, wz)
    scaled = jacobian * e[u + _3] * e[v + _3] * e[w + _3]
    return jacobian, scaled if scaled < _IMPOSSIBLE else _ZERO


@inlined
def _term(scaled):
    """``scaled`` to the power -2/3: a third of the exponent and mantissa bits, then one step of sixth order."""
    s = max(scaled, _FLAT)
    r = _from_bits(np.int32(_GUESS - np.float32(_bits(s)) * _THIRD))
    d = _ONE - s * r * r * r
    r += r * d * (_A1 + d * (_A2 + d * (_A3 + d * (_A4 + d * _A5))))
    return r * r


@inlined
def _triple(ux, uy, uz, vx, vy, vz, wx, wy, wz):
    return wx * (uy * vz - uz * vy) + wy * (uz * vx - ux * vz) + wz * (ux * vy - uy * vx)


@inlined
def _sum(e, a, b, c, d):
    x = (e[a] + e[b]) + (e[c] + e[d])
    y = (e[a + _1] + e[b + _1]) + (e[c + _1] + e[d + _1])
    z = (e[a + _2] + e[b + _2]) + (e[c + _2] + e[d + _2])
    return x, y, z


@inlined
def _skewness(t, cells):
    """f_skew from the corners."""
    for m in range(cells):
        t[m + _2] = _ZERO
    for c in range(4):
        row = np.uint64(c) * _4 + _4
        for m in range(cells):
            t[m + _2] += _term(t[row + _2 + m]) + _term(t[row + _3 + m])
    for m in range(cells):
        t[m + _2] = min(_EIGHT / t[m + _2], _ONE)


@inlined
def _judge(e, new, old, t, cells, width):
    """Ratios to the undeformed cell; open is what is not proved sound: its smallest corner does not outweigh twists."""
    for m in range(cells):
        t[m] = _HUGE
    for c in range(4):
        row = np.uint64(c) * _4 + _4
        for m in range(cells):
            n = row + m
            t[m] = min(t[m], min(new[n] / old[n], new[n + _1] / old[n + _1]))
    # Lengths in a loop of their own: for too many rows in one the compiler does not see that they are apart.
    for m in range(cells):
        u0, v0 = m, _4 + m
        w0, w1 = v0 + _8, v0 + _8 + width
        t[m + _5] = _longest(e, u0, u0 + _NEXT, u0 + width, u0 + width + _NEXT)
        t[m + _6] = _longest(e, v0, v0 + _NEXT, v0 + _4, v0 + _4 + _NEXT)
        t[m + _7] = _longest(e, w0, w1, w0 + _4, w1 + _4)
    for m in range(cells):
        lu, lv, lw = t[_5 + m], t[_6 + m], t[_7 + m]
        u0, v0 = m, _4 + m
        u2, v2 = u0 + width, v0 + _4
        ab = math.sqrt(max(_square(e, u0, u2), _square(e, u0 + _NEXT, u2 + _NEXT))) + _ROUNDING * lu
        ac = math.sqrt(max(_square(e, u0, u0 + _NEXT), _square(e, u2, u2 + _NEXT))) + _ROUNDING * lu
        bc = math.sqrt(max(_square(e, v0, v0 + _NEXT), _square(e, v2, v2 + _NEXT))) + _ROUNDING * lv
        t[_8 + m] = _HALF * (ab * ac * lu + ab * bc * lv + ac * bc * lw)
    for m in range(cells):
        least, least_old = new[_1 + m], old[_1 + m]
        sound = (min(new[m], old[m]) > _FLAT) & (least * _MARGIN > t[_8 + m]) & (min(least, least_old) > _TINY)
        t[_1 + m] = new[_3 + m] / old[_3 + m]
        t[_2 + m] = _ZERO if sound & (least_old > _SPREAD * old[_3 + m]) else _ONE


@inlined
def _longest(e, a, b, c, d):
    """The largest of four lengths."""
    return _ONE / min(min(e[a + _3], e[b + _3]), min(e[c + _3], e[d + _3]))


@inlined
def _square(e, a, b):
    """Squared length of the difference of two edges."""
    dx, dy, dz = e[b] - e[a], e[b + _1] - e[a + _1], e[b + _2] - e[a + _2]
    return dx * dx + dy * dy + dz * dz


@inlined
def _collect(t, judged, i, j0, k0, rows, width, out, first, sums, counts):
    """f_skew and scaled Jacobian of the window's cells; the last node of every row begins none."""
    bins = np.zeros((4, 20), np.int32)
    for j in range(rows):
        at = j * width
        for k in range(width - 1):
            out[first, i, j0 + j, k0 + k] = t[2 * _N + at + k]
        for k in range(width - 1):
            out[first + 1, i, j0 + j, k0 + k] = t[at + k]
        inverse, total = 0.0, 0.0
        for k in range(width - 1):
            skew = t[2 * _N + at + k]
            if judged[2 * _N + at + k] == _ZERO:
                inverse += _ONE / skew
                total += skew
                bins[k & 3, min(np.int64(skew * _TWENTY), 19)] += 1
        sums[0] += inverse
        sums[1] += total
    for n in range(20):
        counts[n] += bins[0, n] + bins[1, n] + bins[2, n] + bins[3, n]


@inlined
def _copy(t, i, j0, k0, rows, width, out, is_open):
    """What is judged between the grids."""
    for j in range(rows):
        at = j * width
        for k in range(width - 1):
            out[2, i, j0 + j, k0 + k] = t[at + k]
        for k in range(width - 1):
            out[3, i, j0 + j, k0 + k] = t[_N + at + k]
        for k in range(width - 1):
            is_open[i, j0 + j, k0 + k] = t[2 * _N + at + k] > _ZERO
