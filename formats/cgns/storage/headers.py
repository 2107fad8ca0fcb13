"""Headers of groups and arrays in an HDF5 file, read from its bytes, as far as CGNS libraries write them.

A file of a thousand zones has some 30,000 nodes, for which the HDF5 library through h5py takes five times as long. Only
the common forms are read here: headers of versions 1 and 2 with links and attributes in the header itself, and numbers
in one range of bytes. Everything else, damage included, is left to the library: the answer is ``None``.

Source: HDF5 File Format Specification, version 3.0.
"""

from __future__ import annotations

import math
import struct
from typing import IO, Any, NamedTuple

import numpy as np
from h5py import h5t
from numpy.typing import NDArray

from .checksum import Checksums
from .tree import DTYPES

_SIGNATURE = b"\x89HDF\r\n\x1a\n"
_UNDEFINED = 0xFFFFFFFFFFFFFFFF
# Kinds of messages in headers.
_SPACE, _LINK_INFO, _TYPE, _LINK, _LAYOUT, _ATTRIBUTE = 0x01, 0x02, 0x03, 0x06, 0x08, 0x0C
_GAP, _OLD_FILL, _FILL, _GROUP_INFO = 0x00, 0x04, 0x05, 0x0A
_CONTINUATION, _TIME, _ATTRIBUTE_INFO = 0x10, 0x12, 0x15
_FOR_NODES = {_SPACE, _LINK_INFO, _TYPE, _OLD_FILL, _FILL, _LINK, _LAYOUT, _GROUP_INFO, _ATTRIBUTE, _ATTRIBUTE_INFO}
_KNOWN = _FOR_NODES | {_GAP, _TIME, _CONTINUATION}
# All but "constant" and "not to be shared", which concern writers; one of them means: stored elsewhere.
_UNUSUAL_FLAGS = 0xFF & ~0b101
_MOST_CHUNKS = 64
# Bytes that are read at once; most headers have fewer.
_GUESS = 512
_LONGEST_TEXT = 255
_OLD_HEADER, _OLD_MESSAGE, _NEW_MESSAGE = struct.Struct("<BxHII4x"), struct.Struct("<HHB3x"), struct.Struct("<BHB")
_NUMBER, _TWO, _FOUR, _SIZES = struct.Struct("<Q"), struct.Struct("<QQ"), struct.Struct("<4Q"), struct.Struct("<HHH")
_SIGNED = struct.Struct("<q")
# Numbers as HDF5 describes them, from the second byte on: the first has a version, without effect on numbers.
_NUMBERS = {h5t.py_create(dtype).encode()[3:]: dtype for dtype in DTYPES.values() if dtype.kind in "iuf"}
_LENGTHS = {0: 12, 1: 20}
"""Bytes of the description of integers and of floating-point numbers."""


class Member(NamedTuple):
    """A link from a group: its place in the order of creation, its name, and the address of the header to which it
    leads; ``None`` if that is known by a path only."""

    order: int
    name: bytes
    address: int | None


class Group(NamedTuple):
    """The attributes ``label`` and ``type`` of a group, and its members in the order of creation."""

    label: bytes
    data_type: bytes
    members: list[Member]


class Array(NamedTuple):
    """An array in one range of bytes from ``place`` on; ``shape`` with the slowest index first."""

    dtype: np.dtype[Any]
    shape: tuple[int, ...]
    place: int


class _UnusualError(Exception):
    """For the library to read."""


