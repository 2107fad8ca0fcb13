"""Displacement tables as surfaces in PLY files, as text and binary.

Rows must have exactly the numbers that the header declares; shorter and longer ones are refused. Format: Greg Turk,
"The PLY polygon file format", 1994.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from .cells import fans
from .numbering import text_numbers, whole
from .table import NO_TRIANGLES, DisplacementTable, surface_table

_KINDS = {
    "char": "i1",
    "uchar": "u1",
    "short": "i2",
    "ushort": "u2",
    "int": "i4",
    "uint": "u4",
    "float": "f4",
    "double": "f8",
    "int8": "i1",
    "uint8": "u1",
    "int16": "i2",
    "uint16": "u2",
    "int32": "i4",
    "uint32": "u4",
    "float32": "f4",
    "float64": "f8",
}
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_INDICES = ("vertex_indices", "vertex_index")


@dataclass
class _Element:
    """A kind of row: its properties are (name, kind), or (name, kind of the count, kind) for lists."""

    name: str
    count: int
    properties: list[tuple[str, ...]]


def read(path: Path) -> DisplacementTable:
    """Read a surface whose vertices have displacements, like ``dx dy dz``.

    Raises
    ------
    FormatError
        When the file is damaged, or has no displacement.
    """
    try:
        return _read(path, path.read_bytes())
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise FormatError(f"cannot read {path} as PLY: {error}; the file is damaged") from error


def _read(path: Path, data: bytes) -> DisplacementTable:
    match = re.match(rb"ply\s*\n(.*?)^end_header[ \t]*\r?\n", data, re.DOTALL | re.MULTILINE)
    if not match:
        raise ValueError("it has no header from 'ply' to 'end_header'")
    order, elements = _header(match[1].decode("latin-1"))
    rows = _Rows(data[match.end() :], order)
    points: NDArray[Any] | None = None
    arrays: dict[str, NDArray[Any]] = {}
    triangles = NO_TRIANGLES
    for element in elements:
        scalars, lists = rows.take(element)
        if element.name == "vertex":
            points = np.stack([scalars.pop(axis) for axis in "xyz"], axis=1)
            arrays = scalars
        elif element.name == "face" and (found := [lists[name] for name in _INDICES if name in lists]):
            triangles = fans(found[0][0], np.cumsum(found[0][1]) - found[0][1], found[0][1])
    rows.finish()
    if points is None:
        raise ValueError("it has no vertices")
    return surface_table(path, points, arrays, triangles)


def _header(text: str) -> tuple[str, list[_Element]]:
    order = None
    elements: list[_Element] = []
    for words in (line.split() for line in text.splitlines()):
        match words:
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, "1.0"] if order is None:
                order = _ORDERS[kind]
            case ["element", name, count] if name not in [element.name for element in elements]:
                if name == "tristrips":
                    raise ValueError("triangle strips are not supported")
                elements.append(_Element(name, int(count), []))
            case ["property", "list", count, kind, name]:
                elements[-1].properties.append((name, _KINDS[count], _KINDS[kind]))
            case ["property", kind, name]:
                elements[-1].properties.append((name, _KINDS[kind]))
            case _:
                raise ValueError(f"its header has the line {' '.join(words)[:60]!r}")
    if order is None:
        raise ValueError("its header has no format")
    for element in elements:
        names = [own[0] for own in element.properties]
        if element.count < 0 or len(set(names)) != len(names):
            raise ValueError(f"its element {element.name} has a negative count or properties of the same name")
    return order, elements


Scalars = dict[str, NDArray[Any]]
Lists = dict[str, tuple[IntArray, IntArray]]
"""All entries, one row after the other, and how many each row has."""


class _Rows:
    """The rows behind the header, as text (``order`` empty) or binary."""

    def __init__(self, data: bytes, order: str):
        self.order, self.at = order, 0
        self.data = data
        self.words = text_numbers(data) if not order else np.empty(0)

    def take(self, element: _Element) -> tuple[Scalars, Lists]:
        """The rows of an element."""
        lists = [own for own in element.properties if len(own) == 3]
        if not element.count:
            none: IntArray = np.empty(0, dtype=np.int64)
            return {p[0]: np.empty(0) for p in element.properties if len(p) == 2}, {p[0]: (none, none) for p in lists}
        parts = list(self._parts(element))
        scalars = {p[0]: np.concatenate([part[p[0]] for part in parts]) for p in element.properties if len(p) == 2}
        entries = {
            name: (
                whole(np.concatenate([part[name].ravel() for part in parts])),
                whole(np.concatenate([part[f"{name} count"].ravel() for part in parts])),
            )
            for name, _, _ in lists
        }
        return {name: values[:, 0].astype(np.float64) for name, values in scalars.items()}, entries

    def _parts(self, element: _Element) -> Iterator[dict[str, NDArray[Any]]]:
        """All rows, in parts with lists of equal lengths, so that rows need not be read one by one."""
        left, most = element.count, element.count
        while left:
            lengths, start = self._lengths(element), self.at
            table, width = self._uniform(element, lengths, min(left, most))
            same = np.ones(len(next(iter(table.values()))), dtype=bool)
            for name, length in lengths.items():
                same &= table[f"{name} count"][:, 0] == length
            count = len(same) if same.all() else int(np.argmin(same))
            self.at = start + count * width
            left, most = left - count, 2 * count + 1
            yield {name: values[:count] for name, values in table.items()}

    def finish(self) -> None:
        """Refuse data that the header does not declare."""
        if self.data[self.at :].strip() if self.order else len(self.words) > self.at:
            raise ValueError("more follows than its header announces")

    def _lengths(self, element: _Element) -> dict[str, int]:
        """Lengths of the lists in the next row."""
        lengths: dict[str, int] = {}
        start = self.at
        for name, *kinds in element.properties:
            if len(kinds) == 2:
                lengths[name] = int(whole(self._numbers(kinds[0], 1))[0])
            self._numbers(kinds[-1], lengths.get(name, 1))
        self.at = start
        return lengths

    def _numbers(self, kind: str, count: int) -> NDArray[Any]:
        width = np.dtype(kind).itemsize if self.order else 1
        if not 0 <= count * width <= (len(self.data) if self.order else len(self.words)) - self.at:
            raise ValueError("its rows end too early")
        self.at += count * width
        if self.order:
            return np.frombuffer(self.data, self.order + kind, count, self.at - count * width)
        return self.words[self.at - count : self.at]

    def _uniform(self, element: _Element, lengths: dict[str, int], count: int) -> tuple[dict[str, NDArray[Any]], int]:
        """At most ``count`` rows with lists of these lengths, as far as the file goes, and the width of a row."""
        fields = []
        for name, *kinds in element.properties:
            fields += [(f"{name} count", kinds[0], 1)] if len(kinds) == 2 else []
            fields.append((name, kinds[-1], lengths.get(name, 1)))
        if self.order:
            record = np.dtype([(name, self.order + kind, (size,)) for name, kind, size in fields])
            count = min(count, (len(self.data) - self.at) // record.itemsize)
            rows = np.frombuffer(self.data, record, count, self.at)
            return {name: rows[name].reshape(count, size) for name, _, size in fields}, record.itemsize
        width = sum(size for _, _, size in fields)
        count = min(count, (len(self.words) - self.at) // width)
        table = self.words[self.at : self.at + count * width].reshape(count, width)
        ends = np.cumsum([size for _, _, size in fields])
        return {name: table[:, end - size : end] for (name, _, size), end in zip(fields, ends, strict=True)}, width
