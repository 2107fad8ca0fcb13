"""Writing structured grids to VTK's XML files (.vts) in every variant that VTK writes."""

from __future__ import annotations

import binascii
import itertools
import lzma
import re
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import BinaryIO

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..text import number_lines
from .dataset import BlockOutput, Reserved, StoredArray, VtkFormat
from .xml_arrays import SECTIONS, TYPES, lz4_block
from .xml_tags import COMPRESSORS

_TYPE_NAMES = {code: name for name, code in TYPES.items()}
_COMPRESSORS = {compression: name for name, compression in COMPRESSORS.items()}
_BYTE_ORDERS = {"little": "LittleEndian", "big": "BigEndian"}

# Bytes that VTK compresses as one block, its level of compression, and bytes encoded in base64 at a time.
_BLOCK, _LEVEL = 1 << 15, 5
_GROUPS = 3 << 16
_SMALLEST_DICTIONARY = 4096

# Space for the offset of an array in its tag, which is written before the offset is known.
_OFFSET_DIGITS = 20

_REPLACED = {"&": "&amp;", "<": "&lt;", ">": "&gt;", '"': "&quot;", "\n": "&#10;", "\r": "&#13;", "\t": "&#9;"}
_ESCAPES = str.maketrans(_REPLACED)
_NOT_IN_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def begin_block(grid: Grid, block: int, path: Path, variant: VtkFormat, contents: Sequence[StoredArray]) -> Reserved:
    """Write one block to a .vts file, where values are stored as they are without those that have planes; returns the
    places of these.

    Raises FormatError when a field cannot be stored in a VTK file. Raises OSError when the file cannot be written.
    """
    points, *arrays = contents
    low = variant.origins[block] if variant.origins else (0, 0, 0)
    extent = " ".join(f"{a} {a + n - 1}" for a, n in zip(low, grid.shapes[block], strict=True))
    header = variant.options["header_type"]
    # The size of an array precedes it: 4 bytes hold only sizes below 4 GiB.
    if max(array.nbytes for array in contents) >= 2**32:
        header = "UInt64"
    with path.open("wb") as stream:
        output = _Output(stream, variant, header, str(path))
        output.data_set(extent, points, arrays)
    return output.reserved(contents)


def plain(options: Mapping[str, str]) -> bool:
    """Whether values are stored as they are."""
    return options["encoding"] == "appended" and options["compression"] == "none"


def attribute(text: str) -> str:
    """A text as the value of an XML attribute.

    Raises FormatError when it contains characters that XML cannot hold.
    """
    if bad := _NOT_IN_XML.search(text):
        raise FormatError(f"the name {text!r} contains the character {bad[0]!r}, which a VTK file cannot hold")
    return f'"{text.translate(_ESCAPES)}"'


def packer(compression: str, path: str) -> Callable[[bytes], bytes] | None:
    """The function that compresses one block."""
    if compression == "zlib":
        return lambda block: zlib.compress(block, _LEVEL)
    if compression == "lz4":
        compress = lz4_block(f"cannot write {path}").compress
        return lambda block: bytes(compress(block, store_size=False))
    if compression == "none":
        return None

    def pack(block: bytes) -> bytes:
        # A dictionary larger than the block costs time to clear for each block, and compresses no better.
        filters = [{"id": lzma.FILTER_LZMA2, "preset": _LEVEL, "dict_size": max(len(block), _SMALLEST_DICTIONARY)}]
        return lzma.compress(block, lzma.FORMAT_XZ, lzma.CHECK_CRC32, filters=filters)

    return pack


def _in_blocks(pieces: Iterable[bytes], size: int) -> Iterator[bytes]:
    """The bytes of all pieces in blocks of equal size; the last one may be smaller."""
    rest = b""
    for piece in pieces:
        data = rest + piece
        whole = len(data) // size * size
        for first in range(0, whole, size):
            yield data[first : first + size]
        rest = data[whole:]
    if rest:
        yield rest


