"""Displacement tables as text: columns separated by commas, semicolons, tabs or blanks, with or without a header."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError

from .table import DISPLACEMENT_NAMES, NO_TRIANGLES, POINT_NAMES, DisplacementTable, vector_names

_UNITS = {"m", "dm", "cm", "mm", "um", "µm", "nm", "km", "in", "inch", "inches", "ft", "feet", "yd"}
_BY_ORDER = {6: "x y z dx dy dz", 4: "x y dx dy", 3: "number x y, as of SU2"}


@dataclass(frozen=True)
class _Layout:
    """Layout of the numbers.

    ``first`` is the first line with numbers (1-based); ``separator`` is ``None`` for blanks and tabs; ``width`` is the
    number of columns; ``points`` and ``displacement`` are the columns (0-based) to take, which ``named`` columns tell.
    """

    first: int
    separator: str | None
    width: int
    points: tuple[int, ...]
    displacement: tuple[int, ...]
    named: bool


def read(path: Path) -> DisplacementTable:
    """Read a text table.

    Without a header the columns are ``x y z dx dy dz``, or ``x y dx dy`` in 2-D, or the number and the new position of
    each point, as in SU2's surface_positions.dat. A header, possibly in a comment, names any number of columns in any
    order (see :func:`vector_names`). ``#`` begins a comment.

    Raises FormatError when the columns are unknown or a line is not a row of numbers; with the line.
    """
    layout = _layout(path)
    try:
        columns = layout.points + layout.displacement
        every = len(columns) == layout.width
        with path.open(encoding="utf-8-sig") as stream:
            values = np.loadtxt(
                # numpy takes a line of blanks, or of blanks and a comment, for a row.
                (line if line.partition("#")[0].strip() else "\n" for line in stream),
                quotechar='"',
                delimiter=layout.separator,
                skiprows=layout.first - 1,
                # When all columns are requested, numpy also checks that there are no more.
                usecols=None if every else columns,
                ndmin=2,
            )
    except ValueError as error:
        raise _explained(path, layout, error) from error
    if every:
        values = values[:, columns]
    split = len(layout.points)

    def place(row: int) -> str:
        return (
            f"line {next(number for index, (number, _) in enumerate(_rows_of_numbers(path, layout)) if index == row)}"
        )

    return DisplacementTable(values[:, :split], values[:, split:], NO_TRIANGLES, place, layout.named)


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


def _layout(path: Path) -> _Layout:
    header, comment = "", ""
    for number, text, remark in _contents(path):
        if not text:
            comment = remark
            continue
        separator = next((mark for mark in ";," if mark in text), None)
        words = _words(text, separator)
        if header or all(map(_is_number, words)):
            return _Layout(
                number, separator, len(words), *_columns(path, number, separator, len(words), header, comment)
            )
        if any(map(_is_number, words)):
            wrong = next(word for word in words if not _is_number(word))
            raise FormatError(f"{path}, line {number}: {_no_number(wrong)}")
        header = text
    below = f" below the header {header[:60]!r}" if header else ""
    raise FormatError(f"{path} has no rows of numbers{below}")


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
    return [word.strip() for word in next(csv.reader([text], delimiter=separator, skipinitialspace=True))]


def _is_number(word: str) -> bool:
    """Whether numpy reads it as a number too: without underscores and in plain digits."""
    try:
        float(word)
    except ValueError:
        return False
    return word.isascii() and "_" not in word


def _rows_of_numbers(path: Path, layout: _Layout) -> Iterator[tuple[int, list[str]]]:
    """Line number and words of each row of numbers."""
    for number, text, _ in _contents(path):
        if text and number >= layout.first:
            yield number, _words(text, layout.separator)


def _no_number(word: str) -> str:
    comma = "; decimal commas are not read: write points" if _is_number(word.replace(",", ".", 1)) else ""
    return f"{word!r} is not a number{comma}"


def _explained(path: Path, layout: _Layout, error: ValueError) -> FormatError:
    """The line and word that numpy could not read."""
    for number, words in _rows_of_numbers(path, layout):
        if len(words) != layout.width:
            return FormatError(f"{path}, line {number}: found {len(words)} columns; expected {layout.width} as before")
        wrong = [words[column] for column in layout.points + layout.displacement if not _is_number(words[column])]
        if wrong:
            return FormatError(f"{path}, line {number}: {_no_number(wrong[0])}")
    return FormatError(f"{path}: {error}")
