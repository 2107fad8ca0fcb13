"""Plot3D as text: Fortran's list-directed input, and exact shortest numbers on output."""

from __future__ import annotations

import codecs
import contextlib
import math
import re
from collections import deque
from collections.abc import Iterator, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid

from .. import text
from ..planes import merge, split
from .binary import allocate, iblank_of
from .variant import LONGEST_HEADER, Reading, UnknownFile, Variant, choose, header_variants, stream_readings

# Bytes of text read at a time.
_PIECE = 1 << 23
# Numbers that a piece of text may stand for; more can only be a nonsensical repeat count.
_MOST_REPEATED = 1 << 28
_LONGEST_NUMBER = 64
# Numbers written per call.
_LINES = 1 << 20

_SPELLED = bytes.maketrans(b",DQdq", b" EEEE")

_WORD = re.compile(rb"[^\s,]+")
_WHOLE_LINE = re.compile(rb"^(-?\d+)$", re.MULTILINE)
_INTEGER = re.compile(rb"(?:\d+\*)?[+-]?\d+")
_NULL_VALUE = re.compile(rb",\s*,")
_NUMBER = re.compile(
    rb"(?:(0*[1-9]\d*)\*)?"  # repeat count
    rb"(?:([+-]?(?:\d+\.?\d*|\.\d+))(?:[EDQ]([+-]?\d+)|([+-]\d+))?"  # the exponent letter may be missing before a sign
    rb"|([+-]?(?:NAN|INF(?:INITY)?)))",
    re.IGNORECASE,
)


def read_numbers(stream: BinaryIO, path: Path) -> FloatArray:
    """All numbers of a text, in order.

    Accepts blanks, tabs, commas and line ends between numbers, repeat counts (``3*0.0``), and exponents with E, D, Q or
    no letter (``1.5-101``).
    """
    line, found, before = 1, [np.empty(0)], b","
    for piece in _pieces(stream):
        if b"," in piece and (null := _NULL_VALUE.search(before + piece)):
            place = _place(path, line, (before + piece)[: null.end()])
            raise FormatError(f"{place}: no number before a comma; null values leave numbers undefined; write them out")
        found.append(_numbers_of_piece(piece, line, path))
        line, before = line + piece.count(b"\n"), piece.rstrip()[-1:] or before
    return np.concatenate(found)


def _pieces(stream: BinaryIO) -> Iterator[bytes]:
    """A whole text, without the byte order mark that some editors write, in pieces of whole lines."""
    stream.seek(0)
    if stream.read(len(codecs.BOM_UTF8)) != codecs.BOM_UTF8:
        stream.seek(0)
    while lines := stream.readlines(_PIECE):
        yield b"".join(lines)


def number_lines(values: NDArray[Any], dotted: bool = False) -> bytes | memoryview:
    """The values one per line, each with the fewest digits that represent it exactly in its own type.

    The last of real values, or with ``dotted`` each, is written as a real number, as readings are told apart by that.
    """
    lines = text.number_lines(values)
    if dotted and values.dtype.kind == "f":
        return _WHOLE_LINE.sub(rb"\1.", bytes(lines))
    last = _WORD.findall(bytes(lines[-_LONGEST_NUMBER:]))[-1]
    return bytes(lines[:-1]) + b".\n" if values.dtype.kind == "f" and _INTEGER.fullmatch(last) else lines


def _numbers_of_piece(text: bytes, line: int, path: Path) -> FloatArray:
    """The numbers in a piece of text that begins on line ``line``."""
    if b"*" not in text and b"_" not in text:
        # Python also reads 1_000. What it does not read may be an exponent without a letter, or no number.
        with contextlib.suppress(ValueError):
            return np.array(list(map(float, text.translate(_SPELLED).split())), np.float64)
    # The numbers read word by word, for repeat counts and exponents without a letter, and to locate invalid words.
    counts, values = [], []
    for word in _WORD.finditer(text):
        number = _NUMBER.fullmatch(word[0])
        if number is None:
            found = word[0][:40].decode("ascii", "replace")
            raise FormatError(
                f"{_place(path, line, text[: word.start()])}: found {found!r} where a Plot3D text has a number (like "
                f"12, 1.5, 1.5D+00 or 3*1.5); comments, other text, null values and '/' are not part of it"
            )
        count, mantissa, exponent, bare_exponent, named = number.groups()
        counts.append(int(count or 1))
        values.append(float(named or b"%be%b" % (mantissa, exponent or bare_exponent or b"0")))
    if sum(counts) > _MOST_REPEATED:
        place = _place(path, line, b"")
        raise FormatError(f"{place}: from here on repeat counts give {sum(counts)} numbers; the file is damaged")
    return np.repeat(np.array(values, np.float64), counts)


def _place(path: Path, line: int, before: bytes) -> str:
    line += before.count(b"\n")
    return f"{path}, line {line}"


# --- grids


def read_ascii(path: Path, options: Mapping[str, Any]) -> Grid:
    """Read a Plot3D text of any variant that ``options`` allow."""
    with path.open("rb") as stream:
        numbers = read_numbers(stream, path)

    def proved_by_notation(readings: list[Reading]) -> list[Reading]:
        """The readings that the notation of the numbers proves: none if real numbers are written as integers."""
        with path.open("rb") as stream:
            last = deque((piece for piece in _pieces(stream) if not piece.isspace()), maxlen=1)[0]
            if not _INTEGER.fullmatch(_WORD.findall(last)[-1]):
                return [reading for reading in readings if not reading.variant.iblank]
            integers = (word for piece in _pieces(stream) for word in _WORD.findall(piece) if _INTEGER.fullmatch(word))
            count = sum(int(word.partition(b"*")[0]) if b"*" in word else 1 for word in integers)
        return [r for r in readings if r.variant.iblank and r.segments[0][0] + sum(map(math.prod, r.shapes)) == count]

    def load(reading: Reading) -> Grid:
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

    head = numbers[:LONGEST_HEADER]
    integers = np.where((head == np.rint(head)) & (np.abs(head) < 2**31), head, 0).astype(np.int64)
    variants = header_variants(encoding="ascii", precision=options.get("precision", "float64"))
    readings = stream_readings(variants, integers, numbers.size)
    return choose(readings, UnknownFile(path, numbers.size, "numbers", options, load, proved_by_notation))


def write_ascii(grid: Grid, stream: BinaryIO, variant: Variant) -> None:
    """Write all blocks, one number per line."""
    if variant.multiblock:
        stream.write(b"%d\n" % grid.n_blocks)
    for shape in grid.shapes:
        stream.write(" ".join(str(n) for n in shape[: variant.dimension]).encode() + b"\n")
    for index in range(grid.n_blocks):
        arrays = split(grid.block(index), variant.real, variant.dimension)
        if variant.iblank:
            iblank = iblank_of(grid, index)
            flags = np.ones(grid.shapes[index]) if iblank is None else iblank.values
            arrays = chain(arrays, [np.ascontiguousarray(flags.T, variant.integer)])
        for flat in (array.reshape(-1) for array in arrays):
            for start in range(0, flat.size, _LINES):
                # If integers follow, a number without a dot must be an integer.
                stream.write(number_lines(flat[start : start + _LINES], dotted=variant.iblank))
