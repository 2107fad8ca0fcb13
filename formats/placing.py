"""Whether there is room for an output: a full disk is found before the computation, not after it."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid
from meshdeform_core.memory import readable

from .files import followed
from .grids import format_of
from .layout import Layout


def require_space(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Refuse an output for whose coordinates the disk has no room beside the file that it replaces.

    The output is complete before it replaces anything. Quotas, and what others write meanwhile, are not foreseen.

    Raises
    ------
    FormatError
        With the bytes needed at least, and those free.
    """
    needed = least_bytes(grid, path, variant)
    folder = existing(followed(path).absolute().parent)
    try:
        free = shutil.disk_usage(folder).free
    except OSError:
        # Writing will tell what is wrong with the folder.
        return
    if needed > free:
        raise FormatError(
            f"cannot write {path}: the disk of {folder} has {readable(free)} free, the grid takes at least "
            f"{readable(needed)}; free some space, or choose an output on another disk"
        )


def least_bytes(grid: Grid | Layout, path: Path, variant: FileFormat) -> int:
    """Size in bytes that a grid has at least in a file; 0 where it is compressed or text, whose size is not known."""
    name = format_of(path)
    container = grid.format.options.get("container") if grid.format else None
    if name == "cgns" and container == "HDF5" and grid.path is not None and grid.path.exists():
        # A copy of the file, whose coordinates may be packed.
        return os.path.getsize(grid.path) // (1 if variant.precision == grid.precision else 2)
    raw = name == "cgns" or (name == "plot3d" and variant.options.get("encoding") != "ascii")
    count = 2 if name == "plot3d" and str(variant.options.get("dimension")) == "2" else grid.dimension
    return grid.n_nodes * count * np.dtype(variant.precision).itemsize if raw else 0


def existing(folder: Path) -> Path:
    """The folder, or the lowest one above it that exists."""
    return next((each for each in (folder, *folder.parents) if each.is_dir()), folder)
