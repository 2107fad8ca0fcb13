"""Grids as arguments: in memory, or by file name."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from meshdeform_core import grid as core
from meshdeform_core.errors import GridError

from .files import read
from .grid import Grid


def user_grid(grid: object) -> Grid:
    """The argument as a :class:`Grid`; a file name is read.

    Raises
    ------
    GridError
        For anything else.
    """
    if isinstance(grid, Grid):
        return grid
    if isinstance(grid, str | Path):
        return read(grid)
    hint = "; wrap coordinate arrays in Grid([block, ...])" if isinstance(grid, np.ndarray | Sequence | Mapping) else ""
    raise GridError(f"found a {type(grid).__name__}; expected a Grid or the name of a grid file{hint}")


def core_grid(grid: object) -> core.Grid:
    """The core grid of the argument.

    Raises
    ------
    GridError
        When every rank holds a part of it.
    """
    return user_grid(grid)._whole("a report or comparison")
