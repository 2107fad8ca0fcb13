"""Structured grids in legacy VTK files (.vtk), ASCII or big-endian binary.

A file consists of keyword lines with runs of values between them. It is not read by VTK, whose reader fills the missing
part of a truncated file with garbage and reports success, and not written by it, as it rounds the numbers of ASCII
files to 11 digits: here all values are exact. Source: VTK User's Guide, "VTK File Formats"; for versions 4.2 to 5.1 the
output of ``vtkDataWriter``.
"""

from __future__ import annotations

import os
import re
import string
from collections.abc import Sequence
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote, unquote

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.parallel import Ranks

from ..text import strict_numbers
from .dataset import BlockOutput, DataArray, DataSet, Reserved, Run, StoredArray, Values

# Value types and their numpy codes. VTK writes ids in binary files with 4 bytes.
TYPES = {
    "char": "i1",
    "signed_char": "i1",
    "unsigned_char": "u1",
    "short": "i2",
    "unsigned_short": "u2",
    "int": "i4",
    "unsigned_int": "u4",
    "long": "i8",
    "unsigned_long": "u8",
    "vtktypeint64": "i8",
    "vtktypeuint64": "u8",
    "vtkidtype": "i8",
    "float": "f4",
    "double": "f8",
}
# The name under which each type is written.
_TYPE_NAMES = {code: name for name, code in TYPES.items()} | {"i1": "char", "i8": "vtktypeint64"}
_LONGEST_LINE = 4096
_CUT_EXPONENT = re.compile(rb"[eE][+-]?(?![+\-\d])")

_OTHER_KINDS = {
    "POLYDATA": "a polygon surface",
    "UNSTRUCTURED_GRID": "an unstructured grid",
    "RECTILINEAR_GRID": "a rectilinear grid; save it as a structured grid",
    "STRUCTURED_POINTS": "an image; save it as a structured grid",
    "FIELD": "field data",
}

_LOCATIONS = {"POINT_DATA": "node", "CELL_DATA": "cell"}
# Attributes with a fixed number of components.
_FIXED = {"VECTORS": 3, "NORMALS": 3, "TENSORS": 9, "TENSORS6": 6, "GLOBAL_IDS": 1, "PEDIGREE_IDS": 1, "EDGE_FLAGS": 1}
# Words on the line of each section with attributes, and the most of them.
_WORDS = {
    **dict.fromkeys(_LOCATIONS, (2, 2)),
    **dict.fromkeys((*_FIXED, "FIELD", "LOOKUP_TABLE", "COLOR_SCALARS"), (3, 3)),
    "SCALARS": (3, 4),
    "TEXTURE_COORDINATES": (4, 4),
}


