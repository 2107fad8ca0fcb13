"""Fortran unformatted records: byte counts (markers) of 4 or 8 bytes before and after the data.

A record too long for a signed 4-byte marker is split into subrecords: the marker before a subrecord is negative when
another one follows, the marker after it when another one precedes (gfortran and Intel Fortran agree on this).
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import accumulate, chain, product, takewhile
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Shape

from .detect import ABSURD, LONGEST_HEADER, MOST_BLOCKS, Reading, header_shapes
from .variant import Variant

# Bytes in the largest subrecord that gfortran and Intel Fortran write.
LONGEST_SUBRECORD = 2**31 - 9


Record = tuple[tuple[int, int], ...]
"""One logical record: the (offset, length) of its data, more than one pair if it has subrecords."""


@dataclass(frozen=True)
class Walk:
    """The records found in a file, and the problem that ended the search before the end of the file."""

    size: int
    records: list[Record]
    problem: str

    @property
    def lengths(self) -> list[int]:
        """Bytes of data in each record."""
        return [sum(length for _, length in record) for record in self.records]


def walk_records(stream: BinaryIO, variant: Variant) -> Walk:
    """Walk through a file that may consist of records with the variant's byte order and markers."""
    size, width = os.fstat(stream.fileno()).st_size, variant.marker.itemsize
    records: list[Record] = []
    segments: list[tuple[int, int]] = []
    position = 0
    while position < size:
        place = f"record {len(records) + 1} at byte {position}"
        before = _marker(stream, position, variant)
        end = position + width + abs(before)
        if before == 0 or end + width > size:
            left = max(size - position - width, 0)
            return Walk(size, records, f"{place} declares {abs(before)} bytes of data and {left} follow")
        after = _marker(stream, end, variant)
        if abs(after) != abs(before) or (after < 0) != bool(segments):
            return Walk(size, records, f"{place} has the marker {before} before its data and {after} after them")
        segments.append((position + width, abs(before)))
        position = end + width
        if before > 0:
            records.append(tuple(segments))
            segments = []
    return Walk(size, records, f"record {len(records) + 1} lacks its last subrecord" if segments else "")


def _marker(stream: BinaryIO, offset: int, variant: Variant) -> int:
    width = variant.marker.itemsize
    stream.seek(offset)
    return int(np.frombuffer(stream.read(width).ljust(width, b"\0"), variant.marker)[0])


def fortran_readings(stream: BinaryIO) -> Iterator[Reading]:
    """Readings of a file that begins with valid records of the size of a header."""
    for byte_order, markers in product(("little", "big"), (4, 8)):
        base = Variant(byte_order=byte_order, markers=markers)
        walk = walk_records(stream, base)
        if not walk.records or sum(length for _, length in walk.records[0]) not in (4, 8, 12):
            continue
        content = bytearray()
        for offset, length in chain.from_iterable(walk.records[: 1 + MOST_BLOCKS]):
            stream.seek(offset)
            content += stream.read(min(length, 4 * LONGEST_HEADER - len(content)))
        integers = np.frombuffer(content, base.integer, count=len(content) // 4).astype(np.int64)
        headers = list(_headers(base, walk, integers))
        for variant, shapes, used in headers:
            yield from _data_readings(variant, shapes, walk, used)
        if not headers:
            defect = f"its header {integers[:9].tolist()} is not a block count with sizes that fill whole records"
            yield Reading(base, (), walk.size, (), (1, 0), defect)


def _headers(
    base: Variant, walk: Walk, integers: NDArray[np.int64]
) -> Iterator[tuple[Variant, tuple[Shape, ...], int]]:
    """Variant, block shapes and number of header records; the block sizes may be in one record or in several."""
    ends = list(accumulate(walk.lengths[: 1 + MOST_BLOCKS]))
    for multiblock, dimension in product((True, False), (3, 2)):
        shapes = header_shapes(integers, multiblock, dimension, walk.size)
        length = 4 * (int(multiblock) + dimension * len(shapes or ()))
        if shapes and ends[0] == (4 if multiblock else length) and length in ends:
            yield replace(base, multiblock=multiblock, dimension=dimension), shapes, ends.index(length) + 1


def _data_readings(header: Variant, shapes: tuple[Shape, ...], walk: Walk, used: int) -> Iterator[Reading]:
    """All possible readings of the records after the ``used`` records of the header."""
    found, segments = walk.lengths, tuple(chain.from_iterable(walk.records[used:]))
    planes = sum(nk for _, _, nk in shapes)
    for precision, iblank, per in product(("float64", "float32"), (False, True), ("block", "array", "plane")):
        # Blocks of one plane have the same records in both forms.
        if per == "plane" and not len(shapes) < planes <= ABSURD * len(found):
            continue
        variant = replace(header, precision=precision, iblank=iblank, records=per)
        expected = found[:used] + [length for shape in shapes for length in record_lengths(variant, shape)]
        good = len(list(takewhile(lambda pair: pair[0] == pair[1], zip(found, expected, strict=False))))
        defect = _defect(found, expected, good, walk.problem)
        size = walk.size
        if defect:
            marks = 2 * variant.marker.itemsize
            size = sum(length + marks * math.ceil(length / _longest(variant)) for length in expected)
        yield Reading(variant, shapes, size, segments, (1, good), defect)


def _defect(found: list[int], expected: list[int], good: int, problem: str) -> str:
    """The fault of the first record after the good ones, if any."""
    if good < min(len(found), len(expected)):
        return f"record {good + 1} holds {found[good]} bytes where {expected[good]} are expected"
    if len(found) > len(expected):
        return f"record {len(expected) + 1} is surplus"
    return problem or (f"record {good + 1} is missing" if len(found) < len(expected) else "")


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
