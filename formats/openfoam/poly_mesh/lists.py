"""Files of OpenFOAM's lists of points, faces and labels, as text or binary, optionally compressed with gzip."""

from __future__ import annotations

import gzip
import re
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray

from ...files import reason_of, require_regular
from ...text.rows import text_rows

_ROWS_AT_ONCE = 20_000
_LABEL = np.dtype("<i4")
# Largest length of a line of text with three numbers, which bounds what is decompressed.
_POINT_BYTES = 100
_BANNER = "/* Written by meshdeform */\n"


def write_points(path: Path, points: FloatArray, place: str, binary: bool) -> None:
    """A ``vectorField`` of points (n, 3); ``place`` is the folder that the header names."""
    with _opened(path) as stream:
        _head(stream, "vectorField", "points", place, binary)
        _rows(stream, np.ascontiguousarray(points, dtype="<f8"), "(%.17g %.17g %.17g)\n", binary)


def write_labels(path: Path, labels: IntArray, place: str, binary: bool, note: str) -> None:
    """A ``labelList``; ``note`` holds the sizes of the mesh."""
    with _opened(path) as stream:
        _head(stream, "labelList", _name(path), place, binary, note)
        _rows(stream, labels.astype(_LABEL)[:, None], "%d\n", binary)


def write_faces(path: Path, corners: IntArray, kept: NDArray[np.bool_], place: str, binary: bool) -> None:
    """Faces from corners (n, 4) and which of them count: a ``faceList`` as text, a ``faceCompactList`` as binary."""
    sizes = kept.sum(axis=1)
    with _opened(path) as stream:
        _head(stream, "faceCompactList" if binary else "faceList", "faces", place, binary)
        if binary:
            starts = np.concatenate([[0], np.cumsum(sizes)]).astype(_LABEL)
            _rows(stream, starts[:, None], "", True)
            _rows(stream, corners[kept].astype(_LABEL)[:, None], "", True)
            return
        stream.write(b"%d\n(\n" % len(corners))
        for begin in range(0, len(corners), _ROWS_AT_ONCE):
            rows = slice(begin, begin + _ROWS_AT_ONCE)
            lines = np.where(sizes[rows] == 4, "4(%d %d %d %d)", "3(%d %d %d)")
            stream.write(("\n".join(lines.tolist()) % tuple(corners[rows][kept[rows]].tolist()) + "\n").encode())
        stream.write(b")\n")


def write_dictionary(path: Path, kind: str, place: str, text: str) -> None:
    """A dictionary of this class: a header, and ``text``."""
    with _opened(path) as stream:
        _head(stream, kind, _name(path), place, False)
        stream.write(text.encode())


def read_points(path: Path, most: int) -> FloatArray:
    """The points (n, 3) of a polyMesh with at most this many.

    Raises
    ------
    FormatError
        When the file is damaged or is no field of points.
    """
    require_regular(path)
    try:
        with gzip.open(path) if path.suffix == ".gz" else path.open("rb") as stream:
            content = stream.read(_POINT_BYTES * (most + 100))
    except (OSError, EOFError) as error:
        raise FormatError(f"cannot read {path}: {reason_of(error)}") from error
    header = re.search(rb"FoamFile\s*\{([^}]*)\}", content)
    start = re.compile(rb"\s*(?://[^\n]*\n\s*)*(\d+)\s*\(").match(content, header.end() if header else 0)
    if header is None or start is None or b"vectorField" not in header[1]:
        raise FormatError(f"{path} is not a list of points of OpenFOAM")
    count, body = int(start[1]), content[start.end() :]
    if count > most:
        raise FormatError(f"{path} has {count:,} points; expected at most {most:,}")
    if re.search(rb"format\s+binary", header[1]):
        kind = np.dtype("<f4" if b"scalar=32" in header[1] else "<f8")
        if len(body) < 3 * count * kind.itemsize:
            raise FormatError(f"{path} is truncated: {count} points need {3 * count * kind.itemsize} bytes")
        values = np.frombuffer(body, kind, 3 * count).astype(np.float64)
    else:
        words = body.translate(bytes.maketrans(b"()", b"  ")).split()
        if len(words) < 3 * count:
            raise FormatError(f"{path} is truncated: {len(words)} numbers, expected {3 * count}")
        try:
            values = np.array(words[: 3 * count], dtype=np.float64)
        except ValueError as error:
            raise FormatError(f"{path}: {error}") from error
    return values.reshape(-1, 3)


def _name(path: Path) -> str:
    """The name of the object in a file, also while the file has a temporary name."""
    return path.name.split(".")[0]


def _opened(path: Path) -> BinaryIO:
    # Without a time of day in it, so that equal meshes give equal files.
    return cast(BinaryIO, gzip.GzipFile(path, "wb", 6, mtime=0) if path.suffix == ".gz" else path.open("wb"))


def _head(stream: BinaryIO, kind: str, name: str, place: str, binary: bool, note: str = "") -> None:
    lines = ["version 2.0;", f"format {'binary' if binary else 'ascii'};", 'arch "LSB;label=32;scalar=64";']
    lines += [f"class {kind};", f'location "{place}";', f"object {name};"] + ([f'note "{note}";'] if note else [])
    stream.write((_BANNER + "FoamFile\n{\n" + "".join(f"    {line}\n" for line in lines) + "}\n\n").encode())


def _rows(stream: BinaryIO, rows: NDArray, line: str, binary: bool) -> None:
    """A list of rows (n, m): its length, and the values in parentheses."""
    if binary:
        stream.write(b"%d\n(" % len(rows))
        stream.write(np.ascontiguousarray(rows).data)
        stream.write(b")\n")
        return
    stream.write(b"%d\n(\n" % len(rows))
    stream.writelines(text_rows(rows, line))
    stream.write(b")\n")
