"""The files of a series: one grid file per level with an index, or one CGNS file for all."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, FloatArray, Grid
from meshdeform_core.parallel import ranks_of, require_whole
from meshdeform_core.velocity import FLUX, SWEPT, face_fields, grid_velocity

from ..fields import WITH_FIELDS
from ..files import invalid_path, remove_partial, replacing
from ..grids import FORMATS, format_of, read_grid, variant_of, write_grid
from .index import index_path, write_index

VELOCITY = "GridVelocity"
_WITH_FACES = (*FORMATS["vtk"].suffixes, *FORMATS["cgns"].suffixes)
Dress = Callable[[Grid], Grid]
"""A level with fields added."""


def as_it_is(grid: Grid) -> Grid:
    """The level unchanged, without further fields."""
    return grid


class SeriesFiles(Protocol):
    """The levels on disk. Every file is complete or absent, whenever the program is stopped.

    ``dress`` adds fields to a level before it is written. ``invalid`` are the numbers of the levels that are kept
    under the name of an invalid grid (:func:`~meshdeform_formats.files.invalid_path`).
    """

    variant: FileFormat
    dress: Dress
    invalid: set[int]

    @property
    def outputs(self) -> list[Path]:
        """All files of the complete series."""
        ...

    @property
    def replaced(self) -> list[Path]:
        """All files that may be written or removed, for checks before anything is computed."""
        ...

    @property
    def view(self) -> Path | None:
        """The file to open in ParaView."""
        ...

    def path(self, number: int) -> Path:
        """The file that holds a level when the series is complete."""
        ...

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        """Write one level, with the grid velocity (n_nodes, 3) and fields at the cell faces; on all ranks."""
        ...

    def read(self, number: int) -> FloatArray:
        """Coordinates (n_nodes, 3) of a written level, in the order of the series' grid."""
        ...

    @property
    def readable(self) -> bool:
        """Whether the files that :meth:`read` needs exist, including after completion of the series."""
        ...

    def has(self, number: int) -> bool:
        """Whether a level has been written."""
        ...

    def recall(self, records: Sequence[Mapping[str, Any]]) -> None:
        """Take over the names of levels that an earlier run has written, from their records in the report."""
        ...

    def publish(self, done: int) -> None:
        """Make the first ``done`` levels visible to other programs."""
        ...

    def clean(self, complete: bool = False) -> None:
        """Remove remains of a killed run and, when the series is complete, files that are no longer needed."""
        ...


def with_velocity(grid: Grid, velocity: FloatArray | None, faces: Sequence[Field], precision: str) -> Grid:
    """The grid with the velocity (n_nodes, 3) as a vector field at its nodes and the fields ``faces``.

    Existing fields of these names are replaced. Swept volumes keep double precision, as their sums nearly cancel.
    """
    if velocity is None:
        return grid
    values = velocity.astype(precision, copy=False)
    new = [Field(VELOCITY, "node", b, grid.block(b, values)) for b in range(grid.n_blocks)]
    kept = (field for field in grid.fields if field.name not in (VELOCITY, SWEPT, FLUX))
    return dataclasses.replace(grid, fields=(*kept, *new, *faces))


def level_name(stem: str, number: int, count: int, suffix: str) -> str:
    """``wing_0007.vtm``: enough digits for all levels, at least four."""
    return f"{stem}_{number:0{max(4, len(str(count - 1)))}d}{suffix}"


