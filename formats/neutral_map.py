"""NASA neutral map files (.nmf): the boundary conditions and block connections that a Plot3D file does not hold.

Source: "The Neutral Map File", W. T. Jones, GEOLAB, NASA Langley; kept with the NASA turbulence modeling resource.
"""

from __future__ import annotations

import contextlib
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, Patch, Shape, Side, Window

from .files import replacing, require_regular

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


NeutralMap = tuple[tuple[Shape, ...], tuple[Entry, ...], tuple[str, ...]]
"""A whole file: block sizes in nodes, entries in file order, and notes."""


def parse_neutral_map(path: Path) -> NeutralMap:
    """Read the text of a neutral map file; comments and stray backslashes at line ends are skipped."""
    require_regular(path)
    try:
        text = path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error
    lines = []
    for number, line in enumerate(text.splitlines(), 1):
        words = [word.strip("'\"").strip() for word in _WORD.findall(_COMMENT.sub("", line))]
        if words:
            lines.append((f"{path}, line {number}", words))
    if not lines:
        raise FormatError(f"{path} is not a neutral map: it has only comments and empty lines")
    (count,) = _whole_numbers(*lines[0], "the number of blocks", 1)
    meaning = f"block number, IDIM, JDIM, KDIM for {count} blocks"
    rows = [_whole_numbers(place, words, meaning, 4) for place, words in lines[1 : 1 + count]]
    if len(rows) < count:
        raise FormatError(f"{path} declares {count} blocks but ends after the sizes of {len(rows)}")
    notes: tuple[str, ...] = ()
    if sorted(row[0] for row in rows) == list(range(1, count + 1)):
        rows.sort()
    else:
        notes = (f"{path}: the block numbers {[row[0] for row in rows]} are not 1 to {count}; taken in file order",)
    entries = []
    for place, (kind, *words) in lines[1 + count :]:
        flag = _LOGICAL.get(words[-1].lower()) if words else None
        meaning = f"after the type {kind} B1 F1 S1 E1 S2 E2, and for connections B2 F2 S1 E1 S2 E2 Swap"
        numbers = _whole_numbers(place, words if flag is None else words[:-1], meaning)
        entry = Entry(place, kind, tuple(tuple(numbers[i : i + 6]) for i in range(0, len(numbers), 6)), flag)
        if len(numbers) not in (6, 12):
            raise FormatError(f"{place}: {kind} has {len(numbers)} numbers; a face range has 6, a connection 12")
        if entry.is_one_to_one and (len(numbers) != 12 or flag is None):
            raise FormatError(f"{place}: {kind} needs two face ranges and Swap (true or false)")
        entries.append(entry)
    return tuple((ni, nj, nk) for _, ni, nj, nk in rows), tuple(entries), notes


def _whole_numbers(place: str, words: Sequence[str], meaning: str, sizes: int = 0) -> list[int]:
    """The words of a line as integers; if it has block sizes, these are its last three and positive.

    ``sizes`` is the number of words of such a line, 0 for other lines.
    """
    with contextlib.suppress(ValueError):
        found = [int(word) for word in words]
        if not sizes or (len(found) == sizes and min(found[-3:]) > 0):
            return found
    raise FormatError(f"{place}: expected {meaning}, found {' '.join(words)!r}")


# Construct2D numbers the four edges of its 2-D grids (KDIM = 1) instead.
_EDGES: dict[int, Face] = {
    1: (Side.IMIN, (1, 2)),
    2: (Side.IMAX, (1, 2)),
    3: (Side.JMIN, (0, 2)),
    4: (Side.JMAX, (0, 2)),
}


@dataclass(frozen=True)
class _Range:
    """A rectangle of nodes on a block face, from ``begin`` to ``end`` in either direction (0-based)."""

    block: int
    side: Side
    axes: tuple[int, int]
    begin: Shape
    end: Shape

    @property
    def window(self) -> Window:
        first, second = ((self.begin[axis], self.end[axis]) for axis in self.side.tangential)
        return Window(self.block, self.side, (min(first), min(second)), (max(first), max(second)))


