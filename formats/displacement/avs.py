"""Displacement tables as surfaces of AVS UCD, as text.

Cells and data refer to nodes by their numbers, in any order. Format: AVS Developer's Guide, "UCD ASCII file format".
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from .cells import split_cells
from .numbering import by_number, rows_of, text_numbers
from .table import NO_TRIANGLES, DisplacementTable, surface_table

_CORNERS = {"tri": 3, "quad": 4}


def read(path: Path) -> DisplacementTable:
    """Read a surface with displacements as node data.

    Raises
    ------
    FormatError
        When the file is damaged, has no displacement, or not one for every node.
    """
    try:
        return _read(path, path.read_text(encoding="utf-8"))
    except (ValueError, IndexError) as error:
        raise FormatError(f"cannot read {path} as AVS UCD: {error}; the file is damaged") from error


def _read(path: Path, text: str) -> DisplacementTable:
    lines = [line.split() for line in text.splitlines() if line.strip() and not line.lstrip().startswith("#")]
    counts = [int(word) for word in lines[0]]
    if len(counts) != 5 or min(counts) < 0:
        raise ValueError("its first line is not five counts")
    nodes, cells, components = counts[:3]
    if len(lines) < 1 + nodes + cells:
        raise ValueError(f"{nodes} nodes and {cells} cells are announced, {len(lines) - 1} lines follow")
    numbers, points = _rows(lines[1 : 1 + nodes], 3)
    triangles = _triangles(path, numbers, lines[1 + nodes : 1 + nodes + cells])
    rest = lines[1 + nodes + cells :]
    arrays = _node_data(path, numbers, rest, components, counts[3] > 0) if components else {}
    return surface_table(path, points, arrays, triangles)


def _rows(lines: list[list[str]], floats: int) -> tuple[IntArray, NDArray[Any]]:
    """The number at the beginning of each line, and the floats behind it."""
    if any(len(words) != 1 + floats for words in lines):
        raise ValueError(f"a line does not hold a number and {floats} values")
    numbers = np.array([int(words[0]) for words in lines], dtype=np.int64)
    values = text_numbers(" ".join(word for words in lines for word in words).encode()).reshape(len(lines), 1 + floats)
    return numbers, values[:, 1:]


def _triangles(path: Path, numbers: IntArray, lines: list[list[str]]) -> IntArray:
    found = [NO_TRIANGLES]
    for kind, corners in _CORNERS.items():
        cells = [words[3:] for words in lines if words[2] == kind]
        if any(len(words) != corners for words in cells):
            raise ValueError(f"a {kind} does not have {corners} corners")
        own = np.array(cells, dtype=np.int64).reshape(len(cells), corners)
        found.append(split_cells(rows_of(path, numbers, own), corners))
    return np.concatenate(found)


def _node_data(
    path: Path, numbers: IntArray, lines: list[list[str]], components: int, more: bool
) -> dict[str, NDArray[Any]]:
    """Arrays by name; ``more``: cell data follow."""
    sizes = [int(word) for word in lines[0][1:]]
    if len(sizes) != int(lines[0][0]) or min(sizes, default=0) < 1 or sum(sizes) != components:
        raise ValueError(f"the sizes of the node data are not {components} components")
    names = [" ".join(words).split(",")[0].strip() for words in lines[1 : 1 + len(sizes)]]
    if len(set(names)) != len(names):
        raise FormatError(f"{path} has node data of the same name: {', '.join(names)}")
    end = 1 + len(sizes) + len(numbers)
    if len(lines) > end and not more:
        raise ValueError(f"{len(lines) - end} lines follow that its first line does not announce")
    own, values = _rows(lines[1 + len(sizes) : end], components)
    parts = np.split(by_number(path, "the node data", numbers, own, values), np.cumsum(sizes)[:-1], axis=1)
    return {name: part if part.shape[1] > 1 else part[:, 0] for name, part in zip(names, parts, strict=True)}