class LevelFiles:
    """One grid file per level, ``NAME_0000.vtm`` ..., and an index of them for ParaView.

    Raises
    ------
    FormatError
        When velocities are requested but the format cannot hold them, or the variant cannot hold the grid.
    """

    def __init__(
        self, grid: Grid, folder: Path, name: str, times: tuple[float, ...], options: Mapping[str, Any], velocity: str
    ):
        self._grid, self._folder, self._times = grid, folder, times
        self._stem, self._suffix = Path(name).stem, Path(name).suffix.lower()
        format_of(Path(name))
        able = _WITH_FACES if velocity == "swept" else WITH_FIELDS
        if velocity != "none" and self._suffix not in able:
            what = "values at cell faces" if velocity == "swept" else "the grid velocity"
            raise FormatError(
                f"{self._suffix} files cannot hold {what}; choose one of {' '.join(dict.fromkeys(able))}, or omit the "
                f"velocity"
            )
        self._options = options
        self.dress: Dress = as_it_is
        self.invalid: set[int] = set()
        self.variant = variant_of(grid, folder / name, options)
        self.view = index_path(folder, self._stem, self._suffix)

    @property
    def outputs(self) -> list[Path]:
        levels = [self.path(number) for number in range(len(self._times))]
        return [*levels, self.view] if self.view else levels

    @property
    def replaced(self) -> list[Path]:
        return [*self.outputs, *(path for number in range(len(self._times)) for path in self._names(number))]

    def path(self, number: int) -> Path:
        return self._names(number)[number in self.invalid]

    def _names(self, number: int) -> tuple[Path, Path]:
        """Paths of a level if it is valid, and if it is invalid."""
        plain = self._folder / level_name(self._stem, number, len(self._times), self._suffix)
        return plain, invalid_path(plain)

    def recall(self, records: Sequence[Mapping[str, Any]]) -> None:
        self.invalid = {n for n, record in enumerate(records) if record["file"] == self._names(n)[1].name}

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        def dressed(level: Grid) -> Grid:
            return with_velocity(self.dress(level), velocity, faces, self.variant.precision)

        write_grid(grid, self.path(number), self._options, dressed)
        # Remove the level of an earlier run with the other verdict, which could be mistaken for this one.
        ranks_of(grid.points).on_first(lambda: self._remove(self._names(number)[number not in self.invalid]))

    def read(self, number: int) -> FloatArray:
        path = self.path(number)
        if not self.readable:
            raise FormatError(
                f"cannot continue after {path}: the next level needs its coordinates, and {self._suffix} files cannot "
                f"be read; restart the series (--force), or use a format that can be read"
            )
        grid = read_grid(path)
        if grid.n_nodes != self._grid.n_nodes:
            raise FormatError(f"{path} has {grid.n_nodes:,} nodes; a level of this series has {self._grid.n_nodes:,}")
        return grid.points

    @property
    def readable(self) -> bool:
        return hasattr(FORMATS[format_of(self.path(0))].load(), "read")

    def has(self, number: int) -> bool:
        return self.path(number).is_file()

    def publish(self, done: int) -> None:
        if self.view:
            levels = [(self._times[number], self.path(number).name) for number in range(done)]
            write_index(self.view, levels, self.variant)

    def clean(self, complete: bool = False) -> None:
        remove_partial(self._folder)
        if self._suffix == ".vtm":
            for number in range(len(self._times)):
                for path in self._names(number):
                    self._remove_lone_pieces(path)

    def _remove(self, path: Path) -> None:
        path.unlink(missing_ok=True)
        if self._suffix == ".vtm":
            self._remove_lone_pieces(path)

    def _remove_lone_pieces(self, index: Path) -> None:
        """Remove remains of a multi-block set from a killed run, and the pieces of one whose index was removed."""
        from ..vtk.multiblock import clean

        clean(index)
        folder = index.with_suffix("")
        if folder.is_dir() and not index.exists():
            for piece in folder.glob(f"{index.stem}_*.vts"):
                piece.unlink()
            folder.rmdir()


class SingleFile:
    """All levels in ``NAME.cgns``. Until the last one is written they are kept in the folder ``NAME.levels``."""

    def __init__(
        self, grid: Grid, folder: Path, name: str, times: tuple[float, ...], options: Mapping[str, Any], velocity: str
    ):
        from ..cgns.time_steps import require_steady

        self._grid, self._folder, self._times, self._velocity = grid, folder, times, velocity
        self._plain = folder / name
        if format_of(self._plain) != "cgns":
            raise FormatError(f"{self._plain}: only a CGNS file can hold all levels; choose the suffix .cgns")
        require_steady(grid)
        self.dress: Dress = as_it_is
        self.invalid: set[int] = set()
        self.variant = variant_of(grid, self._plain, options)
        self._levels = folder / f"{self._plain.stem}.levels"

    @property
    def outputs(self) -> list[Path]:
        return [self.view]

    @property
    def replaced(self) -> list[Path]:
        return [self._plain, invalid_path(self._plain)]

    @property
    def view(self) -> Path:
        return invalid_path(self._plain) if self.invalid else self._plain

    def path(self, number: int) -> Path:
        return self.view

    def recall(self, records: Sequence[Mapping[str, Any]]) -> None:
        # From the first invalid level on: all of them are in one file.
        bad = invalid_path(self._plain).name
        self.invalid = {number for number, record in enumerate(records) if record["file"] == bad}

    def _part(self, number: int) -> Path:
        return self._levels / level_name("level", number, len(self._times), ".npy")

    def write(self, number: int, grid: Grid, velocity: FloatArray | None, faces: Sequence[Field] = ()) -> None:
        # Velocities are differences of coordinates, computed when the file is assembled.
        require_whole(grid.points, "all levels are in one file")
        self._levels.mkdir(exist_ok=True)
        with replacing(self._part(number)) as partial:
            np.save(partial, grid.points.astype(self.variant.precision, copy=False))

    def read(self, number: int) -> FloatArray:
        return np.load(self._part(number), allow_pickle=False).astype(np.float64)

    @property
    def readable(self) -> bool:
        return self._levels.is_dir()

    def has(self, number: int) -> bool:
        return self._part(number).is_file()

    def publish(self, done: int) -> None:
        if done == len(self._times):
            from ..cgns.time_steps import write_series

            write_series(self._grid, self.view, self.variant, self._times, self._level)
            (self._plain if self.invalid else invalid_path(self._plain)).unlink(missing_ok=True)

    def _level(self, number: int) -> Grid:
        grid = self.dress(dataclasses.replace(self._grid, points=self.read(number), fields=()))
        if self._velocity == "none":
            return grid
        points = [*(self.read(n) for n in range(max(0, number - 2), number)), grid.points]
        times = self._times[: number + 1]
        velocity = grid_velocity(times, points, self._velocity)
        faces = face_fields(self._grid, times, points) if self._velocity == "swept" else ()
        return with_velocity(grid, velocity, faces, self.variant.precision)

    def clean(self, complete: bool = False) -> None:
        remove_partial(self._folder)
        if complete and self._levels.is_dir():
            shutil.rmtree(self._levels)
        elif self._levels.is_dir():
            remove_partial(self._levels)
