"""Conversion between the arrays of a Plot3D file and the blocks of a grid.

A file contains, block by block, all x, all y, all z and all IBLANK, each with i running fastest (with records per
plane: the same for each k in turn). A grid stores x, y, z together, with k running fastest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, FloatArray, Grid, Shape
from meshdeform_core.parallel import empty

from ..coordinates import merge, split
from .detect import Reading
from .variant import Variant

IBLANK = "iblank"


class Numbers(Protocol):
    """The numbers after the header of a file, in sequence."""

    def take(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """The next ``count`` numbers."""
        ...

    def skip(self, dtype: np.dtype[Any], count: int) -> None:
        """Skip the next ``count`` numbers."""
        ...


def assemble(reading: Reading, path: Path, numbers: Numbers) -> Grid:
    """Make the grid of a reading from the numbers of its file."""
    variant = reading.variant
    grid = Grid.allocate(reading.shapes, format=variant.file_format(), path=path)
    flags = empty([grid.n_nodes if variant.iblank else 0], np.int32)
    ahead = iter(range(grid.n_blocks))

    def put(index: int) -> None:
        # Blocks that other processes read.
        while (skipped := next(ahead)) != index:
            numbers.skip(variant.real, variant.dimension * math.prod(grid.shapes[skipped]))
            numbers.skip(variant.integer, variant.iblank * math.prod(grid.shapes[skipped]))
        _read_block(numbers, variant, grid.block(index), grid.block(index, flags) if variant.iblank else None)

    grid.fill(put, *([flags] if variant.iblank else []))
    if not variant.iblank:
        return grid
    return replace(grid, fields=tuple(Field(IBLANK, "node", b, grid.block(b, flags)) for b in range(grid.n_blocks)))


def _read_block(numbers: Numbers, variant: Variant, block: FloatArray, iblank: NDArray[Any] | None) -> None:
    for planes in _slabs(variant, block.shape[:3]):
        part = block[:, :, planes]
        ni, nj, nk = part.shape[:3]
        merge(part, (numbers.take(variant.real, ni * nj * nk) for _ in range(variant.dimension)), variant.dimension)
        if iblank is not None:
            iblank[:, :, planes] = numbers.take(variant.integer, ni * nj * nk).reshape(nk, nj, ni).T
    block[..., variant.dimension :] = 0.0


def file_arrays(grid: Grid, variant: Variant, index: int) -> Iterator[NDArray[Any]]:
    """The flat arrays of one block in the order and types of the file."""
    block, shape = grid.block(index), grid.shapes[index]
    iblank = iblank_of(grid, index)
    for planes in _slabs(variant, shape):
        for array in split(block[:, :, planes], variant.real, variant.dimension):
            yield array.reshape(-1)
        if variant.iblank:
            flags = np.ones(shape) if iblank is None else iblank
            yield np.ascontiguousarray(flags[:, :, planes].T, variant.integer).reshape(-1)


def iblank_of(grid: Grid, index: int) -> NDArray[Any] | None:
    """IBLANK values (ni, nj, nk) of a block from any format."""
    found = (f.values for f in grid.fields if f.block == index and f.location == "node" and f.name.lower() == IBLANK)
    return next(found, None)


def _slabs(variant: Variant, shape: Shape) -> list[slice]:
    """Ranges of k that follow one another in the file."""
    return [slice(k, k + 1) for k in range(shape[2])] if variant.records == "plane" else [slice(0, shape[2])]
