"""Displacement tables as text: columns separated by commas, semicolons, tabs or blanks, with or without a header."""

from __future__ import annotations

import csv
import re
from array import array
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError

from .table import DISPLACEMENT_NAMES, NO_TRIANGLES, POINT_NAMES, DisplacementTable, vector_names

_UNITS = {"m", "dm", "cm", "mm", "um", "µm", "nm", "km", "in", "inch", "inches", "ft", "feet", "yd"}
_BY_ORDER = {6: "x y z dx dy dz", 4: "x y dx dy", 3: "number x y, as of SU2"}


def read(path: Path) -> DisplacementTable:
    """Read a text table.

    Without a header the columns are ``x y z dx dy dz``, or ``x y dx dy`` in 2-D, or the number and the new position of
    each point, as in SU2's surface_positions.dat. A header, possibly in a comment, names any number of columns in any
    order (see :func:`vector_names`). ``#`` begins a comment.
    """
    header, remark, separator, width = "", "", None, 0
    points: tuple[int, ...] = ()
    moves: tuple[int, ...] = ()
    lines, values, named = array("q"), array("d"), False
    for number, text, comment in _contents(path):
        if not text:
            remark = remark if width else comment
            continue
        if not width:
            separator = next((mark for mark in ";," if mark in text), None)
        words = _words(text, separator)
        if not width:
            wrong = [word for word in words if not _is_number(word)]
            if not header and len(wrong) == len(words):
                header = text
                continue
            if not header and wrong:
                raise FormatError(f"{path}, line {number}: {_no_number(wrong[0])}")
            width = len(words)
            points, moves, named = _columns(path, number, separator, width, header, remark)
        if len(words) != width:
            raise FormatError(f"{path}, line {number}: found {len(words)} columns; expected {width} as before")
        own = [words[column] for column in points + moves]
        # Python also reads 1_000 and the digits of other scripts.
        strange = "_" in text or not text.isascii()
        try:
            values.extend(map(float, own))
        except ValueError:
            strange = True
        if strange and (wrong := [word for word in own if not _is_number(word)]):
            raise FormatError(f"{path}, line {number}: {_no_number(wrong[0])}")
        lines.append(number)
    if not lines:
        below = f" below the header {header[:60]!r}" if header else ""
        raise FormatError(f"{path} has no rows of numbers{below}")
    rows = np.frombuffer(values).reshape(len(lines), -1)
    split = len(points)
    return DisplacementTable(rows[:, :split], rows[:, split:], NO_TRIANGLES, lambda row: f"line {lines[row]}", named)


def _contents(path: Path) -> Iterator[tuple[int, str, str]]:
    """Number, text before ``#`` and comment after it of each line that is not blank."""
    try:
        with path.open(encoding="utf-8-sig") as stream:
            for number, line in enumerate(stream, start=1):
                text, _, comment = line.partition("#")
                if text.strip() or comment.strip():
                    yield number, text.strip(), comment.strip()
    except UnicodeDecodeError as error:
        raise FormatError(f"{path} is not UTF-8 text: {error}") from error


def _columns(
    path: Path, number: int, separator: str | None, width: int, header: str, comment: str
) -> tuple[tuple[int, ...], tuple[int, ...], bool]:
    """The columns of points and displacement in the rows that begin at line ``number``, and whether names tell them."""
    names = _words(header or comment, separator)
    if len(names) != width:
        names = _words(header or comment, None)
    try:
        found = [vector_names(wanted, names) for wanted in (POINT_NAMES, DISPLACEMENT_NAMES)]
    except FormatError as error:
        raise FormatError(f"{path}: {error}") from None
    if len(names) == width and found[0] and found[1]:
        units = {unit.lower() for name in found[0] + found[1] for unit in re.findall(r"[\[(]\s*(\w+)\s*[\])]", name)}
        if len(units := units & _UNITS) > 1:
            # Like ``x [m]`` and ``dx [mm]``.
            raise FormatError(
                f"{path}: its columns have lengths in {', '.join(sorted(units))}; expected all in the grid's unit"
            )
        points, displacement = (tuple(map(names.index, columns)) for columns in found if columns)
        return points, displacement, True
    if header:
        raise FormatError(
            f"{path}: expected a name for each of {width} columns, x y z (or x y) and dx dy dz (or dx dy) among them; "
            f"found {' '.join(map(repr, names))}"
        )
    if width not in _BY_ORDER:
        expected = " or ".join(f"{number} ({names})" for number, names in _BY_ORDER.items())
        raise FormatError(f"{path}, line {number}: found {width} columns without names; expected {expected}")
    half = (width + 1) // 2
    return tuple(range(half)), tuple(range(half, width)), False


def _words(text: str, separator: str | None) -> list[str]:
    if separator is None:
        return [word.strip('"') for word in text.split()]
    if '"' not in text or len(text) > csv.field_size_limit():
        return [word.strip() for word in text.split(separator)]
    return [word.strip() for word in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _is_number(word: str) -> bool:
    """Whether it is a number without underscores and in plain digits."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def _no_number(word: str) -> str:
    comma = "; decimal commas are not read: write points" if _is_number(word.replace(",", ".", 1)) else ""
    return f"{word!r} is not a number{comma}"
