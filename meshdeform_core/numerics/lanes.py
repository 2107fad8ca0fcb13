"""Vector code in numba loops: sixteen numbers in single precision at a time.

A loop that computes a hundred numbers from fifty rows remains scalar in numba: LLVM cannot exclude that a result
overwrites another row, and numba has no option to say so. Here Python functions emit the vector instructions
themselves, and LLVM maps them to the registers of the processor. The pass over hexahedra takes a fifth to a sixth of
the time of the same formulas in a plain loop (docs/performance.md, "Vector instructions").
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils, errors
from numba.extending import intrinsic

WIDTH = 16
"""Numbers in a vector, which fill one AVX-512 register, two AVX2 or four NEON registers."""

NARROW = 8
"""Numbers in a vector of functions made by :func:`narrow`, which fill one AVX-512 register in double precision."""

_SINGLE, _DOUBLE, _INTEGER = (ir.VectorType(kind, WIDTH) for kind in (ir.FloatType(), ir.DoubleType(), ir.IntType(32)))
_BYTES = ir.VectorType(ir.IntType(8), WIDTH)
# Fuse multiplications with additions, approximate and refine reciprocals and roots; no reordering, NaN is respected.
_FLAGS = ("contract", "arcp", "afn")


class Lanes:
    """Sixteen numbers of one type, or fewer; operators emit instructions."""

    def __init__(self, builder: ir.IRBuilder, value: ir.Value):
        self.builder, self.value = builder, value

    def __add__(self, other: Lanes | float) -> Lanes:
        return self._with(other, self.builder.fadd)

    def __sub__(self, other: Lanes | float) -> Lanes:
        return self._with(other, self.builder.fsub)

    def __mul__(self, other: Lanes | float) -> Lanes:
        return self._with(other, self.builder.fmul)

    def __truediv__(self, other: Lanes | float) -> Lanes:
        return self._with(other, self.builder.fdiv)

    def __rsub__(self, other: float) -> Lanes:
        return self._same(other) - self

    def __rtruediv__(self, other: float) -> Lanes:
        return self._same(other) / self

    __radd__, __rmul__ = __add__, __mul__

    def below(self, other: Lanes | float) -> Mask:
        """Mask of the lanes where this is smaller; false where either is not a number."""
        return Mask(self.builder, self.builder.fcmp_ordered("<", self.value, self._same(other).value))

    def min(self, other: Lanes | float) -> Lanes:
        """The smaller of the two; ``other`` where either is not a number."""
        return self.below(other).choose(self, self._same(other))

    def max(self, other: Lanes | float) -> Lanes:
        """The larger of the two; ``other`` where either is not a number."""
        other = self._same(other)
        return other.below(self).choose(self, other)

    def sqrt(self) -> Lanes:
        kind = self.value.type
        name = f"llvm.sqrt.v{kind.count}f{8 * _bytes(kind.element)}"
        function = cgutils.get_or_insert_function(self.builder.module, ir.FunctionType(kind, [kind]), name)
        return Lanes(self.builder, self.builder.call(function, [self.value], fastmath=_FLAGS))

    def bits(self) -> Lanes:
        """The bits of the lanes, in double precision their upper halves, read as integers and converted to numbers."""
        kind, bits, integer = self.value.type, self.value, self._integer(32)
        if _bytes(kind.element) == 8:
            upper = self.builder.lshr(self.builder.bitcast(bits, self._integer(64)), self._half())
            bits = self.builder.trunc(upper, integer)
        return Lanes(self.builder, self.builder.sitofp(self.builder.bitcast(bits, integer), kind))

    def from_bits(self) -> Lanes:
        """Inverse of :meth:`bits`: the numbers with these bits, in double precision with lower halves of zero."""
        kind, bits = self.value.type, self.whole()
        if _bytes(kind.element) == 8:
            bits = self.builder.shl(self.builder.zext(bits, self._integer(64)), self._half())
        return Lanes(self.builder, self.builder.bitcast(bits, kind))

    def whole(self) -> ir.Value:
        """Truncated to 32-bit integers."""
        return self.builder.fptosi(self.value, self._integer(32))

    def _integer(self, bits: int) -> ir.VectorType:
        return ir.VectorType(ir.IntType(bits), self.value.type.count)

    def _half(self) -> ir.Constant:
        return ir.Constant(self._integer(64), [32] * self.value.type.count)

    def single(self) -> Lanes:
        """From double to single precision."""
        return Lanes(
            self.builder, self.builder.fptrunc(self.value, ir.VectorType(ir.FloatType(), self.value.type.count))
        )

    def double(self) -> Lanes:
        """From single to double precision."""
        return Lanes(
            self.builder, self.builder.fpext(self.value, ir.VectorType(ir.DoubleType(), self.value.type.count))
        )

    def mixed(self, other: Lanes, places: list[int]) -> Lanes:
        """Lanes of this one, from 0 on, and of ``other``, counted on."""
        return _shuffle(self, other, places)

    def _same(self, other: Lanes | float) -> Lanes:
        if isinstance(other, Lanes):
            return other
        return Lanes(self.builder, ir.Constant(self.value.type, [float(other)] * self.value.type.count))

    def _with(self, other: Lanes | float, operation: Callable[..., ir.Value]) -> Lanes:
        return Lanes(self.builder, operation(self.value, self._same(other).value, flags=_FLAGS))


class Mask:
    """Sixteen booleans."""

    def __init__(self, builder: ir.IRBuilder, value: ir.Value):
        self.builder, self.value = builder, value

    def __and__(self, other: Mask) -> Mask:
        return Mask(self.builder, self.builder.and_(self.value, other.value))

    def choose(self, yes: Lanes, no: Lanes | float) -> Lanes:
        return Lanes(self.builder, self.builder.select(self.value, yes.value, yes._same(no).value))


class Array:
    """The data of a contiguous array; ``at + further`` is the index of an element of the flattened array."""

    def __init__(self, builder: ir.IRBuilder, data: ir.Value, kind: ir.Type, width: int = WIDTH):
        self.builder, self._data, self._kind, self._width = builder, data, kind, width

    def load(self, at: ir.Value, further: int = 0) -> Lanes:
        vector = ir.VectorType(self._kind, self._width)
        return Lanes(self.builder, self.builder.load(self._pointer(at, further, vector), align=_bytes(self._kind)))

    def store(self, at: ir.Value, lanes: Lanes | ir.Value, further: int = 0) -> None:
        value = lanes.value if isinstance(lanes, Lanes) else lanes
        self.builder.store(value, self._pointer(at, further, value.type), align=_bytes(self._kind))

    def add(self, at: ir.Value, lanes: Lanes, further: int = 0) -> None:
        self.store(at, self.load(at, further) + lanes, further)

    def every(self, at: ir.Value, further: int = 0) -> Lanes:
        """One number, copied to all lanes."""
        return _copied(self.builder, self.one(at, further), self._width)

    def one(self, at: ir.Value, further: int = 0) -> ir.Value:
        """One number."""
        place = self.builder.add(at, ir.Constant(at.type, further))
        return self.builder.load(self.builder.gep(self._data, [place]))

    def store_one(self, at: ir.Value, number: ir.Value, further: int = 0) -> None:
        """Store a single element."""
        place = self.builder.add(at, ir.Constant(at.type, further))
        self.builder.store(number, self.builder.gep(self._data, [place]))

    def store_pair(self, at: ir.Value, lanes: Lanes) -> None:
        """Store the first two lanes."""
        self.store(at, _shuffle(lanes, lanes, [0, 1]))

    def load_some(self, at: ir.Value, count: ir.Value) -> Lanes:
        """The first ``count`` of sixteen numbers; the others are zero and not read."""
        kind = ir.VectorType(self._kind, WIDTH)
        value = self._masked("load", at, kind, [], [ir.Constant(kind, [0.0] * WIDTH)], count)
        return Lanes(self.builder, value)

    def store_some(self, at: ir.Value, lanes: Lanes | Mask, count: ir.Value) -> None:
        """Store the first ``count`` of sixteen numbers, or of sixteen booleans as bytes."""
        value = lanes.value if isinstance(lanes, Lanes) else self.builder.zext(lanes.value, _BYTES)
        self._masked("store", at, value.type, [value], [], count)

    def _masked(
        self, verb: str, at: ir.Value, kind: ir.Type, first: list[ir.Value], last: list[ir.Value], count: ir.Value
    ) -> ir.Value:
        builder = self.builder
        number = builder.trunc(count, ir.IntType(32)) if count.type.width > 32 else count
        one = builder.insert_element(ir.Constant(_INTEGER, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
        every = builder.shuffle_vector(one, one, ir.Constant(_INTEGER, [0] * WIDTH))
        mask = builder.icmp_signed("<", ir.Constant(_INTEGER, list(range(WIDTH))), every)
        pointer, align = self._pointer(at, 0, kind), ir.Constant(ir.IntType(32), _bytes(self._kind))
        values = [*first, pointer, align, mask, *last]
        result = ir.VoidType() if verb == "store" else kind
        element = {_BYTES: "i8", _SINGLE: "f32", _DOUBLE: "f64"}[kind]
        name = f"llvm.masked.{verb}.v{WIDTH}{element}.p0"
        types_of = ir.FunctionType(result, [value.type for value in values])
        return builder.call(cgutils.get_or_insert_function(builder.module, types_of, name), values)

    def count(self, at: ir.Value, bins: Lanes, row: int) -> None:
        """Add one, for each lane n, to bin ``bins[n]`` of the lane's own row of ``row`` numbers."""
        whole, kind = bins.whole(), ir.IntType(32)
        for lane in range(WIDTH):
            place = self.builder.zext(self.builder.extract_element(whole, ir.Constant(kind, lane)), at.type)
            place = self.builder.add(self.builder.add(at, place), ir.Constant(at.type, lane * row))
            pointer = self.builder.gep(self._data, [place])
            self.builder.store(self.builder.add(self.builder.load(pointer), ir.Constant(kind, 1)), pointer)

    def load_points(self, at: ir.Value) -> list[Lanes]:
        """Sixteen points, interleaved x, y, z, as three vectors; :func:`components` separates them."""
        return [self.load(at, WIDTH * n) for n in range(3)]

    def load_some_points(self, at: ir.Value, count: ir.Value) -> list[Lanes]:
        """As :meth:`load_points`, but only the first ``count`` numbers; the others are zero and not read."""
        further = [ir.Constant(at.type, WIDTH * n) for n in range(3)]
        return [self.load_some(self.builder.add(at, n), self.builder.sub(count, n)) for n in further]

    def _pointer(self, at: ir.Value, further: int, vector: ir.Type) -> ir.Value:
        place = self.builder.add(at, ir.Constant(at.type, further))
        return self.builder.bitcast(self.builder.gep(self._data, [place]), vector.as_pointer())


