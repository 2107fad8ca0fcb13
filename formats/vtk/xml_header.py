"""What stands in a VTK XML file around the data: kind and encoding, and whether VTK may be trusted with the rest.

VTK's readers take a truncated file for complete, and abort the whole program on sizes they cannot allocate. So the
closing tag and the sizes before every binary array are checked here first. The layout (VTK User's Guide, "XML File
Formats"): before an array stands its number of bytes or, if compressed, the number of blocks, the size of a block, the
size of the last block if smaller (else 0), and the packed size of each block.
"""

from __future__ import annotations

import base64
import binascii
import mmap
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError

# Words of the VTKFile tag, and ours; the first of each is what a missing attribute means.
_COMPRESSIONS = {
    "": "none",
    "vtkZLibDataCompressor": "zlib",
    "vtkLZ4DataCompressor": "lz4",
    "vtkLZMADataCompressor": "lzma",
}
_BYTE_ORDERS = {"": "little", "LittleEndian": "little", "BigEndian": "big"}
_HEADER_TYPES = {"": "UInt32", "UInt32": "UInt32", "UInt64": "UInt64"}

_ATTRIBUTES = rb"""\b((?:[^>"]|"[^"]*")*)>"""
_ROOT = re.compile(rb"<(VTKFile)" + _ATTRIBUTES)
_ARRAY = re.compile(rb"<(DataArray|Array)" + _ATTRIBUTES)
_APPENDED = re.compile(rb"<(AppendedData)" + _ATTRIBUTES + rb"\s*_")
_SIZED = re.compile(rb"<(StructuredGrid|RectilinearGrid|ImageData|Piece|DataArray|Array)" + _ATTRIBUTES + rb"\s*")
_ATTRIBUTE = re.compile(rb"""(\w+)\s*=\s*["']([^"']*)["']""")

# Blocks of 32 kB are compressed one by one: no file packs more bytes than this into one of its own.
_LARGEST_RATIO = 10_000


@dataclass(frozen=True)
class XmlHeader:
    """``kind`` is the type of the VTKFile tag, e.g. ``StructuredGrid``; ``options`` are the variant's switches."""

    kind: str
    options: dict[str, str]


def read_header(path: Path) -> XmlHeader:
    """Read the tags of a VTK XML file and check the sizes in it.

    Raises
    ------
    FormatError
        When the closing tag is missing, or a size cannot be true.
    """
    if path.stat().st_size == 0:
        raise FormatError(f"{path} is empty")
    with path.open("rb") as stream, mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as data:
        if data.rfind(b"</VTKFile>", max(0, len(data) - 1024)) < 0:
            raise FormatError(f"{path} does not end with </VTKFile>; the file is truncated")
        root = _attributes(_ROOT.search(data))
        array, appended = _ARRAY.search(data), _APPENDED.search(data)
        encoding = _attributes(array).get("format", "ascii")
        if encoding == "appended" and _attributes(appended).get("encoding") == "base64":
            encoding = "appended-base64"
        compression = _known(path, root, "compressor", _COMPRESSIONS)
        options = {
            "encoding": encoding,
            "compression": "none" if encoding == "ascii" else compression,
            "byte_order": _known(path, root, "byte_order", _BYTE_ORDERS),
            "header_type": _known(path, root, "header_type", _HEADER_TYPES),
        }
        if array:
            _check_sizes(path, data, options, appended.end() if appended else len(data))
    return XmlHeader(root.get("type", "unknown"), options)


def _attributes(tag: re.Match[bytes] | None) -> dict[str, str]:
    found = _ATTRIBUTE.findall(tag[2]) if tag else []
    return {key.decode(): value.decode("utf-8", "replace") for key, value in found}


def _known(path: Path, root: Mapping[str, str], key: str, words: Mapping[str, str]) -> str:
    word = root.get(key, "")
    if word not in words:
        raise FormatError(f"{path} has {key} {word!r}; known are {' '.join(filter(None, words))}")
    return words[word]


def _check_sizes(path: Path, data: mmap.mmap, options: Mapping[str, str], appended: int) -> None:
    """Check every size in the tags and before the arrays; appended data begin at byte ``appended``."""
    for tag in _SIZED.finditer(data, 0, appended):
        attributes = _attributes(tag)
        if tag[1] not in (b"DataArray", b"Array"):
            _check_counts(path, len(data), tag[1].decode(), attributes)
        elif attributes.get("format") in ("appended", "binary"):
            inline, offset = attributes["format"] == "binary", attributes.get("offset", "0")
            start = tag.end() if inline else appended + (int(offset) if offset.isdecimal() else len(data))
            words = _Words(data, start, options, inline or options["encoding"] == "appended-base64")
            if not words.plausible():
                name = attributes.get("Name", "without name")
                raise FormatError(
                    f"{path}: the size of array {name}, at byte {start}, cannot be true; the file is damaged"
                )


def _check_counts(path: Path, size: int, tag: str, attributes: Mapping[str, str]) -> None:
    for key, value in attributes.items():
        numbers = [int(word) for word in re.findall(r"-?\d+", value)]
        if key.endswith("Extent") and len(numbers) == 6:
            count = 1
            for low, high in zip(numbers[::2], numbers[1::2], strict=True):
                count *= max(high - low + 1, 0)
        elif key.startswith("NumberOf") and len(numbers) == 1:
            count = numbers[0]
        else:
            continue
        if count > size * _LARGEST_RATIO:
            raise FormatError(f"{path} has {tag} {key} {value!r}: a file of {size} bytes cannot hold {count} entries")


class _Words:
    """The numbers before an array."""

    def __init__(self, data: mmap.mmap, start: int, options: Mapping[str, str], encoded: bool) -> None:
        self.data = data
        self.start = start
        self.encoded = encoded
        self.compressed = options["compression"] != "none"
        order = "<" if options["byte_order"] == "little" else ">"
        self.dtype = np.dtype(order + ("u4" if options["header_type"] == "UInt32" else "u8"))
        left = len(data) - start
        self.available = left * 3 // 4 if encoded else left

    def plausible(self) -> bool:
        """Whether the file is large enough for what the numbers say."""
        if not self.compressed:
            number = self._read(1)
            return len(number) == 1 and number[0] <= self.available
        head = self._read(3)
        if len(head) < 3 or (3 + head[0]) * self.dtype.itemsize > self.available:
            return False
        blocks, size, last = head
        packed = self._read(3 + blocks)[3:]
        unpacked_fits = max(blocks * size, last) <= self.available * _LARGEST_RATIO
        return unpacked_fits and (blocks == 0 or size > 0) and sum(packed) <= self.available

    def _read(self, count: int) -> list[int]:
        """The first ``count`` numbers, fewer where the file ends or is no base64."""
        size = count * self.dtype.itemsize
        raw: bytes = self.data[self.start : self.start + (-(-size // 3) * 4 if self.encoded else size)]
        if self.encoded:
            try:
                raw = base64.b64decode(raw, validate=True)
            except binascii.Error:
                return []
        return [int(n) for n in np.frombuffer(raw[:size], self.dtype, min(count, len(raw) // self.dtype.itemsize))]
