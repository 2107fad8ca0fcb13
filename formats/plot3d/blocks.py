"""Conversion between the arrays of a Plot3D file and the blocks of a grid.

A file contains, block by block, all x, all y, all z and all IBLANK, each with i running fastest (with records per
plane: the same for each k in turn). A grid stores x, y, z together, with k running fastest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, FloatArray, Grid, Shape
from meshdeform_core.parallel import empty

from ..coordinates import merge, split
from ..planes import Stored, Stretches
from .detect import Reading
from .variant import Variant


class Numbers(Protocol):
    """The numbers after the header of a text, in sequence."""

    def take(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """The next ``count`` numbers."""
        ...


def assemble(reading: Reading, path: Path, numbers: Numbers) -> Grid:
    """Make the grid of a reading from the numbers of a text."""
    variant = reading.variant
    grid, flags = allocate(reading, path)

    def put(index: int) -> None:
        _read_block(numbers, variant, grid.block(index), flags[index] if flags else None)

    grid.fill(put)
    return grid


def allocate(reading: Reading, path: Path) -> tuple[Grid, list[NDArray[Any]]]:
    """The grid of a reading, still to be filled, and the IBLANK values of the planes i of every block that this rank
    holds, if there are any."""
    grid = Grid.allocate(reading.shapes, format=reading.variant.file_format(), path=path)
    if not reading.variant.iblank:
        return grid, []
    flags = [empty(grid.own_shape(block, shape), np.int32) for block, shape in enumerate(grid.shapes)]
    values = (grid.spread(own, shape[0]) for own, shape in zip(flags, grid.shapes, strict=True))
    fields = tuple(Field("iblank", "node", block, each) for block, each in enumerate(values))
    return replace(grid, fields=fields), flags


def places_of(
    variant: Variant, shapes: Sequence[Shape], path: Path, data: Stretches
) -> tuple[list[list[Stored]], list[Stored]]:
    """Positions of the components and, with IBLANK, of the flags of every block within the ``data`` of a file."""
    coordinates: list[list[Stored]] = []
    flags, begin = [], 0
    for ni, nj, nk in shapes:
        planes = 1 if variant.records == "plane" else nk
        step = ni * nj * variant.real.itemsize
        last = begin + variant.dimension * planes * step
        end = last + variant.iblank * planes * ni * nj * variant.integer.itemsize
        whole = end - begin if variant.records == "plane" else 0
        coordinates.append(
            [
                Stored(path, variant.real, (nj, ni), begin + axis * planes * step, whole or step, data)
                for axis in range(variant.dimension)
            ]
        )
        flags.append(Stored(path, variant.integer, (nj, ni), last, whole or ni * nj * variant.integer.itemsize, data))
        begin += (end - begin) * (nk // planes)
    return coordinates, flags if variant.iblank else []


def _read_block(numbers: Numbers, variant: Variant, block: FloatArray, iblank: NDArray[Any] | None) -> None:
    count = math.prod(block.shape[:3])
    merge(block, (numbers.take(variant.real, count) for _ in range(variant.dimension)), variant.dimension)
    if iblank is not None:
        iblank[...] = numbers.take(variant.integer, count).reshape(iblank.shape[::-1]).T
    block[..., variant.dimension :] = 0.0


def text_arrays(grid: Grid, variant: Variant, index: int) -> Iterator[NDArray[Any]]:
    """The flat arrays of one block in the order and types of a text."""
    for array in split(grid.block(index), variant.real, variant.dimension):
        yield array.reshape(-1)
    if variant.iblank:
        iblank = iblank_of(grid, index)
        flags = np.ones(grid.shapes[index]) if iblank is None else iblank.values
        yield np.ascontiguousarray(flags.T, variant.integer).reshape(-1)


def iblank_of(grid: Grid, index: int) -> Field | None:
    """IBLANK values of a block from any format."""
    return next((field for field in grid.fields if field.block == index and field.blanks), None)
