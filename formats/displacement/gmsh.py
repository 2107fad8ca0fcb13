"""Displacement tables as surfaces of Gmsh, versions 2 and 4.1, as text and binary.

A ``$NodeData`` section lists the numbers of the nodes to which its data belong, in any order; meshio assigns the data
to nodes in the order of the file, hence this reader. Format: Gmsh reference manual, "Gmsh file formats".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from .cells import split_cells
from .numbering import by_number, rows_of, text_numbers, whole
from .table import NO_TRIANGLES, DisplacementTable, surface_table

# Nodes of the elements up to type 19, and corners of those that are surfaces.
_NODES = {1: 2, 2: 3, 3: 4, 4: 4, 5: 8, 6: 6, 7: 5, 8: 3, 9: 6, 10: 9, 11: 10, 12: 27, 13: 18, 14: 14, 15: 1, 16: 8,
          17: 20, 18: 15, 19: 13}  # fmt: skip
_CORNERS = {2: 3, 3: 4, 9: 3, 10: 4, 16: 4}
_VERSIONS = ("2", "2.0", "2.1", "2.2", "4.1")


def read(path: Path) -> DisplacementTable:
    """Read a surface with displacements as ``$NodeData``.

    Raises
    ------
    FormatError
        When the file is damaged, of another version, has no displacement, or not one for every node.
    """
    try:
        return _read(path, path.read_bytes())
    except (ValueError, IndexError, KeyError, OverflowError) as error:
        raise FormatError(f"cannot read {path} as gmsh: {error}; the file is damaged") from error


def _read(path: Path, data: bytes) -> DisplacementTable:
    sections = list(_sections(data))
    heads = [body for name, body in sections if name == "MeshFormat"]
    words = heads[0].split(b"\n")[0].split() if heads else []
    version = words[0].decode("latin-1") if words else "none"
    if version not in _VERSIONS:
        raise FormatError(f"{path}: version {version} of Gmsh's format; expected 2.2 or 4.1 (gmsh -save -format msh41)")
    order = "" if words[1] == b"0" else ">" if heads[0].split(b"\n", 1)[1][:4] == b"\0\0\0\1" else "<"
    bodies: dict[str, bytes] = {}
    for name, body in sections:
        if name in ("Nodes", "Elements") and name in bodies:
            raise FormatError(f"{path} has two sections ${name}; expected one")
        bodies[name] = body
    nodes, elements = (_nodes_2, _elements_2) if version[0] == "2" else (_nodes_4, _elements_4)
    numbers, points = nodes(_Numbers(bodies["Nodes"], order))
    arrays: dict[str, NDArray[Any]] = {}
    for name, own, values in (_node_data(body, order) for name, body in sections if name == "NodeData"):
        if name in arrays:
            raise FormatError(f"{path} has several $NodeData called {name!r} (steps in time?); expected one")
        arrays[name] = by_number(path, name, numbers, own, values)
    triangles = [NO_TRIANGLES]
    if "Elements" in bodies:
        for kind, corners in elements(_Numbers(bodies["Elements"], order)):
            rows = rows_of(path, numbers, corners)
            triangles.append(split_cells(rows, _CORNERS[kind]))
    return surface_table(path, points, arrays, np.concatenate(triangles))


def _sections(data: bytes) -> Iterator[tuple[str, bytes]]:
    """Name and body of every section."""
    at = 0
    while match := re.compile(rb"\s*\$(\w+)[ \t]*\r?\n").match(data, at):
        end = data.find(b"$End" + match[1], match.end())
        if end < 0:
            raise ValueError(f"${match[1].decode()} has no end")
        yield match[1].decode(), data[match.end() : end]
        at = end + 4 + len(match[1])
    if data[at:].strip():
        raise ValueError(f"found {data[at : at + 20].strip()!r} between sections")


class _Numbers:
    """The numbers of a section, as text (``order`` empty) or binary."""

    def __init__(self, data: bytes, order: str):
        self.data, self.order, self.at = data, order, 0
        self.words = text_numbers(data) if not order else np.empty(0)

    def integers(self, count: int, kind: str = "i4") -> IntArray:
        """The next ``count`` whole numbers, of type ``kind`` in binary files."""
        if not self.order:
            return whole(self._words(count))
        return self._records(count, np.dtype(self.order + kind)).astype(np.int64)

    def rows(self, count: int, floats: int) -> tuple[IntArray, NDArray[Any]]:
        """The next ``count`` rows of a number and floats."""
        if not self.order:
            table = self._words(count * (1 + floats)).reshape(count, 1 + floats)
            return whole(table[:, 0]), table[:, 1:]
        found = self._records(count, np.dtype([("number", self.order + "i4"), ("x", self.order + "f8", (floats,))]))
        return found["number"].astype(np.int64), found["x"].reshape(count, floats).astype(np.float64)

    def floats(self, count: int) -> NDArray[Any]:
        """The next ``count`` floats."""
        return self._records(count, np.dtype(self.order + "f8")) if self.order else self._words(count)

    def finish(self, what: str) -> None:
        """Refuse a section with numbers left over."""
        left = self.data[self.at :].strip() if self.order else self.words[self.at :]
        if len(left):
            raise ValueError(f"{what}: more numbers than announced")

    def _words(self, count: int) -> NDArray[Any]:
        if not 0 <= count <= len(self.words) - self.at:
            raise ValueError(f"{count} numbers announced, {len(self.words) - self.at} found")
        self.at += count
        return self.words[self.at - count : self.at]

    def _records(self, count: int, kind: np.dtype[Any]) -> NDArray[Any]:
        if not 0 <= count <= (len(self.data) - self.at) // kind.itemsize:
            raise ValueError(f"{count} records announced, {len(self.data) - self.at} bytes found")
        self.at += count * kind.itemsize
        return np.frombuffer(self.data, kind, count, self.at - count * kind.itemsize)


def _line(data: bytes, at: int) -> tuple[bytes, int]:
    end = data.index(b"\n", at)
    return data[at:end].strip(), end + 1


def _nodes_2(numbers: _Numbers) -> tuple[IntArray, NDArray[Any]]:
    if numbers.order:
        line, numbers.at = _line(numbers.data, 0)
        count = int(line)
    else:
        count = int(numbers.integers(1)[0])
    found = numbers.rows(count, 3)
    numbers.finish("$Nodes")
    return found


def _nodes_4(numbers: _Numbers) -> tuple[IntArray, NDArray[Any]]:
    blocks, total, _, _ = numbers.integers(4, "u8").tolist()
    tags, points = [], []
    for _ in range(blocks):
        _, _, parametric = numbers.integers(3).tolist()
        if parametric:
            raise ValueError("nodes with parameters are not supported (Mesh.SaveParametric = 0)")
        count = int(numbers.integers(1, "u8")[0])
        tags.append(numbers.integers(count, "u8"))
        points.append(numbers.floats(3 * count).reshape(count, 3))
    numbers.finish("$Nodes")
    if sum(map(len, tags)) != total:
        raise ValueError(f"{total} nodes announced, {sum(map(len, tags))} found")
    return np.concatenate(tags), np.concatenate(points)


def _elements_2(numbers: _Numbers) -> Iterator[tuple[int, IntArray]]:
    """Type and node numbers of surface elements."""
    if not numbers.order:
        yield from _elements_2_text(numbers)
        return
    line, numbers.at = _line(numbers.data, 0)
    left = int(line)
    while left > 0:
        kind, count, tags = numbers.integers(3).tolist()
        width = 1 + tags + _NODES[kind]
        table = numbers.integers(count * width).reshape(count, width)
        left -= max(count, 1)
        if kind in _CORNERS:
            yield kind, table[:, 1 + tags :]
    numbers.finish("$Elements")


def _elements_2_text(numbers: _Numbers) -> Iterator[tuple[int, IntArray]]:
    words = whole(numbers.words).tolist()
    found: dict[int, list[list[int]]] = {}
    seen: set[int] = set()
    at = 1
    for _ in range(words[0]):
        number, kind, tags = words[at : at + 3]
        first, at = at + 3 + tags, at + 3 + tags + _NODES[kind]
        if tags < 0 or at > len(words):
            raise ValueError("$Elements ends too early")
        # With a number missing or added, elements are misread, and one of them usually appears twice.
        if number in seen:
            raise ValueError(f"$Elements has two elements {number}")
        seen.add(number)
        if kind in _CORNERS:
            found.setdefault(kind, []).append(words[first:at])
    if at != len(words):
        raise ValueError("$Elements: more numbers than announced")
    yield from ((kind, np.array(rows, dtype=np.int64)) for kind, rows in found.items())


def _elements_4(numbers: _Numbers) -> Iterator[tuple[int, IntArray]]:
    blocks = int(numbers.integers(4, "u8")[0])
    for _ in range(blocks):
        _, _, kind = numbers.integers(3).tolist()
        count = int(numbers.integers(1, "u8")[0])
        width = 1 + _NODES[kind]
        table = numbers.integers(count * width, "u8").reshape(count, width)
        if kind in _CORNERS:
            yield kind, table[:, 1:]
    numbers.finish("$Elements")


def _node_data(data: bytes, order: str) -> tuple[str, IntArray, NDArray[Any]]:
    """Name, node numbers and values (n,) or (n, components) of a section."""
    at, tags = 0, []
    for _ in range(3):
        line, at = _line(data, at)
        group = []
        for _ in range(int(line)):
            line, at = _line(data, at)
            group.append(line)
        tags.append(group)
    _, components, count = (int(word) for word in tags[2][:3])
    if components < 1:
        raise ValueError(f"$NodeData of {components} components")
    numbers = _Numbers(data[at:], order)
    own, values = numbers.rows(count, components)
    numbers.finish("$NodeData")
    return tags[0][0].strip(b'"').decode("utf-8", "replace"), own, values if components > 1 else values[:, 0]
