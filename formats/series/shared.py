"""Series whose levels share a file or a mesh: one CGNS file, an OpenFOAM case."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FloatArray, Grid
from meshdeform_core.parallel import Nodes
from meshdeform_core.velocity import face_fields, grid_velocity

from ..files import invalid_path, remove_partial, replacing, replacing_by_all
from ..grids import format_of
from ..openfoam.case import POLY_MESH, mesh_files, replaced_mesh
from ..openfoam.format import MeshWriter
from ..placing import velocity_bytes
from ..planes import Stored, synchronous
from .outputs import SeriesFiles, level_name, with_velocity

_ROWS = 1 << 18
_LONGEST = 17


class SingleFile(SeriesFiles):
    """All levels in ``NAME.cgns``. Until the last one is written they are kept in the folder ``NAME.levels``."""

    def __init__(
        self, grid: Grid, folder: Path, name: str, times: tuple[float, ...], options: Mapping[str, Any], velocity: str
    ):
        from ..cgns.time_steps import require_steady

        if format_of(folder / name) != "cgns":
            raise FormatError(f"{folder / name}: only a CGNS file can hold all levels; choose the suffix .cgns")
        require_steady(grid)
        super().__init__(grid, folder, name, times, options, velocity)
        self._levels = folder / f"{self.plain.stem}.levels"

    def names(self, number: int) -> tuple[Path, Path]:
        return self.plain, invalid_path(self.plain)

    @property
    def view(self) -> Path:  # type: ignore[override]
        return self.names(0)[bool(self.invalid)]

    def path(self, number: int) -> Path:
        # From the first invalid level on: all of them are in one file.
        return self.view

    def _coordinates_file(self, number: int) -> Path:
        return self._levels / level_name("level", number, len(self.times), ".npy")

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        # Velocities are differences of coordinates, computed when the file is assembled.
        ranks, kind = grid.nodes.ranks, np.dtype(self.variant.precision)
        ranks.on_first(lambda: self._levels.mkdir(exist_ok=True))
        with replacing_by_all(self._coordinates_file(number), grid.points) as partial:
            start = ranks.on_first(lambda: _begin(partial, kind, grid.points.shape))
            stored = Stored(partial, kind, (3,), start, 3 * kind.itemsize)
            grid.nodes.on_each(lambda: _put(stored, grid.nodes.rows, grid.nodes.ends, synchronous(ranks)))

    def read(self, number: int) -> FloatArray:
        points: FloatArray = self.grid.nodes.like(3)
        nodes = Nodes.of(points)
        nodes.on_each(lambda: _get(self._coordinates_file(number), nodes.rows, nodes.ends))
        nodes.keep_like(self.grid.points)
        return points

    @property
    def readable(self) -> bool:
        return self._levels.is_dir()

    def kept(self, number: int) -> Path:
        return self._coordinates_file(number)

    def least_bytes(self, first: int) -> int:
        # The folder of the levels is removed when the file is complete.
        grid, count, precision = self.grid, len(self.times), self.variant.precision
        values = np.dtype(precision).itemsize * grid.n_nodes
        level = grid.dimension * values + velocity_bytes(grid, self.velocity, precision)
        return 3 * values * (count - first) + level * count if first < count else 0

    def publish(self, done: int) -> None:
        if done == len(self.times):
            from ..cgns.time_steps import write_series

            write_series(self.grid, self.view, self.variant, self.times, self._level)
            other = self.plain if self.invalid else invalid_path(self.plain)
            self.grid.nodes.on_first(lambda: other.unlink(missing_ok=True))

    def _level(self, number: int) -> Grid:
        grid = self.dress(dataclasses.replace(self.grid, points=self.read(number), fields=()))
        if self.velocity == "none":
            return grid
        points = [*(self.read(n) for n in range(max(0, number - 2), number)), grid.points]
        times = self.times[: number + 1]
        velocity = grid_velocity(times, points, self.velocity)
        faces = face_fields(self.grid, times, points) if self.velocity == "swept" else ()
        return with_velocity(grid, velocity, faces, self.variant.precision)

    def clean(self, complete: bool = False) -> None:
        super().clean(complete)
        if complete and self._levels.is_dir():
            shutil.rmtree(self._levels)
        elif self._levels.is_dir():
            remove_partial(self._levels)


def _begin(path: Path, kind: np.dtype[Any], shape: tuple[int, ...]) -> int:
    """Begin a numpy file; returns the place of the first value."""
    with path.open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": kind.str, "fortran_order": False, "shape": shape})
        return file.tell()


def _put(stored: Stored, rows: FloatArray, own: tuple[int, int], synchronous: bool) -> None:
    """Write the ``own`` range of rows (n, 3) to their places in a file."""
    for at in range(*own, _ROWS):
        stored.write(at, rows[at : min(at + _ROWS, own[1])], synchronous)


def _get(path: Path, rows: FloatArray, own: tuple[int, int]) -> None:
    """Fill the ``own`` range of rows (n, 3) from a numpy file."""
    stored = np.load(path, mmap_mode="r", allow_pickle=False)
    for at in range(*own, _ROWS):
        part = slice(at, min(at + _ROWS, own[1]))
        rows[part] = stored[part]


class FoamFiles(SeriesFiles):
    """``NAME.foam``, ``constant/polyMesh`` and ``TIME/polyMesh/points``, as OpenFOAM's moving meshes have them.

    Levels with invalid cells are in ``TIME.invalid``, which OpenFOAM does not take for a time. OpenFOAM and ParaView
    find the times by their folders.

    Raises FormatError when velocities are requested, or two times cannot be told apart by their names.
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
        return path / "polyMesh" / "points"

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        grid.nodes.require_whole("levels are written for OpenFOAM")
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
