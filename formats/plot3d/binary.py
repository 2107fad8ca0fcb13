"""Plot3D in binary: C streams and Fortran unformatted records.

A file contains, block by block, all x, all y, all z and all IBLANK, each with i running fastest (with records per
plane: the same for each k in turn). A grid stores x, y, z together, with k running fastest.

Records lie between byte counts (markers) of 4 or 8 bytes. A record too long for a signed 4-byte marker is split into
subrecords: the marker before a subrecord is negative when another one follows, the marker after it when another one
precedes (gfortran and Intel Fortran agree on this).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import accumulate, chain, product, takewhile
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, Grid, Planes, Shape
from meshdeform_core.parallel import ONE_PROCESS, Ranks, empty

from ..planes import Output, Stored, Stretches, ranges_of, read_planes, write_outputs
from .variant import (
    ABSURD,
    LONGEST_HEADER,
    MOST_BLOCKS,
    Reading,
    UnknownFile,
    Variant,
    choose,
    header_shapes,
    header_variants,
    stream_readings,
)


def read_binary(path: Path, options: Mapping[str, Any], ranks: Ranks) -> Grid:
    """Read a binary Plot3D file of any variant that ``options`` allow; on all ranks."""

    def load(reading: Reading) -> Grid:
        grid, flags = allocate(reading, path, ranks)
        places, flag_places = places_of(reading.variant, grid.shapes, path, Stretches(reading.segments))

        def put(part: Planes) -> None:
            read_planes(grid, part, places[part.block])
            for array in flags[part.block : part.block + 1]:
                values = flag_places[part.block].read(part.first, part.last)[:, :, grid.planes(part.block)]
                array[:, :, part.first : part.last] = values.T

        grid.fill_planes(put, ranges_of(list(enumerate(grid.shapes))))
        return grid

    with path.open("rb") as stream:
        return choose(_readings(stream), UnknownFile(path, path.stat().st_size, "bytes", options, load))


def binary_layout(path: Path, options: Mapping[str, Any]) -> Reading | None:
    """The only reading of a file that its size and ``options`` allow, if there is one."""
    with path.open("rb") as stream:
        size = path.stat().st_size
        fitting = [each for each in _readings(stream) if each.variant.matches(options) and each.agrees(size)]
    return fitting[0] if len(fitting) == 1 else None


def allocate(reading: Reading, path: Path, ranks: Ranks = ONE_PROCESS) -> tuple[Grid, list[NDArray[Any]]]:
    """The grid of a reading, still to be filled, and the IBLANK values of the planes i of every block that this rank
    holds, if there are any."""
    grid = Grid.allocate(reading.shapes, None, ranks, format=reading.variant.file_format(), path=path)
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

    grid.nodes.ranks.on_first(begin)
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
    if any(reading.evidence >= (1, 2) for reading in readings):
        return readings
    for byte_order, precision in product(("little", "big"), ("float64", "float32")):
        variants = list(header_variants(encoding="binary", byte_order=byte_order, precision=precision))
        stream.seek(0)
        head = stream.read(4 * LONGEST_HEADER)
        integers = np.frombuffer(head, variants[0].integer, count=len(head) // 4).astype(np.int64)
        readings += stream_readings(variants, integers, os.fstat(stream.fileno()).st_size)
    return readings


# Bytes in the largest subrecord that gfortran and Intel Fortran write.
LONGEST_SUBRECORD = 2**31 - 9

Record = tuple[tuple[int, int], ...]
"""One logical record: the (offset, length) of its data, more than one pair if it has subrecords."""


def walk_records(stream: BinaryIO, variant: Variant) -> tuple[list[Record], str]:
    """The records of a file that may have the variant's byte order and markers, and the problem that ended the search
    before the end of the file."""
    size, width = os.fstat(stream.fileno()).st_size, variant.marker.itemsize
    records, segments, position = list[Record](), list[tuple[int, int]](), 0

    def marker(offset: int) -> int:
        stream.seek(offset)
        return int(np.frombuffer(stream.read(width).ljust(width, b"\0"), variant.marker)[0])

    while position < size:
        place, before = f"record {len(records) + 1} at byte {position}", marker(position)
        end = position + width + abs(before)
        if before == 0 or end + width > size:
            left = max(size - position - width, 0)
            return records, f"{place} declares {abs(before)} bytes of data and {left} follow"
        after = marker(end)
        if abs(after) != abs(before) or (after < 0) != bool(segments):
            return records, f"{place} has the marker {before} before its data and {after} after them"
        segments.append((position + width, abs(before)))
        position = end + width
        if before > 0:
            records.append(tuple(segments))
            segments = []
    return records, f"record {len(records) + 1} lacks its last subrecord" if segments else ""


def fortran_readings(stream: BinaryIO) -> Iterator[Reading]:
    """Readings of a file that begins with valid records of the size of a header."""
    size = os.fstat(stream.fileno()).st_size
    for byte_order, markers in product(("little", "big"), (4, 8)):
        base = Variant(byte_order=byte_order, markers=markers)
        records, problem = walk_records(stream, base)
        found = [sum(length for _, length in record) for record in records]
        if not found or found[0] not in (4, 8, 12):
            continue
        content = bytearray()
        for offset, length in chain.from_iterable(records[: 1 + MOST_BLOCKS]):
            stream.seek(offset)
            content += stream.read(min(length, 4 * LONGEST_HEADER - len(content)))
        integers = np.frombuffer(content, base.integer, count=len(content) // 4).astype(np.int64)
        ends, fits = list(accumulate(found[: 1 + MOST_BLOCKS])), False
        for header in header_variants(encoding="fortran", byte_order=byte_order, markers=markers):
            shapes = header_shapes(integers, header.multiblock, header.dimension, size)
            length = 4 * (int(header.multiblock) + header.dimension * len(shapes or ()))
            # The block sizes may be in one record or in several.
            if not shapes or ends[0] != (4 if header.multiblock else length) or length not in ends:
                continue
            fits, used, planes = True, ends.index(length) + 1, sum(nk for _, _, nk in shapes)
            for precision, per in product(("float64", "float32"), ("block", "array", "plane")):
                # Blocks of one plane have the same records in both forms.
                if per != "plane" or len(shapes) < planes <= ABSURD * len(found):
                    variant = replace(header, precision=precision, records=per)
                    expected = found[:used] + [length for shape in shapes for length in record_lengths(variant, shape)]
                    good, defect = _agreement(found, expected, problem)
                    marks = 2 * variant.marker.itemsize
                    needed = (length + marks * math.ceil(length / _longest(variant)) for length in expected)
                    segments = tuple(chain.from_iterable(records[used:]))
                    yield Reading(variant, shapes, sum(needed) if defect else size, segments, (1, good), defect)
        if not fits:
            defect = f"its header {integers[:9].tolist()} is not a block count with sizes that fill whole records"
            yield Reading(base, (), size, (), (1, 0), defect)


def _agreement(found: Sequence[int], expected: Sequence[int], problem: str) -> tuple[int, str]:
    """How many of the first records hold as many bytes as expected, and the fault of the one after them."""
    good = len(list(takewhile(lambda pair: pair[0] == pair[1], zip(found, expected, strict=False))))
    if good < min(len(found), len(expected)):
        return good, f"record {good + 1} holds {found[good]} bytes where {expected[good]} are expected"
    if len(found) > len(expected):
        return good, f"record {len(expected) + 1} is surplus"
    return good, problem or (f"record {good + 1} is missing" if len(found) < len(expected) else "")


def record_lengths(variant: Variant, shape: Shape) -> list[int]:
    """Bytes of data in each record of one block."""
    real, integer = variant.real.itemsize, variant.integer.itemsize
    per_node = variant.dimension * real + variant.iblank * integer
    if variant.records == "array":
        return [real * math.prod(shape)] * variant.dimension + [integer * math.prod(shape)] * variant.iblank
    if variant.records == "plane":
        return [per_node * shape[0] * shape[1]] * shape[2]
    return [per_node * math.prod(shape)]


def _longest(variant: Variant) -> int:
    return LONGEST_SUBRECORD if variant.markers == 4 else sys.maxsize


def laid_out(lengths: Sequence[int], variant: Variant) -> tuple[list[tuple[int, bytes]], list[list[tuple[int, int]]]]:
    """Layout of a file whose records have data of these lengths; records of a C stream have no markers.

    Returns
    -------
    markers : offset and bytes of each marker
    records : (offset, length) of the stretches of data of each record
    """
    markers, records, at = [], [], 0
    width = variant.marker.itemsize if variant.encoding == "fortran" else 0
    for length in lengths:
        longest = _longest(variant) if width else max(length, 1)
        parts = [min(longest, length - start) for start in range(0, length, longest)]
        stretches = []
        for number, part in enumerate(parts, 1):
            stretches.append((at + width, part))
            if width:
                before, after = (part if one else -part for one in (number == len(parts), number == 1))
                markers.append((at, np.array(before, variant.marker).tobytes()))
                markers.append((at + width + part, np.array(after, variant.marker).tobytes()))
            at += part + 2 * width
        records.append(stretches)
    return markers, records