def _bytes(kind: ir.Type) -> int:
    return {ir.DoubleType(): 8, ir.FloatType(): 4}.get(kind, 1)


def components(points: list[Lanes]) -> list[Lanes]:
    """The x, y and z of sixteen points that are stored interleaved in three vectors."""
    one, two, three = points
    found = []
    for axis in range(3):
        # Lane n of a component is number 3 n + axis; shuffles take two vectors at a time, the third comes last.
        places = [3 * n + axis for n in range(WIDTH)]
        early = _shuffle(one, two, [min(place, 2 * WIDTH - 1) for place in places])
        found.append(_shuffle(early, three, [n if p < 2 * WIDTH else p - WIDTH for n, p in enumerate(places)]))
    return found


def _shuffle(one: Lanes, two: Lanes, places: list[int]) -> Lanes:
    mask = ir.Constant(ir.VectorType(ir.IntType(32), len(places)), places)
    return Lanes(one.builder, one.builder.shuffle_vector(one.value, two.value, mask))


def lanes(emit: Callable[..., None], width: int = WIDTH) -> Any:
    """Decorator: makes a function for numba loops from ``emit``, which emits its instructions.

    ``emit`` gets :class:`Array` for contiguous arrays, ``ir.Value`` for integers, and :class:`Lanes` of sixteen equal
    numbers for floats. With another ``width``, only loads, stores, comparisons and arithmetic are available.
    """

    def define(typing_context: Any, *kinds: Any) -> Any:
        def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
            values = zip(signature.args, arguments, strict=True)
            emit(*(_argument(context, builder, kind, value, width) for kind, value in values))
            return context.get_dummy_value()

        return types.void(*kinds), generate

    names = ("typing_context", *inspect.signature(emit).parameters)
    define.__name__, define.__doc__ = emit.__name__, emit.__doc__
    # numba inspects the names of the arguments.
    define.__signature__ = inspect.Signature(  # type: ignore[attr-defined]
        [inspect.Parameter(name, inspect.Parameter.POSITIONAL_OR_KEYWORD) for name in names]
    )
    return intrinsic(define)


