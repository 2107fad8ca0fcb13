"""The files of a series: one grid file per level with an index, or one CGNS file for all."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, FloatArray, Grid
from meshdeform_core.series import grid_velocity

from ..fields import WITH_FIELDS
from ..files import remove_partial, replacing
from ..grids import FORMATS, format_of, read_grid, variant_of, write_grid
from .index import index_path, write_index

VELOCITY = "GridVelocity"
Dress = Callable[[Grid], Grid]
"""A level with fields added."""


def _as_it_is(grid: Grid) -> Grid:
    return grid


class SeriesFiles(Protocol):
    """The levels on disk. Every file is complete or absent, whenever the program is stopped.

    ``dress`` adds fields to a level before it is written.
    """

    variant: FileFormat
    dress: Dress

    @property
    def outputs(self) -> list[Path]:
        """All files to be written, for checks before anything is computed."""
        ...

    @property
    def view(self) -> Path | None:
        """The file to open in ParaView."""
        ...

    def path(self, number: int) -> Path:
        """The file that holds a level when the series is complete."""
        ...

    def write(self, number: int, grid: Grid, velocity: FloatArray | None) -> None:
        """Write one level."""
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

    def publish(self, done: int) -> None:
        """Make the first ``done`` levels visible to other programs."""
        ...

    def clean(self, complete: bool = False) -> None:
        """Remove remains of a killed run and, when the series is complete, files that are no longer needed."""
        ...


def with_velocity(grid: Grid, velocity: FloatArray | None, precision: str) -> Grid:
    """The grid with the velocity (n_nodes, 3) as a vector field at its nodes, replacing an existing one."""
    if velocity is None:
        return grid
    values = velocity.astype(precision, copy=False)
    new = [Field(VELOCITY, "node", b, grid.block(b, values)) for b in range(grid.n_blocks)]
    return dataclasses.replace(grid, fields=(*(f for f in grid.fields if f.name != VELOCITY), *new))


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
        if velocity != "none" and self._suffix not in WITH_FIELDS:
            raise FormatError(
                f"{self._suffix} files cannot hold the grid velocity; choose one of "
                f"{' '.join(dict.fromkeys(WITH_FIELDS))}, or omit the velocity"
            )
        self._options = options
        self.dress: Dress = _as_it_is
        self.variant = variant_of(grid, folder / name, options)
        self.view = index_path(folder, self._stem, self._suffix)

    @property
    def outputs(self) -> list[Path]:
        levels = [self.path(number) for number in range(len(self._times))]
        return [*levels, self.view] if self.view else levels

    def path(self, number: int) -> Path:
        return self._folder / level_name(self._stem, number, len(self._times), self._suffix)

    def write(self, number: int, grid: Grid, velocity: FloatArray | None) -> None:
        write_grid(with_velocity(self.dress(grid), velocity, self.variant.precision), self.path(number), self._options)

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
                self._remove_lone_pieces(self.path(number))

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
        from ..cgns.series import require_steady

        self._grid, self._folder, self._times, self._velocity = grid, folder, times, velocity
        self.view = folder / name
        if format_of(self.view) != "cgns":
            raise FormatError(f"{self.view}: only a CGNS file can hold all levels; choose the suffix .cgns")
        require_steady(grid)
        self.dress: Dress = _as_it_is
        self.variant = variant_of(grid, self.view, options)
        self._levels = folder / f"{self.view.stem}.levels"

    @property
    def outputs(self) -> list[Path]:
        return [self.view]

    def path(self, number: int) -> Path:
        return self.view

    def _part(self, number: int) -> Path:
        return self._levels / level_name("level", number, len(self._times), ".npy")

    def write(self, number: int, grid: Grid, velocity: FloatArray | None) -> None:
        # Velocities are differences of coordinates, computed when the file is assembled.
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
            from ..cgns.series import write_series

            write_series(self._grid, self.view, self.variant, self._times, self._level)

    def _level(self, number: int) -> Grid:
        grid = self.dress(dataclasses.replace(self._grid, points=self.read(number), fields=()))
        if self._velocity == "none":
            return grid
        past = [self.read(n) for n in range(max(0, number - 2), number)]
        velocity = grid_velocity(self._times[: number + 1], [*past, grid.points], self._velocity)
        return with_velocity(grid, velocity, self.variant.precision)

    def clean(self, complete: bool = False) -> None:
        remove_partial(self._folder)
        if complete and self._levels.is_dir():
            shutil.rmtree(self._levels)
        elif self._levels.is_dir():
            remove_partial(self._levels)
