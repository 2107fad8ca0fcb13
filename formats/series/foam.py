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
from ..openfoam.case import POLY_MESH, mesh_files, replaced_mesh
from ..openfoam.format import MeshWriter
from .outputs import SeriesFiles

_LONGEST = 17


class FoamFiles(SeriesFiles):
    """``NAME.foam``, ``constant/polyMesh`` and ``TIME/polyMesh/points``, as OpenFOAM's moving meshes have them.

    Levels with invalid cells are in ``TIME.invalid``, which OpenFOAM does not take for a time. OpenFOAM and ParaView
    find the times by their folders.

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
        self.time_names = _time_names(times)
        super().__init__(grid, folder, name, times, options, velocity)
        self.view = self.plain
        self._begun = False

    @cached_property
    def _writer(self) -> MeshWriter:
        return MeshWriter(self.grid, self.variant)

    def names(self, number: int) -> tuple[Path, Path]:
        return self.folder / self.time_names[number], self.folder / f"{self.time_names[number]}.invalid"

    def stored(self, path: Path) -> Path:
        return path / "polyMesh" / ("points.gz" if self.variant.options["compression"] == "gzip" else "points")

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        require_whole(grid.points, "levels are written for OpenFOAM")
        if not self._begun:
            with replaced_mesh(self.plain) as folder:
                self._writer.write(folder, self.grid)
            self._begun = True
        target = self.stored(self.path(number))
        target.parent.mkdir(parents=True, exist_ok=True)
        with replacing(target) as partial:
            self._writer.write_points(partial, grid, f"{self.time_names[number]}/polyMesh")
        # Remove the level of an earlier run with the other verdict, which could be mistaken for this one, and its
        # folder unless something else is in it.
        other = self.names(number)[number not in self.invalid]
        self.stored(other).unlink(missing_ok=True)
        for empty in (other / "polyMesh", other):
            if empty.is_dir() and not any(empty.iterdir()):
                empty.rmdir()

    def read(self, number: int) -> FloatArray:
        return self._writer.read_points(self.stored(self.path(number)))

    def has(self, number: int) -> bool:
        return super().has(number) and len(mesh_files(self.plain)) > 0

    def clean(self, complete: bool = False) -> None:
        super().clean(complete)
        remove_partial(self.folder / POLY_MESH)
        for number in range(len(self.time_names)):
            for folder in self.names(number):
                remove_partial(folder / "polyMesh")


def _time_names(times: Sequence[float]) -> list[str]:
    """Distinct names of the times with as few digits as possible, at least the six that OpenFOAM writes."""
    for digits in range(6, _LONGEST + 1):
        names = [f"{time:.{digits}g}" for time in times]
        if len(set(names)) == len(names):
            return names
    raise FormatError("two times of the series are equal; expected different ones")