narrow = partial(lanes, width=NARROW)
"""As :func:`lanes`, for eight numbers at a time: enough in double precision, with half as much scratch memory."""


@narrow
def transpose(source: Array, target: Array, first: ir.Value, at: ir.Value, row: ir.Value) -> None:
    """Eight rows of eight numbers of ``source``, from element ``first`` on, as columns of ``target``, whose rows have
    ``row`` elements, from element ``at`` on."""
    rows = [source.load(first, NARROW * n) for n in range(NARROW)]
    for step in (1, 2, 4):
        for n in (n for n in range(NARROW) if not n & step):
            one, two = rows[n], rows[n + step]
            rows[n] = one.mixed(two, [k + (NARROW - step if k & step else 0) for k in range(NARROW)])
            rows[n + step] = one.mixed(two, [k + (NARROW if k & step else step) for k in range(NARROW)])
    for lanes_of_row in rows:
        target.store(at, lanes_of_row)
        at = target.builder.add(at, row)


def _argument(context: Any, builder: ir.IRBuilder, kind: Any, value: ir.Value, width: int) -> Any:
    if isinstance(kind, types.Array):
        if kind.layout != "C":
            raise errors.TypingError(f"{kind} is not contiguous")
        return Array(
            builder, context.make_array(kind)(context, builder, value).data, context.get_value_type(kind.dtype), width
        )
    if isinstance(kind, types.Integer):
        return value
    return _copied(builder, value, width)