class _Output(BlockOutput):
    """A .vts file being written."""

    def __init__(self, stream: BinaryIO, variant: VtkFormat, header: str, path: str) -> None:
        super().__init__(stream)
        self.header, self.options = header, variant.options
        self.order = "<" if self.options["byte_order"] == "little" else ">"
        self.pack = packer(self.options["compression"], path)
        self.appended: list[tuple[StoredArray, int]] = []

    def data_set(self, extent: str, points: StoredArray, arrays: Sequence[StoredArray]) -> None:
        # VTK calls the layout with the wider sizes version 1.0.
        version = "1.0" if self.header == "UInt64" else "0.1"
        order, compression = _BYTE_ORDERS[self.options["byte_order"]], self.options["compression"]
        compressor = f' compressor="{_COMPRESSORS[compression]}"' if self.pack else ""
        self.line('<?xml version="1.0"?>')
        self.line(
            f'<VTKFile type="StructuredGrid" version="{version}" byte_order="{order}" header_type="{self.header}"'
            f"{compressor}>"
        )
        self.line(f'  <StructuredGrid WholeExtent="{extent}">')
        field_data = [array for array in arrays if not array.location]
        if field_data:
            self.section("FieldData", field_data)
        self.line(f'    <Piece Extent="{extent}">')
        for tag in ("PointData", "CellData"):
            self.section(tag, [array for array in arrays if array.location == SECTIONS[tag]])
        self.section("Points", [points])
        self.line("    </Piece>\n  </StructuredGrid>")
        if self.options["encoding"].startswith("appended"):
            self.append()
        self.line("</VTKFile>")

    def section(self, tag: str, arrays: Sequence[StoredArray]) -> None:
        active = {role: array.name for array in arrays for role in array.roles}
        roles = "".join(f" {role}={attribute(name)}" for role, name in active.items())
        self.line(f"      <{tag}{roles}>")
        for array in arrays:
            self.array(array)
        self.line(f"      </{tag}>")

    def array(self, array: StoredArray) -> None:
        words = [f'type="{_TYPE_NAMES[array.precision.str[1:]]}"']
        if array.precision == np.int64 and not {"GlobalIds", "PedigreeIds"}.isdisjoint(array.roles):
            words.append('IdType="1"')
        words.append(f"Name={attribute(array.name)}")
        if array.components != 1:
            words.append(f'NumberOfComponents="{array.components}"')
        words += [f"ComponentName{index}={attribute(name)}" for index, name in enumerate(array.component_names)]
        if not array.location:
            words.append(f'NumberOfTuples="{array.tuples}"')
        encoding = self.options["encoding"]
        kind = encoding if encoding in ("ascii", "binary") else "appended"
        self.stream.write(f'        <DataArray {" ".join(words)} format="{kind}"'.encode())
        if kind == "appended":
            self.stream.write(b' offset="')
            self.appended.append((array, self.stream.tell()))
            self.line(" " * (_OFFSET_DIGITS + 1) + "/>")
            return
        self.line(">")
        if kind == "ascii":
            self.text(array)
        else:
            self.binary(array)
        self.line(("" if kind == "ascii" else "\n") + "        </DataArray>")

    def text(self, array: StoredArray) -> None:
        for slab in array.slabs():
            # The writer of numbers knows no integers of 8 or 16 bits.
            wide = slab.astype(np.int64) if slab.dtype.itemsize < 4 else slab
            lines = number_lines(wide)
            if wide.dtype.kind == "f" and not np.isfinite(wide).all():
                # VTK stumbles over longer words.
                lines = memoryview(bytes(lines).replace(b"Infinity", b"inf").replace(b"NaN", b"nan"))
            self.stream.write(lines)

    def binary(self, array: StoredArray) -> None:
        """The sizes and values of an array; compressed or not, raw or in base64."""
        pieces = (
            slab.astype(np.dtype(self.order + slab.dtype.str[1:]), copy=False).tobytes() for slab in array.slabs()
        )
        if self.pack is None:
            self.segment(itertools.chain([self.sizes([array.nbytes])], pieces))
            return
        number, last = -(-array.nbytes // _BLOCK), array.nbytes % _BLOCK
        place, packed, pack = self.stream.tell(), [0] * number, self.pack

        def compressed_blocks() -> Iterator[bytes]:
            for index, block in enumerate(_in_blocks(pieces, _BLOCK)):
                data = pack(block)
                packed[index] = len(data)
                yield data

        # The compressed sizes precede the blocks: they are written again when they are known.
        self.segment([self.sizes([number, _BLOCK, last, *packed])])
        self.segment(compressed_blocks())
        end = self.stream.tell()
        self.stream.seek(place)
        self.segment([self.sizes([number, _BLOCK, last, *packed])])
        self.stream.seek(end)

    def sizes(self, sizes: list[int]) -> bytes:
        return np.array(sizes, self.order + ("u4" if self.header == "UInt32" else "u8")).tobytes()

    def segment(self, pieces: Iterable[bytes]) -> None:
        """Bytes as they are, or in base64 with padding only at the end."""
        if self.options["encoding"] == "appended":
            self.stream.writelines(pieces)
        else:
            self.stream.writelines(binascii.b2a_base64(part, newline=False) for part in _in_blocks(pieces, _GROUPS))

    def append(self) -> None:
        """All arrays in sequence, and their offsets in the tags."""
        raw = self.options["encoding"] == "appended"
        self.stream.write(f'  <AppendedData encoding="{"raw" if raw else "base64"}">\n   _'.encode())
        start = self.stream.tell()
        for array, place in self.appended:
            offset = self.stream.tell() - start
            self.stream.seek(place)
            self.stream.write(f'{offset}"'.encode())
            self.stream.seek(start + offset)
            if array.in_planes and plain(self.options):
                # All ranks write these values later.
                self.stream.write(self.sizes([array.nbytes]))
                self.reserve(array, np.dtype(self.order + array.precision.str[1:]))
            else:
                self.binary(array)
        self.line("\n  </AppendedData>")