@dataclass(frozen=True)
class _Frame:
    """The mapping from face ranges of the file to ranges of the grid.

    ``sizes`` are the block sizes in the file, ``axes`` the index of the grid for each index of the file, ``dropped``
    the index of the file that a 2-D grid lacks.
    """

    sizes: tuple[Shape, ...]
    faces: Mapping[int, Face]
    axes: Shape
    dropped: int | None

    def locate(self, numbers: Sequence[int], place: str) -> _Range:
        """The range of the grid for block, face, S1, E1, S2, E2 of the file."""
        block, face, *limits = numbers
        if not 1 <= block <= len(self.sizes):
            raise FormatError(f"{place}: block {block} does not exist; the file has blocks 1 to {len(self.sizes)}")
        if face not in self.faces:
            raise FormatError(f"{place}: face {face} does not exist; faces are 1 to {len(self.faces)}")
        size, (side, tangential) = self.sizes[block - 1], self.faces[face]
        # Along the indices of the grid.
        begin, end, axes = [0, 0, 0], [0, 0, 0], self.axes
        begin[axes[side.axis]] = end[axes[side.axis]] = side.layer(size)
        for axis, first, last in zip(tangential, limits[::2], limits[1::2], strict=True):
            if not (1 <= first <= size[axis] and 1 <= last <= size[axis]):
                raise FormatError(
                    f"{place}: range {first} to {last} along {'ijk'[axis]} on face {face} ({side.label}) of block "
                    f"{block}, which has nodes 1 to {size[axis]} there"
                )
            begin[axes[axis]], end[axes[axis]] = first - 1, last - 1
        if self.dropped is not None:
            begin[axes[self.dropped]] = end[axes[self.dropped]] = 0
        (i, j, k), (i_end, j_end, k_end), (primary, secondary) = begin, end, tangential
        in_grid = Side(2 * axes[side.axis] + side.value % 2)
        return _Range(block - 1, in_grid, (axes[primary], axes[secondary]), (i, j, k), (i_end, j_end, k_end))


def read_neutral_map(path: Path, grid: Grid) -> Grid:
    """The grid with the patches and connections of a neutral map file added.

    An entry becomes a patch whose family and ``bc_type`` are the type of the entry and whose name is numbered, like
    ``viscous_solid-2``; a one-to-one entry becomes a connection. A 2-D grid also accepts the map of the same grid with
    one layer of cells; entries on the plane of the 2-D grid itself are omitted with a note.
    """
    sizes, entries, notes = parse_neutral_map(Path(path))
    frame = _frame(sizes, entries, grid, Path(path))
    patches, connections, left_out = list(grid.patches), list(grid.connections), 0
    counts = Counter(patch.family for patch in patches)
    for entry in entries:
        ranges = [frame.locate(numbers, entry.place) for numbers in entry.ranges]
        if any(grid.shapes[r.block][r.side.axis] == 1 for r in ranges):
            left_out += 1
            continue
        counts[entry.type] += 1
        name = f"{entry.type}-{counts[entry.type]}"
        if not entry.is_one_to_one:
            patches.append(Patch(name, tuple(r.window for r in ranges), entry.type, entry.type))
            continue
        # Begin is mapped to begin, the primary index to the primary one or, with Swap, to the secondary one.
        here, there = ranges
        transform = [0, 0, 0]
        for axis, partner in zip(here.axes, there.axes[::-1] if entry.flag else there.axes, strict=True):
            along, across = here.end[axis] - here.begin[axis], there.end[partner] - there.begin[partner]
            if abs(along) != abs(across):
                raise FormatError(
                    f"{entry.place}: {abs(along) + 1} nodes of block {here.block + 1} along {'ijk'[axis]} meet "
                    f"{abs(across) + 1} of block {there.block + 1} along {'ijk'[partner]}; check the ranges and Swap"
                )
            transform[axis] = (partner + 1) * (-1 if along * across < 0 else 1)
        # The direction out of one block leads into the other.
        transform[here.side.axis] = here.side.into(there.side)
        i, j, k = transform
        ends = here.block, here.begin, here.end, there.block, there.begin, there.end
        connections.append(Connection(name, *ends, (i, j, k)))
    if left_out:
        notes = (*notes, f"{path}: {left_out} entries lie on the plane of the 2-D grid itself and are ignored")
    return replace(grid, patches=tuple(patches), connections=tuple(connections), notes=(*grid.notes, *notes))


def _frame(sizes: tuple[Shape, ...], entries: tuple[Entry, ...], grid: Grid, path: Path) -> _Frame:
    if len(sizes) != grid.n_blocks:
        raise FormatError(
            f"{path} describes {len(sizes)} blocks, the grid has {grid.n_blocks}; expected the map of this grid"
        )
    if sizes == grid.shapes:
        # Faces 1 and 2 are edges if a range of a single line of nodes, in a 2-D grid, cannot be its plane.
        ranges = [numbers for entry in entries for numbers in entry.ranges]
        plane = all(nk == 1 for _, _, nk in sizes)
        edges = plane and any(face in (1, 2) and s2 == e2 == 1 for _, face, _, _, s2, e2 in ranges)
        return _Frame(sizes, _EDGES if edges else FACES, (0, 1, 2), None)
    siblings = [
        (flat, dropped)
        for flat, dropped in product(range(3), range(3))
        if all(shape[flat] == 1 for shape in grid.shapes)
        and all(size[dropped] <= 2 for size in sizes)
        and [np.delete(size, dropped).tolist() for size in sizes]
        == [np.delete(shape, flat).tolist() for shape in grid.shapes]
    ]
    if len(siblings) == 1:
        flat, dropped = siblings[0]
        axes = np.insert(np.delete(np.arange(3), flat), dropped, flat)
        return _Frame(sizes, FACES, (int(axes[0]), int(axes[1]), int(axes[2])), dropped)
    index = next(i for i, (size, shape) in enumerate(zip(sizes, grid.shapes, strict=True)) if size != shape)
    size, shape = ("x".join(str(n) for n in each[index]) for each in (sizes, grid.shapes))
    raise FormatError(
        f"{path}: block {index + 1} has {size} nodes, {grid.names[index]} of the grid has {shape}; expected "
        f"the map of this grid or, for a 2-D grid, that of the same grid with one layer of cells"
    )


