"""Gmsh files of version 4.1: an entity with a physical group for each block and each marker.

Source: the Gmsh reference manual, "MSH file format".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import FloatArray, IntArray

from ..text.rows import text_rows

_TYPES = {("line", 2): 1, ("quad", 4): 3, ("hexahedron", 8): 5}


@dataclass(frozen=True)
class Entity:
    """Elements (m, corners) of one kind, as point numbers from 0, in a physical group of their own."""

    name: str
    dimension: int
    kind: str
    elements: IntArray


def write_msh41(stream: BinaryIO, points: FloatArray, entities: Sequence[Entity], binary: bool) -> None:
    """Write points (n, 3) and entities; the numbers of points and elements begin at 1."""
    out = _Output(stream, binary)
    stream.write(b"$MeshFormat\n4.1 %d 8\n" % binary)
    if binary:
        out.numbers([1], "i")
        stream.write(b"\n")
    stream.write(b"$EndMeshFormat\n$PhysicalNames\n%d\n" % len(entities))
    for tag, entity in enumerate(entities, start=1):
        stream.write(f'{entity.dimension} {tag} "{entity.name}"\n'.encode())
    stream.write(b"$EndPhysicalNames\n$Entities\n")
    out.numbers([sum(entity.dimension == d for entity in entities) for d in range(4)], "q")
    for dimension in (1, 2, 3):
        for tag, entity in enumerate(entities, start=1):
            if entity.dimension == dimension:
                corners = points[entity.elements.ravel()]
                out.numbers([tag], "i", end="")
                out.numbers([*corners.min(axis=0), *corners.max(axis=0)], "d", end="")
                out.numbers([1], "q", end="")
                out.numbers([tag], "i", end="")
                out.numbers([0], "q")
    stream.write(b"\n$EndEntities\n$Nodes\n")
    n = len(points)
    top = max(entity.dimension for entity in entities)
    home = next(tag for tag, entity in enumerate(entities, start=1) if entity.dimension == top)
    out.numbers([1, n, 1, n], "q")
    out.numbers([top, home, 0], "i", end="")
    out.numbers([n], "q")
    out.rows(np.arange(1, n + 1)[:, None], "q")
    out.rows(points, "d")
    stream.write(b"\n$EndNodes\n$Elements\n")
    total = sum(len(entity.elements) for entity in entities)
    out.numbers([len(entities), total, 1, total], "q")
    first = 1
    for tag, entity in enumerate(entities, start=1):
        rows = np.insert(entity.elements + 1, 0, np.arange(first, first + len(entity.elements)), axis=1)
        out.numbers([entity.dimension, tag, _TYPES[entity.kind, entity.elements.shape[1]]], "i", end="")
        out.numbers([len(rows)], "q")
        out.rows(rows, "q")
        first += len(rows)
    stream.write(b"\n$EndElements\n")


class _Output:
    """Numbers as text or binary; types are those of numpy in little endian."""

    def __init__(self, stream: BinaryIO, binary: bool):
        self._stream, self._binary = stream, binary

    def numbers(self, values: Sequence[float], kind: str, end: str = "\n") -> None:
        if self._binary:
            self._stream.write(np.array(values, dtype=f"<{kind}").tobytes())
        else:
            text = " ".join(f"{value:.17g}" if kind == "d" else str(int(value)) for value in values)
            self._stream.write((text + (end or " ")).encode())

    def rows(self, values: NDArray, kind: str) -> None:
        if self._binary:
            self._stream.write(np.ascontiguousarray(values, dtype=f"<{kind}").data)
            return
        line = " ".join(["%.17g" if kind == "d" else "%d"] * values.shape[1]) + "\n"
        self._stream.writelines(text_rows(values, line))
