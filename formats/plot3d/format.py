"""Plot3D grid files: every variant is recognised by content when reading and chosen by name when writing.

Sources: the PLOT3D manual (Walatka, Buning, Pierce, Elson, NASA TM-101067) for the contents of a file, the gfortran
manual ("File format of unformatted sequential files") for records.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, Grid, Shape
from meshdeform_core.grid.planes import block_extents
from meshdeform_core.numerics.arrays import extent
from meshdeform_core.parallel import ONE_PROCESS, Ranks

from ..files import checked_options, read_head, replacing_by_all
from .ascii import read_ascii, write_ascii
from .binary import binary_layout, iblank_of, read_binary, write_binary
from .variant import CHOICES, Variant

_TEXT_SUFFIXES = (".fmt", ".p2dfmt", ".p3dfmt")
_BINARY_SUFFIXES = (".p2dbin", ".p3dbin", ".bin")


def read(path: Path, ranks: Ranks = ONE_PROCESS, **options: Any) -> Grid:
    """Read a Plot3D grid of any variant, whatever its name; ``options`` (of :class:`.variant.Variant`) restrict what is
    considered.

    Blocks are ``(ni, nj, nk, 3)``, in 2-D files ``(ni, nj, 1, 3)`` with z = 0; IBLANK is the node field ``iblank``
    (int32).
    """
    path = Path(path)
    wanted = checked_options("Plot3D", options, CHOICES)
    # Every binary header has small integers with zero bytes, which no text has.
    if b"\0" in read_head(path):
        return read_binary(path, wanted, ranks)
    ranks.require_one(f"{path} is text")
    return read_ascii(path, wanted)


def layout(path: Path, **options: Any) -> tuple[tuple[Shape, ...], FileFormat] | None:
    """Block sizes of a binary file, without coordinates; ``None`` for text files, and if the size of the file does not
    determine the variant."""
    if b"\0" not in read_head(path):
        return None
    found = binary_layout(path, checked_options("Plot3D", options, CHOICES))
    return None if found is None else (found.shapes, found.variant.file_format())


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How to write ``grid``: the variant it was read from, else that of the suffix, changed by ``options``.

    The suffixes ``.fmt .p2dfmt .p3dfmt`` mean text and ``.p2dbin .p3dbin`` binary, whatever the grid was read from.
    A grid without a variant is written with Fortran records, little endian, float64, multi-block, and 3-D unless the
    suffix is ``.p2d ...``. IBLANK is written if the grid has it.
    """
    carries_iblank = any(iblank_of(grid, block) is not None for block in range(grid.n_blocks))
    suffix = Path(path).suffix.lower()
    if grid.format is not None and grid.format.name == "plot3d":
        usual = Variant.of(grid.format)
        usual = usual.changed({"iblank": usual.iblank or carries_iblank})
    else:
        usual = Variant().changed({"dimension": 2 if suffix.startswith(".p2d") else 3, "iblank": carries_iblank})
    if suffix in _TEXT_SUFFIXES:
        usual = usual.changed({"encoding": "ascii"})
    elif suffix in _BINARY_SUFFIXES and usual.encoding == "ascii":
        usual = usual.changed({"encoding": "fortran"})
    chosen = usual.changed(checked_options("Plot3D", options, CHOICES))
    _require_writable(grid, Path(path), chosen)
    return chosen.file_format()


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid`` in the given variant, replacing ``path`` as a whole or leaving it unchanged; on all ranks."""
    chosen = Variant.of(variant)
    _require_writable(grid, Path(path), chosen)
    with replacing_by_all(Path(path), grid.points) as partial:
        if chosen.encoding == "ascii":
            with partial.open("wb") as stream:
                write_ascii(grid, stream, chosen)
        else:
            write_binary(grid, partial, chosen)


def _require_writable(grid: Grid, path: Path, chosen: Variant) -> None:
    if not chosen.multiblock and grid.n_blocks > 1:
        raise FormatError(
            f"cannot write {path} without block count: the grid has {grid.n_blocks} blocks; use multiblock=true"
        )
    if max(max(shape) for shape in grid.shapes) >= 2**31:
        raise FormatError(f"cannot write {path}: a block has more than 2**31 - 1 nodes along an index")
    # Lowest and highest z of each block, which a grid in parts finds together.
    bottom, top = (ends[:, 2].tolist() for ends in block_extents(grid)) if chosen.dimension == 2 else ([], [])
    for index, (name, shape) in enumerate(zip(grid.names, grid.shapes, strict=True)):
        iblank = iblank_of(grid, index)
        if iblank is not None and iblank.values.shape != shape:
            raise FormatError(f"cannot write {path}: {name} has {shape} nodes but IBLANK values {iblank.values.shape}")
        if chosen.dimension == 2 and shape[2] != 1:
            raise FormatError(
                f"cannot write {path} as 2-D: {name} has {shape[0]}x{shape[1]}x{shape[2]} nodes, a 2-D file holds one "
                f"plane k = 1; use dimension=3"
            )
        if chosen.dimension == 2 and (bottom[index] or top[index]):
            raise FormatError(
                f"cannot write {path} as 2-D: {name} has z from {bottom[index]:g} to {top[index]:g}, which a 2-D file "
                f"cannot hold; use dimension=3"
            )
    if chosen.precision == "float32":
        low, high = extent(grid.points)
        largest = max(float(high.max()), -float(low.min()))
        if largest > float(np.finfo(np.float32).max):
            raise FormatError(f"cannot write {path} as float32: a coordinate is {largest:g}; use precision=float64")
    if chosen.encoding == "ascii":
        grid.nodes.require_whole(f"{path} is written as a whole")