_NUMBERED = {side: (number, axes) for number, (side, axes) in FACES.items()}
_WIDE = "=" * 83
_THIN = "-" * 83

# First and last node (0-based) along each index axis of a face range.
Spans = Mapping[int, tuple[int, int]]


def write_neutral_map(grid: Grid, path: Path) -> Path:
    """Write patches and connections of ``grid`` as a neutral map file, replacing ``path`` as a whole."""
    with replacing(Path(path)) as partial:
        partial.write_text(neutral_map_text(grid), encoding="utf-8")
    return path


def neutral_map_text(grid: Grid) -> str:
    """Patches and connections of ``grid`` in the format of neutral map files.

    The type of a patch is its ``bc_type``, else its family or name. A connection that both blocks declare is written
    once; both sides of a periodic one, for which the format has no entry, have the type ``periodic``.
    """
    lines = [f"# ===== Neutral Map File written by meshdeform {'=' * 39}", f"# {_WIDE}"]
    lines += ["# Block#   IDIM   JDIM   KDIM", f"# {_THIN}", f"{grid.n_blocks:8d}", ""]
    lines += [f"{b:8d}{ni:7d}{nj:7d}{nk:7d}" for b, (ni, nj, nk) in enumerate(grid.shapes, 1)]
    lines += ["", f"# {_WIDE}"]
    lines += ["# Type                B1  F1     S1     E1     S2     E2  B2  F2     S1     E1     S2     E2  Swap"]
    lines += [f"# {_THIN}"]
    for patch in grid.patches:
        word = re.sub(r"[\s#'\"\\]+", "_", patch.bc_type or patch.family or patch.name)
        ranges = [
            _index_range(w.block, w.side, dict(zip(w.side.tangential, zip(w.low, w.high, strict=True), strict=True)))
            for w in patch.windows
        ]
        # A patched interface is one entry with both its faces.
        if word.lower() == "patched" and len(ranges) == 2:
            ranges = ["".join(ranges)]
        lines += [f"{word:20s}{text}" for text in ranges]
    written = set()
    for connection in grid.connections:
        faces = _sides_of_connection(connection, grid.shapes[connection.block])
        ends = frozenset((block, *(tuple(sorted(span)) for span in spans.values())) for block, _, spans in faces)
        if ends in written:
            continue
        written.add(ends)
        here, there = (_index_range(*face) for face in faces)
        if connection.periodic is None:
            (primary, _), (_, donor_secondary) = (_NUMBERED[side][1] for _, side, _ in faces)
            swap = abs(connection.transform[primary]) - 1 == donor_secondary
            lines.append(f"{'one-to-one':20s}{here}{there}  {str(swap).lower()}")
        else:
            lines += [f"{'periodic':20s}{here}", f"{'periodic':20s}{there}"]
    return "\n".join(lines) + "\n"


def _sides_of_connection(
    connection: Connection, shape: Shape
) -> tuple[tuple[int, Side, Spans], tuple[int, Side, Spans]]:
    """Block, side and range of both sides of a connection."""
    begin, end, donor_begin = connection.begin, connection.end, connection.donor_begin
    axis = next(a for a in range(3) if begin[a] == end[a] and shape[a] > 1 and begin[a] in (0, shape[a] - 1))
    donor_axis = abs(connection.transform[axis]) - 1
    spans = dict(enumerate(zip(begin, end, strict=True)))
    donor_spans = dict(enumerate(zip(donor_begin, connection.donor_end, strict=True)))
    return (
        (connection.block, Side(2 * axis + (begin[axis] > 0)), spans),
        (connection.donor_block, Side(2 * donor_axis + (donor_begin[donor_axis] > 0)), donor_spans),
    )


def _index_range(block: int, side: Side, spans: Spans) -> str:
    number, (primary, secondary) = _NUMBERED[side]
    limits = (*spans[primary], *spans[secondary])
    return f" {block + 1:3d} {number:3d}" + "".join(f" {limit + 1:6d}" for limit in limits)
