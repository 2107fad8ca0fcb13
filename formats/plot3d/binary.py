"""Plot3D in binary: C streams and Fortran unformatted records."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from io import BufferedReader
from itertools import chain, product
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Grid

from ..coordinates import ahead
from .blocks import assemble, file_arrays
from .detect import LONGEST_HEADER, Reading, UnknownFile, choose, header_variants, stream_readings
from .records import fortran_readings, record_lengths, write_record
from .variant import Variant


def read_binary(path: Path, options: Mapping[str, Any]) -> Grid:
    """Read a binary Plot3D file of any variant that ``options`` allow."""
    with path.open("rb") as stream:

        def load(reading: Reading) -> Grid:
            return assemble(reading, path, _Data(stream, reading.segments))

        readings = list(fortran_readings(stream))
        # A header in proper records is no coincidence; a stream of matching size can be.
        if all(reading.evidence < (1, 2) for reading in readings):
            readings += _c_readings(stream)
        return choose(readings, UnknownFile(path, path.stat().st_size, "bytes", options, load))


def write_binary(grid: Grid, stream: BinaryIO, variant: Variant) -> None:
    """Write all blocks as a C stream or as Fortran records."""
    sizes = np.array([shape[: variant.dimension] for shape in grid.shapes], variant.integer).reshape(-1)
    header = [np.array([grid.n_blocks], variant.integer)] * variant.multiblock + [sizes]
    for array in header:
        _write(stream, iter([array]), [array.nbytes], variant)
    blocks = (file_arrays(grid, variant, index) for index in range(grid.n_blocks))
    lengths = [length for shape in grid.shapes for length in record_lengths(variant, shape)]
    _write(stream, ahead(chain.from_iterable(blocks)), lengths, variant)


def _write(stream: BinaryIO, arrays: Iterator[NDArray[Any]], lengths: list[int], variant: Variant) -> None:
    if variant.encoding == "binary":
        for array in arrays:
            stream.write(array.view(np.uint8).data)
    else:
        for length in lengths:
            write_record(stream, arrays, length, variant)


def _c_readings(stream: BinaryIO) -> Iterator[Reading]:
    for byte_order, precision in product(("little", "big"), ("float64", "float32")):
        variants = list(header_variants(encoding="binary", byte_order=byte_order, precision=precision))
        stream.seek(0)
        head = stream.read(4 * LONGEST_HEADER)
        integers = np.frombuffer(head, variants[0].integer, count=len(head) // 4).astype(np.int64)
        yield from stream_readings(variants, integers, os.fstat(stream.fileno()).st_size)


class _Data:
    """The data after the header, read in sequence across record boundaries."""

    def __init__(self, stream: BufferedReader, segments: tuple[tuple[int, int], ...]) -> None:
        self._stream = stream
        self._segments = iter(segments)
        self._left = 0

    def take(self, dtype: np.dtype[Any], count: int) -> NDArray[Any]:
        """The next ``count`` numbers."""
        array = np.empty(count, dtype)
        missing = array.view(np.uint8).data
        while missing:
            self._reach_data()
            done = self._stream.readinto(missing[: self._left])
            missing, self._left = missing[done:], self._left - done
        return array

    def skip(self, dtype: np.dtype[Any], count: int) -> None:
        """Skip the next ``count`` numbers."""
        missing = dtype.itemsize * count
        while missing:
            self._reach_data()
            step = min(missing, self._left)
            self._stream.seek(step, os.SEEK_CUR)
            missing, self._left = missing - step, self._left - step

    def _reach_data(self) -> None:
        if not self._left:
            offset, self._left = next(self._segments)
            self._stream.seek(offset)
