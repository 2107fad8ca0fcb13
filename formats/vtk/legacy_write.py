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

from meshdeform_core.grid import Grid

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

# Sections that define the role of an array: keyword, the line, and possible numbers of components.
_SECTIONS = {
    "Scalars": ("SCALARS", "{0} {1} {3} {2}\nLOOKUP_TABLE default", (1, 2, 3, 4)),
    "Vectors": ("VECTORS", "{0} {1} {3}", (3,)),
    "Normals": ("NORMALS", "{0} {1} {3}", (3,)),
    "Tensors": ("TENSORS", "{0} {1} {3}", (9,)),
    "TCoords": ("TEXTURE_COORDINATES", "{0} {1} {2} {3}", (1, 2, 3)),
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
        shape, origin = grid.shapes[block], variant.origins[block] if variant.origins else (0, 0, 0)
        extent = " ".join(f"{low} {low + n - 1}" for low, n in zip(origin, shape, strict=True))
        output.line(f"EXTENT {extent}" if any(origin) else "DIMENSIONS {} {} {}".format(*shape))
        output.line(f"POINTS {points.tuples} {_type_name(points)}")
        output.values(points)
        for keyword, location in (("CELL_DATA", "cell"), ("POINT_DATA", "node")):
            output.attributes(keyword, [a for a in arrays if a.location == location])
    return {number: output.places[id(array)] for number, array in enumerate(contents) if id(array) in output.places}


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
            flat = array.run()
            number = {"f4": "%.9g", "f8": "%.17g"}.get(flat.dtype.str[1:], "%d")
            line = " ".join([number] * _VALUES_PER_LINE) + "\n"
            at_once = _LINES_AT_ONCE * _VALUES_PER_LINE
            for start in range(0, flat.size, at_once):
                part = flat[start : start + at_once].tolist()
                full, rest = divmod(len(part), _VALUES_PER_LINE)
                self.line((line * full + " ".join([number] * rest)) % tuple(part))
            return
        kind = array.precision.newbyteorder(">")
        if array.in_planes:
            self.places[id(array)] = self.stream.tell(), kind
            self.stream.seek(array.nbytes, os.SEEK_CUR)
        else:
            self.stream.write(array.run().astype(kind, copy=False).data)
        self.stream.write(b"\n")

    def attributes(self, keyword: str, arrays: Sequence[StoredArray]) -> None:
        """CELL_DATA or POINT_DATA: sections for the arrays with a role, the others as a FIELD."""
        if arrays:
            self.line(f"{keyword} {arrays[0].tuples}")
        others = []
        for array in arrays:
            found = (_SECTIONS[role] for role in array.roles if role in _SECTIONS)
            section, form, _ = next((each for each in found if array.components in each[2]), ("", "", ()))
            if not section:
                others.append(array)
                continue
            self.line(form.format(section, _encoded(array.name), array.components, _type_name(array)))
            self._values_and_metadata(array)
        self.fields(others)

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


def _type_name(array: StoredArray) -> str:
    return _TYPE_NAMES[array.precision.str[1:]]


def _encoded(name: str) -> str:
    return quote(name, safe=_PLAIN)
