"""Writing structured grids to VTK's XML files (.vts): text, or raw appended data."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid

from .dataset import BlockOutput, Reserved, StoredArray
from .xml_arrays import SECTIONS, TYPES

_TYPE_NAMES = {code: name for name, code in TYPES.items()}

# Space for the offset of an array in its tag, which is written before the offset is known.
_OFFSET_DIGITS = 20

_REPLACED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
_ESCAPES = str.maketrans(_REPLACED)
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def begin_block(grid: Grid, block: int, path: Path, variant: FileFormat, contents: Sequence[StoredArray]) -> Reserved:
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


def attribute(text: str) -> str:
    """A text as the value of an XML attribute.

    Raises FormatError when it contains characters that XML cannot hold.
    """
    if bad := _NOT_IN_XML.search(text):
        raise FormatError(f"the name {text!r} contains the character {bad[0]!r}, which a VTK file cannot hold")
    return f'"{text.translate(_ESCAPES)}"'


class _Output(BlockOutput):
    """A .vts file being written."""

    def __init__(self, stream: BinaryIO, variant: FileFormat) -> None:
        super().__init__(stream)
        self.encoding = variant.options["encoding"]
        self.appended: list[tuple[StoredArray, int]] = []

    def data_set(self, extent: str, points: StoredArray, arrays: Sequence[StoredArray]) -> None:
        head = 'type="StructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
        self.line(f'<?xml version="1.0"?>\n<VTKFile {head}>')
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
        self.stream.write(f'        <DataArray {" ".join(words)} format="{self.encoding}"'.encode())
        if self.encoding == "appended":
            self.stream.write(b' offset="')
            self.appended.append((array, self.stream.tell()))
            self.line(" " * (_OFFSET_DIGITS + 1) + "/>")
            return
        self.line(">")
        self.text(array)
        self.line("        </DataArray>")

    def append(self) -> None:
        """All arrays in sequence, and their offsets in the tags."""
        self.stream.write(b'  <AppendedData encoding="raw">\n   _')
        start = self.stream.tell()
        for array, place in self.appended:
            offset = self.stream.tell() - start
            self.stream.seek(place)
            self.stream.write(f'{offset}"'.encode())
            self.stream.seek(start + offset)
            self.stream.write(np.array(array.nbytes, "<u8").tobytes())
            self.binary(array, "<")
        self.line("\n  </AppendedData>")
