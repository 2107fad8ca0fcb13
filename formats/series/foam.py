"""A series as an OpenFOAM case: the undeformed mesh, and the points of every level in a folder of its time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FloatArray, Grid
from meshdeform_core.parallel import require_whole

from ..files import remove_partial, replacing
from ..grids import variant_of
from ..openfoam.case import POLY_MESH, mesh_files, replaced_mesh
from ..openfoam.format import MeshWriter
from .outputs import Dress, as_it_is

_LONGEST = 17


class FoamFiles:
    """``NAME.foam``, ``constant/polyMesh`` and ``TIME/polyMesh/points``, as OpenFOAM's moving meshes have them.

    Levels with invalid cells are in ``TIME.invalid``, which OpenFOAM does not take for a time.

    Raises
    ------
    FormatError
        When velocities are requested, or two times cannot be told apart by their names.
    """

    def __init__(
        self, grid: Grid, folder: Path, name: str, times: tuple[float, ...], options: Mapping[str, Any], velocity: str
    ):
        if velocity != "none":
            raise FormatError("OpenFOAM finds the grid velocity from the points; omit --velocity")
        self._grid, self._folder, self._names = grid, folder, _time_names(times)
        self.view = folder / name
        self.variant = variant_of(grid, self.view, options)
        self.dress: Dress = as_it_is
        self.invalid: set[int] = set()
        self._begun = False

    @cached_property
    def _writer(self) -> MeshWriter:
        return MeshWriter(self._grid, self.variant)

    @property
    def outputs(self) -> list[Path]:
        return [self.view, *(self._points(self.path(number)) for number in range(len(self._names)))]

    @property
    def replaced(self) -> list[Path]:
        both = [self._points(path) for number in range(len(self._names)) for path in self._folders(number)]
        return [self.view, *both]

    def path(self, number: int) -> Path:
        return self._folders(number)[number in self.invalid]

    def _folders(self, number: int) -> tuple[Path, Path]:
        """Folders of a level if it is valid, and if it is invalid."""
        return self._folder / self._names[number], self._folder / f"{self._names[number]}.invalid"

    def _points(self, folder: Path) -> Path:
        packed = self.variant.options["compression"] == "gzip"
        return folder / "polyMesh" / ("points.gz" if packed else "points")

    def recall(self, records: Sequence[Mapping[str, Any]]) -> None:
        self.invalid = {n for n, record in enumerate(records) if record["file"] == self._folders(n)[1].name}

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        require_whole(grid.points, "levels are written for OpenFOAM")
        if not self._begun:
            with replaced_mesh(self.view) as folder:
                self._writer.write(folder, self._grid)
            self._begun = True
        target = self._points(self.path(number))
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as partial:
            self._writer.write_points(partial, grid, f"{self._names[number]}/polyMesh")
        # Remove the level of an earlier run with the other verdict, which could be mistaken for this one.
        self._remove(self._folders(number)[number not in self.invalid])

    def read(self, number: int) -> FloatArray:
        return self._writer.read_points(self._points(self.path(number)))

    @property
    def readable(self) -> bool:
        return True

    def has(self, number: int) -> bool:
        return self._points(self.path(number)).is_file() and len(mesh_files(self.view)) > 0

    def least_bytes(self, first: int) -> int:
        return 0

    def publish(self, done: int) -> None:
        """Nothing to publish: OpenFOAM and ParaView find the times by their folders."""

    def clean(self, complete: bool = False) -> None:
        for folder in (self._folder, self._folder / POLY_MESH):
            remove_partial(folder)
        for number in range(len(self._names)):
            for folder in self._folders(number):
                remove_partial(folder / "polyMesh")

    def _remove(self, folder: Path) -> None:
        """Remove the points of a level, and its folder unless something else is in it."""
        self._points(folder).unlink(missing_ok=True)
        for empty in (folder / "polyMesh", folder):
            if empty.is_dir() and not any(empty.iterdir()):
                empty.rmdir()


def _time_names(times: Sequence[float]) -> list[str]:
    """Distinct names of the times with as few digits as possible, at least the six that OpenFOAM writes."""
    for digits in range(6, _LONGEST + 1):
        names = [f"{time:.{digits}g}" for time in times]
        if len(set(names)) == len(names):
            return names
    raise FormatError("two times of the series are equal; expected different ones")
