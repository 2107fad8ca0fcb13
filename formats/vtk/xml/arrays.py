"""The values of the arrays in a VTK XML file, each checked against the expected number.

A binary array is preceded by its number of bytes or, if compressed, by the number of blocks, the size of a block, the
size of the last block if smaller (else 0), and the compressed size of each block. All of them are checked against the
file and the expected number of values before anything is allocated.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from ..dataset import Run, Values
from .bytes import ArrayBytes, Base64Bytes, NotBase64, RawBytes
from .codecs import LARGEST_RATIO, DamagedBlock, unpacker
from .numbers import NotANumber, numbers_in_text
from .tags import Element, XmlFile

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

# Total size to which the arrays of a file may be decompressed, beyond what its size explains.
_ALWAYS_ALLOWED = 64 << 20
_PIECE = 1 << 21
_GAPS = b" \t\r\n"


class ArrayReader:
    """Reads the arrays of one file."""

    def __init__(self, file: XmlFile, stream: BinaryIO) -> None:
        self.file, self._stream = file, stream
        self._order = "<" if file.options["byte_order"] == "little" else ">"
        self._head = np.dtype(self._order + ("u4" if file.options["header_type"] == "UInt32" else "u8"))
        self._compression = file.compression
        self._left = _ALWAYS_ALLOWED + LARGEST_RATIO[self._compression] * file.size
        self._unpack: Callable[[bytes, int], bytes] | None = None

    def values_or_run(self, array: Element, tuples: int, components: int | None = None) -> Values:
        """As :meth:`values`, but values that are stored as they are remain to be read."""
        if array.get("format") != "appended" or not self._plain_raw or array.get("type") not in TYPES:
            return self.values(array, tuples, components)
        stated, dtype, wanted = self._declared(array, tuples, components)
        data, place = self._bytes_of(array)
        self._require_size(array, data, tuples * stated * dtype.itemsize, place, wanted)
        start = place + self._head.itemsize
        return Run(self.file.path, dtype, start, (tuples,) if stated == 1 else (tuples, stated))

    @property
    def _plain_raw(self) -> bool:
        return self._compression == "none" and self.file.appended_encoding == "appended"

    def _declared(self, array: Element, tuples: int, components: int | None) -> tuple[int, np.dtype[Any], str]:
        """Number of components and type of an array, and the values that it must have, for messages."""
        stated = self._number(array, "NumberOfComponents", 1)
        if components is not None and stated != components:
            raise self.error(array, f"has {stated} components, expected {components}")
        bits = array.get("type") == "Bit"
        if not bits and array.get("type") not in TYPES:
            raise self.error(array, f"is of type {array.get('type')!r}; known are {' '.join(TYPES)} Bit")
        count = tuples * stated
        wanted = f"{count} values ({tuples} x {stated})" if stated > 1 else f"{count} values"
        return stated, np.dtype("u1" if bits else self._order + TYPES[array.get("type")]), wanted

    def values(self, array: Element, tuples: int, components: int | None = None) -> NDArray[Any]:
        """The values of an array, ``(tuples,)`` or ``(tuples, components)``, in the byte order of the file.

        ``components`` is the required number; ``None`` accepts that of the array.

        Raises
        ------
        FormatError
            When the array is damaged or does not have the expected number of values.
        """
        stated, dtype, wanted = self._declared(array, tuples, components)
        count = tuples * stated
        if array.get("format") in ("", "ascii"):
            flat = self._ascii(array, count, dtype.newbyteorder("="), wanted)
        elif array.get("type") == "Bit":
            flat = np.unpackbits(self._binary(array, (count + 7) // 8, dtype, wanted))[:count]
        else:
            flat = self._binary(array, count, dtype, wanted)
        return flat if stated == 1 else flat.reshape(tuples, stated)

    def arrays_of(self, piece: Element, tag: str, number: int) -> list[Element]:
        """The arrays of all ``tag`` elements in ``piece``, of which there must be ``number``."""
        arrays = [array for section in piece.all(tag) for array in section.arrays()]
        if len(arrays) != number:
            raise self.error(piece, f"has {len(arrays)} arrays of {tag}, expected {number}")
        return arrays

    def number(self, element: Element, name: str) -> int:
        """A count that an element must declare.

        Raises
        ------
        FormatError
            When it is missing or not a count.
        """
        return self._number(element, name, None)

    def _number(self, element: Element, name: str, otherwise: int | None) -> int:
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

        Raises
        ------
        FormatError
            When other bytes follow the last array.
        """
        arrays = [array for array in self.file.root.below() if array.get("format") == "appended"]
        if not arrays:
            return
        end, closing = max(map(self._end_of, arrays)), self.file.appended[1]
        rest = RawBytes(self._stream, end, closing)
        while piece := rest.read(_PIECE):
            if piece.strip(_GAPS):
                raise FormatError(
                    f"cannot read {self.file.path}: the appended data go on after the last array, from byte {end} to "
                    f"{closing}; expected the closing tag there, the file is damaged"
                )

    def _end_of(self, array: Element) -> int:
        """Position after an appended array, from its header."""
        data, place = self._bytes_of(array)
        if self._compression == "none":
            (size,) = self._header(array, data, 1, place)
        else:
            blocks = self._header(array, data, 3, place)[0]
            size = sum(self._header(array, data, blocks, place))
        return data.end_after(size)

    def error(self, element: Element, message: str) -> FormatError:
        """An error with the element and its line."""
        what = element.tag
        if element.tag in ("DataArray", "Array"):
            what = f"array {element.get('Name') or 'without name'}"
        return FormatError(f"cannot read {self.file.path}, line {element.line}: {what} {message}")

    def _allocate(self, array: Element, size: int, wanted: str) -> NDArray[np.uint8]:
        """Memory for an array, unless all arrays together need more than a file of this size can contain."""
        self._left -= size
        if self._left < 0:
            raise self.error(array, f"cannot hold {wanted}: the file has only {self.file.size} bytes")
        return np.empty(size, np.uint8)

    def _ascii(self, array: Element, count: int, dtype: np.dtype[Any], wanted: str) -> NDArray[Any]:
        # Each number takes at least two bytes of text.
        length = array.end - array.start
        values = np.empty(count if 2 * count <= length + 1 else 0, dtype)
        text, found = RawBytes(self._stream, array.start, array.end), 0
        rest = b""
        while piece := text.read(_PIECE):
            piece = rest + piece
            cut = 1 + max(piece.rfind(gap) for gap in (b" ", b"\n", b"\t", b"\r"))
            if not text.available():
                cut = len(piece)
            elif not cut:
                raise self.error(array, f"holds a word of more than {len(piece)} characters, expected numbers")
            piece, rest = piece[:cut], piece[cut:]
            found = self._put(array, values, found, piece, dtype)
        if found != count:
            raise self.error(array, f"has {found} values, expected {wanted}")
        return values

    def _put(self, array: Element, values: NDArray[Any], found: int, text: bytes, dtype: np.dtype[Any]) -> int:
        """Append the numbers of ``text`` after the first ``found``; return how many there are now."""
        try:
            numbers = numbers_in_text(text, dtype)
        except NotANumber as error:
            raise self.error(array, f"holds {error}, expected {dtype.name} numbers") from error
        if found + numbers.size <= values.size:
            values[found : found + numbers.size] = numbers
        return found + numbers.size

    def _binary(self, array: Element, count: int, dtype: np.dtype[Any], wanted: str) -> NDArray[Any]:
        data, place = self._bytes_of(array)
        try:
            read = self._plain if self._compression == "none" else self._packed
            return read(array, data, count * dtype.itemsize, place, wanted).view(dtype)
        except NotBase64 as error:
            raise self.error(array, f"contains something that is not base64: {error}") from error

    def _bytes_of(self, array: Element) -> tuple[ArrayBytes, int]:
        """The bytes of an array, and their position in the file."""
        if array.get("format") == "binary":
            start, end = self._stripped(array)
            return Base64Bytes(self._stream, start, end), start
        if array.get("format") != "appended":
            raise self.error(array, f"has format {array.get('format')!r}; known are ascii binary appended")
        start, end = self.file.appended
        if not self.file.appended_encoding:
            raise self.error(array, "refers to appended data, but the file has none")
        start += self.number(array, "offset")
        if start > end:
            raise self.error(array, f"begins at byte {start}, after the end of the appended data at {end}")
        raw = self.file.appended_encoding == "appended"
        return (RawBytes if raw else Base64Bytes)(self._stream, start, end), start

    def _stripped(self, array: Element) -> tuple[int, int]:
        """Begin and end of the text of an array without surrounding white space."""
        start, end = array.start, array.end
        while start < end:
            piece = RawBytes(self._stream, start, min(end, start + 4096)).read(4096)
            start += len(piece) - len(piece.lstrip(_GAPS))
            if piece.strip(_GAPS):
                break
        while end > start:
            piece = RawBytes(self._stream, max(start, end - 4096), end).read(4096)
            end -= len(piece) - len(piece.rstrip(_GAPS))
            if piece.strip(_GAPS):
                break
        return start, end

    def _damaged_size(self, array: Element, place: int) -> FormatError:
        name = array.get("Name") or "without name"
        return FormatError(
            f"cannot read {self.file.path}: the size of array {name}, at byte {place}, is impossible; the file is "
            "damaged"
        )

    def _header(self, array: Element, data: ArrayBytes, count: int, place: int) -> list[int]:
        size = count * self._head.itemsize
        if size > data.available():
            raise self._damaged_size(array, place)
        try:
            raw = data.read(size)
        except NotBase64 as error:
            raise self._damaged_size(array, place) from error
        if len(raw) < size:
            raise self._damaged_size(array, place)
        return [int(number) for number in np.frombuffer(raw, self._head)]

    def _require_size(self, array: Element, data: ArrayBytes, size: int, place: int, wanted: str) -> None:
        """Read the header of an array that is not compressed, which must have ``size`` bytes."""
        (stated,) = self._header(array, data, 1, place)
        if stated > data.available():
            raise self._damaged_size(array, place)
        if stated != size:
            raise self.error(array, f"has {stated} bytes, expected {size} for {wanted}")

    def _plain(self, array: Element, data: ArrayBytes, size: int, place: int, wanted: str) -> NDArray[np.uint8]:
        self._require_size(array, data, size, place, wanted)
        values, filled = self._allocate(array, size, wanted), 0
        while filled < size:
            piece = data.read(min(size - filled, _PIECE))
            if not piece:
                raise self.error(array, f"ends after {filled} of {size} bytes")
            values[filled : filled + len(piece)] = np.frombuffer(piece, np.uint8)
            filled += len(piece)
        self._require_end_of_text(array, data)
        return values

    def _packed(self, array: Element, data: ArrayBytes, size: int, place: int, wanted: str) -> NDArray[np.uint8]:
        blocks, block, last = self._header(array, data, 3, place)
        packed = self._header(array, data, blocks, place)
        if not data.next_segment() or sum(packed) > data.available():
            raise self._damaged_size(array, place)
        stated = blocks * block - (block - last if blocks and last else 0)
        if stated != size:
            raise self.error(array, f"decompresses to {stated} bytes, expected {size} for {wanted}")
        values, filled = self._allocate(array, size, wanted), 0
        unpack = self._unpack = self._unpack or unpacker(self._compression, self.file.path)
        for number, length in enumerate(packed, start=1):
            part = min(last if number == blocks and last else block, size - filled)
            try:
                values[filled : filled + part] = np.frombuffer(unpack(data.read(length), part), np.uint8)
            except DamagedBlock as error:
                raise self.error(array, f"is damaged in block {number} of {blocks}: {error}") from error
            filled += part
        self._require_end_of_text(array, data)
        return values

    def _require_end_of_text(self, array: Element, data: ArrayBytes) -> None:
        if array.get("format") == "binary" and data.read(1):
            raise self.error(array, "continues after its last value")
