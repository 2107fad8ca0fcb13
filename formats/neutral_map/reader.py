"""NASA neutral map files (.nmf): the boundary conditions and block connections that a Plot3D file does not hold.

Source: "The Neutral Map File", W. T. Jones, GEOLAB, NASA Langley; kept with the NASA turbulence modeling resource.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, Patch, Shape, Side, Window

from .text import FACES, Entry, Face, NeutralMap, parse_neutral_map

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
        begin, end = [0, 0, 0], [0, 0, 0]
        begin[side.axis] = end[side.axis] = side.layer(size)
        for axis, first, last in zip(tangential, limits[::2], limits[1::2], strict=True):
            if not (1 <= first <= size[axis] and 1 <= last <= size[axis]):
                raise FormatError(
                    f"{place}: range {first} to {last} along {'ijk'[axis]} on face {face} ({side.label}) of block "
                    f"{block}, which has nodes 1 to {size[axis]} there"
                )
            begin[axis], end[axis] = first - 1, last - 1
        for corner in (begin, end):
            if self.dropped is not None:
                corner[self.dropped] = 0
        primary, secondary = tangential
        return _Range(
            block - 1,
            Side(2 * self.axes[side.axis] + side.value % 2),
            (self.axes[primary], self.axes[secondary]),
            self._in_grid(begin),
            self._in_grid(end),
        )

    def _in_grid(self, corner: Sequence[int]) -> Shape:
        i, j, k = (corner[self.axes.index(axis)] for axis in range(3))
        return i, j, k


def read_neutral_map(path: Path, grid: Grid) -> Grid:
    """The grid with the patches and connections of a neutral map file added.

    An entry becomes a patch whose family and ``bc_type`` are the type of the entry and whose name is numbered, like
    ``viscous_solid-2``; a one-to-one entry becomes a connection. A 2-D grid also accepts the map of the same grid with
    one layer of cells; entries on the plane of the 2-D grid itself are omitted with a note.

    Raises
    ------
    FormatError
        When the file cannot be read, is not a neutral map, or describes blocks that the grid does not have.
    """
    file = parse_neutral_map(Path(path))
    frame = _frame(file, grid, Path(path))
    patches, connections, left_out = list(grid.patches), list(grid.connections), 0
    counts = Counter(patch.family for patch in patches)
    for entry in file.entries:
        ranges = [frame.locate(numbers, entry.place) for numbers in entry.ranges]
        if any(grid.shapes[r.block][r.side.axis] == 1 for r in ranges):
            left_out += 1
            continue
        counts[entry.type] += 1
        name = f"{entry.type}-{counts[entry.type]}"
        if entry.is_one_to_one:
            connections.append(_connection(name, entry, *ranges))
        else:
            patches.append(Patch(name, tuple(r.window for r in ranges), entry.type, entry.type))
    notes = list(file.notes)
    if left_out:
        notes.append(f"{path}: {left_out} entries lie on the plane of the 2-D grid itself and are ignored")
    return replace(grid, patches=tuple(patches), connections=tuple(connections), notes=(*grid.notes, *notes))


def _frame(file: NeutralMap, grid: Grid, path: Path) -> _Frame:
    if len(file.sizes) != grid.n_blocks:
        raise FormatError(
            f"{path} describes {len(file.sizes)} blocks, the grid has {grid.n_blocks}; expected the map of this grid"
        )
    if file.sizes == grid.shapes:
        return _Frame(file.sizes, _EDGES if _counts_edges(file) else FACES, (0, 1, 2), None)
    siblings = [
        (flat, dropped)
        for flat, dropped in product(range(3), range(3))
        if all(shape[flat] == 1 for shape in grid.shapes)
        and all(size[dropped] <= 2 for size in file.sizes)
        and [np.delete(size, dropped).tolist() for size in file.sizes]
        == [np.delete(shape, flat).tolist() for shape in grid.shapes]
    ]
    if len(siblings) == 1:
        flat, dropped = siblings[0]
        axes = np.insert(np.delete(np.arange(3), flat), dropped, flat)
        return _Frame(file.sizes, FACES, (int(axes[0]), int(axes[1]), int(axes[2])), dropped)
    raise FormatError(_other_blocks(file, grid, path))


def _other_blocks(file: NeutralMap, grid: Grid, path: Path) -> str:
    index = next(i for i, (size, shape) in enumerate(zip(file.sizes, grid.shapes, strict=True)) if size != shape)
    size, shape = ("x".join(str(n) for n in sizes[index]) for sizes in (file.sizes, grid.shapes))
    return (
        f"{path}: block {index + 1} has {size} nodes, {grid.names[index]} of the grid has {shape}; expected "
        f"the map of this grid or, for a 2-D grid, that of the same grid with one layer of cells"
    )


def _counts_edges(file: NeutralMap) -> bool:
    """Whether faces 1 and 2 are edges: a range of a single line of nodes in a 2-D grid cannot be its plane."""
    ranges = [numbers for entry in file.entries for numbers in entry.ranges]
    flat = all(nk == 1 for _, _, nk in file.sizes)
    return flat and any(face in (1, 2) and s2 == e2 == 1 for _, face, _, _, s2, e2 in ranges)


def _connection(name: str, entry: Entry, here: _Range, there: _Range) -> Connection:
    """Map one range onto the other: begin to begin, primary to primary index or, with Swap, to secondary."""
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
    return Connection(name, here.block, here.begin, here.end, there.block, there.begin, there.end, (i, j, k))
