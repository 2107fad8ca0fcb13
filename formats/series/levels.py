"""The levels of a series that lies on disk, one after the other."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from pathlib import Path

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..contents import digest
from ..grids import read_grid
from .manifest import NAME, Manifest


@dataclass(frozen=True)
class Levels:
    """Times of the levels that are done and the files that hold them.

    ``undeformed`` is the grid that they were made of, if it is still where and what it was.
    """

    times: tuple[float, ...]
    files: tuple[Path, ...]
    single: bool
    undeformed: Path | None

    def read(self, number: int) -> Grid:
        """The grid of a level.

        Raises
        ------
        FormatError
            When its file is gone or cannot be read.
        """
        path = self.files[number]
        grid = read_grid(path)
        if not self.single:
            return grid
        from ..cgns.time_steps import read_level

        return dataclasses.replace(grid, points=read_level(grid, path, number))

    def __len__(self) -> int:
        return len(self.times)


def is_series(path: Path) -> bool:
    """Whether a path is the folder of a series, or its ``series.json``."""
    return path.name == NAME or (path / NAME).is_file()


def open_levels(path: Path) -> Levels:
    """The levels of the series in a folder.

    Raises
    ------
    FormatError
        When there is none.
    """
    folder = path.parent if path.name == NAME else path
    state = Manifest.load(folder / NAME)
    single = bool(state.ingredients.get("single file"))
    if single and not state.complete:
        raise FormatError(f"{folder}: the series is not complete; go on with `meshdeform series ... --resume`")
    if not state.levels:
        raise FormatError(f"{folder}: no level of the series is done yet")
    files = tuple(folder / level["file"] for level in state.levels)
    source = Path(state.head["grid"]["file"])
    same = source.exists() and digest(source) == state.ingredients["grid"]
    return Levels(tuple(level["time"] for level in state.levels), files, single, source if same else None)
