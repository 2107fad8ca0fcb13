"""The text of a NASA neutral map file: block sizes and entries; only the syntax is checked."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Shape, Side

from ..files import require_regular

Face = tuple[Side, tuple[int, int]]

# Face number: side, primary and secondary index.
FACES: dict[int, Face] = {
    1: (Side.KMIN, (0, 1)),
    2: (Side.KMAX, (0, 1)),
    3: (Side.IMIN, (1, 2)),
    4: (Side.IMAX, (1, 2)),
    5: (Side.JMIN, (2, 0)),
    6: (Side.JMAX, (2, 0)),
}

_COMMENT = re.compile(r"#.*|\\\s*$")
_WORD = re.compile(r"'[^']*'|\"[^\"]*\"|\S+")
_LOGICAL = {".true.": True, "true": True, "t": True, ".false.": False, "false": False, "f": False}


@dataclass(frozen=True)
class Line:
    """The words of a line, without comments, and its position."""

    place: str
    words: tuple[str, ...]

    def integers(self, first: int, meaning: str) -> tuple[int, ...]:
        """All words starting at ``first`` as integers."""
        try:
            return tuple(int(word) for word in self.words[first:])
        except ValueError:
            raise FormatError(f"{self.place}: expected {meaning}, found {' '.join(self.words)!r}") from None


@dataclass(frozen=True)
class Entry:
    """A boundary condition or connection.

    ``ranges`` are one or two face ranges as written: block, face, S1, E1, S2, E2 (1-based). ``flag`` is the logical at
    the end of the line: Swap for connections, absent (``None``) or ignored for boundary conditions.
    """

    place: str
    type: str
    ranges: tuple[tuple[int, ...], ...]
    flag: bool | None

    @property
    def is_one_to_one(self) -> bool:
        return self.type.lower().replace("-", "_") == "one_to_one"


@dataclass(frozen=True)
class NeutralMap:
    """A whole file: block sizes in nodes, and entries in file order."""

    sizes: tuple[Shape, ...]
    entries: tuple[Entry, ...]
    notes: tuple[str, ...]


def parse_neutral_map(path: Path) -> NeutralMap:
    """Read the text of a neutral map file; comments and stray backslashes at line ends are skipped.

    Raises
    ------
    FormatError
        When the file cannot be read or a line does not conform to the format.
    """
    require_regular(path)
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        words = tuple(word.strip("'\"").strip() for word in _WORD.findall(_COMMENT.sub("", line)))
        if words:
            lines.append(Line(f"{path}, line {number}", words))
    if not lines:
        raise FormatError(f"{path} is not a neutral map: it has only comments and empty lines")
    sizes, notes = _sizes(lines, path)
    return NeutralMap(sizes, tuple(_entry(line) for line in lines[1 + len(sizes) :]), notes)


def _sizes(lines: list[Line], path: Path) -> tuple[tuple[Shape, ...], tuple[str, ...]]:
    count = lines[0].integers(0, "the number of blocks")
    if len(count) != 1 or count[0] < 1:
        raise FormatError(f"{lines[0].place}: expected the number of blocks, found {' '.join(lines[0].words)!r}")
    rows = []
    for line in lines[1 : 1 + count[0]]:
        meaning = f"block number, IDIM, JDIM, KDIM for {count[0]} blocks"
        row = line.integers(0, meaning)
        if len(row) != 4 or min(row[1:]) < 1:
            raise FormatError(f"{line.place}: expected {meaning}, found {' '.join(line.words)!r}")
        rows.append(row)
    if len(rows) < count[0]:
        raise FormatError(f"{path} declares {count[0]} blocks but ends after the sizes of {len(rows)}")
    notes: tuple[str, ...] = ()
    if sorted(row[0] for row in rows) == list(range(1, len(rows) + 1)):
        rows.sort()
    else:
        notes = (f"{path}: the block numbers {[row[0] for row in rows]} are not 1 to {len(rows)}; taken in file order",)
    return tuple((ni, nj, nk) for _, ni, nj, nk in rows), notes


def _entry(line: Line) -> Entry:
    flag = _LOGICAL.get(line.words[-1].lower())
    numbers = (line if flag is None else Line(line.place, line.words[:-1])).integers(
        1, "a type, B1 F1 S1 E1 S2 E2, and for connections B2 F2 S1 E1 S2 E2 Swap"
    )
    entry = Entry(line.place, line.words[0], tuple(numbers[i : i + 6] for i in range(0, len(numbers), 6)), flag)
    if len(numbers) not in (6, 12):
        raise FormatError(f"{line.place}: {entry.type} has {len(numbers)} numbers; a face range has 6, a connection 12")
    if entry.is_one_to_one and (len(numbers) != 12 or flag is None):
        raise FormatError(f"{line.place}: {entry.type} needs two face ranges and Swap (true or false)")
    return entry
