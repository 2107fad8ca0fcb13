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

from .tree import DTYPES, MAXIMUM_DEPTH, Link, Node, decoded, is_adf

_BLOCK = 4096
_FILE_HEADER = struct.Struct("<32s4s28s4s28s4sss4s24s4s12s12s12s12s4s")
_NODE_HEADER = struct.Struct("<4s32s32s8s8s12s32s2s96s4s12s4s")
_CHUNK_HEAD = 16  # tag and pointer to the end tag, before the contents of every chunk of variable length
_CHILD = struct.Struct("<32s12s")
_PIECE = struct.Struct("<12s12s")
_HEXADECIMAL = re.compile(rb"[0-9A-Fa-f]+")


def read_adf(path: Path) -> Node:
    """Root node of an ADF file; data arrays are views of the file, read when used."""
    return _AdfFile(path, {}).root


class _AdfFile:
    """One ADF file mapped into memory. ``opened`` contains this file and those reached from it by links."""

    def __init__(self, path: Path, opened: dict[Path, _AdfFile]) -> None:
        self.path = path
        self.opened = opened
        self.opened[path.resolve()] = self
        try:
            with path.open("rb") as stream:
                self.bytes = mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ)
        except (OSError, ValueError) as error:  # ValueError: an empty file cannot be mapped
            raise FormatError(f"cannot read {path}: {error}") from error
        if len(self.bytes) < _FILE_HEADER.size:
            raise self.damaged(f"the file has {len(self.bytes)} bytes; its header alone has {_FILE_HEADER.size}")
        fields = _FILE_HEADER.unpack_from(self.bytes)
        what, numeric, widths, root = fields[0], fields[6], fields[9], fields[11]
        if b"ADF Database Version" not in what:
            raise FormatError(f"{path} is not an ADF file: it begins with {what[:24]!r}")
        tags = (fields[1], fields[3], fields[5], fields[8], fields[10], fields[15])
        if tags != (b"AdF0", b"AdF1", b"AdF2", b"AdF3", b"AdF4", b"AdF5"):
            raise self.damaged(f"the file header has the tags {tags}; expected AdF0 .. AdF5")
        version = what[25:31]
        if version[:1] not in b"AB" or b">" in version:
            raise FormatError(f"{path} is ADF version {decoded(version)}; known are A01xxx to B02xxx")
        if numeric not in b"LB":
            raise FormatError(
                f"{path} stores numbers in the format {decoded(numeric)!r} (C is Cray, N is unknown); "
                f"known are L and B, IEEE little and big endian: convert it on the machine that wrote it"
            )
        self.binary = version[:1] == b"B"
        self.separator = b" " if version[:3] == b"A01" else b">"
        self.order: Literal["<", ">"] = "<" if numeric == b"L" else ">"
        self.dtypes = {name: dtype.newbyteorder(self.order) for name, dtype in DTYPES.items()}
        sizes = [self.number(widths[2 * i : 2 * i + 2], "a type size") for i in range(6)]
        # A long integer has 4 bytes on 32-bit machines.
        if sizes[:3] != [1, 2, 4] or sizes[3] not in (4, 8) or sizes[4:] != [4, 8]:
            raise FormatError(
                f"{path} has char, short, int, long, float and double of {sizes} bytes; expected 1, 2, 4, 4 or 8, 4, 8"
            )
        for name, kind in (("I8", "i"), ("U8", "u")):
            self.dtypes[name] = np.dtype(f"{self.order}{kind}{sizes[3]}")
        # Every node may be reached only once; otherwise there would be a loop.
        self.visited: set[int] = set()
        self.root = self.node(bytes(root), "", 0)

    def node(self, pointer: bytes, parent: str, depth: int) -> _AdfNode:
        """The node to which a disk pointer leads."""
        at = self.offset(pointer, _NODE_HEADER.size, f"a child of {parent or '/'}")
        if at in self.visited:
            raise self.damaged(f"the node at byte {at} belongs to two parents, the second is {parent or '/'}")
        self.visited.add(at)
        header = _NODE_HEADER.unpack_from(self.bytes, at)
        begin, raw_name, label, count, _, table, kind, rank, raw_dims, n_chunks, chunks, end = header
        if (begin, end) != (b"NoDe", b"TaiL"):
            raise self.damaged(f"expected a node (NoDe .. TaiL) at byte {at}, found {begin!r} .. {end!r}")
        axes = self.number(rank, f"the number of dimensions at byte {at}")
        if axes > 12:
            raise self.damaged(f"the node at byte {at} has {axes} dimensions; at most 12 are possible")
        if self.binary:
            dims = struct.unpack(f"{self.order}12Q", raw_dims)[:axes]
        else:
            words = (raw_dims[8 * axis : 8 * axis + 8] for axis in range(axes))
            dims = tuple(self.number(word, f"a dimension at byte {at}") for word in words)
        name, data_type = decoded(raw_name), decoded(kind).upper()
        n_children = self.number(count, f"the number of children at byte {at}")
        pieces = self.number(n_chunks, f"the number of data chunks at byte {at}")
        if not name or "/" in name or name == ".":
            raise self.damaged(f"the node at byte {at} has the impossible name {name!r}")
        path = f"{parent}/{name}" if depth else ""
        if depth > MAXIMUM_DEPTH:
            raise self.damaged(f"nodes are nested more than {MAXIMUM_DEPTH} deep at {path}")
        dtype = np.dtype(np.uint8) if data_type == "LK" else self.dtypes.get(data_type)
        node = _AdfNode(
            name, self.path, path, decoded(label), data_type, dims, dtype,
            container=self, depth=depth, n_children=n_children, table=table, n_chunks=pieces, chunks=chunks,
        )  # fmt: skip
        if data_type == "LK":
            file, _, place = node.fetch_values().tobytes().partition(self.separator)
            link = Link(decoded(file.strip()), decoded(place.strip()))
            return _AdfNode(name, self.path, path, data_type="LK", link=link, container=self)
        return node

    def chunk(self, pointer: bytes, begin_tag: bytes, end_tag: bytes, what: str) -> tuple[int, int]:
        """Begin and end byte of the contents between two tags, both of which are checked."""
        at = self.offset(pointer, _CHUNK_HEAD, what)
        found = self.bytes[at : at + 4]
        if found != begin_tag:
            raise self.damaged(f"expected {begin_tag.decode()} at byte {at} for {what}, found {found!r}")
        end = self.offset(self.bytes[at + 4 : at + _CHUNK_HEAD], 4, f"the end of {what}")
        if end < at + _CHUNK_HEAD or self.bytes[end : end + 4] != end_tag:
            raise self.damaged(
                f"{what} begin at byte {at}, but there is no {end_tag.decode()} after them at byte {end}"
            )
        return at + _CHUNK_HEAD, end

    def offset(self, pointer: bytes, needed: int, what: str) -> int:
        """Byte position of a disk pointer, after which at least ``needed`` bytes must follow."""
        if self.binary:
            block, offset = struct.unpack(f"{self.order}QI", pointer)
        else:
            block = self.number(pointer[:8], f"the pointer to {what}")
            offset = self.number(pointer[8:], f"the pointer to {what}")
        at: int = block * _BLOCK + offset
        if offset > _BLOCK or at + needed > len(self.bytes):
            raise self.damaged(
                f"{what} should be at byte {at}, but the file has {len(self.bytes)} bytes: it is probably truncated"
            )
        return at

    def number(self, field: bytes, what: str) -> int:
        if not _HEXADECIMAL.fullmatch(field):
            raise self.damaged(f"{what} is {field!r}; expected a hexadecimal number")
        return int(field, 16)

    def linked(self, name: str) -> _AdfFile | None:
        """The file of a link; the CGNS library finds only ADF files."""
        for candidate in (self.path.parent / name, Path(name)):
            if candidate.is_file():
                known = self.opened.get(candidate.resolve())
                return known or (_AdfFile(candidate, self.opened) if is_adf(candidate) else None)
        return None

    def damaged(self, problem: str) -> FormatError:
        return FormatError(f"{self.path} is a damaged ADF file: {problem}; download or write it again")


