"""Structured grids in VTK's XML files (.vts), read and written, and the values of the arrays in all XML files.

A binary array is preceded by its number of bytes or, if compressed, by the number of blocks, the size of a block, the
size of the last block if smaller (else 0), and the compressed size of each block. All of them are checked against the
file and the expected number of values before anything is allocated. In base64 these sizes and the values are one piece,
or two, each padded to four characters.
"""

from __future__ import annotations

import binascii
import lzma
import math
import re
import zlib
from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid, Shape
from meshdeform_core.parallel import Ranks

from ..text import strict_numbers
from .dataset import BlockOutput, DataArray, DataSet, Reserved, Run, StoredArray
from .xml_tags import TAG, Element, XmlFile

TYPES = {
    "Int8": "i1",
    "UInt8": "u1",
    "Int16": "i2",
    "UInt16": "u2",
    "Int32": "i4",
    "UInt32": "u4",
    "Int64": "i8",
    "UInt64": "u8",
    "Float32": "f4",
    "Float64": "f8",
}

SECTIONS = {"PointData": "node", "CellData": "cell"}
# Largest compression ratio, by the definition of zlib; lzma exceeds it for constants.
LARGEST_RATIO = {"none": 1, "zlib": 1032, "lzma": 10_000}
# Total size to which the arrays of a file may be decompressed, beyond what its size explains.
_ALWAYS_ALLOWED = 64 << 20
# Memory limit of decompression; the largest preset needs 65 MiB.
_LZMA_MEMORY = 80 << 20


