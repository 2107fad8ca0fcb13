"""Structured grids in VTK's XML files (.vts), and the values of the arrays in all XML files, each checked against the
expected number.

A binary array is preceded by its number of bytes or, if compressed, by the number of blocks, the size of a block, the
size of the last block if smaller (else 0), and the compressed size of each block. All of them are checked against the
file and the expected number of values before anything is allocated. In base64, a compressed array is two segments, each
padded to four characters; without compression size and values are one, of some writers two.
"""

from __future__ import annotations

import binascii
import io
import lzma
import math
import re
import zlib
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Shape
from meshdeform_core.parallel import require_undivided

from ..text import strict_numbers
from .dataset import DataArray, DataSet, Run
from .xml_tags import TAG, Element, XmlFile, read_tags

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


class Encoded(NamedTuple):
    """The bytes of an array between ``start`` and ``end`` of a stream, as they are or in base64."""

    stream: BinaryIO
    start: int
    end: int
    base64: bool

    def end_of(self, place: int, count: int) -> int:
        """End of a segment of ``count`` bytes that begins at ``place``."""
        return place + (-(-count // 3) * 4 if self.base64 else count)

    def segment(self, place: int, count: int) -> bytes:
        """The ``count`` bytes of a segment that begins at ``place``; up to two more where it continues in base64.

        Raises binascii.Error when characters or padding are not base64, or there are fewer bytes.
        """
        self.stream.seek(place)
        data = self.stream.read(self.end_of(place, count) - place)
        if self.base64:
            data = binascii.a2b_base64(data, strict_mode=True)
        if len(data) < count:
            raise binascii.Error("the data end too early")
        return data


class ArrayReader:
    """Reads the arrays of one file."""

    def __init__(self, file: XmlFile, stream: BinaryIO) -> None:
        self.file, self._stream = file, stream
        self._order = "<" if file.options["byte_order"] == "little" else ">"
        self._head = np.dtype(self._order + ("u4" if file.options["header_type"] == "UInt32" else "u8"))
        self._compressed = file.compression != "none"
        self._left = _ALWAYS_ALLOWED + LARGEST_RATIO[file.compression] * file.size

    def values(self, array: Element, tuples: int, components: int | None = None, later: bool = False) -> Any:
        """The values of an array, ``(tuples,)`` or ``(tuples, components)``, in the byte order of the file.

        ``components`` is the required number; ``None`` accepts that of the array. With ``later``, values that are
        stored as they are remain to be read, as a :class:`.Run`.

        Raises FormatError when the array is damaged or does not have the expected number of values.
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
                found = numbers_in_text(self._content(array), dtype.newbyteorder("="))
            except ValueError as error:
                raise self.error(array, f"holds {error}, expected {dtype.name} numbers") from error
            if len(found) != count:
                raise self.error(array, f"has {len(found)} values, expected {wanted}")
            return found.reshape(shape)
        size = (count + 7) // 8 if kind == "Bit" else count * dtype.itemsize
        try:
            stored = self._binary(array, size, wanted, later and kind != "Bit")
        except binascii.Error as error:
            raise self.error(array, f"contains something that is not base64: {error}") from error
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
        """A count that an element declares, or ``otherwise``.

        Raises FormatError when it is not a count, or missing without an alternative.
        """
        word = element.get(name).strip()
        if not word and otherwise is not None:
            return otherwise
        if not re.fullmatch(r"\d{1,18}", word):
            raise self.error(element, f"has {name} {word!r}, expected a count")
        return int(word)

    def require_no_rest(self) -> None:
        """Require that the last appended array ends where the appended data do, white space aside.

        Offsets count from the beginning of the data: bytes inserted into the last array would go unnoticed, and the
        values after them would be read shifted.

        Raises FormatError when other bytes follow the last array.
        """
        end, closing = 0, self.file.appended[1]
        for array in self.file.root.below():
            if array.get("format") == "appended":
                data = self._encoded(array)
                _, place, count = self._sizes_of(array, data)
                end = max(end, data.end_of(place, count))
        self._stream.seek(end)
        if end and self._stream.read(closing - end).strip():
            raise FormatError(
                f"cannot read {self.file.path}: the appended data go on after the last array, from byte {end} to "
                f"{closing}; expected the closing tag there, the file is damaged"
            )

    def error(self, element: Element, message: str) -> FormatError:
        """An error with the element and its line."""
        what = element.tag
        if element.tag in ("DataArray", "Array"):
            what = f"array {element.get('Name') or 'without name'}"
        return FormatError(f"cannot read {self.file.path}, line {element.line}: {what} {message}")

    def _content(self, array: Element) -> bytes:
        """The text of an array."""
        self._stream.seek(array.start)
        content = self._stream.read(array.end - array.start)
        opening = TAG.match(content)
        return content[opening.end() :] if opening else b""

    def _binary(self, array: Element, size: int, wanted: str, later: bool) -> NDArray[np.uint8] | int:
        """The ``size`` bytes of an array or, with ``later``, the position of those that are stored as they are."""
        data = self._encoded(array)
        sizes, place, count = self._sizes_of(array, data)
        if self._compressed:
            blocks, block, last = sizes[:3]
            stated = blocks * block - (block - last if blocks and last else 0)
            if stated != size:
                raise self.error(array, f"decompresses to {stated} bytes, expected {size} for {wanted}")
        elif sizes[0] != size:
            raise self.error(array, f"has {sizes[0]} bytes, expected {size} for {wanted}")
        elif later and not data.base64:
            return place
        self._left -= size
        if self._left < 0:
            raise self.error(array, f"cannot hold {wanted}: the file has only {self.file.size} bytes")
        if array.get("format") == "binary" and data.end_of(place, count) != data.end:
            raise self.error(array, "continues after its last value")
        content = data.segment(place, count)
        if self._compressed:
            values, filled, begin = np.empty(size, np.uint8), 0, 0
            blocks, block, last, *packed = sizes
            for number, length in enumerate(packed, start=1):
                part = min(last if number == blocks and last else block, size - filled)
                try:
                    unpacked = unpack(self.file.compression, content[begin : begin + length], part)
                except ValueError as error:
                    raise self.error(array, f"is damaged in block {number} of {blocks}: {error}") from error
                values[filled : filled + part] = np.frombuffer(unpacked, np.uint8)
                filled, begin = filled + part, begin + length
            return values
        return np.frombuffer(content, np.uint8)[count - size : count]

    def _encoded(self, array: Element) -> Encoded:
        if array.get("format") == "binary":
            text = self._content(array).strip()
            return Encoded(io.BytesIO(text), 0, len(text), True)
        if array.get("format") != "appended":
            raise self.error(array, f"has format {array.get('format')!r}; known are ascii binary appended")
        start, end = self.file.appended
        if not self.file.appended_encoding:
            raise self.error(array, "refers to appended data, but the file has none")
        start += self.number(array, "offset")
        if start > end:
            raise self.error(array, f"begins at byte {start}, after the end of the appended data at {end}")
        return Encoded(self._stream, start, end, self.file.appended_encoding != "appended")

    def _sizes_of(self, array: Element, data: Encoded) -> tuple[list[int], int, int]:
        """The sizes that precede an array, and the beginning and number of bytes of the segment with its values, which
        are its last ones."""

        def leading(count: int) -> tuple[list[int], int]:
            """So many sizes, and how many bytes of their segment follow at least."""
            size = count * self._head.itemsize
            if data.end_of(data.start, size) > data.end:
                raise binascii.Error
            head = data.segment(data.start, size)
            return np.frombuffer(head, self._head, count).tolist(), len(head) - size

        try:
            number = 3 + leading(3)[0][0] if self._compressed else 1
            sizes, rest = leading(number)
            size, place = sum(sizes[3:]) if self._compressed else sizes[0], data.start
            if rest:
                size += number * self._head.itemsize
            else:
                place = data.end_of(place, number * self._head.itemsize)
            if data.end_of(place, size) > data.end or (rest and self._compressed):
                raise binascii.Error
        except binascii.Error as error:
            name, byte = array.get("Name") or "without name", max(data.start, array.start)
            raise FormatError(
                f"cannot read {self.file.path}: the size of array {name}, at byte {byte}, is impossible; the file is "
                "damaged"
            ) from error
        return sizes, place, size


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
        raise ValueError(f"it decompresses to {found} bytes, expected {size}")
    return data


def read_section(
    reader: ArrayReader, above: Element, tag: str, tuples: int, notes: list[str], later: bool = False
) -> list[DataArray]:
    """The arrays of all ``tag`` elements (a key of :data:`SECTIONS`) in ``above``.

    ``tuples`` is the number of nodes or cells; a line for each array that is not kept is added to ``notes``. With
    ``later``, values that are stored as they are remain to be read.

    Raises FormatError when an array is damaged or does not have the expected number of values.
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


def read(path: Path) -> DataSet:
    """Read the structured data set of an XML file.

    Raises FormatError when the file is truncated or damaged, its data set is of another kind, or not one Piece with all
    nodes.
    """
    file = read_tags(path)
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
            require_undivided(f"{path} is text or compressed")
        array = reader.array_of_points(piece)
        points = reader.values(array, ni * nj * nk, 3, later=True).reshape(nk, nj, ni, 3)
        n_cells = math.prod(max(n - 1, 1) for n in (ni, nj, nk))
        arrays = [
            *read_section(reader, piece, "PointData", ni * nj * nk, notes, later=True),
            *read_section(reader, piece, "CellData", n_cells, notes, later=True),
        ]
        reader.require_no_rest()
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
