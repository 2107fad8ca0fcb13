"""Disk space for outputs, which is checked before the computation."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import readable

from .files import followed
from .grids import Layout, format_of


def lack(needed: int, path: Path, what: str) -> str:
    """A message on the space on the disk that ``needed`` bytes beside ``path`` lack; empty if they fit.

    ``what`` like ``the grid takes``. An output is completed before it replaces a file. Quotas, and data that others
    write meanwhile, are not considered.
    """
    folder = existing(followed(path).absolute().parent)
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        # Errors of the folder are reported when the file is written.
        return ""
    if needed <= free:
        return ""
    return (
        f"the disk of {folder} has {readable(free)} free, {what} at least {readable(needed)}; free some space, "
        f"or choose an output on another disk"
    )


def least_bytes(grid: Grid | Layout, path: Path, variant: FileFormat) -> int:
    """Smallest size in bytes of a grid in a file; 0 for text, whose size is not known."""
    name = format_of(path)
    container = grid.format.options.get("container") if grid.format else None
    if name == "cgns" and container == "HDF5" and grid.path is not None and grid.path.exists():
        # A copy of the original file, whose coordinates may be compressed.
        return os.path.getsize(grid.path) // (1 if variant.precision == grid.precision else 2)
    options = variant.options
    raw = name == "cgns" or (name in ("plot3d", "vtk") and options.get("encoding") != "ascii")
    plane = name == "plot3d" and str(options.get("dimension")) == "2"
    count = 3 if name == "vtk" else 2 if plane else grid.dimension
    return grid.n_nodes * count * np.dtype(variant.precision).itemsize if raw else 0


def velocity_bytes(grid: Grid | Layout, velocity: str, precision: str) -> int:
    """Smallest size in bytes of the velocities at the nodes, and of what the cell faces sweep, of one level."""
    if velocity == "none":
        return 0
    faces = 2 * np.dtype("float64").itemsize * grid.n_cells if velocity == "swept" else 0
    return grid.dimension * (grid.n_nodes * np.dtype(precision).itemsize + faces)


def bytes_at(path: Path) -> int:
    """Size of a grid file, of a multi-block set with its blocks; 0 if there is none."""
    parts = [path, *(path.with_suffix("").glob("*") if path.suffix.lower() == ".vtm" else ())]
    return sum(part.stat().st_size for part in parts if part.is_file())


def existing(folder: Path) -> Path:
    """The folder, or its closest parent that exists."""
    return next((each for each in (folder, *folder.parents) if each.is_dir()), folder)
