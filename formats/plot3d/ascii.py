"""Plot3D as text."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid

from ..planes import merge, split
from .binary import allocate, iblank_of
from .detect import LONGEST_HEADER, Reading, UnknownFile, Writing, choose, header_variants, stream_readings
from .numbers import count_integers, ends_with_integer, number_lines, read_numbers
from .variant import Variant

# Numbers written per call.
_LINES = 1 << 20


def read_ascii(path: Path, options: Mapping[str, Any]) -> Grid:
    """Read a Plot3D text of any variant that ``options`` allow."""
    with path.open("rb") as stream:
        numbers = read_numbers(stream, path)
        with_integer = ends_with_integer(stream)

    def integers_in_text() -> int:
        with path.open("rb") as stream:
            return count_integers(stream)

    def load(reading: Reading) -> Grid:
        return _assemble(reading, path, numbers)

    head = numbers[:LONGEST_HEADER]
    integers = np.where((head == np.rint(head)) & (np.abs(head) < 2**31), head, 0).astype(np.int64)
    variants = header_variants(encoding="ascii", precision=options.get("precision", "float64"))
    readings = stream_readings(variants, integers, numbers.size)
    writing = Writing(with_integer, integers_in_text)
    return choose(readings, UnknownFile(path, numbers.size, "numbers", options, load, writing))


def write_ascii(grid: Grid, stream: BinaryIO, variant: Variant) -> None:
    """Write all blocks, one number per line."""
    if variant.multiblock:
        stream.write(b"%d\n" % grid.n_blocks)
    for shape in grid.shapes:
        stream.write(" ".join(str(n) for n in shape[: variant.dimension]).encode() + b"\n")
    for index in range(grid.n_blocks):
        for array in _text_arrays(grid, variant, index):
            for start in range(0, array.size, _LINES):
                # If integers follow, a number without a dot must be an integer.
                stream.write(number_lines(array[start : start + _LINES], dotted=variant.iblank))


def _assemble(reading: Reading, path: Path, numbers: FloatArray) -> Grid:
    """The grid of a reading from all numbers of a text."""
    grid, flags = allocate(reading, path)
    dimension = reading.variant.dimension
    position = reading.segments[0][0]

    def put(index: int) -> None:
        nonlocal position
        block, count = grid.block(index), math.prod(grid.shapes[index])
        arrays = numbers[position:][: (dimension + reading.variant.iblank) * count].reshape(-1, count)
        position += arrays.size
        merge(block, iter(arrays[:dimension]), dimension)
        block[..., dimension:] = 0.0
        if flags:
            values = arrays[dimension]
            whole = (values == np.rint(values)) & (np.abs(values) < 2**31)
            if not whole.all():
                first = values[np.argmin(whole)]
                raise FormatError(
                    f"{path} has the size for IBLANK values, but one of them is {first:g}, not an integer"
                )
            flags[index][...] = values.reshape(block.shape[2::-1]).T

    grid.fill(put)
    return grid


def _text_arrays(grid: Grid, variant: Variant, index: int) -> Iterator[NDArray[Any]]:
    """The flat arrays of one block in the order and types of a text."""
    for array in split(grid.block(index), variant.real, variant.dimension):
        yield array.reshape(-1)
    if variant.iblank:
        iblank = iblank_of(grid, index)
        flags = np.ones(grid.shapes[index]) if iblank is None else iblank.values
        yield np.ascontiguousarray(flags.T, variant.integer).reshape(-1)