class LegacyFile:
    """A legacy file being read: keyword lines, runs of values, and the position of every error.

    Attributes
    ----------
    later : whether binary values of nodes and cells remain to be read
    binary : True for BINARY (big-endian), False for ASCII
    kind : the word after DATASET, e.g. ``STRUCTURED_GRID``
    arrays : those of the sections read
    notes : what is not kept
    """

    def __init__(self, path: Path, stream: BinaryIO, later: bool = False) -> None:
        self.path, self.stream, self.later = path, stream, later
        self.size, self.binary = path.stat().st_size, False
        self.arrays: list[DataArray] = []
        self.notes: list[str] = []
        # Where the arrays that follow belong, and their length.
        self._location, self._length = "", 0
        stream.readline(_LONGEST_LINE)
        # The title.
        self._line()
        # VTK's readers skip blank lines after the title.
        encoding = " ".join(self.words()).upper()
        if encoding not in ("ASCII", "BINARY"):
            raise self.error(f"expected ASCII or BINARY, found {encoding[:40]!r}")
        self.binary = encoding == "BINARY"
        words = self.words()
        if len(words) != 2 or words[0].upper() != "DATASET":
            raise self.error(f"expected 'DATASET kind', found {' '.join(words)[:40]!r}")
        self.kind = words[1].upper()

    def error(self, message: str) -> FormatError:
        """An error with the current position: the line, or the byte of a binary file."""
        position = self.stream.tell()
        self.stream.seek(0)
        line = self.stream.read(position).count(b"\n")
        self.stream.seek(position)
        return FormatError(f"{self.path}, {f'byte {position}' if self.binary else f'line {line}'}: {message}")

    def words(self) -> list[str]:
        """The words of the next line that has any; empty at the end of the file."""
        while self.stream.tell() < self.size:
            if words := self._line().split():
                return words
        return []

    def _line(self) -> str:
        return self.stream.readline(_LONGEST_LINE).decode("utf-8", "replace").strip()

    def number(self, word: str) -> int:
        """A count from a keyword line."""
        if not (word.isascii() and word.isdigit()):
            raise self.error(f"expected a number, found {word!r}")
        return int(word)

    def values(self, count: int, type_name: str, what: str, later: bool = False) -> Any:
        """The next ``count`` values, ``(count,)``, in the byte order of the file; with ``later``, binary ones remain to
        be read.
        """
        name = type_name.lower()
        if name == "bit":
            if not self.binary:
                return self.values(count, "unsigned_char", what)
            return np.unpackbits(self.values((count + 7) // 8, "unsigned_char", what))[:count]
        if name not in TYPES:
            raise self.error(f"{what}: unknown type {type_name!r}; known are {' '.join(TYPES)} and bit")
        code = "i4" if self.binary and name == "vtkidtype" else TYPES[name]
        dtype = np.dtype(code).newbyteorder(">" if self.binary else "=")
        # Each number of a text takes at least two bytes: never allocate more than the file can hold.
        needed = count * dtype.itemsize if self.binary else max(2 * count - 1, 0)
        start = self.stream.tell()
        if needed > self.size - start:
            left = self.size - start
            raise self.error(f"{what}: {count} values need {needed} bytes, {left} are left; the file is truncated")
        if later and self.binary:
            self.stream.seek(needed, os.SEEK_CUR)
            return Run(self.path, dtype, start, (count,))
        try:
            with strict_numbers():
                values = np.fromfile(self.stream, dtype, count, sep="" if self.binary else " ")
            if not self.binary:
                end = self.stream.tell()
                self.stream.seek(start)
                # numpy reads 5 where it finds 5E-.
                if _CUT_EXPONENT.search(self.stream.read(end - start)):
                    raise ValueError
        except ValueError as error:
            raise self.error(f"{what}: expected {count} values, found something that is not a number") from error
        if len(values) != count:
            raise self.error(f"{what}: expected {count} values, found {len(values)}; the file is truncated or wrong")
        return values

    def skip_metadata(self) -> None:
        """Skip the METADATA that may follow an array, such as names of components."""
        position = self.stream.tell()
        if [word.upper() for word in self.words()] != ["METADATA"]:
            self.stream.seek(position)
            return
        while self._line():
            pass

    def skip_strings(self, count: int) -> None:
        """Skip a string array: one string per line, or in binary after a length of 1, 2, 4 or 8 bytes."""
        for _ in range(count):
            if not self.binary:
                self.stream.readline()
            elif first := self.stream.read(1):
                width = 1 << (3 - (first[0] >> 6))
                length = int.from_bytes(first + self.stream.read(width - 1), "big") & ~(3 << (8 * width - 2))
                self.stream.seek(min(length, self.size - self.stream.tell()), 1)

    def read_section(self, words: list[str]) -> None:
        """Read the section of attributes that begins with the line ``words``."""
        keyword, number = words[0].upper(), self.number
        few, many = _WORDS.get(keyword, (0, 0))
        if not few <= len(words) <= many:
            raise self.error(f"expected a section of a VTK file, found {' '.join(words)[:60]!r}")
        colour_type = "unsigned_char" if self.binary else "float"
        if keyword in _LOCATIONS:
            self._location, self._length = _LOCATIONS[keyword], number(words[1])
        elif keyword == "FIELD":
            for _ in range(number(words[2])):
                self._read_field(self.words())
        elif keyword == "LOOKUP_TABLE":
            self.values(4 * number(words[2]), colour_type, f"lookup table {words[1]!r}")
            self.notes.append(f"the lookup table {words[1]!r} is not kept")
        elif keyword == "SCALARS":
            table = self.words()
            if len(table) != 2 or table[0].upper() != "LOOKUP_TABLE":
                raise self.error(f"expected 'LOOKUP_TABLE name' after SCALARS, found {' '.join(table)[:60]!r}")
            self._read_array(words[1], number(words[3]) if len(words) == 4 else 1, words[2], self._length)
        elif keyword == "COLOR_SCALARS":
            name, _, values = self._read_array(words[1], number(words[2]), colour_type, self._length)
            if not self.binary:
                colours = np.rint(255 * np.clip(values, 0, 1)).astype(np.uint8)
                self.arrays[-1] = DataArray(name, self._location, colours)
        else:
            components = number(words[2]) if keyword == "TEXTURE_COORDINATES" else _FIXED[keyword]
            self._read_array(words[1], components, words[-1], self._length)

    def _read_field(self, words: list[str]) -> None:
        if words[:1] == ["NULL_ARRAY"]:
            return
        if len(words) != 4:
            raise self.error(f"expected 'name components tuples type' of an array, found {' '.join(words)!r}")
        components, length = self.number(words[1]), self.number(words[2])
        if words[3].lower() in ("string", "utf8_string"):
            self.skip_strings(components * length)
            self.notes.append(f"the text array {unquote(words[0])!r} is not kept")
        else:
            self._read_array(words[0], components, words[3], length)

    def _read_array(self, name: str, components: int, type_name: str, length: int) -> DataArray:
        later = self.later and bool(self._location)
        values = self.values(components * length, type_name, f"array {unquote(name)!r}", later)
        self.skip_metadata()
        values = values if components == 1 else values.reshape(length, components)
        self.arrays.append(DataArray(unquote(name), self._location, values))
        return self.arrays[-1]


def read(path: Path, ranks: Ranks) -> DataSet:
    """Read the structured data set of a legacy file; a text only without other ranks."""
    with path.open("rb") as stream:
        file = LegacyFile(path, stream, later=True)
        if file.kind != "STRUCTURED_GRID":
            other = _OTHER_KINDS.get(file.kind, "another kind of data set")
            raise FormatError(f"{path} is {other} (DATASET {file.kind}); expected a structured grid")
        if not file.binary:
            ranks.require_one(f"{path} is text")
        shape: list[int] = []
        points: Values | None = None
        while words := file.words():
            keyword = words[0].upper()
            if keyword == "DIMENSIONS":
                if len(words) != 4 or not all(word.isascii() and word.isdigit() for word in words[1:]):
                    raise file.error(f"DIMENSIONS: expected 3 whole numbers, found {' '.join(words[1:])[:60]!r}")
                shape = [int(word) for word in words[1:]]
            elif keyword == "POINTS":
                if len(words) != 3:
                    raise file.error(f"expected 'POINTS number type', found {' '.join(words)[:60]!r}")
                points = file.values(3 * file.number(words[1]), words[2], keyword, later=True)
                file.skip_metadata()
            else:
                file.read_section(words)
        # A number truncated at the end of a text is still a number.
        stream.seek(-1, os.SEEK_END)
        complete = file.binary or stream.read(1).isspace()
    if not shape or points is None:
        raise FormatError(f"{path} has no {'POINTS' if shape else 'DIMENSIONS'}; is the file truncated?")
    ni, nj, nk = shape
    if 0 in shape:
        raise FormatError(f"{path} is an empty grid: {ni} x {nj} x {nk} nodes")
    if len(points) != 3 * ni * nj * nk:
        raise FormatError(f"{path} has {len(points) // 3} points; its DIMENSIONS {ni} {nj} {nk} need {ni * nj * nk}")
    cut = "the last line has no line end; if the file is truncated there, its last number is wrong"
    options = {"encoding": "binary" if file.binary else "ascii"}
    return DataSet(
        points.reshape(nk, nj, ni, 3), tuple(file.arrays), options, (*([] if complete else [cut]), *file.notes)
    )


# --- writing

# VTK encodes blanks, quotation marks and percent signs in names.
_PLAIN = "".join(sorted(set(string.punctuation) - set('"%')))


def begin_block(grid: Grid, block: int, path: Path, variant: FileFormat, contents: Sequence[StoredArray]) -> Reserved:
    """Write one block, in binary without the values that have planes; returns the places of these."""
    (points, *arrays), encoding = contents, variant.options["encoding"]
    with path.open("wb") as stream:
        output = BlockOutput(stream, ">", encoding == "ascii")

        def put(head: str, array: StoredArray) -> None:
            output.line(f"{head} {_TYPE_NAMES[array.precision.str[1:]]}")
            output.values(array)
            if not output.as_text:
                output.line("")

        def put_fields(head: str, location: str) -> None:
            own = [array for array in arrays if array.location == location]
            if own:
                output.line(f"{head.format(own[0].tuples)}FIELD FieldData {len(own)}")
            for array in own:
                put(f"{quote(array.name, safe=_PLAIN)} {array.components} {array.tuples}", array)

        output.line(f"# vtk DataFile Version 4.2\nwritten by meshdeform\n{encoding.upper()}\nDATASET STRUCTURED_GRID")
        put_fields("", "")
        output.line("DIMENSIONS {} {} {}".format(*grid.shapes[block]))
        put(f"POINTS {points.tuples}", points)
        put_fields("CELL_DATA {}\n", "cell")
        put_fields("POINT_DATA {}\n", "node")
    return output.reserved(contents)