class ArrayReader:
    """Reads the arrays of one file."""

    def __init__(self, file: XmlFile, stream: BinaryIO) -> None:
        self.file, self._stream = file, stream
        self._order = "<" if file.options["byte_order"] == "little" else ">"
        self._size = np.dtype(self._order + ("u4" if file.options["header_type"] == "UInt32" else "u8"))
        self._compressed = file.compression != "none"
        self._left = _ALWAYS_ALLOWED + LARGEST_RATIO[file.compression] * file.size

    def values(self, array: Element, tuples: int, components: int | None = None, later: bool = False) -> Any:
        """The values of an array, ``(tuples,)`` or ``(tuples, components)``, in the byte order of the file.

        ``components`` is the required number; ``None`` accepts that of the array. With ``later``, values that are
        stored as they are remain to be read, as a :class:`.Run`.
        """
        stated = self.number(array, "NumberOfComponents", 1)
        if components is not None and stated != components:
            raise self.error(array, f"has {stated} components, expected {components}")
        kind = array.get("type")
        if kind != "Bit" and kind not in TYPES:
            raise self.error(array, f"is of type {kind!r}; known are {' '.join(TYPES)} Bit")
        dtype, count = np.dtype(self._order + TYPES.get(kind, "u1")), tuples * stated
        wanted = f"{count} values ({tuples} x {stated})" if stated > 1 else f"{count} values"
        shape = (tuples,) if stated == 1 else (tuples, stated)
        if array.get("format") in ("", "ascii"):
            try:
                found = numbers_in_text(self._read(*self._text(array)), dtype.newbyteorder("="))
            except ValueError as error:
                raise self.error(array, f"holds {error}, expected {dtype.name} numbers") from error
            if len(found) != count:
                raise self.error(array, f"has {len(found)} values, expected {wanted}")
            return found.reshape(shape)
        size = (count + 7) // 8 if kind == "Bit" else count * dtype.itemsize
        stored = self._binary(array, size, wanted, later and kind != "Bit")
        if isinstance(stored, int):
            return Run(self.file.path, dtype, stored, shape)
        return (np.unpackbits(stored)[:count] if kind == "Bit" else stored.view(dtype)).reshape(shape)

    def array_of_points(self, piece: Element) -> Element:
        """The array of the points of a piece, which must be its only one."""
        arrays = [array for section in piece.all("Points") for array in section.arrays()]
        if len(arrays) != 1:
            raise self.error(piece, f"has {len(arrays)} arrays of Points, expected 1")
        return arrays[0]

    def number(self, element: Element, name: str, otherwise: int | None = None) -> int:
        """A count that an element declares, or ``otherwise``."""
        word = element.get(name).strip()
        if not word and otherwise is not None:
            return otherwise
        if not re.fullmatch(r"\d{1,18}", word):
            raise self.error(element, f"has {name} {word!r}, expected a count")
        return int(word)

    def error(self, element: Element, message: str) -> FormatError:
        """An error with the element and its line."""
        what = element.tag
        if element.tag in ("DataArray", "Array"):
            what = f"array {element.get('Name') or 'without name'}"
        return FormatError(f"cannot read {self.file.path}, line {element.line}: {what} {message}")

    def _read(self, start: int, end: int) -> bytes:
        self._stream.seek(start)
        return self._stream.read(end - start)

    def _text(self, array: Element) -> tuple[int, int]:
        """First and last byte (exclusive) of the text of an array."""
        opening = TAG.match(self._read(array.start, array.end))
        return array.start + opening.end() if opening else array.end, array.end

    @cached_property
    def _appended(self) -> dict[int, int]:
        """First and last byte (exclusive) of every appended array: it may reach to where the next one begins."""
        first, closing = self.file.appended
        arrays = [array for array in self.file.root.below() if array.get("format") == "appended"]
        begins = sorted({first + self.number(array, "offset") for array in arrays})
        return {begin: min(after, closing) for begin, after in zip(begins, [*begins[1:], closing], strict=True)}

    def _place(self, array: Element) -> tuple[int, int, bool]:
        """First and last byte (exclusive) of a binary array, and whether it is in base64."""
        if array.get("format") == "binary":
            return *self._text(array), True
        if array.get("format") != "appended":
            raise self.error(array, f"has format {array.get('format')!r}; known are ascii binary appended")
        if not self.file.appended_encoding:
            raise self.error(array, "refers to appended data, but the file has none")
        first, closing = self.file.appended
        start = first + self.number(array, "offset")
        if start > closing:
            raise self.error(array, f"begins at byte {start}, after the end of the appended data at {closing}")
        return start, self._appended[start], self.file.appended_encoding != "appended"

    def _binary(self, array: Element, size: int, wanted: str, later: bool) -> NDArray[np.uint8] | int:
        """The ``size`` bytes of an array or, with ``later``, the position of those that are stored as they are."""
        (start, end, base64), width = self._place(array), self._size.itemsize
        later = later and not base64 and not self._compressed
        content = self._read(start, min(start + width, end) if later else end)
        if base64:
            try:
                # One piece or two, of which the first may be padded.
                pieces = re.findall(rb"[^=]*=*", content.strip())
                content = b"".join(binascii.a2b_base64(piece, strict_mode=True) for piece in pieces)
            except binascii.Error as error:
                raise self.error(array, f"contains something that is not base64: {error}") from error
        # The sizes in front of the values, the last ones those of compressed blocks.
        sizes = np.frombuffer(content, self._size, min(len(content) // width, 1)).tolist()
        number = 3 + sum(sizes) if self._compressed else 1
        sizes = np.frombuffer(content, self._size, min(len(content) // width, number)).tolist()
        head, packed = number * width, sizes[3:] if self._compressed else sizes
        filled = head + sum(packed)
        if filled > (end - start if later else len(content)):
            raise self.error(array, f"has an impossible size, at byte {start}; the file is damaged")
        stated = sizes[0]
        if self._compressed:
            blocks, block, last = sizes[:3]
            stated = blocks * block - (block - last if blocks and last else 0)
        if stated != size:
            verb = "decompresses to" if self._compressed else "has"
            raise self.error(array, f"{verb} {stated} bytes, expected {size} for {wanted}")
        # Offsets count from the beginning of the data: bytes inserted into the last array would shift its values.
        if array.get("format") == "binary" or end == self.file.appended[1]:
            rest = self._read(start + filled, end) if later else content[filled:]
            if rest.strip():
                raise self.error(array, "continues after its last value; the file is damaged")
        if later:
            return start + head
        self._left -= size
        if self._left < 0:
            raise self.error(array, f"cannot hold {wanted}: the file has only {self.file.size} bytes")
        if not self._compressed:
            return np.frombuffer(content, np.uint8, size, head)
        values, done = np.empty(size, np.uint8), 0
        for number, length in enumerate(packed, start=1):
            part = min(last if number == blocks and last else block, size - done)
            try:
                unpacked = unpack(self.file.compression, content[head : head + length], part)
            except ValueError as error:
                raise self.error(array, f"is damaged in block {number} of {blocks}: {error}") from error
            values[done : done + part] = np.frombuffer(unpacked, np.uint8)
            done, head = done + part, head + length
        return values


def numbers_in_text(text: bytes, dtype: np.dtype[Any]) -> NDArray[Any]:
    """All numbers of a text between white space, in ``dtype``.

    Raises ValueError, which quotes it, when something is not a number or exceeds the type.
    """
    if not text.strip():
        return np.empty(0, dtype)
    wide = np.dtype("f8" if dtype.kind == "f" else f"{dtype.kind if dtype.itemsize == 8 else 'i'}8")
    try:
        with strict_numbers():
            numbers = np.fromstring(text, wide, sep=" ")
    except ValueError as error:
        number = float if dtype.kind == "f" else int
        for word in text.split():
            try:
                number(word)
            except ValueError:
                raise ValueError(_shown(word)) from error
        raise ValueError("something that is not a number") from error
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            values = numbers.astype(dtype, copy=False)
        if np.isinf(values).any() and b"inf" not in text.lower():
            raise ValueError("a number out of range")
        return values
    limits, end = np.iinfo(dtype), np.iinfo(wide)
    # The parser saturates at the limits of 64 bits; a number there may be anything beyond.
    doubtful = (numbers < limits.min) | (numbers > limits.max) | (numbers == end.max) | (numbers == end.min)
    if doubtful.any():
        for word, doubt in zip(text.split(), doubtful, strict=True):
            if doubt and not limits.min <= int(word) <= limits.max:
                raise ValueError(_shown(word))
    return numbers.astype(dtype, copy=False)


def _shown(word: bytes) -> str:
    return repr(word[:40].decode("utf-8", "replace"))


def unpack(compression: str, packed: bytes, size: int) -> bytes:
    """Decompress one block to exactly ``size`` bytes, never to more than one byte beyond.

    Raises ValueError with the reason when it has another size, or is no such block.
    """
    xz = compression == "lzma"
    stream: Any = lzma.LZMADecompressor(lzma.FORMAT_XZ, _LZMA_MEMORY) if xz else zlib.decompressobj()
    try:
        data: bytes = stream.decompress(packed, size + 1)
    except (zlib.error, lzma.LZMAError) as error:
        raise ValueError(str(error)) from error
    if len(data) != size or not stream.eof:
        found = f"more than {size}" if len(data) > size else f"{len(data)}"
        raise ValueError(f"it decompresses to {found} bytes, expected {size}" if len(data) != size else "it has no end")
    return data


def read_section(
    reader: ArrayReader, above: Element, tag: str, tuples: int, notes: list[str], later: bool = False
) -> list[DataArray]:
    """The arrays of all ``tag`` elements (a key of :data:`SECTIONS`) in ``above``.

    ``tuples`` is the number of nodes or cells; a line for each array that is not kept is added to ``notes``. With
    ``later``, values that are stored as they are remain to be read.
    """
    found: dict[str, DataArray] = {}
    for section in above.all(tag):
        for index, element in enumerate(section.arrays()):
            name = element.get("Name") or f"array{index}"
            if element.tag != "DataArray":
                notes.append(f"the text array {name!r} is not kept")
                continue
            if name in found:
                notes.append(f"{SECTIONS[tag]} array {name!r} exists twice; the last one is kept")
            found[name] = DataArray(name, SECTIONS[tag], reader.values(element, tuples, later=later))
    return list(found.values())


# --- structured grids

_OTHER_KINDS = {
    "PolyData": "a polygon surface",
    "UnstructuredGrid": "an unstructured grid",
    "RectilinearGrid": "a rectilinear grid; save it as a structured grid (.vts)",
    "ImageData": "an image; save it as a structured grid (.vts)",
    "PStructuredGrid": "the index of a parallel data set; merge its pieces into one .vts",
    "vtkMultiBlockDataSet": "a multi-block set",
    "vtkPartitionedDataSetCollection": "a partitioned collection; save it as a multi-block set (.vtm)",
}

# Nodes that an extent may have regardless of the size of the file.
_ANY_EXTENT = 1_000_000

Extent = tuple[Shape, Shape]
"""First node (i, j, k), and number of nodes along each index."""


def read(file: XmlFile, ranks: Ranks) -> DataSet:
    """Read the structured data set of an XML file; a text only without other ranks."""
    path = file.path
    if file.kind != "StructuredGrid":
        other = _OTHER_KINDS.get(file.kind, "another kind of data set")
        raise FormatError(f"{path} is {other} (VTKFile type {file.kind}); expected a structured grid")
    data_set = file.data_set()
    notes: list[str] = []
    with path.open("rb") as stream:
        reader = ArrayReader(file, stream)
        _, (ni, nj, nk) = whole = _extent(reader, data_set, "WholeExtent")
        found = [(piece, _extent(reader, piece, "Extent")) for piece in data_set.all("Piece")]
        # Further pieces may only be empty.
        found = [(piece, extent) for piece, extent in found if min(extent[1]) > 0]
        if min(ni, nj, nk) < 1 or not found:
            raise FormatError(f"{path} is an empty grid: it has no nodes")
        piece, extent = found[0]
        if extent != whole or len(found) > 1:
            raise reader.error(
                piece,
                f"has Extent {piece.get('Extent')}; expected one Piece with all nodes of the WholeExtent "
                f"{data_set.get('WholeExtent')}: merge the pieces",
            )
        if file.options["encoding"] != "appended" or file.compression != "none":
            ranks.require_one(f"{path} is text or compressed")
        array = reader.array_of_points(piece)
        points = reader.values(array, ni * nj * nk, 3, later=True).reshape(nk, nj, ni, 3)
        n_cells = math.prod(max(n - 1, 1) for n in (ni, nj, nk))
        arrays = [
            *read_section(reader, piece, "PointData", ni * nj * nk, notes, later=True),
            *read_section(reader, piece, "CellData", n_cells, notes, later=True),
        ]
    return DataSet(points, tuple(arrays), file.options, tuple(dict.fromkeys(notes)))


def _extent(reader: ArrayReader, element: Element, name: str) -> Extent:
    words = element.get(name).split()
    if len(words) != 6 or not all(re.fullmatch(r"[+-]?\d{1,9}", word) for word in words):
        raise reader.error(element, f"has {name} {element.get(name)!r}, expected six whole numbers")
    i, last_i, j, last_j, k, last_k = map(int, words)
    shape = last_i - i + 1, last_j - j + 1, last_k - k + 1
    count, size = math.prod(max(n, 0) for n in shape), reader.file.size
    if count > max(_ANY_EXTENT, size * LARGEST_RATIO[reader.file.compression]):
        raise FormatError(
            f"{reader.file.path} has {element.tag} {name} {element.get(name)!r}: a file of {size} bytes cannot hold "
            f"{count} entries"
        )
    return (i, j, k), shape


# --- writing

_TYPE_NAMES = {code: name for name, code in TYPES.items()}

# Space for the offset of an array in its tag, which is written before the offset is known.
_OFFSET_DIGITS = 20

_REPLACED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
_ESCAPES = str.maketrans(_REPLACED)
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def attribute(text: str) -> str:
    """A text as the value of an XML attribute."""
    if bad := _NOT_IN_XML.search(text):
        raise FormatError(f"the name {text!r} contains the character {bad[0]!r}, which a VTK file cannot hold")
    return f'"{text.translate(_ESCAPES)}"'


def begin_block(grid: Grid, block: int, path: Path, variant: FileFormat, contents: Sequence[StoredArray]) -> Reserved:
    """Write one block to a .vts file, where values are stored as they are without those that have planes; returns the
    places of these."""
    (points, *arrays), encoding = contents, variant.options["encoding"]
    extent = " ".join(f"0 {n - 1}" for n in grid.shapes[block])
    head = 'type="StructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64"'
    located = {at: [array for array in arrays if array.location == at] for at in ("", *SECTIONS.values())}
    appended: list[tuple[StoredArray, int]] = []
    with path.open("wb") as stream:
        output = BlockOutput(stream, "<", encoding == "ascii")

        def put_section(tag: str, own: Sequence[StoredArray]) -> None:
            output.line(f"      <{tag}>")
            for array in own:
                words = [f'type="{_TYPE_NAMES[array.precision.str[1:]]}"', f"Name={attribute(array.name)}"]
                words += [f'NumberOfComponents="{array.components}"'] if array.components != 1 else []
                words += [] if array.location else [f'NumberOfTuples="{array.tuples}"']
                stream.write(f'        <DataArray {" ".join(words)} format="{encoding}"'.encode())
                if output.as_text:
                    output.line(">")
                    output.values(array)
                    output.line("        </DataArray>")
                else:
                    stream.write(b' offset="')
                    appended.append((array, stream.tell()))
                    output.line(" " * (_OFFSET_DIGITS + 1) + "/>")
            output.line(f"      </{tag}>")

        output.line(f'<?xml version="1.0"?>\n<VTKFile {head}>\n  <StructuredGrid WholeExtent="{extent}">')
        if located[""]:
            put_section("FieldData", located[""])
        output.line(f'    <Piece Extent="{extent}">')
        for tag, location in SECTIONS.items():
            put_section(tag, located[location])
        put_section("Points", [points])
        output.line("    </Piece>\n  </StructuredGrid>")
        if appended:
            # All arrays in sequence, and their offsets in the tags.
            stream.write(b'  <AppendedData encoding="raw">\n   _')
            start = stream.tell()
            for array, place in appended:
                offset = stream.tell() - start
                stream.seek(place)
                stream.write(f'{offset}"'.encode())
                stream.seek(start + offset)
                stream.write(np.array(array.nbytes, "<u8").tobytes())
                output.values(array)
            output.line("\n  </AppendedData>")
        output.line("</VTKFile>")
    return output.reserved(contents)
