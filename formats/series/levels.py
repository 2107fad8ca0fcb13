"""Reading the levels of a series from its files."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from ..grids import read_grid, variant_of
from ..inputs import digest
from ..openfoam.case import dictionary_of, is_foam, mesh_file
from ..openfoam.format import MeshWriter
from .manifest import NAME, Manifest


@dataclass(frozen=True)
class Levels:
    """Times of the finished levels and their files.

    ``undeformed`` is the undeformed grid, if its file still exists unchanged. ``foam`` is the ``.foam`` file of a
    series whose levels are points of an OpenFOAM mesh.
    """

    times: tuple[float, ...]
    files: tuple[Path, ...]
    single: bool
    undeformed: Path | None
    foam: Path | None = None

    def read(self, number: int) -> Grid:
        """The grid of a level.

        Raises
        ------
        FormatError
            When its file is missing or cannot be read.
        """
        path = self.files[number]
        if self.foam is not None:
            return self._with_points(path)
        grid = read_grid(path)
        if not self.single:
            return grid
        from ..cgns.time_steps import read_level

        return dataclasses.replace(grid, points=read_level(grid, path, number))

    def _with_points(self, folder: Path) -> Grid:
        """The undeformed grid with the points of a level."""
        grid, writer = self._mesh
        return grid.moved(writer.read_points(mesh_file(folder / "polyMesh", "points")))

    @cached_property
    def _mesh(self) -> tuple[Grid, MeshWriter]:
        assert self.foam is not None
        if self.undeformed is None:
            raise FormatError(
                f"{self.foam.parent}: its levels are points of OpenFOAM, and the grid that they were made of is not "
                f"where and what it was; expected it unchanged"
            )
        grid = read_grid(self.undeformed)
        return grid, MeshWriter(grid, variant_of(grid, self.foam))

    def __len__(self) -> int:
        return len(self.times)


def is_series(path: Path) -> bool:
    """Whether a path is the folder of a series, its ``series.json``, or its ``.foam`` file that is no grid."""
    if is_foam(path):
        return (path.parent / NAME).is_file() and dictionary_of(path) is None
    return path.name == NAME or (path / NAME).is_file()


def open_levels(path: Path) -> Levels:
    """The levels of the series in a folder.

    Raises
    ------
    FormatError
        When there is none.
    """
    folder = path if path.is_dir() else path.parent
    state = Manifest.load(folder / NAME)
    single = bool(state.ingredients.get("single file"))
    if single and not state.complete:
        raise FormatError(f"{folder}: the series is not complete; continue it with `meshdeform series ... --resume`")
    if not state.levels:
        raise FormatError(f"{folder}: no level of the series is done yet")
    files = tuple(folder / level["file"] for level in state.levels)
    source = Path(state.head["grid"]["file"])
    same = source.exists() and digest(source) == state.ingredients["grid"]
    output = folder / str(state.ingredients.get("output", ""))
    foam = output if is_foam(output) else None
    return Levels(tuple(level["time"] for level in state.levels), files, single, source if same else None, foam)
