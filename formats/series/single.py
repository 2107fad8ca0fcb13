"""All levels of a series in one CGNS file."""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FloatArray, Grid
from meshdeform_core.parallel import Part, alike, on_each, own_rows, ranks_of, rows_of
from meshdeform_core.velocity import face_fields, grid_velocity

from ..files import invalid_path, remove_partial, replacing_by_all
from ..grids import format_of, variant_of
from ..placing import velocity_bytes
from ..planes import Stored, synchronous
from .outputs import Dress, as_it_is, level_name, with_velocity

_ROWS = 1 << 18


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
        ranks, kind = ranks_of(grid.points), np.dtype(self.variant.precision)
        ranks.on_first(lambda: self._levels.mkdir(exist_ok=True))
        with replacing_by_all(self._part(number), grid.points) as partial:
            start = ranks.on_first(lambda: _begin(partial, kind, grid.points.shape))
            stored = Stored(partial, kind, (3,), start, 3 * kind.itemsize)
            _on_all(grid.points, lambda: _put(stored, rows_of(grid.points), own_rows(grid.points), synchronous(ranks)))

    def read(self, number: int) -> FloatArray:
        points: FloatArray = alike(self._grid.points)
        _on_all(points, lambda: _get(self._part(number), rows_of(points), own_rows(points)))
        if isinstance(points, Part):
            points.keep_like(self._grid.points)
        return points

    @property
    def readable(self) -> bool:
        return self._levels.is_dir()

    def has(self, number: int) -> bool:
        return self._part(number).is_file()

    def least_bytes(self, first: int) -> int:
        # The folder of the levels is removed when the file is complete.
        grid, count, precision = self._grid, len(self._times), self.variant.precision
        values = np.dtype(precision).itemsize * grid.n_nodes
        level = grid.dimension * values + velocity_bytes(grid, self._velocity, precision)
        return 3 * values * (count - first) + level * count if first < count else 0

    def publish(self, done: int) -> None:
        if done == len(self._times):
            from ..cgns.time_steps import write_series

            write_series(self._grid, self.view, self.variant, self._times, self._level)
            other = self._plain if self.invalid else invalid_path(self._plain)
            ranks_of(self._grid.points).on_first(lambda: other.unlink(missing_ok=True))

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


def _on_all(points: Any, action: Callable[[], object]) -> None:
    """Do it on all ranks that hold ``points``; an error of one of them is raised on all."""
    if isinstance(points, Part):
        on_each(points, action)
    else:
        action()


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
