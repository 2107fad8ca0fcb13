"""Writing structured grids to legacy VTK files (.vtk), ASCII or big-endian binary.

Not written by VTK, whose writer rounds the numbers of ASCII files to 11 digits: here all values are exact.
"""

from __future__ import annotations

import os
import string
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Grid, Shape

from .dataset import Reserved, StoredArray, VtkFormat

_TYPE_NAMES = {
    "i1": "char",
    "u1": "unsigned_char",
    "i2": "short",
    "u2": "unsigned_short",
    "i4": "int",
    "u4": "unsigned_int",
    "i8": "vtktypeint64",
    "u8": "vtktypeuint64",
    "f4": "float",
    "f8": "double",
}

# Sections that define the role of an array, and their possible numbers of components.
_SECTIONS = {
    "Scalars": ("SCALARS", (1, 2, 3, 4)),
    "Vectors": ("VECTORS", (3,)),
    "Normals": ("NORMALS", (3,)),
    "Tensors": ("TENSORS", (9,)),
    "TCoords": ("TEXTURE_COORDINATES", (1, 2, 3)),
}

# VTK encodes blanks, quotation marks and percent signs in names.
_PLAIN = "".join(sorted(set(string.punctuation) - set('"%')))

_VALUES_PER_LINE = 9
_LINES_AT_ONCE = 10_000


def begin_block(grid: Grid, block: int, path: Path, variant: VtkFormat, contents: Sequence[StoredArray]) -> Reserved:
    """Write one block, in binary without the values that have planes; returns the places of these.

    Roles without a legacy section are lost, but never values.
    """
    points, *arrays = contents
    with path.open("wb") as stream:
        output = _Output(stream, variant.options["encoding"])
        output.line("# vtk DataFile Version 4.2")
        output.line(variant.title[:255])
        output.line(variant.options["encoding"].upper())
        output.line("DATASET STRUCTURED_GRID")
        output.fields([a for a in arrays if not a.location])
        output.line(_extent(grid.shapes[block], variant.origins[block] if variant.origins else (0, 0, 0)))
        output.line(f"POINTS {points.tuples} {_type_name(points)}")
        output.values(points)
        for keyword, location in (("CELL_DATA", "cell"), ("POINT_DATA", "node")):
            output.attributes(keyword, [a for a in arrays if a.location == location])
    return {number: output.places[id(array)] for number, array in enumerate(contents) if id(array) in output.places}


def _extent(shape: Shape, origin: Shape) -> str:
    if origin == (0, 0, 0):
        return f"DIMENSIONS {shape[0]} {shape[1]} {shape[2]}"
    return "EXTENT " + " ".join(f"{low} {low + n - 1}" for low, n in zip(origin, shape, strict=True))


class _Output:
    """A legacy file being written."""

    def __init__(self, stream: BinaryIO, encoding: str) -> None:
        self.stream = stream
        self.binary = encoding == "binary"
        self.places: dict[int, tuple[int, np.dtype[Any]]] = {}

    def line(self, text: str) -> None:
        self.stream.write(f"{text}\n".encode())

    def values(self, array: StoredArray) -> None:
        if not self.binary:
            self._text(array.run())
            return
        kind = array.precision.newbyteorder(">")
        if array.in_planes:
            self.places[id(array)] = self.stream.tell(), kind
            self.stream.seek(array.nbytes, os.SEEK_CUR)
        else:
            self.stream.write(array.run().astype(kind, copy=False).data)
        self.stream.write(b"\n")

    def _text(self, flat: NDArray[Any]) -> None:
        number = {"f4": "%.9g", "f8": "%.17g"}.get(flat.dtype.str[1:], "%d")
        line = " ".join([number] * _VALUES_PER_LINE) + "\n"
        at_once = _LINES_AT_ONCE * _VALUES_PER_LINE
        for start in range(0, flat.size, at_once):
            part = flat[start : start + at_once].tolist()
            full, rest = divmod(len(part), _VALUES_PER_LINE)
            self.line((line * full + " ".join([number] * rest)) % tuple(part))

    def attributes(self, keyword: str, arrays: Sequence[StoredArray]) -> None:
        """CELL_DATA or POINT_DATA: sections for the arrays with a role, the others as a FIELD."""
        if not arrays:
            return
        self.line(f"{keyword} {arrays[0].tuples}")
        others = []
        for array in arrays:
            if section := _section_keyword(array):
                self._section(section, array)
            else:
                others.append(array)
        self.fields(others)

    def _section(self, keyword: str, array: StoredArray) -> None:
        components = {"SCALARS": " {1} {0}", "TEXTURE_COORDINATES": " {0} {1}"}.get(keyword, " {1}")
        words = components.format(array.components, _type_name(array))
        self.line(f"{keyword} {_encoded(array.name)}{words}")
        if keyword == "SCALARS":
            self.line("LOOKUP_TABLE default")
        self._values_and_metadata(array)

    def fields(self, arrays: Sequence[StoredArray]) -> None:
        """A FIELD of arrays."""
        if arrays:
            self.line(f"FIELD FieldData {len(arrays)}")
        for array in arrays:
            size = f"{array.components} {array.tuples}"
            self.line(f"{_encoded(array.name)} {size} {_type_name(array)}")
            self._values_and_metadata(array)

    def _values_and_metadata(self, array: StoredArray) -> None:
        self.values(array)
        if array.component_names:
            self.line("METADATA\nCOMPONENT_NAMES")
            self.line("\n".join(map(_encoded, array.component_names)) + "\n")


def _section_keyword(array: StoredArray) -> str:
    for role in array.roles:
        keyword, components = _SECTIONS.get(role, ("", ()))
        if array.components in components:
            return keyword
    return ""


def _type_name(array: StoredArray) -> str:
    return _TYPE_NAMES[array.precision.str[1:]]


def _encoded(name: str) -> str:
    return quote(name, safe=_PLAIN)
