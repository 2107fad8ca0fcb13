"""Results of CalculiX as text (``.frd``).

Lines have fields of fixed width that may touch. Format: G. Dhondt, K. Wittig, "CalculiX CrunchiX/GraphiX user's
manual", section "Result Format".
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from .results import Displacements, Results, outer_faces, surface_results

_NUMBER = re.compile(r"[-+]?\d\.\d+E[-+]\d{2,3}")
# Width of node numbers by the last word of a block's first line; binary blocks have 2 and 3.
_WIDTHS = {"0": 5, "1": 10}
# Type of element: corners, and whether it is a solid.
_CORNERS = {1: (8, True), 2: (6, True), 3: (4, True), 4: (8, True), 5: (6, True), 6: (4, True),
            7: (3, False), 8: (3, False), 9: (4, False), 10: (4, False), 11: (2, False), 12: (2, False)}  # fmt: skip
_NODES = {1: 8, 2: 6, 3: 4, 4: 20, 5: 15, 6: 10, 7: 3, 8: 6, 9: 4, 10: 8, 11: 2, 12: 3}
_COMPLEX = ("DISPI", "PDISP")
# Kinds of analysis, and the meaning of the value of a step: a time, a frequency or a number.
_FREQUENCY = "2"


class _Lines:
    """The lines of a file, with the number of the current one."""

    def __init__(self, text: str):
        self._lines, self.number = text.splitlines(), 0

    def __iter__(self) -> Iterator[str]:
        while self.number < len(self._lines):
            self.number += 1
            yield self._lines[self.number - 1]

    def block(self) -> list[str]:
        """The lines up to the end of a block."""
        found: list[str] = []
        for line in self:
            if line.startswith(" -3"):
                return found
            found.append(line)
        raise ValueError("a block has no end")


def read(path: Path) -> Results:
    """Read nodes, elements and all displacements.

    Raises
    ------
    FormatError
        When the file is damaged, binary, or has no displacement.
    """
    try:
        lines = _Lines(path.read_text(encoding="ascii"))
    except UnicodeDecodeError:
        raise FormatError(f"{path} is binary; write it as text (in CalculiX the default)") from None
    try:
        return _read(path, lines)
    except (ValueError, IndexError) as error:
        raise FormatError(f"cannot read {path} as .frd: {error}, line {lines.number}; the file is damaged") from error


def _read(path: Path, lines: _Lines) -> Results:
    numbers, points = np.empty(0, dtype=np.int64), np.empty((0, 3))
    faces: list[IntArray] = []
    found: list[Displacements] = []
    ended = False
    for line in lines:
        key, values = line[:6].strip(), line.split()
        if key == "2C":
            numbers, points = _rows(lines.block(), _width(values), 3, int(values[1]))
        elif key == "3C":
            faces = _faces(lines.block(), _width(values), int(values[1]))
        elif line[2:7] == "100CL":
            step = _step(path, lines, line, len(found) + 1)
            found += [step] if step else []
        elif key == "9999":
            ended = True
    if not ended:
        raise ValueError("it does not end with 9999")
    if not len(numbers):
        raise FormatError(f"{path} has no nodes")
    return surface_results(path, numbers, points, faces, found)


def _width(words: list[str]) -> int:
    if words[-1] not in _WIDTHS:
        raise ValueError(f"a block has the form {words[-1]}; expected text, 0 or 1")
    return _WIDTHS[words[-1]]


def _rows(block: list[str], width: int, count: int, expected: int) -> tuple[IntArray, NDArray[np.float64]]:
    """Number and ``count`` values of each line."""
    if len(block) != expected:
        raise ValueError(f"a block has {len(block)} lines, {expected} are announced")
    if any(line[:3] != " -1" for line in block):
        raise ValueError("a line of values does not begin with -1")
    words = [_NUMBER.findall(line[3 + width :]) for line in block]
    for line, found in zip(block, words, strict=True):
        if len(found) < count or "".join(found) != line[3 + width :].replace(" ", ""):
            raise ValueError(f"{line!r} does not hold a number and {count} values")
    numbers = np.array([int(line[3 : 3 + width]) for line in block], dtype=np.int64)
    return numbers, np.array([found[:count] for found in words], dtype=np.float64).reshape(len(block), count)


def _faces(block: list[str], width: int, expected: int) -> list[IntArray]:
    """Faces of shells, and of the outside of solids."""
    cells: dict[int, list[list[int]]] = {}
    kind, nodes = 0, []  # type: int, list[int]
    count = 0
    for line in [*block, " -1"]:
        if line.startswith(" -1"):
            if kind:
                cells.setdefault(kind, []).append(_whole(kind, nodes))
            if line != " -1":
                kind, nodes, count = int(line[3 + width : 8 + width]), [], count + 1
        else:
            nodes += [int(line[at : at + width]) for at in range(3, len(line.rstrip()), width)]
    if count != expected:
        raise ValueError(f"a block has {count} elements, {expected} are announced")
    found = {kind: np.array(rows, dtype=np.int64)[:, : _CORNERS[kind][0]] for kind, rows in cells.items()}
    shells = [own for kind, own in found.items() if not _CORNERS[kind][1] and own.shape[1] > 2]
    return [*shells, *outer_faces([own for kind, own in found.items() if _CORNERS[kind][1]])]


def _whole(kind: int, nodes: list[int]) -> list[int]:
    if kind not in _NODES:
        raise ValueError(f"an element has the unknown type {kind}")
    if len(nodes) != _NODES[kind]:
        raise ValueError(f"an element of type {kind} has {len(nodes)} nodes, not {_NODES[kind]}")
    return nodes


def _step(path: Path, lines: _Lines, head: str, number: int) -> Displacements | None:
    """The displacements of a block of results, ``None`` if it holds other values."""
    title = next(iter(lines))
    if not title.startswith(" -4"):
        raise ValueError("a block of results has no name")
    block = lines.block()
    name = title.split()[1]
    if name in _COMPLEX:
        raise FormatError(f"{path} has complex displacements ({name}), line {lines.number}; expected real ones")
    if name != "DISP":
        return None
    value, frequency = float(head[12:24]), head[56:58].strip() == _FREQUENCY
    width = _width([head[73:75].strip()]) if head[73:75].strip() else 10
    rows = [line for line in block if not line.startswith(" -5")]
    numbers, values = _rows(rows, width, 3, int(head[24:36]))
    return Displacements(f"shape {number} ({value:g}{' Hz' if frequency else ''})", numbers, values)
