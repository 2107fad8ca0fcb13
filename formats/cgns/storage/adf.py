"""Read the ADF container (Advanced Data Format), in which most public CGNS files are stored.

An ADF file is a tree of nodes in 4096-byte blocks, linked by disk pointers (block, offset). Each piece lies between a
start and an end tag: the node header ``NoDe`` .. ``TaiL``, its table of children ``SNTb`` .. ``snTE``, its
data ``DaTa`` .. ``dEnD``, or a table ``DCtb`` .. ``dcTE`` of several such data chunks. Numbers in headers are ASCII
hexadecimal; version B writes pointers and dimensions in binary, in the byte order of the data.

Source: the layout tables at the head of ADF_internals.c in the public CGNS library.
"""

from __future__ import annotations

import math
import mmap
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from .tree import DTYPES, MAXIMUM_DEPTH, Link, Node, decoded, describe

_BLOCK = 4096
_FILE_HEADER = struct.Struct("<32s4s28s4s28s4sss4s24s4s12s12s12s12s4s")
_NODE_HEADER = struct.Struct("<4s32s32s8s8s12s32s2s96s4s12s4s")
_CHUNK_HEAD = 16  # tag and pointer to the end tag, before the contents of every chunk of variable length
_CHILD = struct.Struct("<32s12s")
_PIECE = struct.Struct("<12s12s")
_HEXADECIMAL = re.compile(rb"[0-9A-Fa-f]+")


def read_adf(path: Path) -> Node:
    """Root node of an ADF file; data arrays are views of the file, read when used.

    Raises
    ------
    FormatError
        When the file is not ADF, truncated, damaged, or in a number format of obsolete machines; also later, when a
        damaged part is reached.
    """
    return _AdfFile(path, {}).root


@dataclass(frozen=True)
class _Header:
    """The fields of a node header that are needed after it has been checked."""

    name: str
    label: str
    data_type: str
    dims: tuple[int, ...]
    n_children: int
    children: bytes
    n_chunks: int
    chunks: bytes


