"""The bytes of one array in a VTK XML file, raw or base64, piece by piece."""

from __future__ import annotations

import binascii
from typing import BinaryIO, Protocol

# Bytes read at a time, a multiple of 3.
_PIECE = 3 << 19


class NotBase64(Exception):
    """Something in the text is not base64."""


class ArrayBytes(Protocol):
    """The bytes of an array, read in sequence."""

    def available(self) -> int:
        """Upper bound of the number of bytes that follow."""

    def read(self, count: int) -> bytes:
        """The next ``count`` bytes, fewer only at the end."""

    def next_segment(self) -> bool:
        """Continue after the header of a compressed array; False if the header did not end there."""

    def end_after(self, count: int) -> int:
        """Position in the file where the next ``count`` bytes end."""


class RawBytes:
    """Raw bytes from ``start`` to ``end`` in the file."""

    def __init__(self, stream: BinaryIO, start: int, end: int) -> None:
        self._stream, self._position, self._end = stream, start, max(start, end)

    def available(self) -> int:
        return self._end - self._position

    def read(self, count: int) -> bytes:
        self._stream.seek(self._position)
        data = self._stream.read(min(count, self.available()))
        self._position += len(data)
        return data

    def next_segment(self) -> bool:
        return True

    def end_after(self, count: int) -> int:
        return self._position + count


class Base64Bytes:
    """Base64 between two bytes of the file; a compressed array is two segments, each padded to four characters."""

    def __init__(self, stream: BinaryIO, start: int, end: int) -> None:
        self._text, self._left = RawBytes(stream, start, end), b""

    def available(self) -> int:
        return len(self._left) + self._text.available() * 3 // 4

    def read(self, count: int) -> bytes:
        """The next ``count`` bytes, fewer only at the end.

        Raises
        ------
        NotBase64
            When characters or padding are not base64.
        """
        parts, missing = [self._left], count - len(self._left)
        while missing > 0:
            characters = -(-min(missing, _PIECE) // 3) * 4
            text = self._text.read(characters)
            if not text:
                break
            try:
                decoded = binascii.a2b_base64(text, strict_mode=True)
            except binascii.Error as error:
                raise NotBase64(str(error)) from error
            parts.append(decoded)
            missing -= len(decoded)
            if len(decoded) < len(text) // 4 * 3:
                # Padding: the segment ends here.
                break
        data = b"".join(parts)
        self._left = data[count:]
        return data[:count]

    def next_segment(self) -> bool:
        return not self._left

    def end_after(self, count: int) -> int:
        return self._text.end_after(-(-max(0, count - len(self._left)) // 3) * 4)
