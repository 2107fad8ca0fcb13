"""Files of OpenFOAM's meshes: lists of points, faces and labels, as text or binary; those packed by gzip are read."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray

from ..files import reason_of, require_regular
from ..text import strict_numbers, text_rows
from .case import POLY_MESH

_ROWS_AT_ONCE = 20_000
_LABEL = np.dtype("<i4")
# Largest length of a row of text, which bounds what is decompressed.
_ROW_BYTES = 100
_BANNER = "/* Written by meshdeform */\n"
_LENGTH = re.compile(rb"\s*(?:(?://[^\n]*\n|/\*.*?\*/)\s*)*(\d+)\s*", re.DOTALL)
_CLOSED = -9
"""Stands for the closing parenthesis of a face."""


def write_points(path: Path, points: FloatArray, place: str, binary: bool) -> None:
    """A ``vectorField`` of points (n, 3); ``place`` is the folder that the header names."""
    with path.open("wb") as stream:
        _head(stream, "vectorField", "points", binary, place=place)
        _rows_in_list(stream, np.ascontiguousarray(points, dtype="<f8"), "(%.17g %.17g %.17g)\n", binary)


def write_labels(path: Path, labels: IntArray, binary: bool, note: str) -> None:
    """A ``labelList``; ``note`` holds the sizes of the mesh."""
    with path.open("wb") as stream:
        _head(stream, "labelList", path.name, binary, note)
        _rows_in_list(stream, labels.astype(_LABEL)[:, None], "%d\n", binary)


def write_faces(path: Path, corners: IntArray, kept: NDArray[np.bool_], binary: bool) -> None:
    """Faces from corners (n, 4) and which of them count: a ``faceList`` as text, a ``faceCompactList`` as binary."""
    sizes = kept.sum(axis=1)
    with path.open("wb") as stream:
        _head(stream, "faceCompactList" if binary else "faceList", "faces", binary)
        if binary:
            starts = np.concatenate([[0], np.cumsum(sizes)]).astype(_LABEL)
            _rows_in_list(stream, starts[:, None], "", True)
            _rows_in_list(stream, corners[kept].astype(_LABEL)[:, None], "", True)
            return
        stream.write(b"%d\n(\n" % len(corners))
        for begin in range(0, len(corners), _ROWS_AT_ONCE):
            rows = slice(begin, begin + _ROWS_AT_ONCE)
            lines = np.where(sizes[rows] == 4, "4(%d %d %d %d)", "3(%d %d %d)")
            stream.write(("\n".join(lines.tolist()) % tuple(corners[rows][kept[rows]].tolist()) + "\n").encode())
        stream.write(b")\n")


def write_boundary(path: Path, patches: list[str]) -> None:
    """The list of the patches, each as the text of its dictionary with its name before it."""
    with path.open("wb") as stream:
        _head(stream, "polyBoundaryMesh", "boundary", False)
        stream.write("\n".join([str(len(patches)), "(", *patches, ")", ""]).encode())


def _head(
    stream: BinaryIO, kind: str, name: str, binary: bool, note: str = "", place: str = POLY_MESH.as_posix()
) -> None:
    lines = ["version 2.0;", f"format {'binary' if binary else 'ascii'};", 'arch "LSB;label=32;scalar=64";']
    lines += [f"class {kind};", f'location "{place}";', f"object {name};"] + ([f'note "{note}";'] if note else [])
    stream.write((_BANNER + "FoamFile\n{\n" + "".join(f"    {line}\n" for line in lines) + "}\n\n").encode())


def _rows_in_list(stream: BinaryIO, rows: NDArray, line: str, binary: bool) -> None:
    """A list of rows (n, m): its length, and the values in parentheses."""
    stream.write(b"%d\n(" % len(rows))
    stream.writelines([np.ascontiguousarray(rows).data] if binary else [b"\n", *text_rows(rows, line)])
    stream.write(b")\n")


def read_points(path: Path, most: int) -> FloatArray:
    """The points (n, 3) of a mesh; no more than this many are expected.

    Raises FormatError when the file is damaged or is no field of points, as for the following functions.
    """
    return _ListFile(path, ("vectorField",), most).rows(float, 3)


def read_labels(path: Path, most: int) -> IntArray:
    """A list of labels (n,)."""
    return _ListFile(path, ("labelList",), most).rows(int, 1)[:, 0]


def read_faces(path: Path, most: int) -> tuple[IntArray, IntArray]:
    """The points (m,) of all faces, one face after another, and where each begins (n + 1,)."""
    file = _ListFile(path, ("faceList", "faceCompactList"), most)
    if file.binary:
        start = file.rows(int, 1)[:, 0]
        corners = file.rows(int, 1)[:, 0]
    else:
        count, numbers = file.count(), file.numbers_of_text(int, b" %d " % _CLOSED)
        # Each face is the number of its corners, the corners, and the mark of a parenthesis.
        end = np.flatnonzero(numbers == _CLOSED)
        sizes = np.diff(end, prepend=-1) - 2
        start = np.append(0, np.cumsum(sizes))
        inside = np.ones(len(numbers), dtype=bool)
        inside[end] = inside[end - sizes - 1] = False
        corners = numbers[inside]
        if len(end) != count or not (numbers[end - sizes - 1] == sizes).all():
            raise FormatError(f"{path} is truncated or damaged: the sizes of its {count:,} faces do not fit")
    if start[0] != 0 or start[-1] != len(corners) or (np.diff(start) < 3).any():
        raise FormatError(f"{path} is truncated or damaged: faces need three or more corners")
    return corners, start


def read_content(path: Path, most: int = -1) -> bytes:
    """The content of a file, decompressed, at most this many bytes of it."""
    require_regular(path)
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            return stream.read(most)
    except (OSError, EOFError) as error:
        raise FormatError(f"cannot read {path}: {reason_of(error)}") from error


class _ListFile:
    """A file with a list of numbers, or with two if it is binary, to be read one after another."""

    def __init__(self, path: Path, kinds: tuple[str, ...], most: int):
        self._content = read_content(path, _ROW_BYTES * (most + 100))
        head = re.search(rb"FoamFile\s*\{([^}]*)\}", self._content)
        kind = re.search(rb"\bclass\s+(\w+)", head[1]) if head else None
        if head is None or kind is None or kind[1].decode() not in kinds:
            raise FormatError(f"{path} is not a {' or '.join(kinds)} of OpenFOAM")
        self._path, self._at = path, head.end()
        self.binary = re.search(rb"format\s+binary", head[1]) is not None
        self._types = {
            int: "<i8" if b"label=64" in head[1] else "<i4",
            float: "<f4" if b"scalar=32" in head[1] else "<f8",
        }

    def count(self) -> int:
        """The length in front of the next list."""
        found = _LENGTH.match(self._content, self._at)
        if found is None:
            raise FormatError(f"{self._path} is truncated or damaged: there is no list")
        self._at = found.end()
        return int(found[1])

    def rows(self, kind: type, width: int) -> NDArray[Any]:
        """The next list as rows (n, width) of ``int`` or ``float``."""
        count = self.count()
        if self.binary:
            size = count * width * np.dtype(self._types[kind]).itemsize
            begin = self._at + 1
            self._at = begin + size + 1 if count else self._at
            whole = len(self._content) >= begin + size and self._content[begin - 1 : begin] == b"("
            values = np.frombuffer(
                self._content, self._types[kind], count * width if whole else 0, begin if whole else 0
            )
        else:
            values = self.numbers_of_text(kind)
        if values.size != count * width:
            raise FormatError(f"{self._path} is truncated: {count:,} rows need {count * width:,} numbers")
        return values.reshape(count, width).astype(kind)

    def numbers_of_text(self, kind: type, closed: bytes = b" ") -> NDArray[Any]:
        """All numbers of a list of text; ``closed`` takes the place of closing parentheses within it."""
        text = self._content[self._at + 1 : self._content.rfind(b")")]
        text = text.replace(b"(", b" ").replace(b")", closed).strip()
        if not text:
            return np.empty(0, dtype=kind)
        try:
            with strict_numbers():
                return np.fromstring(text, dtype=kind, sep=" ")
        except ValueError as error:
            raise FormatError(f"{self._path} is damaged: {error}") from error
