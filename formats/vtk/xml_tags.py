"""The tags of a VTK XML file: its elements and the position of each array, without the arrays.

The layout is described in the VTK User's Guide, "XML File Formats". Tags are read by expat, and little else of XML is
needed: a DOCTYPE, and with it every entity, is refused, and so are deeply nested and unclosed elements. The data after
``<AppendedData>`` are not XML and are never passed to the parser.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO, NoReturn
from xml.parsers import expat

from meshdeform_core.errors import FormatError

# Values of attributes, and our words for them.
_COMPRESSORS = {"": "none", "vtkZLibDataCompressor": "zlib", "vtkLZMADataCompressor": "lzma"}
_BYTE_ORDERS = {"": "little", "LittleEndian": "little", "BigEndian": "big"}
_HEADER_TYPES = {"": "UInt32", "UInt32": "UInt32", "UInt64": "UInt64"}
_APPENDED_ENCODINGS = {"": "appended-base64", "base64": "appended-base64", "raw": "appended"}

_ENCODINGS = ("utf-8", "us-ascii", "ascii", "iso-8859-1", "latin-1")
_ARRAYS = ("DataArray", "Array")
TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_END = b"</VTKFile>"

# Real files do not come near these limits; one that does would cost time and memory before it is refused.
DEEPEST = 100
_MOST_ELEMENTS = 1_000_000
_LONGEST_PROLOG = 1 << 16

_CHUNK = 1 << 20


@dataclass(slots=True)
class Element:
    """One element; ``start`` is the first byte of its tag, ``end`` that of the next tag: the text is between them."""

    tag: str
    attributes: dict[str, str]
    line: int
    start: int
    end: int = -1
    children: list[Element] = field(default_factory=list)

    def get(self, name: str) -> str:
        return self.attributes.get(name, "")

    def all(self, tag: str) -> list[Element]:
        return [child for child in self.children if child.tag == tag]

    def arrays(self) -> list[Element]:
        return [child for child in self.children if child.tag in _ARRAYS]

    def below(self) -> Iterator[Element]:
        """This element and all below it, in file order."""
        waiting = [self]
        while waiting:
            element = waiting.pop()
            yield element
            waiting.extend(reversed(element.children))


@dataclass(frozen=True)
class XmlFile:
    """The tags of a file.

    Attributes
    ----------
    kind : type of the VTKFile tag, e.g. ``StructuredGrid``
    options : ``encoding`` (of the first array), ``compression``, ``byte_order``, ``header_type`` in our words
    compression : of binary arrays, even if the first array is text
    appended : first and last byte (exclusive) of the appended data
    """

    path: Path
    size: int
    kind: str
    root: Element
    options: Mapping[str, str]
    compression: str
    appended: tuple[int, int] = (0, 0)
    appended_encoding: str = ""

    def data_set(self) -> Element:
        """The element named by the type of the file."""
        found = self.root.all(self.kind)
        if not found:
            raise FormatError(f"cannot read {self.path}: it has no {self.kind} element")
        steps = found[0].get("TimeValues").split()
        if len(steps) > 1:
            raise FormatError(f"cannot read {self.path}: it contains {len(steps)} time steps; save only one of them")
        return found[0]


def read_tags(path: Path) -> XmlFile:
    """Read the tags of a VTK XML file."""
    with path.open("rb") as stream:
        size = _require_end(path, stream)
        tags = _Tags(path, stream)
        root, appended, encoding = tags.root, (0, 0), ""
        if tags.appended is not None:
            # The bytes between the ``_`` that opens the appended data and the tag that closes them.
            start = tags.appended.start
            stream.seek(start)
            head = stream.read(4096)
            opening = TAG.match(head)
            rest = head[opening.end() :].lstrip() if opening else b""
            if not rest.startswith(b"_"):
                raise FormatError(f"cannot read {path}: no '_' follows the AppendedData tag at byte {start}")
            begin = start + len(head) - len(rest) + 1
            tail = max(start, size - 1024)
            stream.seek(tail)
            closing = stream.read(1024).rfind(b"</AppendedData")
            if closing < 0 or tail + closing < begin:
                raise FormatError(f"cannot read {path}: the appended data do not end with </AppendedData>")
            appended = begin, tail + closing
            encoding = _known(path, tags.appended, "encoding", _APPENDED_ENCODINGS)
    compression = _known(path, root, "compressor", _COMPRESSORS)
    first = next((array.get("format") for array in root.below() if array.tag in _ARRAYS), "") or "ascii"
    options = {
        "encoding": encoding or first if first == "appended" else first,
        "compression": "none" if first == "ascii" else compression,
        "byte_order": _known(path, root, "byte_order", _BYTE_ORDERS),
        "header_type": _known(path, root, "header_type", _HEADER_TYPES),
    }
    return XmlFile(path, size, root.get("type") or "unknown", root, options, compression, appended, encoding)


def _require_end(path: Path, stream: BinaryIO) -> int:
    """Size of the file, whose last tag is the end of VTKFile."""
    size = os.fstat(stream.fileno()).st_size
    if size == 0:
        raise FormatError(f"{path} is empty")
    stream.seek(max(0, size - 1024))
    if not stream.read(1024).rstrip(b" \t\r\n\0").endswith(_END):
        raise FormatError(f"{path} does not end with {_END.decode()}; the file is truncated")
    stream.seek(0)
    return size


def _known(path: Path, element: Element, key: str, words: Mapping[str, str]) -> str:
    word = element.get(key)
    if word not in words:
        raise FormatError(f"{path} has {key} {word!r}; known are {' '.join(filter(None, words))}")
    return words[word]


class _Complete(Exception):
    """Raised at the tag of the appended data, which ends the XML."""


class _Tags:
    """The elements of a file as expat reads it: all before the appended data."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path = path
        self.root: Element
        self.appended: Element | None = None
        self._open: list[Element] = []
        self._count = 0
        self._parser = parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = lambda *_: self._malformed(
            "a VTK file has no DOCTYPE; it is refused because of the entities it may define"
        )
        parser.XmlDeclHandler = self._declaration
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        prolog = stream.read(_LONGEST_PROLOG)
        start = prolog.find(b"<VTKFile")
        if start < 0:
            raise FormatError(f"cannot read {path}: it has no VTKFile element")
        try:
            # The prolog first: a DOCTYPE is refused before anything could use its definitions.
            parser.Parse(prolog[:start], False)
            parser.Parse(prolog[start:], False)
            while chunk := stream.read(_CHUNK):
                parser.Parse(chunk, False)
            parser.Parse(b"", True)
        except _Complete:
            pass
        except expat.ExpatError as error:
            raise FormatError(f"cannot read {path}: Error parsing XML: {error}") from error

    def _malformed(self, message: str) -> NoReturn:
        raise FormatError(f"cannot read {self.path}, line {self._parser.CurrentLineNumber}: {message}")

    def _declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        if encoding and encoding.lower() not in _ENCODINGS:
            self._malformed(f"the text is encoded as {encoding}; expected UTF-8")

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._count += 1
        if len(self._open) >= DEEPEST:
            self._malformed(f"elements are nested more than {DEEPEST} deep")
        if self._count > _MOST_ELEMENTS:
            self._malformed(f"there are more than {_MOST_ELEMENTS} elements")
        element = Element(tag, attributes, self._parser.CurrentLineNumber, self._parser.CurrentByteIndex)
        if len(self._open) == 1 and tag == "AppendedData":
            self.appended = element
            raise _Complete
        if self._open:
            self._text_ends(self._open[-1])
            self._open[-1].children.append(element)
        elif tag == "VTKFile":
            self.root = element
        else:
            raise FormatError(f"cannot read {self.path}: its first element is not VTKFile")
        self._open.append(element)

    def _end(self, tag: str) -> None:
        self._text_ends(self._open.pop())
        # The text of an array precedes elements inside it, such as a range of values.
        if self._open and self._open[-1].tag in _ARRAYS:
            self._parser.CharacterDataHandler = self._later_text

    def _text_ends(self, element: Element) -> None:
        if element.end < 0:
            element.end = self._parser.CurrentByteIndex
        self._parser.CharacterDataHandler = None

    def _later_text(self, text: str) -> None:
        if text.strip():
            name = self._open[-1].get("Name") or "without name"
            self._malformed(f"array {name} continues after an element inside it: {text.strip()[:40]!r}")
