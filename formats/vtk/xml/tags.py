"""The tags of a VTK XML file: its elements and the position of the text of each array, without the arrays.

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
from typing import Any, BinaryIO, NoReturn
from xml.parsers import expat

from meshdeform_core.errors import FormatError

# Words of the VTKFile tag, and ours; the first of each is the default.
_COMPRESSIONS = {
    "": "none",
    "vtkZLibDataCompressor": "zlib",
    "vtkLZ4DataCompressor": "lz4",
    "vtkLZMADataCompressor": "lzma",
}
_BYTE_ORDERS = {"": "little", "LittleEndian": "little", "BigEndian": "big"}
_HEADER_TYPES = {"": "UInt32", "UInt32": "UInt32", "UInt64": "UInt64"}
_APPENDED_ENCODINGS = {"": "appended-base64", "base64": "appended-base64", "raw": "appended"}

_ENCODINGS = ("utf-8", "us-ascii", "ascii", "iso-8859-1", "latin-1")
_ARRAYS = ("DataArray", "Array")
_APPENDED_TAG = re.compile(rb"""<AppendedData(?:[^>"']|"[^"]*"|'[^']*')*>\s*_""")
_END = b"</VTKFile>"

# Real files do not come near these limits; one that does would cost time and memory before it is refused.
DEEPEST = 100
_MOST_ELEMENTS = 1_000_000
_LONGEST_PROLOG = 1 << 16

_CHUNK = 1 << 20


@dataclass(slots=True)
class Element:
    """One element; ``start`` and ``end`` are the first and last byte (exclusive) of the text of an array."""

    tag: str
    attributes: dict[str, str]
    line: int
    children: list[Element] = field(default_factory=list)
    start: int = -1
    end: int = -1

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
    options : ``encoding`` (of the first array), ``compression``, ``byte_order``, ``header_type`` in the writer's words
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
        """The element named by the type of the file.

        Raises
        ------
        FormatError
            When it is missing or contains more than one time step.
        """
        found = self.root.all(self.kind)
        if not found:
            raise FormatError(f"cannot read {self.path}: it has no {self.kind} element")
        steps = found[0].get("TimeValues").split()
        if len(steps) > 1:
            raise FormatError(f"cannot read {self.path}: it contains {len(steps)} time steps; save only one of them")
        return found[0]


def file_kind(path: Path) -> str:
    """Type of the VTKFile tag, e.g. ``StructuredGrid``; ``unknown`` if missing.

    Raises
    ------
    FormatError
        When the file is truncated or not a VTK file.
    """
    with path.open("rb") as stream:
        _require_end(path, stream)
        return _Tags(path, stream).root_only().get("type") or "unknown"


def read_tags(path: Path) -> XmlFile:
    """Read the tags of a VTK XML file.

    Raises
    ------
    FormatError
        When the file is truncated, is not well-formed XML, has a DOCTYPE, nests elements deeper than :data:`DEEPEST`,
        or its VTKFile tag has unknown attribute values.
    """
    with path.open("rb") as stream:
        size = _require_end(path, stream)
        tags = _Tags(path, stream)
        root = tags.whole()
        compression = _known(path, root, "compressor", _COMPRESSIONS)
        options = {
            "encoding": "ascii",
            "compression": compression,
            "byte_order": _known(path, root, "byte_order", _BYTE_ORDERS),
            "header_type": _known(path, root, "header_type", _HEADER_TYPES),
        }
        appended, encoding = (0, 0), ""
        if tags.appended is not None:
            appended = _appended_data(path, stream, tags.appended.start, size)
            encoding = _known(path, tags.appended, "encoding", _APPENDED_ENCODINGS)
    first = next((array.get("format") for array in root.below() if array.tag in _ARRAYS), "") or "ascii"
    options["encoding"] = encoding or first if first == "appended" else first
    if options["encoding"] == "ascii":
        options["compression"] = "none"
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


def _appended_data(path: Path, stream: BinaryIO, start: int, size: int) -> tuple[int, int]:
    """The bytes between the ``_`` that opens the appended data and the tag that closes them."""
    stream.seek(start)
    opening = _APPENDED_TAG.match(stream.read(4096))
    if opening is None:
        raise FormatError(f"cannot read {path}: no '_' follows the AppendedData tag at byte {start}")
    tail = max(start, size - 1024)
    stream.seek(tail)
    closing = stream.read(1024).rfind(b"</AppendedData")
    if closing < 0 or tail + closing < start + opening.end():
        raise FormatError(f"cannot read {path}: the appended data do not end with </AppendedData>")
    return start + opening.end(), tail + closing


class _Appended(Exception):
    """Raised after the AppendedData tag, which ends the XML part of the file."""


class _Root(Exception):
    """Raised after the first tag."""


class _Tags:
    """The elements of a file, gathered while expat reads it."""

    def __init__(self, path: Path, stream: BinaryIO) -> None:
        self.path, self.stream = path, stream
        self.root: Element | None = None
        self.appended: Element | None = None
        self._open: list[Element] = []
        self._depth = self._count = 0
        self._parser = parser = expat.ParserCreate()
        parser.StartDoctypeDeclHandler = self._doctype
        parser.XmlDeclHandler = self._declaration
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end

    def root_only(self) -> Element:
        """The VTKFile element without its contents."""
        self._parser.StartElementHandler = self._first
        self._parse(_Root)
        return self._required_root()

    def whole(self) -> Element:
        """The VTKFile element with its contents."""
        self._parse(_Appended)
        return self._required_root()

    def _required_root(self) -> Element:
        if self.root is None or self.root.tag != "VTKFile":
            raise FormatError(f"cannot read {self.path}: its first element is not VTKFile")
        return self.root

    def _parse(self, stop: type[Exception]) -> None:
        prolog = self.stream.read(_LONGEST_PROLOG)
        start = prolog.find(b"<VTKFile")
        if start < 0:
            raise FormatError(f"cannot read {self.path}: it has no VTKFile element")
        try:
            # The prolog first: a DOCTYPE is refused before anything could use its definitions.
            self._parser.Parse(prolog[:start], False)
            self._parser.Parse(prolog[start:], False)
            while chunk := self.stream.read(_CHUNK):
                self._parser.Parse(chunk, False)
            self._parser.Parse(b"", True)
        except stop:
            pass
        except expat.ExpatError as error:
            raise FormatError(f"cannot read {self.path}: Error parsing XML: {error}") from error

    def _refuse(self, message: str) -> NoReturn:
        raise FormatError(f"cannot read {self.path}, line {self._parser.CurrentLineNumber}: {message}")

    def _doctype(self, *_: Any) -> NoReturn:
        self._refuse("a VTK file has no DOCTYPE; it is refused because of the entities it may define")

    def _declaration(self, version: str, encoding: str | None, standalone: int) -> None:
        if encoding and encoding.lower() not in _ENCODINGS:
            self._refuse(f"the text is encoded as {encoding}; expected UTF-8")

    def _first(self, tag: str, attributes: dict[str, str]) -> NoReturn:
        self.root = Element(tag, attributes, self._parser.CurrentLineNumber)
        raise _Root

    def _start(self, tag: str, attributes: dict[str, str]) -> None:
        self._depth += 1
        self._count += 1
        if self._depth > DEEPEST:
            self._refuse(f"elements are nested more than {DEEPEST} deep")
        if self._count > _MOST_ELEMENTS:
            self._refuse(f"there are more than {_MOST_ELEMENTS} elements")
        above = self._open[-1] if self._open else None
        if above is not None and above.tag in _ARRAYS:
            self._end_of_text(above)
            return
        element = Element(tag, attributes, self._parser.CurrentLineNumber)
        if above is None:
            self.root = element
        elif tag == "AppendedData" and self._depth == 2:
            element.start = self._parser.CurrentByteIndex
            self.appended = element
            raise _Appended
        else:
            above.children.append(element)
        self._open.append(element)
        if tag in _ARRAYS:
            self._parser.CharacterDataHandler = self._first_text

    def _end(self, tag: str) -> None:
        self._depth -= 1
        if len(self._open) > self._depth:
            element = self._open.pop()
            if element.tag in _ARRAYS:
                self._end_of_text(element)
                self._parser.CharacterDataHandler = None
        elif len(self._open) == self._depth:
            # After an element inside an array, such as a range of values, which the array's own text precedes.
            self._parser.CharacterDataHandler = self._later_text

    def _end_of_text(self, array: Element) -> None:
        if array.end < 0:
            array.end = self._parser.CurrentByteIndex
            array.start = array.end if array.start < 0 else array.start
        self._parser.CharacterDataHandler = None

    def _first_text(self, _: str) -> None:
        self._open[-1].start = self._parser.CurrentByteIndex
        self._parser.CharacterDataHandler = None

    def _later_text(self, text: str) -> None:
        if text.strip():
            name = self._open[-1].get("Name") or "without name"
            self._refuse(f"array {name} continues after an element inside it: {text.strip()[:40]!r}")
