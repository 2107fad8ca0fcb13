"""Checksums of headers in HDF5 files: Jenkins' hash *lookup3*, of many headers of the same length at a time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Bytes that wait, so that a file of any size takes little memory.
_MOST = 1 << 20
_SIZE = 4


class Checksums:
    """Whether pieces of a file, each of which ends with its own checksum, are as they were written."""

    def __init__(self) -> None:
        self._waiting: dict[int, list[bytes]] = {}
        self._bytes = 0
        self._right = True

    def add(self, piece: bytes) -> None:
        self._waiting.setdefault(len(piece), []).append(piece)
        self._bytes += len(piece)
        if self._bytes > _MOST:
            self.all_right()

    def all_right(self) -> bool:
        """Whether all pieces so far are."""
        for length, pieces in self._waiting.items():
            table = np.frombuffer(b"".join(pieces), np.uint8).reshape(-1, length)
            stored = np.ascontiguousarray(table[:, -_SIZE:]).view("<u4")[:, 0]
            self._right &= bool((lookup3(table[:, :-_SIZE]) == stored).all())
        self._waiting.clear()
        self._bytes = 0
        return self._right


def lookup3(rows: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """The hash (n,) of each of the ``rows`` (n, length) of bytes, with the initial value 0.

    Source: R. J. Jenkins, lookup3.c (public domain), as in the HDF5 File Format Specification.
    """
    count, length = rows.shape
    padded = np.zeros((count, -(-length // 12) * 12), np.uint8)
    padded[:, :length] = rows
    words = padded.view("<u4").astype(np.uint32)
    a = np.full(count, (0xDEADBEEF + length) & 0xFFFFFFFF, np.uint32)
    b, c = a.copy(), a.copy()
    for at in range(0, words.shape[1], 3):
        a += words[:, at]
        b += words[:, at + 1]
        c += words[:, at + 2]
        if at + 3 < words.shape[1]:
            _mix(a, b, c)
    for target, other, bits in ((c, b, 14), (a, c, 11), (b, a, 25), (c, b, 16), (a, c, 4), (b, a, 14), (c, b, 24)):
        target ^= other
        target -= _rotated(other, bits)
    return c


def _mix(a: NDArray[np.uint32], b: NDArray[np.uint32], c: NDArray[np.uint32]) -> None:
    turns = (a, c, b, 4), (b, a, c, 6), (c, b, a, 8), (a, c, b, 16), (b, a, c, 19), (c, b, a, 4)
    for target, other, third, bits in turns:
        target -= other
        target ^= _rotated(other, bits)
        other += third


def _rotated(values: NDArray[np.uint32], bits: int) -> NDArray[np.uint32]:
    return (values << np.uint32(bits)) | (values >> np.uint32(32 - bits))