def _copied(builder: ir.IRBuilder, value: ir.Value, width: int) -> Lanes:
    one = builder.insert_element(
        ir.Constant(ir.VectorType(value.type, width), ir.Undefined), value, ir.Constant(ir.IntType(32), 0)
    )
    return Lanes(
        builder, builder.shuffle_vector(one, one, ir.Constant(ir.VectorType(ir.IntType(32), width), [0] * width))
    )


_four = partial(lanes, width=4)
"""As :func:`lanes`, for four numbers, of columns of 2 x 2 or 3 x 3 blocks: the compiler leaves loops over these scalar.
What is loaded too much is not used; arrays must have room for it (:func:`with_room`)."""


def with_room(shape: tuple[int, ...], dtype: Any = np.float64) -> Any:
    """An uninitialised array with room for one more row behind it."""
    return np.empty((shape[0] + 1, *shape[1:]), dtype)[:-1]


@_four
def add_four(target: Array, at: ir.Value, source: Array, first: ir.Value) -> None:
    """Add four numbers of ``source``, from element ``first`` on, to those of ``target`` from element ``at`` on."""
    target.add(at, source.load(first))


def _solving(size: int) -> Any:
    @_four
    def solve_row(
        blocks: Array, columns: Array, vector: Array, right: Array, row: ir.Value, first: ir.Value, count: ir.Value,
        step: ir.Value, factor: Lanes,
    ) -> None:  # fmt: skip
        """Row of ``vector`` (n, size): that of ``right`` less the sum of ``blocks[at].T @ vector[columns[at]]``, times
        a factor.

        ``at`` takes ``count`` values from ``first`` on by ``step``. The row computed before should come last, as all
        others can be summed before it is known.
        """
        builder, at, zero = blocks.builder, row.type, ir.Constant(ir.VectorType(ir.DoubleType(), 4), [0.0] * 4)
        totals = [cgutils.alloca_once_value(builder, zero) for _ in range(size)]
        for total in totals:
            # Allocated once per function, which may contain several loops.
            builder.store(zero, total)
        with cgutils.for_range(builder, count) as loop:
            place = builder.add(first, builder.mul(loop.index, step))
            block, column = (builder.mul(a, at(b)) for a, b in ((place, size**2), (_column(columns, place), size)))
            for d, total in enumerate(totals):
                product = blocks.load(block, size * d).double() * vector.every(column, d)
                builder.store((Lanes(builder, builder.load(total)) + product).value, total)
        start = builder.mul(row, at(size))
        value = right.load(start)
        for total in totals:
            value = value - Lanes(builder, builder.load(total))
        vector.store_pair(start, value * factor)
        if size == 3:
            vector.store_one(start, builder.extract_element((value * factor).value, at(2)), 2)

    return solve_row


def _column(columns: Array, place: ir.Value) -> ir.Value:
    return columns.builder.zext(columns.one(place), place.type)


solve_pair, solve_three = _solving(2), _solving(3)
