"""From the arrays of a Plot3D file to the blocks of a grid, and back.

A file holds, block after block, all x, all y, all z and all IBLANK, each with i running fastest (records of one plane:
the same for one k after the other). A grid holds x, y, z together with k running fastest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, Grid, Shape

from .plot3d_detect import Reading
from .plot3d_variant import Variant

IBLANK = "iblank"

Take = Callable[[np.dtype[Any], int], NDArray[Any]]


def assemble(reading: Reading, path: Path, take: Take) -> Grid:
    """Make the grid of a reading; ``take(dtype, count)`` gives the next numbers of the file."""
    variant = reading.variant
    grid = Grid.allocate(reading.shapes, format=variant.file_format(), path=path)
    fields = []
    for index, shape in enumerate(reading.shapes):
        block, iblank = grid.block(index), np.empty(shape, np.int32)
        for planes in _slabs(variant, shape):
            part = block[:, :, planes]
            ni, nj, nk = part.shape[:3]
            # What is no number in the file is reported by the caller, not by a warning of the conversion.
            with np.errstate(invalid="ignore"):
                for axis in range(variant.dimension):
                    part[..., axis] = take(variant.real, ni * nj * nk).reshape(nk, nj, ni).T
            if variant.iblank:
                iblank[:, :, planes] = take(variant.integer, ni * nj * nk).reshape(nk, nj, ni).T
        block[..., variant.dimension :] = 0.0
        fields += [Field(IBLANK, "node", index, iblank)] if variant.iblank else []
    return replace(grid, fields=tuple(fields))


def file_arrays(grid: Grid, variant: Variant, index: int) -> Iterator[NDArray[Any]]:
    """The flat arrays of one block in the order and types of the file."""
    block, shape = grid.block(index), grid.shapes[index]
    iblank = iblank_of(grid, index)
    for planes in _slabs(variant, shape):
        for axis in range(variant.dimension):
            yield np.ascontiguousarray(block[:, :, planes, axis].T, variant.real).reshape(-1)
        if variant.iblank:
            flags = np.ones(shape) if iblank is None else iblank
            yield np.ascontiguousarray(flags[:, :, planes].T, variant.integer).reshape(-1)


def iblank_of(grid: Grid, index: int) -> NDArray[Any] | None:
    """IBLANK values (ni, nj, nk) that a block carries, from whatever format it came."""
    found = (f.values for f in grid.fields if f.block == index and f.location == "node" and f.name.lower() == IBLANK)
    return next(found, None)


def _slabs(variant: Variant, shape: Shape) -> list[slice]:
    """Ranges of k that follow one another in the file."""
    return [slice(k, k + 1) for k in range(shape[2])] if variant.records == "plane" else [slice(0, shape[2])]
