"""The formulas of :mod:`.inspection` for sixteen cells at a time, in single precision."""

from __future__ import annotations

from typing import Any

from llvmlite import ir

from ..lanes import WIDTH, Array, Lanes, Mask, components, lanes

# Numbers in a row: the nodes of a window of a plane, flat along j and k, and room for vectors that extend beyond. The
# rows together stay in the second-level cache.
N = 1024
NODES, LONGEST = N - 2 * WIDTH, 160
# Rows of edges, each x, y, z, 1 / length: along i from one plane to the next, along j and k in both planes.
ALONG_I, ALONG_J, ALONG_K, PLANE, ROWS = 0, 4, 8, 8, 20
SKEW, SCALED, RATIO, CHANGE, SKEW_BEFORE, SCALED_BEFORE = 0, 1, 2, 3, 4, 5
OPEN, RESULTS = 6, 7
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
# Rounding of a twist relative to the edges; of corners and products relative to the smallest corner: see "Rounding" in
# :mod:`.inspection`.
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
    _measure(_cell_edges(e, m, low, high, width), t, to)


def _measure(cell: tuple[Lines, Lines, Lines], t: Array, to: ir.Value) -> None:
    u, v, w = cell
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


def _comparable(least: Lanes, unit: Lanes, volume: Lanes) -> Mask:
    """Mask of undeformed cells that are neither too flat nor too small nor too distorted for single precision."""
    return _above(unit, _FLAT) & _above(least, _TINY) & (volume * _SPREAD).below(least)


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
    e: Array,
    m: ir.Value,
    low: ir.Value,
    high: ir.Value,
    width: ir.Value,
    t: Array,
    new: ir.Value,
    old: ir.Value,
    r: Array,
) -> None:
    """Measures of deformed cells and their ratios to those of the undeformed cells, already in ``t`` at ``old``.

    Cells whose smallest corner Jacobian does not outweigh the twists are not proved sound and marked open.
    """
    u, v, w = cell = _cell_edges(e, m, low, high, width)
    _measure(cell, t, new)
    corners = range(_JACOBIAN, _JACOBIAN + 8)
    ratio, *others = [t.load(new, n * WIDTH) / t.load(old, n * WIDTH) for n in corners]
    for other in others:
        ratio = ratio.min(other)
    r.store(m, ratio, RATIO * N)
    least, least_old, volume_old = (t.load(g, n * WIDTH) for g, n in ((new, _LEAST), (old, _LEAST), (old, _VOLUME)))
    r.store(m, t.load(new, _VOLUME * WIDTH) / volume_old, CHANGE * N)
    longest = [_longest(lines) for lines in (u, v, w)]
    # Differences of parallel edges one step apart along another index: u along j and k, v along k.
    ab, ac, bc = (
        _twist(u, 0) + longest[0] * _ROUNDING, _twist(u, 1) + longest[0] * _ROUNDING,
        _twist(v, 1) + longest[1] * _ROUNDING,
    )  # fmt: skip
    twists = (ab * ac * longest[0] + ab * bc * longest[1] + ac * bc * longest[2]) * 0.5
    sound = twists.below(least * _MARGIN) & _above(t.load(new, _LEAST_UNIT * WIDTH), _FLAT) & _above(least, _TINY)
    sound = sound & _comparable(least_old, t.load(old, _LEAST_UNIT * WIDTH), volume_old)
    r.store(m, sound.choose(ratio * 0.0, 1.0), OPEN * N)


def _longest(lines: Lines) -> Lanes:
    """The largest of four lengths."""
    a, b, c, d = (edge[3] for edge in lines.values())
    return 1.0 / a.min(b).min(c.min(d))


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
def collect(
    t: Array,
    g: ir.Value,
    r: Array,
    m: ir.Value,
    first: ir.Value,
    inside: Array,
    total: Array,
    at: ir.Value,
    bins: Array,
    start: ir.Value,
) -> None:
    """Store f_skew and scaled Jacobians; of cells that are not open, add up f_skew, its inverse and its histogram."""
    skew = t.load(g, _SKEW * WIDTH)
    to = r.builder.add(m, first)
    r.store(to, skew, SKEW * N)
    r.store(to, t.load(g, _LEAST_UNIT * WIDTH), SCALED * N)
    clear = r.load(m, OPEN * N).below(inside.load(m))
    total.add(at, clear.choose(1.0 / skew, 0.0).double())
    total.add(at, clear.choose(skew, 0.0).double(), WIDTH)
    bins.count(start, clear.choose((skew * BINS).min(BINS - 1.0), BINS), BIN_ROW)
