"""The syntax of a legacy VTK file (.vtk): keyword lines with runs of values between them.

Not read by VTK, whose reader fills the missing part of a truncated file with garbage and reports success. Source: VTK
User's Guide, "VTK File Formats"; for versions 4.2 to 5.1 the output of ``vtkDataWriter``.
"""

from __future__ import annotations

import os
import warnings
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from .dataset import Run, Values

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

_LONGEST_LINE = 4096


class LegacyFile:
    """A legacy file being read: keyword lines, runs of values, and the position of every error.

    Attributes
    ----------
    title : second line of the file
    binary : True for BINARY (big-endian), False for ASCII
    kind : the word after DATASET, e.g. ``STRUCTURED_GRID``
    """

    def __init__(self, path: Path, stream: BinaryIO, later: bool = False) -> None:
        self.path = path
        self.stream = stream
        self.size = path.stat().st_size
        self.binary, self._later = False, later
        stream.readline(_LONGEST_LINE)
        self.title = self._line()
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

    def ends_in_a_line(self) -> bool:
        """Whether the last line is complete; a number truncated at the end of a text is still a number."""
        self.stream.seek(-1, 2)
        return self.stream.read(1).isspace()

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

    def values_or_run(self, count: int, type_name: str, what: str) -> Values:
        """As :meth:`values`, but binary ones remain to be read if the file was opened for that."""
        if not self.binary or not self._later or type_name.lower() == "bit":
            return self.values(count, type_name, what)
        run = Run(self.path, self._type_of(count, type_name, what), self.stream.tell(), (count,))
        self.stream.seek(count * run.dtype.itemsize, os.SEEK_CUR)
        return run

    def values(self, count: int, type_name: str, what: str) -> NDArray[Any]:
        """The next ``count`` values, ``(count,)``, in the byte order of the file.

        Raises
        ------
        FormatError
            When the file ends too early, contains anything but numbers, or the type is unknown.
        """
        if type_name.lower() == "bit":
            return self._bits(count, what)
        values = self._run(count, self._type_of(count, type_name, what), what)
        if len(values) != count:
            raise self.error(f"{what}: expected {count} values, found {len(values)}; the file is truncated or wrong")
        return values

    def _type_of(self, count: int, type_name: str, what: str) -> np.dtype[Any]:
        """The type of the next ``count`` values, for which the file must be long enough."""
        name = type_name.lower()
        if name not in TYPES:
            raise self.error(f"{what}: unknown type {type_name!r}; known are {' '.join(TYPES)} and bit")
        code = "i4" if self.binary and name == "vtkidtype" else TYPES[name]
        dtype = np.dtype(code).newbyteorder(">" if self.binary else "=")
        # Each number of a text takes at least two bytes: never allocate more than the file can hold.
        needed = count * dtype.itemsize if self.binary else max(2 * count - 1, 0)
        left = self.size - self.stream.tell()
        if needed > left:
            raise self.error(f"{what}: {count} values need {needed} bytes, {left} are left; the file is truncated")
        return dtype

    def _run(self, count: int, dtype: np.dtype[Any], what: str) -> NDArray[Any]:
        with warnings.catch_warnings():
            # numpy before 2.3 warns where later versions raise.
            warnings.simplefilter("error", DeprecationWarning)
            try:
                return np.fromfile(self.stream, dtype, count, sep="" if self.binary else " ")
            except (ValueError, DeprecationWarning) as error:
                raise self.error(f"{what}: expected {count} values, found something that is not a number") from error

    def _bits(self, count: int, what: str) -> NDArray[np.uint8]:
        if not self.binary:
            return self.values(count, "unsigned_char", what)
        return np.unpackbits(self.values((count + 7) // 8, "unsigned_char", what))[:count]

    def component_names(self) -> tuple[str, ...]:
        """Component names from the METADATA that may follow an array; the rest of METADATA is skipped."""
        position = self.stream.tell()
        if [word.upper() for word in self.words()] != ["METADATA"]:
            self.stream.seek(position)
            return ()
        lines = list(iter(self._line, ""))
        return tuple(map(unquote, lines[1:])) if lines and lines[0].upper() == "COMPONENT_NAMES" else ()

    def skip_strings(self, count: int) -> None:
        """Skip a string array: one string per line, or in binary after a length of 1, 2, 4 or 8 bytes."""
        for _ in range(count):
            if not self.binary:
                self.stream.readline()
            elif first := self.stream.read(1):
                width = 1 << (3 - (first[0] >> 6))
                length = int.from_bytes(first + self.stream.read(width - 1), "big") & ~(3 << (8 * width - 2))
                self.stream.seek(min(length, self.size - self.stream.tell()), 1)


def dataset_kind(path: Path) -> str:
    """The word after DATASET of a legacy file, in capitals."""
    with path.open("rb") as stream:
        return LegacyFile(path, stream).kind
