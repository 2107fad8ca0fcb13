"""Writing structured grids to VTK's XML files (.vts): text, or raw appended data, as they are or packed by zlib."""

from __future__ import annotations

import os
import re
import zlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..text import number_lines
from .dataset import BlockOutput, Reserved, StoredArray, VtkFormat
from .xml_arrays import SECTIONS, TYPES

_TYPE_NAMES = {code: name for name, code in TYPES.items()}

# Bytes that VTK compresses as one block, and its level of compression.
_BLOCK, _LEVEL = 1 << 15, 5

# Space for the offset of an array in its tag, which is written before the offset is known.
_OFFSET_DIGITS = 20

_REPLACED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
_ESCAPES = str.maketrans(_REPLACED)
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def begin_block(grid: Grid, block: int, path: Path, variant: VtkFormat, contents: Sequence[StoredArray]) -> Reserved:
    """Write one block to a .vts file, where values are stored as they are without those that have planes; returns the
    places of these.

    Raises FormatError when a field cannot be stored in a VTK file. Raises OSError when the file cannot be written.
    """
    points, *arrays = contents
    extent = " ".join(f"0 {n - 1}" for n in grid.shapes[block])
    with path.open("wb") as stream:
        output = _Output(stream, variant)
        output.data_set(extent, points, arrays)
    return output.reserved(contents)


def plain(options: Mapping[str, str]) -> bool:
    """Whether values are stored as they are."""
    return options["encoding"] == "appended" and options["compression"] == "none"


def attribute(text: str) -> str:
    """A text as the value of an XML attribute.

    Raises FormatError when it contains characters that XML cannot hold.
    """
    if bad := _NOT_IN_XML.search(text):
        raise FormatError(f"the name {text!r} contains the character {bad[0]!r}, which a VTK file cannot hold")
    return f'"{text.translate(_ESCAPES)}"'


def _in_blocks(pieces: Iterable[bytes], size: int) -> Iterator[bytes]:
    """The bytes of all pieces in blocks of equal size; the last one may be smaller."""
    rest = b""
    for piece in pieces:
        data = rest + piece
        whole = len(data) // size * size
        for first in range(0, whole, size):
            yield data[first : first + size]
        rest = data[whole:]
    if rest:
        yield rest


class _Output(BlockOutput):
    """A .vts file being written."""

    def __init__(self, stream: BinaryIO, variant: VtkFormat) -> None:
        super().__init__(stream)
        self.options, self.packed = variant.options, variant.options["compression"] == "zlib"
        self.appended: list[tuple[StoredArray, int]] = []

    def data_set(self, extent: str, points: StoredArray, arrays: Sequence[StoredArray]) -> None:
        compressor = ' compressor="vtkZLibDataCompressor"' if self.packed else ""
        head = 'type="StructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        self.line(f'<?xml version="1.0"?>\n<VTKFile {head}{compressor}>')
        self.line(f'  <StructuredGrid WholeExtent="{extent}">')
        field_data = [array for array in arrays if not array.location]
        if field_data:
            self.section("FieldData", field_data)
        self.line(f'    <Piece Extent="{extent}">')
        for tag in ("PointData", "CellData"):
            self.section(tag, [array for array in arrays if array.location == SECTIONS[tag]])
        self.section("Points", [points])
        self.line("    </Piece>\n  </StructuredGrid>")
        if self.appended:
            self.append()
        self.line("</VTKFile>")

    def section(self, tag: str, arrays: Sequence[StoredArray]) -> None:
        self.line(f"      <{tag}>")
        for array in arrays:
            self.array(array)
        self.line(f"      </{tag}>")

    def array(self, array: StoredArray) -> None:
        words = [f'type="{_TYPE_NAMES[array.precision.str[1:]]}"']
        words.append(f"Name={attribute(array.name)}")
        if array.components != 1:
            words.append(f'NumberOfComponents="{array.components}"')
        if not array.location:
            words.append(f'NumberOfTuples="{array.tuples}"')
        kind = self.options["encoding"]
        self.stream.write(f'        <DataArray {" ".join(words)} format="{kind}"'.encode())
        if kind == "appended":
            self.stream.write(b' offset="')
            self.appended.append((array, self.stream.tell()))
            self.line(" " * (_OFFSET_DIGITS + 1) + "/>")
            return
        self.line(">")
        self.text(array)
        self.line("        </DataArray>")

    def text(self, array: StoredArray) -> None:
        for slab in array.slabs():
            # The writer of numbers knows no integers of 8 or 16 bits.
            wide = slab.astype(np.int64) if slab.dtype.itemsize < 4 else slab
            lines = number_lines(wide)
            if wide.dtype.kind == "f" and not np.isfinite(wide).all():
                # VTK stumbles over longer words.
                lines = memoryview(bytes(lines).replace(b"Infinity", b"inf").replace(b"NaN", b"nan"))
            self.stream.write(lines)

    def binary(self, array: StoredArray) -> None:
        """The sizes and values of an array; compressed or not."""
        pieces = (slab.astype(slab.dtype.newbyteorder("<"), copy=False).tobytes() for slab in array.slabs())
        if not self.packed:
            self.sizes([array.nbytes])
            self.stream.writelines(pieces)
            return
        place, sizes = self.stream.tell(), [-(-array.nbytes // _BLOCK), _BLOCK, array.nbytes % _BLOCK]
        # The compressed sizes precede the blocks: they are written when they are known.
        self.stream.seek(8 * (3 + sizes[0]), os.SEEK_CUR)
        for block in _in_blocks(pieces, _BLOCK):
            data = zlib.compress(block, _LEVEL)
            sizes.append(len(data))
            self.stream.write(data)
        end = self.stream.tell()
        self.stream.seek(place)
        self.sizes(sizes)
        self.stream.seek(end)

    def sizes(self, sizes: list[int]) -> None:
        self.stream.write(np.array(sizes, "<u8").tobytes())

    def append(self) -> None:
        """All arrays in sequence, and their offsets in the tags."""
        self.stream.write(b'  <AppendedData encoding="raw">\n   _')
        start = self.stream.tell()
        for array, place in self.appended:
            offset = self.stream.tell() - start
            self.stream.seek(place)
            self.stream.write(f'{offset}"'.encode())
            self.stream.seek(start + offset)
            if array.in_planes and plain(self.options):
                # All ranks write these values later.
                self.sizes([array.nbytes])
                self.reserve(array, array.precision.newbyteorder("<"))
            else:
                self.binary(array)
        self.line("\n  </AppendedData>")
