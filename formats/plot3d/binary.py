"""Plot3D in binary: C streams and Fortran unformatted records.

A file contains, block by block, all x, all y, all z and all IBLANK, each with i running fastest (with records per
plane: the same for each k in turn). A grid stores x, y, z together, with k running fastest.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain, product
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, Grid, Planes, Shape
from meshdeform_core.parallel import empty

from ..planes import Output, Stored, Stretches, ranges_of, read_planes, write_outputs
from .detect import LONGEST_HEADER, Reading, UnknownFile, choose, header_variants, stream_readings
from .records import fortran_readings, laid_out, record_lengths
from .variant import Variant


def read_binary(path: Path, options: Mapping[str, Any]) -> Grid:
    """Read a binary Plot3D file of any variant that ``options`` allow."""

    def load(reading: Reading) -> Grid:
        return _load(reading, path)

    with path.open("rb") as stream:
        return choose(_readings(stream), UnknownFile(path, path.stat().st_size, "bytes", options, load))


def binary_layout(path: Path, options: Mapping[str, Any]) -> Reading | None:
    """The only reading of a file that its size and ``options`` allow, if there is one."""
    with path.open("rb") as stream:
        size = path.stat().st_size
        fitting = [each for each in _readings(stream) if each.variant.matches(options) and each.agrees(size)]
    return fitting[0] if len(fitting) == 1 else None


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


def _load(reading: Reading, path: Path) -> Grid:
    grid, flags = allocate(reading, path)
    places, flag_places = places_of(reading.variant, grid.shapes, path, Stretches(reading.segments))

    def put(part: Planes) -> None:
        read_planes(grid, part, places[part.block])
        for array in flags[part.block : part.block + 1]:
            values = flag_places[part.block].read(part.first, part.last)[:, :, grid.planes(part.block)]
            array[:, :, part.first : part.last] = values.T

    grid.fill_planes(put, ranges_of(list(enumerate(grid.shapes))))
    return grid


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


def write_binary(grid: Grid, path: Path, variant: Variant) -> None:
    """Write all blocks to the file ``path`` as a C stream or as Fortran records; all ranks share the work."""
    sizes = np.array([shape[: variant.dimension] for shape in grid.shapes], variant.integer).reshape(-1)
    header = [np.array([grid.n_blocks], variant.integer)] * variant.multiblock + [sizes]
    lengths = [array.nbytes for array in header]
    lengths += [length for shape in grid.shapes for length in record_lengths(variant, shape)]
    markers, records = laid_out(lengths, variant)

    def begin() -> None:
        with path.open("wb") as stream:
            for at, data in markers:
                stream.seek(at)
                stream.write(data)
            for array, stretches in zip(header, records, strict=False):
                data = array.tobytes()
                for at, length in stretches:
                    stream.seek(at)
                    stream.write(data[:length])
                    data = data[length:]
            # The data come later; the last marker of a Fortran file is behind them.
            if not markers:
                stream.truncate(sum(records[-1][-1]))

    grid.nodes.on_first(begin)
    data = Stretches(list(chain.from_iterable(records[len(header) :])))
    places, flag_places = places_of(variant, grid.shapes, path, data)
    outputs = [Output.of_coordinates(grid, block, arrays) for block, arrays in enumerate(places)]
    for block, place in enumerate(flag_places):
        shape, field = grid.shapes[block], iblank_of(grid, block)
        # All 1 where the block has none.
        own = np.broadcast_to(np.ones((), place.dtype), grid.own_shape(block, shape)) if field is None else field.own
        outputs.append(Output.of_values(block, shape, own, [place]))
    write_outputs(grid, outputs)


def iblank_of(grid: Grid, index: int) -> Field | None:
    """IBLANK values of a block from any format."""
    return next((field for field in grid.fields if field.block == index and field.blanks), None)


def _readings(stream: BinaryIO) -> list[Reading]:
    readings = list(fortran_readings(stream))
    # A header in proper records cannot be a coincidence, but a stream of matching size can.
    return readings if any(reading.evidence >= (1, 2) for reading in readings) else [*readings, *_c_readings(stream)]


def _c_readings(stream: BinaryIO) -> Iterator[Reading]:
    for byte_order, precision in product(("little", "big"), ("float64", "float32")):
        variants = list(header_variants(encoding="binary", byte_order=byte_order, precision=precision))
        stream.seek(0)
        head = stream.read(4 * LONGEST_HEADER)
        integers = np.frombuffer(head, variants[0].integer, count=len(head) // 4).astype(np.int64)
        yield from stream_readings(variants, integers, os.fstat(stream.fileno()).st_size)
