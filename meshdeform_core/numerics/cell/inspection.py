"""Shape and validity of hexahedra: one pass over a block in single precision, which leaves doubtful cells undecided.

Edges are differences in double precision, rounded once; everything else is relative to the edges of the cell itself, so
that the measures of cells without nearly flat corners have relative errors of about 1e-6 at any distance from the
origin. Cells that are nearly flat, collapsed, of extreme size or not proved positive inside are left open for
:mod:`.measures`, which works in double precision.

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

from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir
from numpy.typing import NDArray

from ..jit import inlined, kernel, record
from ..lanes import WIDTH, Array, Lanes, Mask, components, lanes

# Numbers in a row: the nodes of a window of a plane, flat along j and k, and room for vectors that extend beyond. The
# rows together stay in the second-level cache.
N = 1024
NODES, LONGEST = N - 2 * WIDTH, 160
# Rows of edges, each x, y, z, 1 / length: along i from one plane to the next, along j and k in both planes.
ALONG_I, ALONG_J, ALONG_K, PLANE, ROWS = 0, 4, 8, 8, 20
# Rows of results: measures, as many as OPEN says, and which cells are left open.
SKEW, SCALED, RATIO, CHANGE, OPEN, RESULTS = range(6)
# Vectors of measures of sixteen cells: eight corner Jacobians, these divided by the edge lengths, the smallest of each
# kind, volume, f_skew.
_JACOBIAN, _UNIT, _LEAST, _LEAST_UNIT, _VOLUME, _SKEW, _FIGURES = 0, 8, 16, 17, 18, 19, 20
BINS = 20
# Numbers stored for a plane of points, for the edges of a grid, and for the measures of sixteen cells.
POINTS, GRID, CELLS = 3 * N, (ROWS + 1) * N, _FIGURES * WIDTH
# Each lane of a vector has its own histogram, so that the increments do not depend on each other.
BIN_ROW = 32
COUNTS = BIN_ROW * WIDTH
# Scaled Jacobians below the first limit are decided in double precision; so are those above the second, which result
# only from overflow or not-a-number.
_FLAT, _IMPOSSIBLE = 0.01, 1.001
_TINY, _SPREAD = 1e-33, 1e-6
# Rounding of a twist relative to the edges; of corners and products relative to the smallest corner: see "Rounding"
# above.
_ROUNDING, _MARGIN = 3e-7, 0.999
# The power -1/3: a third of the exponent and mantissa bits, then one step of sixth order.
_GUESS, _SERIES = 1419967116.0, (1 / 3, 2 / 9, 14 / 81, 35 / 243, 91 / 729)


@lanes
def move(one: Array, at: ir.Value, other: Array, to: ir.Value, count: ir.Value) -> None:
    """Copy at most sixteen numbers."""
    other.store_some(to, one.load_some(at, count), count)


@lanes
def answer(numbers: Array, at: ir.Value, answers: Array, to: ir.Value, count: ir.Value) -> None:
    """Store which of at most sixteen numbers are positive."""
    zero = numbers.load(at) * 0.0
    answers.store_some(to, zero.below(numbers.load(at)), count)


@lanes
def edges(points: Array, one: ir.Value, other: ir.Value, e: Array, to: ir.Value, scale: Lanes) -> None:
    """Edges between sixteen pairs of points, scaled, and their inverse lengths."""
    apart = [(b - a).single() for a, b in zip(points.load_points(one), points.load_points(other), strict=True)]
    x, y, z = (difference * scale for difference in components(apart))
    for row, value in enumerate((x, y, z, 1.0 / _square((x, y, z)).sqrt())):
        e.store(to, value, row * N)


Edge = tuple[Lanes, Lanes, Lanes, Lanes]
Lines = dict[tuple[int, int], Edge]


def _cell_edges(e: Array, m: ir.Value, low: ir.Value, high: ir.Value, width: ir.Value) -> tuple[Lines, Lines, Lines]:
    """The edges of cells along i at (b, c), along j at (a, c), along k at (a, b); a, b, c are 0 or 1 along i, j, k.

    They begin at ``m`` in the rows along i, at ``low`` and ``high`` in the rows of the two planes.
    """

    def edge(kind: int, at: ir.Value, next_line: int, next_node: int) -> Edge:
        start = e.builder.add(at, width) if next_line else at
        x, y, z, inverse = (e.load(start, (kind + row) * N + next_node) for row in range(4))
        return x, y, z, inverse

    ends, planes = ((0, 0), (0, 1), (1, 0), (1, 1)), (low, high)
    u = {(b, c): edge(ALONG_I, m, b, c) for b, c in ends}
    v = {(a, c): edge(ALONG_J, planes[a], 0, c) for a, c in ends}
    w = {(a, b): edge(ALONG_K, planes[a], b, 0) for a, b in ends}
    return u, v, w


@lanes
def measure(e: Array, m: ir.Value, low: ir.Value, high: ir.Value, width: ir.Value, t: Array, to: ir.Value) -> None:
    """Corner Jacobians, plain and divided by the edge lengths, the smallest of each, and the volume."""
    u, v, w = cell = _cell_edges(e, m, low, high, width)
    found = [_corner(u[b, c], v[a, c], w[a, b]) for b in (0, 1) for c in (0, 1) for a in (0, 1)]
    least, least_unit = found[0]
    total = least * 0.0
    for n, (jacobian, unit) in enumerate(found):
        t.store(to, jacobian, (_JACOBIAN + n) * WIDTH)
        t.store(to, unit, (_UNIT + n) * WIDTH)
        least, least_unit = least.min(jacobian), least_unit.min(unit)
        total = total + jacobian
    t.store(to, least, _LEAST * WIDTH)
    t.store(to, least_unit, _LEAST_UNIT * WIDTH)
    # The Jacobian at the centre and the mean of the corner Jacobians deviate from the volume in opposite directions,
    # the mean twice as far (only terms quadratic in one local coordinate differ), so (2 centre + mean) / 3 is exact.
    mean = _triple(*(_total(lines) for lines in cell))
    t.store(to, mean * (2 / 3 / 64) + total * (1 / 24), _VOLUME * WIDTH)


def _corner(u: Edge, v: Edge, w: Edge) -> tuple[Lanes, Lanes]:
    """Jacobian of a corner, plain and divided by the edge lengths; the latter is 0 where above 1 or not a number."""
    jacobian = _triple(u, v, w)
    unit = jacobian * u[3] * v[3] * w[3]
    return jacobian, unit.below(_IMPOSSIBLE).choose(unit, 0.0)


def _triple(u: Any, v: Any, w: Any) -> Lanes:
    return w[0] * (u[1] * v[2] - u[2] * v[1]) + w[1] * (u[2] * v[0] - u[0] * v[2]) + w[2] * (u[0] * v[1] - u[1] * v[0])


def _total(lines: Lines) -> list[Lanes]:
    """Sum of four edges."""
    a, b, c, d = lines.values()
    return [(a[n] + b[n]) + (c[n] + d[n]) for n in range(3)]


def _square(x: Any) -> Lanes:
    return x[0] * x[0] + x[1] * x[1] + x[2] * x[2]


@lanes
def skewness(t: Array, to: ir.Value) -> None:
    """f_skew from the corners."""
    total = t.load(to, _UNIT * WIDTH) * 0.0
    for n in range(8):
        scaled = t.load(to, (_UNIT + n) * WIDTH).max(_FLAT)
        r = (_GUESS - scaled.bits() * (1 / 3)).from_bits()
        d = 1.0 - scaled * r * r * r
        series = d * _SERIES[4]
        for term in _SERIES[3::-1]:
            series = d * (series + term)
        r = r + r * series
        total = total + r * r
    t.store(to, (8.0 / total).min(1.0), _SKEW * WIDTH)


@lanes
def compare_cells(
    e: Array, m: ir.Value, low: ir.Value, high: ir.Value, width: ir.Value, t: Array, old: ir.Value, r: Array
) -> None:
    """Ratios of the measures of deformed cells, at the start of ``t``, to those of the undeformed cells at ``old``.

    Cells whose smallest corner Jacobian does not outweigh the twists are not proved sound and marked open.
    """
    new = old.type(0)
    u, v, w = _cell_edges(e, m, low, high, width)
    corners = range(_JACOBIAN, _JACOBIAN + 8)
    ratio, *others = [t.load(new, n * WIDTH) / t.load(old, n * WIDTH) for n in corners]
    for other in others:
        ratio = ratio.min(other)
    r.store(m, ratio, RATIO * N)
    least, least_old, volume_old = (t.load(g, n * WIDTH) for g, n in ((new, _LEAST), (old, _LEAST), (old, _VOLUME)))
    r.store(m, t.load(new, _VOLUME * WIDTH) / volume_old, CHANGE * N)
    longest = [1.0 / a.min(b).min(c.min(d)) for a, b, c, d in ([edge[3] for edge in x.values()] for x in (u, v, w))]
    # Differences of parallel edges one step apart along another index: u along j and k, v along k.
    ab, ac = (_twist(u, along) + longest[0] * _ROUNDING for along in (0, 1))
    bc = _twist(v, 1) + longest[1] * _ROUNDING
    twists = (ab * ac * longest[0] + ab * bc * longest[1] + ac * bc * longest[2]) * 0.5
    sound = twists.below(least * _MARGIN) & _above(t.load(new, _LEAST_UNIT * WIDTH), _FLAT) & _above(least, _TINY)
    # Undeformed cells that are too flat, too small or too distorted for single precision have no ratio.
    sound = sound & _above(t.load(old, _LEAST_UNIT * WIDTH), _FLAT) & _above(least_old, _TINY)
    sound = sound & (volume_old * _SPREAD).below(least_old)
    r.store(m, sound.choose(ratio * 0.0, 1.0), OPEN * N)


def _twist(lines: Lines, along: int) -> Lanes:
    """Largest length of the differences of edges that are opposite along the first or the second index of ``lines``."""
    squares = []
    for other in (0, 1):
        a, b = (lines[(end, other) if along == 0 else (other, end)] for end in (0, 1))
        squares.append(_square([b[n] - a[n] for n in range(3)]))
    return squares[0].max(squares[1]).sqrt()


def _above(value: Lanes, bound: float) -> Mask:
    return (value * 0.0 + bound).below(value)


@lanes
def collect(t: Array, r: Array, m: ir.Value, inside: Array, total: Array, bins: Array) -> None:
    """Store f_skew and scaled Jacobians; of cells that are not open, add up f_skew, its inverse and its histogram."""
    zero = m.type(0)
    skew = t.load(zero, _SKEW * WIDTH)
    r.store(m, skew, SKEW * N)
    r.store(m, t.load(zero, _LEAST_UNIT * WIDTH), SCALED * N)
    clear = r.load(m, OPEN * N).below(inside.load(m))
    total.add(zero, clear.choose(1.0 / skew, 0.0).double())
    total.add(zero, clear.choose(skew, 0.0).double(), WIDTH)
    bins.count(zero, clear.choose((skew * BINS).min(BINS - 1.0), BINS), BIN_ROW)


@record("f8[::1], f4[::1], f4[::1], f4[::1], f4[::1], f8[::1], i4[::1]")
class Scratch(NamedTuple):
    """Room for a window of a block; every array is plain, as numba counts references to views with atomic operations.

    Made by Python: each kind of array that a loop makes takes as long to compile as a short loop.
    """

    points: NDArray[np.float64]
    edges: NDArray[np.float32]
    figures: NDArray[np.float32]
    results: NDArray[np.float32]
    inside: NDArray[np.float32]
    total: NDArray[np.float64]
    bins: NDArray[np.int32]

    @classmethod
    def new(cls) -> Scratch:
        """Fresh arrays, for one call of :func:`inspect_hexahedra`."""
        edges, figures, results, inside = (
            np.ones(count, np.float32) for count in (2 * GRID, 2 * CELLS, (RESULTS + 1) * N, N)
        )
        total, bins = np.zeros(2 * WIDTH), np.zeros(COUNTS, np.int32)
        return cls(np.zeros(4 * POINTS), edges, figures, results, inside, total, bins)


@kernel(
    "f8[:, :, :, ::1], f8[:, :, :, ::1], b1, f8, f8, i8, i8, f4[:, :, :, ::1], b1[:, :, ::1], f8[::1], Scratch",
    Scratch,
)
def inspect_hexahedra(before, x, compare, sign, scale, i0, i1, out, is_open, totals, scratch):
    """Measures of the cells i0 <= i < i1 of a block.

    Parameters
    ----------
    before, x : (ni, nj, nk, 3) nodes undeformed and deformed
    compare : whether ``before`` is another grid; otherwise RATIO and CHANGE are one
    sign : handedness of the block
    scale : one over the size of a cell (1 / length); cells of 1e-10 to 1e10 times that size are judged at once
    out : (OPEN, i1 - i0, cj, ck) float32: SKEW f_skew (see :mod:`.measures`), SCALED smallest scaled corner Jacobian,
        RATIO smallest corner Jacobian relative to the undeformed one, CHANGE volume relative to the undeformed one
    is_open : (i1 - i0, cj, ck) bool, out: cells neither proved sound nor measured, left to the double-precision pass
    totals : (n,), added to, of the cells that are not open: sums of 1 / f_skew and of f_skew; in the last 20 places a
        histogram of f_skew, equal bins of [0, 1]
    scratch : overwritten
    """
    points, e, t, r, inside, total, bins = scratch
    single, signed = np.float32(scale), np.float32(sign * scale)
    cj, ck = x.shape[1] - 1, x.shape[2] - 1
    left = 1 if compare else 0
    step = -(-ck // -(-ck // LONGEST))
    for k0 in range(0, ck, step):
        width = min(ck - k0, step) + 1
        height = max(min(NODES // width, cj + 1), 2)
        for j0 in range(0, cj, height - 1):
            rows = min(cj - j0 + 1, height)
            # One at the nodes of the window that are the low corner of a cell: all but the last of every row.
            for m in range(N):
                inside[m] = 1.0 if m < (rows - 1) * width and m % width < width - 1 else 0.0
            for i in range(i0, i1 + 1):
                here, last = PLANE * N * (i & 1), PLANE * N * (1 - (i & 1))
                for g in range(left + 1):
                    new, old, to = (2 * g + (i & 1)) * POINTS, (2 * g + 1 - (i & 1)) * POINTS, g * GRID
                    nodes = x if g == 0 else before
                    for j in range(rows):
                        start = ((i * nodes.shape[1] + j0 + j) * nodes.shape[2] + k0) * 3
                        for m in range(0, 3 * width, WIDTH):
                            move(nodes, start + m, points, new + 3 * j * width + m, 3 * width - m)
                    for kind in range(0 if i > i0 else 1, 3):
                        _edges_from_plane(
                            points, old, new, e, to, here, kind, rows, width, signed if kind == 0 else single
                        )
                if i > i0:
                    for m in range(0, (rows - 1) * width - 1, WIDTH):
                        for g in range(left + 1):
                            at = m + g * GRID
                            measure(e, at, at + last, at + here, width, t, g * CELLS)
                        compare_cells(e, m, m + last, m + here, width, t, left * CELLS, r)
                        skewness(t, 0)
                        collect(t, r, m, inside, total, bins)
                    _copy(r, i - 1 - i0, j0, k0, rows - 1, width, out, is_open)
    for n in range(WIDTH):
        totals[0] += total[n]
        totals[1] += total[WIDTH + n]
        for b in range(BINS):
            totals[len(totals) - BINS + b] += bins[n * BIN_ROW + b]


@inlined
def _edges_from_plane(points, old, new, e, to, here, kind, rows, width, scale):
    """Edges along i from the plane of points at ``old`` to that at ``new``; along j or k within the latter."""
    one, other, row, count = old, new, ALONG_I * N, rows * width
    if kind > 0:
        one, other, row, count = new, new + 3 * width, ALONG_J * N + here, (rows - 1) * width
    if kind > 1:
        other, row, count = new + 3, ALONG_K * N + here, rows * width - 1
    for m in range(0, count, WIDTH):
        edges(points, one + 3 * m, other + 3 * m, e, to + row + m, scale)


@inlined
def _copy(r, i, j0, k0, rows, width, out, is_open):
    """Results of a window's cells."""
    for j in range(rows):
        at, start = j * width, (i * out.shape[2] + j0 + j) * out.shape[3] + k0
        for k in range(0, width - 1, WIDTH):
            for kind in range(out.shape[0]):
                to = kind * out.shape[1] * out.shape[2] * out.shape[3] + start + k
                move(r, kind * N + at + k, out, to, width - 1 - k)
            answer(r, OPEN * N + at + k, is_open, start + k, width - 1 - k)
