"""Products of rows of sparse matrices of small square blocks, in single precision, with vectors in double precision.

Every block is one or three vectors of four numbers: the compiler leaves loops over blocks of 2 x 2 or 3 x 3 numbers
scalar. Of three numbers, four are loaded, the last of which is not used; arrays must have room for it
(:func:`with_room`).
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba.core import cgutils

from ..lanes import Array, Lanes, lanes

_four = partial(lanes, width=4)


def with_room(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """An uninitialised array with room for one more row behind it."""
    return np.empty((shape[0] + 1, *shape[1:]), dtype)[:-1]


@_four
def multiply_row(
    blocks: Array, columns: Array, vector: Array, image: Array, row: ir.Value, first: ir.Value, last: ir.Value
) -> None:
    """Row of ``image`` (n, 3): the sum of ``blocks[at] @ vector[columns[at]]`` for first <= at < last."""
    builder, at = blocks.builder, row.type
    totals = [_Total(builder) for _ in range(3)]
    with cgutils.for_range_slice(builder, first, last, at(1), at) as (place, _):
        value = vector.load(builder.mul(_column(columns, place), at(3)))
        for d, total in enumerate(totals):
            total.add(blocks.load(builder.mul(place, at(9)), 3 * d).double() * value)
    for d, total in enumerate(totals):
        image.store_one(builder.mul(row, at(3)), total.of(range(3)), d)


@_four
def solve_row(
    blocks: Array,
    columns: Array,
    vector: Array,
    right: Array,
    row: ir.Value,
    first: ir.Value,
    count: ir.Value,
    step: ir.Value,
    factor: Lanes,
) -> None:
    """Row of ``vector`` (n, 2): that of ``right`` less the sum of ``blocks[at] @ vector[columns[at]]``, times a factor.

    ``at`` takes ``count`` values from ``first`` on by ``step``. The row computed before should come last, as all others
    can be summed before it is known.
    """
    builder, at, total = blocks.builder, row.type, _Total(blocks.builder)
    with cgutils.for_range(builder, count) as loop:
        place = builder.add(first, builder.mul(loop.index, step))
        pair = vector.load_pair(builder.mul(_column(columns, place), at(2)))
        total.add(blocks.load(builder.mul(place, at(4))).double() * pair)
    sums, start = total.lanes, builder.mul(row, at(2))
    sums = sums + sums.mixed(sums, [1, 0, 3, 2])
    vector.store_pair(start, (right.load_pair(start) - sums.mixed(sums, [0, 2, 0, 2])) * factor)


class _Total:
    """Four running sums in a loop."""

    def __init__(self, builder: ir.IRBuilder):
        zero = ir.Constant(ir.VectorType(ir.DoubleType(), 4), [0.0] * 4)
        self._builder, self._place = builder, cgutils.alloca_once_value(builder, zero)
        # The place is initialised once per function, which may contain several loops.
        builder.store(zero, self._place)

    def add(self, more: Lanes) -> None:
        self._builder.store((self.lanes + more).value, self._place)

    @property
    def lanes(self) -> Lanes:
        return Lanes(self._builder, self._builder.load(self._place))

    def of(self, numbers: range) -> ir.Value:
        """The sum of some of the four."""
        value, kind = self.lanes.value, ir.IntType(32)
        parts = [self._builder.extract_element(value, kind(n)) for n in numbers]
        total = parts[0]
        for part in parts[1:]:
            total = self._builder.fadd(total, part)
        return total


def _column(columns: Array, place: ir.Value) -> ir.Value:
    return columns.builder.zext(columns.one(place), place.type)
