"""Eight cells or triangles at a time: rows of arrays, and from derivatives with respect to the vectors e_k of
:mod:`.corners` to those with respect to the nodes of cells."""

from __future__ import annotations

from llvmlite import ir

from ...lanes import NARROW as WIDTH
from ...lanes import Array, Lanes, narrow

Vector = list[Lanes]

FORCE, ROWS = 36 * 9, 44 * 8
"""Rows of ``result`` (ROWS, WIDTH), derivatives with respect to the nodes of the cells: the second ones (36, 3, 3) for
pairs of nodes in ascending order, from FORCE on the first ones (8, 3)."""
PULL, BEND, TURNED, PARTS = 0, 9, 90, 117
"""Rows of ``parts`` (PARTS, WIDTH), derivatives at a sample point with respect to the vectors e_k: the first ones
(3, 3), the second ones (3, 3, 3, 3), and those (3, 3, 3) with respect to a node and the vectors."""


@narrow
def turn_to_node(slope: Array, parts: Array, result: Array, sample: ir.Value, node: ir.Value) -> None:
    """Add the first derivatives at a sample point to those of a node; in ``parts``, the second ones with respect to the
    node and the vectors."""
    slopes_of_node = slopes_of(slope, sample, node)
    for d in range(3):
        total = dot(slopes_of_node, [load(parts, PULL + 3 * k + d) for k in range(3)])
        result.add(row_of(result, node), total, (FORCE + d) * WIDTH)
        for m in range(3):
            for e in range(3):
                place = 3 * d + e
                bends = [load(parts, BEND + 9 * (3 * k + m) + place) for k in range(3)]
                store(parts, TURNED + 9 * m + place, dot(slopes_of_node, bends))


@narrow
def add_to_pair(slope: Array, parts: Array, result: Array, sample: ir.Value, node: ir.Value, other: ir.Value) -> None:
    """Add the second derivatives with respect to a node, from :func:`turn_to_node`, and one that is not less."""
    slopes_of_other = slopes_of(slope, sample, other)
    _add_pair(result, node, other, [
        [dot(slopes_of_other, [load(parts, TURNED + 9 * m + 3 * d + e) for m in range(3)]) for e in range(3)]
        for d in range(3)
    ])  # fmt: skip


def add_forces(result: Array, node: ir.Value, edges: list[Vector]) -> None:
    """Add forces on the ends of the edges, and their opposite to the corner."""
    for other, vector in zip(neighbours(result, node), edges, strict=True):
        for d in range(3):
            result.add(row_of(result, other), vector[d], (FORCE + d) * WIDTH)
    for d in range(3):
        result.add(row_of(result, node), (edges[0][d] + edges[1][d] + edges[2][d]) * -1.0, (FORCE + d) * WIDTH)


def add_blocks(result: Array, node: ir.Value, second: list[list[list[Vector]]]) -> None:
    """Add second derivatives with respect to edges to those with respect to nodes."""
    others = neighbours(result, node)
    columns = [[[-1.0 * (second[0][m][d][e] + second[1][m][d][e] + second[2][m][d][e])
                 for e in range(3)] for d in range(3)] for m in range(3)]  # fmt: skip
    whole = [[-1.0 * (columns[0][d][e] + columns[1][d][e] + columns[2][d][e]) for e in range(3)] for d in range(3)]
    _add_pair(result, node, node, whole)
    for m in range(3):
        _add_pair(result, node, others[m], columns[m])
        for k in range(m + 1):
            _add_pair(result, others[k], others[m], second[k][m])


def _add_pair(result: Array, one: ir.Value, two: ir.Value, values: list[Vector]) -> None:
    """Add ``values`` (3, 3), transposed if the nodes descend, to the block of two nodes."""
    builder = result.builder
    descends = builder.icmp_signed(">", one, two)
    low, high = builder.select(descends, two, one), builder.select(descends, one, two)
    long, short = one.type(3 * WIDTH), one.type(WIDTH)
    by_row, by_column = builder.select(descends, short, long), builder.select(descends, long, short)
    # Before the row of the lower node are those of lower ones, each shorter by one than the row before.
    before = builder.lshr(builder.mul(low, builder.sub(one.type(15), low)), one.type(1))
    first = builder.mul(builder.add(before, high), one.type(9 * WIDTH))
    for d in range(3):
        row = builder.add(first, builder.mul(by_row, one.type(d)))
        for e in range(3):
            result.add(builder.add(row, builder.mul(by_column, one.type(e))), values[d][e])


def slopes_of(slope: Array, sample: ir.Value, node: ir.Value) -> Vector:
    """The derivatives of a node's shape function along the three axes, the same for all cells."""
    builder = slope.builder
    place = builder.mul(builder.add(builder.mul(sample, sample.type(8)), node), sample.type(3))
    return [slope.every(place, k) for k in range(3)]


def neighbours(array: Array, node: ir.Value) -> list[ir.Value]:
    """The neighbours of a node of the cells along the index axes."""
    return [array.builder.xor(node, node.type(bit)) for bit in (4, 2, 1)]


def row_of(array: Array, node: ir.Value) -> ir.Value:
    """Offset of the three rows, of WIDTH numbers each, that belong to a node."""
    return array.builder.mul(node, node.type(3 * WIDTH))


def load(array: Array, row: int) -> Lanes:
    """A row of an array (n, WIDTH)."""
    return array.load(ir.IntType(64)(row * WIDTH))


def store(array: Array, row: int, value: Lanes) -> None:
    """Store a row of an array (n, WIDTH)."""
    array.store(ir.IntType(64)(row * WIDTH), value)


def regular(det: Lanes, eps: Lanes) -> tuple[Lanes, Lanes]:
    """As :func:`.jacobian.regular`."""
    root = (eps * eps + det * det).sqrt()
    return (det * 0.0).below(det).choose(0.5 * (det + root), 0.5 * eps * eps / (root - det)), root


def dot(a: Vector, b: Vector) -> Lanes:
    """The scalar product of two vectors in space."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@narrow
def transpose(result: Array, row: ir.Value, found: Array, rows: ir.Value) -> None:
    """Copy eight of the ``rows`` of ``result`` (rows, WIDTH) to ``found`` (WIDTH, rows)."""
    builder = result.builder
    place = builder.mul(row, row.type(WIDTH))
    lines = [result.load(place, n * WIDTH) for n in range(WIDTH)]
    for step in (1, 2, 4):
        upper = [n if not n & step else WIDTH + (n ^ step) for n in range(WIDTH)]
        lower = [n | step if not n & step else WIDTH + n for n in range(WIDTH)]
        for n in range(WIDTH):
            if not n & step:
                one, two = lines[n], lines[n | step]
                lines[n], lines[n | step] = one.mixed(two, upper), one.mixed(two, lower)
    for n, line in enumerate(lines):
        found.store(builder.add(row, builder.mul(rows, row.type(n))), line)
