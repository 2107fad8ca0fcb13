"""Encoding of an array in a VTK XML file: first its sizes; compressed or not, raw or base64."""

from __future__ import annotations

import binascii
import os
from collections.abc import Iterator, Mapping
from typing import Any, BinaryIO

import numpy as np

from ..dataset import StoredArray
from .codecs import packer

# Bytes that VTK compresses as one block.
_BLOCK = 1 << 15


class ArrayEncoder:
    """Writes arrays at the position of ``stream``; ``options`` are those of the file variant."""

    def __init__(self, stream: BinaryIO, options: Mapping[str, str], header_type: str, path: str) -> None:
        self._stream = stream
        self._encoded = options["encoding"] != "appended"
        self._order = "<" if options["byte_order"] == "little" else ">"
        self._head = np.dtype(self._order + ("u4" if header_type == "UInt32" else "u8"))
        compression = options["compression"]
        self._pack = packer(compression, f"cannot write {path}") if compression != "none" else None

    def write(self, array: StoredArray) -> None:
        """Write the sizes and values of an array."""
        if self._pack is None:
            segment = self._segment()
            segment.write(self._sizes([array.nbytes]))
            for piece in self._pieces(array):
                segment.write(piece)
            segment.close()
        else:
            self._write_packed(array)

    def reserve(self, array: StoredArray) -> tuple[int, np.dtype[Any]]:
        """Write the size of an array and leave room for its values, neither compressed nor in base64; returns the place
        of the first one, and the type of all."""
        self._stream.write(self._sizes([array.nbytes]))
        start = self._stream.tell()
        self._stream.seek(array.nbytes, os.SEEK_CUR)
        return start, np.dtype(self._order + array.precision.str[1:])

    def _write_packed(self, array: StoredArray) -> None:
        assert self._pack is not None
        number, last = -(-array.nbytes // _BLOCK), array.nbytes % _BLOCK
        place, packed = self._stream.tell(), [0] * number
        # The compressed sizes precede the blocks: reserve space for them.
        self._write_sizes([number, _BLOCK, last, *packed])
        segment = self._segment()
        for index, block in enumerate(_blocks(self._pieces(array))):
            data = self._pack(block)
            packed[index] = len(data)
            segment.write(data)
        segment.close()
        end = self._stream.tell()
        self._stream.seek(place)
        self._write_sizes([number, _BLOCK, last, *packed])
        self._stream.seek(end)

    def _write_sizes(self, sizes: list[int]) -> None:
        segment = self._segment()
        segment.write(self._sizes(sizes))
        segment.close()

    def _sizes(self, sizes: list[int]) -> bytes:
        return np.array(sizes, self._head).tobytes()

    def _pieces(self, array: StoredArray) -> Iterator[memoryview]:
        """The values as bytes in the byte order of the file."""
        for slab in array.slabs():
            stored = slab.astype(np.dtype(self._order + slab.dtype.str[1:]), copy=False)
            yield stored.data.cast("B")

    def _segment(self) -> _Segment:
        return _Segment(self._stream, self._encoded)


class _Segment:
    """Bytes written to a stream, in base64 if ``encoded``; only the end of a segment is padded."""

    def __init__(self, stream: BinaryIO, encoded: bool) -> None:
        self._stream, self._encoded, self._rest = stream, encoded, b""

    def write(self, data: bytes | memoryview) -> None:
        if not self._encoded:
            self._stream.write(data)
            return
        joined = self._rest + bytes(data)
        whole = len(joined) // 3 * 3
        self._rest = joined[whole:]
        self._stream.write(binascii.b2a_base64(memoryview(joined)[:whole], newline=False))

    def close(self) -> None:
        self._stream.write(binascii.b2a_base64(self._rest, newline=False))


def _blocks(pieces: Iterator[memoryview]) -> Iterator[bytes | memoryview]:
    """The bytes of all pieces in blocks of equal size; the last one may be smaller."""
    rest = b""
    for piece in pieces:
        start = 0
        if rest:
            start = min(_BLOCK - len(rest), len(piece))
            rest += bytes(piece[:start])
            if len(rest) < _BLOCK:
                continue
            yield rest
        whole = start + (len(piece) - start) // _BLOCK * _BLOCK
        for first in range(start, whole, _BLOCK):
            yield piece[first : first + _BLOCK]
        rest = bytes(piece[whole:])
    if rest:
        yield rest
