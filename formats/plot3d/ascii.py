"""Plot3D as text."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid

from .blocks import assemble, text_arrays
from .detect import LONGEST_HEADER, Reading, UnknownFile, Writing, choose, header_variants, stream_readings
from .numbers import count_integers, ends_with_integer, number_lines, read_numbers
from .variant import Variant

# Numbers written per call.
_LINES = 1 << 20


def read_ascii(path: Path, options: Mapping[str, Any]) -> Grid:
    """Read a Plot3D text of any variant that ``options`` allow."""
    with path.open("rb") as stream:
        numbers = read_numbers(stream, path)
        writing = Writing(ends_with_integer(stream), lambda: _count_integers(path))

    def load(reading: Reading) -> Grid:
        return assemble(reading, path, _Text(path, numbers, reading.segments[0][0]))

    head = numbers[:LONGEST_HEADER]
    integers = np.where((head == np.rint(head)) & (np.abs(head) < 2**31), head, 0).astype(np.int64)
    variants = header_variants(encoding="ascii", precision=options.get("precision", "float64"))
    readings = stream_readings(variants, integers, numbers.size)
    return choose(readings, UnknownFile(path, numbers.size, "numbers", options, load, writing))


def write_ascii(grid: Grid, stream: BinaryIO, variant: Variant) -> None:
    """Write all blocks, one number per line."""
    if variant.multiblock:
        stream.write(b"%d\n" % grid.n_blocks)
    for shape in grid.shapes:
        stream.write(" ".join(str(n) for n in shape[: variant.dimension]).encode() + b"\n")
    for index in range(grid.n_blocks):
        for array in text_arrays(grid, variant, index):
            for start in range(0, array.size, _LINES):
                # If integers follow, a number without a dot must be an integer.
                stream.write(number_lines(array[start : start + _LINES], dotted=variant.iblank))


def _count_integers(path: Path) -> int:
    with path.open("rb") as stream:
        return count_integers(stream)


class _Text:
    """The numbers of a text starting at ``position``, read in sequence."""

    def __init__(self, path: Path, numbers: FloatArray, position: int) -> None:
        self._path, self._numbers, self._position = path, numbers, position

    def take(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """The next ``count`` numbers."""
        taken = self._numbers[self._position : self._position + count]
        self._position += count
        return taken if dtype.kind == "f" else _integers(taken, self._path)


def _integers(values: FloatArray, path: Path) -> FloatArray:
    whole = (values == np.rint(values)) & (np.abs(values) < 2**31)
    if not whole.all():
        first = values[np.argmin(whole)]
        raise FormatError(f"{path} has the size for IBLANK values, but one of them is {first:g}, not an integer")
    return values
