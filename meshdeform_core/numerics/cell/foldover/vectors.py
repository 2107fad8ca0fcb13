"""What hexahedra and triangles share where eight of them are computed at a time."""

from __future__ import annotations

from llvmlite import ir

from ...lanes import NARROW as WIDTH
from ...lanes import Array, Lanes, narrow

Vector = list[Lanes]


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