class Headers:
    """The headers of an open file; ``usual`` tells whether its addresses are places in the file."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._size = file.seek(0, 2)
        self._checksums = Checksums()
        self.usual = _plain(self._bytes(0, min(96, self._size)))

    def all_right(self) -> bool:
        """Whether the checksums of all headers so far are right; those of version 1 have none."""
        return self._checksums.all_right()

    def group(self, address: int) -> Group | None:
        """The group with the header at this address."""
        try:
            return _group(self._messages(address))
        except (_UnusualError, struct.error, IndexError):  # the last two: there are too few bytes
            return None

    def array(self, address: int) -> Array | None:
        """The array with the header at this address."""
        try:
            found = _array(self._messages(address))
        except (_UnusualError, struct.error, IndexError):
            return None
        return found if found.place + math.prod(found.shape) * found.dtype.itemsize <= self._size else None

    def values(self, found: Array) -> NDArray[Any]:
        """The values of an array, read-only."""
        raw = self._bytes(found.place, math.prod(found.shape) * found.dtype.itemsize)
        return np.frombuffer(raw, found.dtype).reshape(found.shape)

    def _bytes(self, at: int, size: int) -> bytes:
        if at + size > self._size:
            raise _UnusualError
        self._file.seek(at)
        return self._file.read(size)

    def _messages(self, address: int) -> list[tuple[int, bytes]]:
        """Kinds and contents of the messages in a header."""
        head = self._bytes(address, min(_GUESS, max(self._size - address, 0)))
        if head[0] == 1:
            return self._old_messages(address, head)
        if head[:5] == b"OHDR\2":
            return self._new_messages(address, head)
        raise _UnusualError

    def _old_messages(self, address: int, raw: bytes) -> list[tuple[int, bytes]]:
        """Those of the header at an address, of which the bytes ``raw`` are already known, and their continuations."""
        _, declared, _, size = _OLD_HEADER.unpack_from(raw)
        found, chunks, unpack = list[tuple[int, bytes]](), [(address + 16, size)], _OLD_MESSAGE.unpack_from
        raw, count = raw[16:], 0
        for at, size in chunks:
            if len(raw) < size:
                raw = self._bytes(at, size)
            begin = 8
            while begin <= size:
                kind, length, flags = unpack(raw, begin - 8)
                count, end = count + 1, begin + length
                _require(kind in _KNOWN and not flags & _UNUSUAL_FLAGS)
                if kind == _CONTINUATION:
                    chunks.append(_TWO.unpack_from(raw, begin))
                elif kind in _FOR_NODES:
                    found.append((kind, raw[begin:end]))
                begin = end + 8
            raw = b""
            # The last message ends with its chunk.
            _require(begin == size + 8 and len(chunks) <= _MOST_CHUNKS)
        # In place of a checksum: damaged kinds and sizes of messages often change their number.
        _require(count == declared)
        return found

    def _new_messages(self, address: int, raw: bytes) -> list[tuple[int, bytes]]:
        """Those of the header at an address, of which the bytes ``raw`` are already known, and their continuations."""
        # Times and numbers of attributes may precede the size of the messages; each of these may have a number.
        flags, width = raw[5], 1 << (raw[5] & 3)
        start = 6 + (16 if flags & 0x20 else 0) + (4 if flags & 0x10 else 0) + width
        before = 6 if flags & 4 else 4
        size = start + int.from_bytes(raw[start - width : start], "little") + 4
        found, chunks, unpack = list[tuple[int, bytes]](), [(address, size)], _NEW_MESSAGE.unpack_from
        for at, size in chunks:
            raw = raw[:size] if len(raw) >= size else self._bytes(at, size)
            self._checksums.add(raw)
            begin = start + before
            while begin <= size - 4:
                kind, length, flags = unpack(raw, begin - before)
                end = begin + length
                _require(kind in _KNOWN and not flags & _UNUSUAL_FLAGS)
                if kind == _CONTINUATION:
                    chunks.append(_TWO.unpack_from(raw, begin))
                elif kind in _FOR_NODES:
                    found.append((kind, raw[begin:end]))
                begin = end + before
            # A gap too small for a message may be left.
            _require(begin - before <= size - 4 and len(chunks) <= _MOST_CHUNKS)
            _require(at == address or raw[:4] == b"OCHK")
            raw, start = b"", 4
        return found


def _require(usual: bool) -> None:
    if not usual:
        raise _UnusualError


def _plain(superblock: bytes) -> bool:
    """Whether addresses have eight bytes and count from the first byte of the file, and nothing extends the format."""
    if not superblock.startswith(_SIGNATURE):
        return False
    version = superblock[8]
    if version < 2:
        base, _, _, driver = _FOUR.unpack_from(superblock, 24 + 4 * version)
        return superblock[13:15] == b"\10\10" and (base, driver) == (0, _UNDEFINED)
    base, extension, _, _ = _FOUR.unpack_from(superblock, 12)
    return version <= 3 and superblock[9:11] == b"\10\10" and (base, extension) == (0, _UNDEFINED)


def _group(messages: list[tuple[int, bytes]]) -> Group:
    texts, members, listed = dict[bytes, bytes](), list[Member](), False
    for kind, body in messages:
        if kind == _ATTRIBUTE:
            _add_text(texts, body)
        elif kind == _LINK:
            members.append(_member(body))
        elif kind == _LINK_INFO:
            # Version, flags, with the largest number of creation, which must be tracked; the heap of other links.
            _require(body[0] == 0 and bool(body[1] & 1) and _NUMBER.unpack_from(body, 10)[0] == _UNDEFINED)
            listed = True
        elif kind != _GROUP_INFO:
            at = 4 if body[1] & 1 else 2
            _require(kind == _ATTRIBUTE_INFO and body[0] == 0 and _NUMBER.unpack_from(body, at)[0] == _UNDEFINED)
    _require(listed and len(texts) == 2 and len({member.order for member in members}) == len(members))
    members.sort()
    return Group(texts[b"label"], texts[b"type"], members)


def _add_text(texts: dict[bytes, bytes], body: bytes) -> None:
    """Add the attribute in a message, if it is one of two: a text of fixed length."""
    version, shared = body[0], body[1]
    sizes = _SIZES.unpack_from(body, 2)
    at = 9 if version == 3 else 8
    name = body[at : at + sizes[0] - 1]
    if name not in (b"label", b"type"):
        return
    if version == 1:
        sizes, shared = tuple((n + 7) & ~7 for n in sizes), 0
    kind = at + sizes[0]
    space = kind + sizes[1]
    value = space + sizes[2]
    length = int.from_bytes(body[kind + 4 : kind + 8], "little")
    text = body[value : value + length]
    _require(1 <= version <= 3 and shared == 0 and name not in texts)
    # A string (class 3) of any version, in a scalar space of version 1 or 2, which has no dimensions.
    _require(body[kind] in (0x13, 0x23, 0x33) and sizes[1] == 8 and length == len(text) <= _LONGEST_TEXT)
    _require(body[space:value] in (b"\1" + bytes(7), b"\2" + bytes(3)))
    texts[name] = text


def _member(body: bytes) -> Member:
    flags = body[1]
    # With the order of creation.
    _require(body[0] == 1 and bool(flags & 4))
    hard, at = True, 2
    if flags & 8:
        hard, at = body[2] == 0, 3
    (order,) = _SIGNED.unpack_from(body, at)
    at += 9 if flags & 0x10 else 8
    width = 1 << (flags & 3)
    begin = at + width
    end = begin + int.from_bytes(body[at:begin], "little")
    return Member(order, body[begin:end], _NUMBER.unpack_from(body, end)[0] if hard else None)


def _array(messages: list[tuple[int, bytes]]) -> Array:
    messages = [message for message in messages if message[0] not in (_ATTRIBUTE, _OLD_FILL, _FILL)]
    parts = dict(messages)
    _require(parts.keys() == {_SPACE, _TYPE, _LAYOUT} and len(parts) == len(messages))
    space, kind, layout = parts[_SPACE], parts[_TYPE], parts[_LAYOUT]
    _require(space[0] == 1 or (space[:1] == b"\2" and space[3] == 1))
    shape = struct.unpack_from(f"<{space[1]}Q", space, 8 if space[0] == 1 else 4)
    dtype = _NUMBERS.get(kind[1 : _LENGTHS.get(kind[0] & 15, 0)])
    place, size = _TWO.unpack_from(layout, 2)
    # One range of bytes is layout 1.
    _require(dtype is not None and 1 <= kind[0] >> 4 <= 3 and layout[0] in (3, 4) and layout[1] == 1)
    assert dtype is not None
    _require(0 < math.prod(shape) * dtype.itemsize == size and space[1] > 0)
    return Array(dtype, shape, place)