@dataclass(eq=False, kw_only=True)
class _AdfNode(Node):
    """A node of the file ``container``, with the pointers to its ``table`` of children and to its data ``chunks``."""

    container: _AdfFile
    depth: int = 0
    n_children: int = 0
    table: bytes = b""
    n_chunks: int = 0
    chunks: bytes = b""

    def fetch_children(self) -> Iterator[Node]:
        if self.n_children == 0:
            return
        file, here = self.container, self.path or "/"
        begin, end = file.chunk(self.table, b"SNTb", b"snTE", f"the children of {here}")
        if self.n_children * _CHILD.size > end - begin:
            raise file.damaged(
                f"{here} has {self.n_children} children; its table has room for {(end - begin) // _CHILD.size}"
            )
        names: set[str] = set()
        for index in range(self.n_children):
            raw_name, pointer = _CHILD.unpack_from(file.bytes, begin + index * _CHILD.size)
            child = file.node(pointer, self.path, self.depth + 1)
            if child.name != decoded(raw_name):
                raise file.damaged(f"{here} lists a child {decoded(raw_name)!r} whose own name is {child.name!r}")
            if child.name in names:
                raise file.damaged(f"{here} has two children named {child.name!r}")
            names.add(child.name)
            yield child

    def fetch_values(self) -> NDArray[Any]:
        pieces = self._data_chunks()
        if self.dtype is None or not pieces:
            return super().fetch_values()
        count, data = math.prod(self.dims), self.container.bytes
        if len(pieces) == 1:
            flat = np.frombuffer(data, self.dtype, count, pieces[0][0])
        else:
            parts = [np.frombuffer(data, np.uint8, end - begin, begin) for begin, end in pieces if end > begin]
            flat = np.concatenate(parts)[: count * self.dtype.itemsize].view(self.dtype)
        return flat.reshape(self.dims, order="F")

    def fetch_target(self) -> Node | None:
        assert self.link is not None
        home = self.container.linked(self.link.file) if self.link.file else self.container
        node: Node | None = home.root if home else None
        for name in self.link.path.strip("/").split("/"):
            node = node.target.by_name.get(name) if node else None
        return node

    def place(self) -> int | None:
        pieces = self._data_chunks()
        return pieces[0][0] if len(pieces) == 1 else None

    def require_stored(self) -> None:
        self._data_chunks()

    def _data_chunks(self) -> list[tuple[int, int]]:
        """Begin and end byte of each piece of the data, which must have the declared size."""
        file, path = self.container, self.path
        if self.data_type == "MT":
            return []
        if self.dtype is None:
            known = ", ".join(DTYPES)
            raise FormatError(f"{file.path}: {path} has the data type {self.data_type!r}; known are {known}")
        needed = math.prod(self.dims) * self.dtype.itemsize
        if not self.dims or needed == 0 or self.n_chunks == 0:
            raise FormatError(f"{file.path}: {path} declares {self.contents} but none are stored")
        pointers = [self.chunks]
        if self.n_chunks > 1:
            begin, end = file.chunk(self.chunks, b"DCtb", b"dcTE", f"the data chunks of {path}")
            if self.n_chunks * _PIECE.size > end - begin:
                raise file.damaged(f"{path} has {self.n_chunks} data chunks; more than its table holds")
            places = range(begin, begin + self.n_chunks * _PIECE.size, _PIECE.size)
            pointers = [_PIECE.unpack_from(file.bytes, at)[0] for at in places]
        pieces = [file.chunk(pointer, b"DaTa", b"dEnD", f"the data of {path}") for pointer in pointers]
        stored = sum(end - begin for begin, end in pieces)
        if stored > len(file.bytes):
            raise file.damaged(f"the data chunks of {path} overlap")
        if needed > stored:
            raise file.damaged(f"{path} declares {needed} bytes of data; {stored} are stored")
        return pieces
