"""Results of CalculiX as text (``.frd``): displacements, such as mode shapes, at the nodes of a model's surface.

Lines have fields of fixed width that may touch. Format: G. Dhondt, K. Wittig, "CalculiX CrunchiX/GraphiX user's
manual", section "Result Format".
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.wording import listed

from .table import NO_TRIANGLES, DisplacementTable, checked_surface, row_place, split_cells

_NUMBER = re.compile(r"[-+]?\d\.\d+E[-+]\d{2,3}")
# Width of node numbers by the last word of a block's first line; binary blocks have 2 and 3.
_WIDTHS = {"0": 5, "1": 10}
# Type of element: nodes, corners, and whether it is a solid.
_ELEMENTS = {1: (8, 8, True), 2: (6, 6, True), 3: (4, 4, True), 4: (20, 8, True), 5: (15, 6, True), 6: (10, 4, True),
             7: (3, 3, False), 8: (6, 3, False), 9: (4, 4, False), 10: (8, 4, False), 11: (2, 2, False),
             12: (3, 2, False)}  # fmt: skip
_COMPLEX = ("DISPI", "PDISP")
# Kind of analysis in which the value of a step is a frequency; else it is a time or a number.
_FREQUENCY = "2"
SOLIDS: Mapping[int, tuple[tuple[int, ...], ...]] = {
    4: ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)),
    6: ((0, 2, 1), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)),
    8: ((0, 3, 2, 1), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7)),
}
"""Corners of the faces of solids, by the number of corners of the solid."""


def read_shapes(path: Path) -> tuple[SurfaceData, ...]:
    """All displacements of a result file, in its order.

    Points and triangles are those of the outer surface of the model; of beams, all points.
    """
    if path.suffix.lower() != ".frd":
        raise FormatError(f"{path} is not a result file of a structural solver; expected CalculiX's .frd")
    return tuple(checked_surface(table, path) for table in _read_displacements(path).values())


def read(path: Path) -> DisplacementTable:
    """The displacement of a result file that has only one."""
    tables = _read_displacements(path)
    if len(tables) > 1:
        labels = listed((f"{number}: {label}" for number, label in enumerate(tables, start=1)), "; ")
        raise FormatError(
            f"{path} has {len(tables)} displacements ({labels}), but a table has one. Use them in a case as "
            f"modes = {{ file = ..., shapes = [...], amplitudes = [...] }}"
        )
    return next(iter(tables.values()))


def _read_displacements(path: Path) -> dict[str, DisplacementTable]:
    """Displacements at the surface by their labels, like ``shape 1 (12.5 Hz)``."""
    numbers, points = np.empty(0, dtype=np.int64), np.empty((0, 3))
    corners = NO_TRIANGLES
    found: dict[str, tuple[IntArray, FloatArray]] = {}
    try:
        for head, block in _blocks(path.read_text(encoding="ascii")):
            words = head.split()
            if head[:6].strip() == "2C":
                numbers, points = _numbered_rows(block, words[-1], int(words[1]))
            elif head[:6].strip() == "3C":
                faces = _faces_of_elements(block, words[-1], int(words[1]))
                corners = np.concatenate([NO_TRIANGLES, *(split_cells(face, face.shape[1]) for face in faces)])
            elif head[2:7] == "100CL" and (name := block[0].split()[1]) in _COMPLEX:
                raise FormatError(f"{path} has complex displacements ({name}); expected real ones")
            elif head[2:7] == "100CL" and name == "DISP":
                rows = [line for line in block if not line.startswith((" -4", " -5"))]
                unit = " Hz" if head[56:58].strip() == _FREQUENCY else ""
                label = f"shape {len(found) + 1} ({float(head[12:24]):g}{unit})"
                found[label] = _numbered_rows(rows, head[73:75].strip() or "1", int(head[24:36]))
    except UnicodeDecodeError:
        raise FormatError(f"{path} is binary; write it as text (in CalculiX the default)") from None
    except (ValueError, IndexError) as error:
        raise FormatError(f"cannot read {path} as .frd: {error}; the file is damaged") from error
    if not len(numbers) or not found:
        raise FormatError(f"{path} has no {'displacements of ' if len(numbers) else ''}nodes")
    used = np.unique(corners) if len(corners) else np.unique(numbers)
    # This also covers nodes without coordinates, or with two of them.
    _rows_of(path, numbers, used)
    for label, (own, _) in found.items():
        missing = used[~np.isin(used, own)]
        if missing.size and len(corners):
            where = f"{missing.size} nodes of the surface, first {missing[0]}"
            raise FormatError(f"{path}: {label} has no displacement at {where}")
        used = used[np.isin(used, own)]
    place, triangles = points[_rows_of(path, numbers, used)], np.searchsorted(used, corners)
    return {
        label: DisplacementTable(place, values[_rows_of(path, own, used)], triangles, row_place)
        for label, (own, values) in found.items()
    }


def _blocks(text: str) -> Iterator[tuple[str, list[str]]]:
    """The line before each block, and the lines of the block."""
    head, block = "", list[str]()
    for line in text.splitlines():
        if line.startswith(" -3"):
            yield head, block
            block = []
        elif line.startswith(" -"):
            block.append(line)
        elif block:
            raise ValueError(f"a block has no end, before {line!r}")
        elif line.strip():
            head = line
    if block or head.strip() != "9999":
        raise ValueError("it does not end with 9999")


def _width(form: str) -> int:
    if form not in _WIDTHS:
        raise ValueError(f"a block has the form {form}; expected text, 0 or 1")
    return _WIDTHS[form]


def _numbered_rows(block: list[str], form: str, expected: int) -> tuple[IntArray, FloatArray]:
    """Number and three values of each line."""
    width, numbers, values = _width(form), [], []
    if len(block) != expected:
        raise ValueError(f"a block has {len(block)} lines, {expected} are announced")
    for line in block:
        found = _NUMBER.findall(line[3 + width :])
        if line[:3] != " -1" or len(found) < 3 or "".join(found) != line[3 + width :].replace(" ", ""):
            raise ValueError(f"{line!r} does not hold a number and 3 values")
        numbers.append(int(line[3 : 3 + width]))
        values.append(found[:3])
    return np.array(numbers, dtype=np.int64), np.array(values, dtype=np.float64).reshape(-1, 3)


def _faces_of_elements(block: list[str], form: str, expected: int) -> list[IntArray]:
    """Faces of shells, and of the outside of solids."""
    width, cells = _width(form), dict[int, list[list[int]]]()
    starts = [number for number, line in enumerate(block) if line.startswith(" -1")]
    if len(starts) != expected:
        raise ValueError(f"a block has {len(starts)} elements, {expected} are announced")
    for begin, end in pairwise([*starts, len(block)]):
        kind = int(block[begin][3 + width : 8 + width])
        nodes = [
            int(line[at : at + width]) for line in block[begin + 1 : end] for at in range(3, len(line.rstrip()), width)
        ]
        if kind not in _ELEMENTS:
            raise ValueError(f"an element has the unknown type {kind}")
        if len(nodes) != _ELEMENTS[kind][0]:
            raise ValueError(f"an element of type {kind} has {len(nodes)} nodes, not {_ELEMENTS[kind][0]}")
        cells.setdefault(kind, []).append(nodes)
    corners = {kind: np.array(rows, dtype=np.int64)[:, : _ELEMENTS[kind][1]] for kind, rows in cells.items()}
    shells = [own for kind, own in corners.items() if not _ELEMENTS[kind][2] and own.shape[1] > 2]
    return [*shells, *outer_faces([own for kind, own in corners.items() if _ELEMENTS[kind][2]])]


def outer_faces(solids: Sequence[NDArray[Any]]) -> list[IntArray]:
    """Faces (m, 3) and (m, 4) that belong to one solid only; ``solids`` (k, corners) for each kind of element."""
    faces: dict[int, list[IntArray]] = {3: [], 4: []}
    for cells in solids:
        for face in SOLIDS[cells.shape[1]]:
            faces[len(face)].append(cells[:, face].astype(np.int64))
    found = []
    for every in (np.concatenate(parts) for parts in faces.values() if parts):
        _, where, count = np.unique(np.sort(every, axis=1), axis=0, return_inverse=True, return_counts=True)
        found.append(every[count[where.ravel()] == 1])
    return found


def _rows_of(path: Path, numbers: IntArray, wanted: IntArray) -> IntArray:
    """Rows of the nodes with the ``wanted`` numbers (n,)."""
    order = np.argsort(numbers, kind="stable")
    ascending = numbers[order]
    twice = np.flatnonzero(ascending[1:] == ascending[:-1])
    if twice.size:
        raise FormatError(f"{path}: two nodes have the number {ascending[twice[0]]}; the file is damaged")
    unknown = wanted[~np.isin(wanted, numbers)]
    if unknown.size:
        raise FormatError(f"{path} refers to the node {unknown[0]}, which it does not have")
    return np.asarray(order[np.searchsorted(ascending, wanted)])