class _AdfFile:
    """One ADF file mapped into memory. ``opened`` contains this file and those reached from it by links."""

    def __init__(self, path: Path, opened: dict[Path, _AdfFile]) -> None:
        self.path = path
        self.opened = opened
        self.opened[path.resolve()] = self
        self.bytes = _mapped(path)
        # Every node may be reached only once; otherwise there would be a loop.
        self.visited: set[int] = set()
        root = self._read_file_header()
        self.root = self._node(root, "", 0)

    def _read_file_header(self) -> bytes:
        """Check the file header, determine the number format, return the pointer to the root node."""
        if len(self.bytes) < _FILE_HEADER.size:
            raise self._damaged(f"the file has {len(self.bytes)} bytes; its header alone has {_FILE_HEADER.size}")
        fields = _FILE_HEADER.unpack_from(self.bytes)
        what, numeric, sizes, root = fields[0], fields[6], fields[9], fields[11]
        if b"ADF Database Version" not in what:
            raise FormatError(f"{self.path} is not an ADF file: it begins with {what[:24]!r}")
        tags = (fields[1], fields[3], fields[5], fields[8], fields[10], fields[15])
        if tags != (b"AdF0", b"AdF1", b"AdF2", b"AdF3", b"AdF4", b"AdF5"):
            raise self._damaged(f"the file header has the tags {tags}; expected AdF0 .. AdF5")
        version = what[25:31]
        if version[:1] not in b"AB" or b">" in version:
            raise FormatError(f"{self.path} is ADF version {decoded(version)}; known are A01xxx to B02xxx")
        if numeric not in b"LB":
            raise FormatError(
                f"{self.path} stores numbers in the format {decoded(numeric)!r} (C is Cray, N is unknown); "
                f"known are L and B, IEEE little and big endian: convert it on the machine that wrote it"
            )
        self.binary = version[:1] == b"B"
        self.separator = b" " if version[:3] == b"A01" else b">"
        self.order: Literal["<", ">"] = "<" if numeric == b"L" else ">"
        self.dtypes = {name: dtype.newbyteorder(self.order) for name, dtype in DTYPES.items()}
        self._check_sizes([self._number(sizes[2 * i : 2 * i + 2], "a type size") for i in range(6)])
        return bytes(root)

    def _check_sizes(self, sizes: list[int]) -> None:
        """Check ``sizes`` of char, short, int, long, float, double; long has 4 bytes on 32-bit machines."""
        if sizes[:3] != [1, 2, 4] or sizes[3] not in (4, 8) or sizes[4:] != [4, 8]:
            raise FormatError(
                f"{self.path} has char, short, int, long, float and double of {sizes} bytes; "
                f"expected 1, 2, 4, 4 or 8, 4, 8"
            )
        for name, kind in (("I8", "i"), ("U8", "u")):
            self.dtypes[name] = np.dtype(f"{self.order}{kind}{sizes[3]}")

    def _node(self, pointer: bytes, parent: str, depth: int) -> Node:
        header = self._header(pointer, parent)
        path = f"{parent}/{header.name}" if depth else ""
        if depth > MAXIMUM_DEPTH:
            raise self._damaged(f"nodes are nested more than {MAXIMUM_DEPTH} deep at {path}")
        if header.data_type == "LK":
            text = self._values(header, path, np.dtype(np.uint8)).tobytes()
            file, _, place = text.partition(self.separator)
            link = Link(decoded(file.strip()), decoded(place.strip()))
            return Node(header.name, self.path, path, data_type="LK", link=link, follow=lambda: self._follow(link))
        dtype = self.dtypes.get(header.data_type)
        return Node(
            header.name,
            self.path,
            path,
            header.label,
            header.data_type,
            header.dims,
            dtype,
            read=lambda: self._values(header, path, dtype),
            require=lambda: self._pieces(header, path, dtype),
            expand=lambda: self._children(header, path, depth + 1),
            place=lambda: self._place(header, path, dtype),
        )

    def _header(self, pointer: bytes, parent: str) -> _Header:
        at = self._offset(pointer, _NODE_HEADER.size, f"a child of {parent or '/'}")
        if at in self.visited:
            raise self._damaged(f"the node at byte {at} belongs to two parents, the second is {parent or '/'}")
        self.visited.add(at)
        begin, name, label, count, _, table, kind, rank, dims, n_chunks, chunks, end = _NODE_HEADER.unpack_from(
            self.bytes, at
        )
        if (begin, end) != (b"NoDe", b"TaiL"):
            raise self._damaged(f"expected a node (NoDe .. TaiL) at byte {at}, found {begin!r} .. {end!r}")
        header = _Header(
            decoded(name),
            decoded(label),
            decoded(kind).upper(),
            self._dimensions(rank, dims, at),
            self._number(count, f"the number of children at byte {at}"),
            table,
            self._number(n_chunks, f"the number of data chunks at byte {at}"),
            chunks,
        )
        if not header.name or "/" in header.name or header.name == ".":
            raise self._damaged(f"the node at byte {at} has the impossible name {header.name!r}")
        return header

    def _dimensions(self, rank: bytes, dims: bytes, at: int) -> tuple[int, ...]:
        count = self._number(rank, f"the number of dimensions at byte {at}")
        if count > 12:
            raise self._damaged(f"the node at byte {at} has {count} dimensions; at most 12 are possible")
        if self.binary:
            return struct.unpack(f"{self.order}12Q", dims)[:count]
        return tuple(self._number(dims[8 * i : 8 * i + 8], f"a dimension at byte {at}") for i in range(count))

    def _children(self, header: _Header, path: str, depth: int) -> Iterator[Node]:
        if header.n_children == 0:
            return
        begin, end = self._chunk(header.children, b"SNTb", b"snTE", f"the children of {path or '/'}")
        if header.n_children * _CHILD.size > end - begin:
            raise self._damaged(
                f"{path or '/'} has {header.n_children} children; its table has room for {(end - begin) // _CHILD.size}"
            )
        names: set[str] = set()
        for index in range(header.n_children):
            name, pointer = _CHILD.unpack_from(self.bytes, begin + index * _CHILD.size)
            child = self._node(pointer, path, depth)
            if child.name != decoded(name):
                raise self._damaged(f"{path or '/'} lists a child {decoded(name)!r} whose own name is {child.name!r}")
            if child.name in names:
                raise self._damaged(f"{path or '/'} has two children named {child.name!r}")
            names.add(child.name)
            yield child

    def _values(self, header: _Header, path: str, dtype: np.dtype[Any] | None) -> NDArray[Any]:
        """Data of a node: a view of the file if they are contiguous."""
        pieces = self._pieces(header, path, dtype)
        if dtype is None or not pieces:
            return np.empty(0, np.uint8)
        count = math.prod(header.dims)
        if len(pieces) == 1:
            flat = np.frombuffer(self.bytes, dtype, count, pieces[0][0])
        else:
            parts = [np.frombuffer(self.bytes, np.uint8, end - begin, begin) for begin, end in pieces if end > begin]
            flat = np.concatenate(parts)[: count * dtype.itemsize].view(dtype)
        return flat.reshape(header.dims, order="F")

    def _place(self, header: _Header, path: str, dtype: np.dtype[Any] | None) -> int | None:
        pieces = self._pieces(header, path, dtype)
        return pieces[0][0] if len(pieces) == 1 else None

    def _pieces(self, header: _Header, path: str, dtype: np.dtype[Any] | None) -> list[tuple[int, int]]:
        """Begin and end byte of each piece of a node's data, which must have the declared size."""
        if header.data_type == "MT":
            return []
        if dtype is None:
            known = ", ".join(DTYPES)
            raise FormatError(f"{self.path}: {path} has the data type {header.data_type!r}; known are {known}")
        needed = math.prod(header.dims) * dtype.itemsize
        if not header.dims or needed == 0 or header.n_chunks == 0:
            announced = describe(header.dims, header.data_type)
            raise FormatError(f"{self.path}: {path} declares {announced} but none are stored")
        pieces = self._chunks(header, path)
        stored = sum(end - begin for begin, end in pieces)
        if stored > len(self.bytes):
            raise self._damaged(f"the data chunks of {path} overlap")
        if needed > stored:
            raise self._damaged(f"{path} declares {needed} bytes of data; {stored} are stored")
        return pieces

    def _chunks(self, header: _Header, path: str) -> list[tuple[int, int]]:
        """Begin and end byte of each data chunk of a node."""
        if header.n_chunks == 1:
            return [self._chunk(header.chunks, b"DaTa", b"dEnD", f"the data of {path}")]
        begin, end = self._chunk(header.chunks, b"DCtb", b"dcTE", f"the data chunks of {path}")
        if header.n_chunks * _PIECE.size > end - begin:
            raise self._damaged(f"{path} has {header.n_chunks} data chunks; more than its table holds")
        starts = (_PIECE.unpack_from(self.bytes, begin + i * _PIECE.size)[0] for i in range(header.n_chunks))
        return [self._chunk(start, b"DaTa", b"dEnD", f"the data of {path}") for start in starts]

    def _chunk(self, pointer: bytes, begin_tag: bytes, end_tag: bytes, what: str) -> tuple[int, int]:
        """Begin and end byte of the contents between two tags, both of which are checked."""
        at = self._offset(pointer, _CHUNK_HEAD, what)
        found = self.bytes[at : at + 4]
        if found != begin_tag:
            raise self._damaged(f"expected {begin_tag.decode()} at byte {at} for {what}, found {found!r}")
        end = self._offset(self.bytes[at + 4 : at + _CHUNK_HEAD], 4, f"the end of {what}")
        if end < at + _CHUNK_HEAD or self.bytes[end : end + 4] != end_tag:
            raise self._damaged(
                f"{what} begin at byte {at}, but there is no {end_tag.decode()} after them at byte {end}"
            )
        return at + _CHUNK_HEAD, end

    def _offset(self, pointer: bytes, room: int, what: str) -> int:
        """Byte position of a disk pointer, after which at least ``room`` bytes must follow."""
        if self.binary:
            block, offset = struct.unpack(f"{self.order}QI", pointer)
        else:
            block = self._number(pointer[:8], f"the pointer to {what}")
            offset = self._number(pointer[8:], f"the pointer to {what}")
        at: int = block * _BLOCK + offset
        if offset > _BLOCK or at + room > len(self.bytes):
            raise self._damaged(
                f"{what} should be at byte {at}, but the file has {len(self.bytes)} bytes: it is probably truncated"
            )
        return at

    def _number(self, field: bytes, what: str) -> int:
        if not _HEXADECIMAL.fullmatch(field):
            raise self._damaged(f"{what} is {field!r}; expected a hexadecimal number")
        return int(field, 16)

    def _follow(self, link: Link) -> Node | None:
        """The target of a link, ``None`` if file or node do not exist (the CGNS library finds only ADF files)."""
        home = self._linked_file(link.file) if link.file else self
        if home is None:
            return None
        node: Node | None = home.root
        for name in link.path.strip("/").split("/"):
            node = node.child(name) if node else None
        return node

    def _linked_file(self, name: str) -> _AdfFile | None:
        for candidate in (self.path.parent / name, Path(name)):
            if candidate.is_file():
                known = self.opened.get(candidate.resolve())
                return known or (_AdfFile(candidate, self.opened) if is_adf(candidate) else None)
        return None

    def _damaged(self, problem: str) -> FormatError:
        return FormatError(f"{self.path} is a damaged ADF file: {problem}; download or write it again")


def is_adf(path: Path) -> bool:
    """Whether a file begins like an ADF file."""
    try:
        with path.open("rb") as stream:
            return b"ADF Database Version" in stream.read(32)
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error


def _mapped(path: Path) -> mmap.mmap:
    try:
        with path.open("rb") as stream:
            return mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
    except (OSError, ValueError) as error:  # ValueError: an empty file cannot be mapped
        raise FormatError(f"cannot read {path}: {error}") from error
