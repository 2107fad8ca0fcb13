"""Displacement tables as surfaces, read by meshio, with checks of what meshio takes without looking."""

from __future__ import annotations

import contextlib
import io
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from .table import NO_TRIANGLES, DisplacementTable, split_cells, surface_table

# Corners of two-dimensional cells; nodes on edges and inside follow them.
_CORNERS = {"triangle": 3, "triangle6": 3, "triangle7": 3, "quad": 4, "quad8": 4, "quad9": 4}
# Nodes of Gmsh's surface elements, by type.
_GMSH_NODES = {2: 3, 3: 4, 9: 6, 10: 9, 16: 8}
_AVS_CORNERS = {"tri": 3, "quad": 4}


def read(path: Path, file_format: str) -> DisplacementTable:
    """Read a surface with displacements as point data."""
    try:
        source = _SOURCES.get(file_format, str)(path)
        # Not meshio.read, which prints errors and ends the program.
        with contextlib.redirect_stderr(io.StringIO()) as doubts:
            mesh = getattr(meshio, file_format).read(source)
        if doubts.getvalue():
            # meshio has skipped cells.
            raise ValueError(" ".join(doubts.getvalue().split()))
        triangles = [
            split_cells(np.asarray(block.data), _CORNERS.get(block.type, len(block.data[0])))
            for block in mesh.cells
            if len(block.data) and (block.type in _CORNERS or block.type == "polygon")
        ]
    # On damaged files, meshio's readers raise exceptions of any type.
    except Exception as error:
        reason = str(error) or f"{type(error).__name__}, the file is damaged"
        raise FormatError(f"cannot read {path} as {file_format}: {reason}") from error
    return surface_table(path, mesh.points, mesh.point_data, np.concatenate([NO_TRIANGLES, *triangles]))


class _EndingText(io.StringIO):
    """A text whose end is an error: meshio's reader of Tecplot loops on truncated files."""

    def __init__(self, path: Path):
        super().__init__(path.read_text(encoding="utf-8"))

    def readline(self, size: Any = -1, /) -> Any:
        line = super().readline(size)
        if not line:
            raise EOFError("the file is truncated")
        return line


def _gmsh(path: Path) -> str:
    """Refuse values of nodes that are not in the order of the nodes: meshio assigns ``$NodeData`` by position.

    Format: Gmsh reference manual, "Gmsh file formats".
    """
    data = path.read_bytes()
    version, kind = (word.decode() for word in data.split(maxsplit=3)[1:3])
    binary = kind == "1"
    sections = re.findall(rb"^\$(Nodes|Elements|NodeData)[ \t]*\r?\n(.*?)\$End\1", data, re.DOTALL | re.MULTILINE)
    names = [name for name, _ in sections]
    if names.count(b"Nodes") != 1 or names.count(b"Elements") > 1:
        raise ValueError("expected one section $Nodes and one $Elements")
    bodies = dict(sections)
    if version.startswith("2"):
        # In binary files meshio requires the numbers 1, 2, ... itself.
        count = int(bodies[b"Nodes"].split(maxsplit=1)[0])
        rows = None if binary else np.array(bodies[b"Nodes"].split()[1:], dtype=np.float64).reshape(count, 4)
        nodes = np.arange(1, count + 1) if rows is None else rows[:, 0]
        # Of elements with a wrong number of nodes meshio takes the last ones, and it counts nodes below 1 from the end.
        elements = [] if binary else bodies.get(b"Elements", b"0").split(b"\n")[1:]
        for words in ([int(word) for word in line.split()] for line in elements if line.split()):
            corners = words[3 + words[2] :]
            if min(corners, default=0) < 1 or len(corners) != _GMSH_NODES.get(words[1], len(corners)):
                raise ValueError(f"the element {' '.join(map(str, words))} does not have the nodes of its type")
    else:
        nodes = _numbers_in_blocks(bodies[b"Nodes"], binary)
    if len(np.unique(nodes)) != len(nodes) or (nodes != np.floor(nodes)).any() or nodes.min(initial=1) < 1:
        raise ValueError("the numbers of its nodes are not different whole numbers")
    found = [_numbers_of_data(body, binary) for name, body in sections if name == b"NodeData"]
    if len({name for name, _ in found}) < len(found):
        raise ValueError("several $NodeData have the same name (steps in time?); expected one")
    for name, numbers in found:
        if not np.array_equal(numbers, nodes):
            raise ValueError(f"$NodeData {name} does not have one row for each node, in the order of $Nodes; sort them")
    return str(path)


def _numbers_in_blocks(body: bytes, binary: bool) -> NDArray[Any]:
    """Numbers of the nodes in the blocks of version 4."""
    words, at = None if binary else np.array(body.split(), dtype=np.float64), 0

    def take(count: int, kind: str) -> NDArray[Any]:
        nonlocal at
        begin, at = at, at + count * (np.dtype(kind).itemsize if binary else 1)
        return np.frombuffer(body, kind, count, begin) if words is None else words[begin:at]

    numbers = []
    for _ in range(int(take(4, "u8")[0])):
        take(3, "i4")
        count = int(take(1, "u8")[0])
        numbers.append(take(count, "u8"))
        take(3 * count, "f8")
    return np.concatenate(numbers)


def _numbers_of_data(body: bytes, binary: bool) -> tuple[str, NDArray[Any]]:
    """Name of a ``$NodeData`` section, and the numbers of the nodes that its rows name."""
    lines, at, tags = body.split(b"\n"), 0, []
    for _ in range(3):
        count = int(lines[at])
        tags.append(lines[at + 1 : at + 1 + count])
        at += 1 + count
    components, rows = int(tags[2][1]), int(tags[2][2])
    rest = b"\n".join(lines[at:])
    if binary:
        record = np.dtype([("number", "i4"), ("values", "f8", (components,))])
        numbers = np.frombuffer(rest, record, rows)["number"]
    else:
        numbers = np.array(rest.split(), dtype=np.float64).reshape(rows, 1 + components)[:, 0]
    return tags[0][0].decode("utf-8", "replace").strip(), numbers


def _avs(path: Path) -> str:
    """Refuse node data that are not one row for each node: meshio leaves the others undefined.

    Format: AVS Developer's Guide, "UCD ASCII file format".
    """
    text = path.read_text(encoding="utf-8")
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    nodes, cells, components, more = (int(word) for word in lines[0][:4])
    end = 1 + nodes + cells
    if any(len(row) != 3 + _AVS_CORNERS.get(row[2], len(row) - 3) for row in lines[1 + nodes : end]):
        raise ValueError("a cell does not have the corners of its type")
    if components:
        arrays = int(lines[end][0])
        names = [" ".join(row).split(",")[0] for row in lines[end + 1 : end + 1 + arrays]]
        rows = lines[end + 1 + arrays :][:nodes]
        numbers = sorted(row[0] for row in lines[1 : 1 + nodes])
        if sorted(row[0] for row in rows) != numbers or len(set(numbers)) < nodes:
            raise ValueError("its node data are not one row for each node")
        if any(len(row) != 1 + components for row in rows) or len(set(names)) < arrays:
            raise ValueError(f"its node data are not {components} values with different names in each row")
        end += 1 + arrays + nodes
    if len(lines) > end and not more:
        raise ValueError(f"{len(lines) - end} lines follow that its first line does not announce")
    return str(path)


_SOURCES: dict[str, Callable[[Path], Any]] = {"avsucd": _avs, "gmsh": _gmsh, "tecplot": _EndingText}
"""What meshio's reader of a format gets, if not the name of the file."""
