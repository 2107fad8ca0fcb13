"""Arrays stored uncompressed in a file, of which every thread and rank reads and writes its own ranges of planes.

Most formats store the values of a block with k running slowest, so that a range of planes k is one stretch of bytes.
"""

from __future__ import annotations

import os
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, IntArray, Planes, Shape
from meshdeform_core.parallel import Part, for_items

from .coordinates import common_type, merge, split

# Smallest numbers of nodes and planes per range, so that reads are large and cache lines of the grid are not split.
_NODES, _PLANES = 1 << 18, 8


class Stretches:
    """Bytes stored in a file in one or more stretches, each given as (offset, length)."""

    def __init__(self, stretches: Sequence[tuple[int, int]]) -> None:
        self._offsets = [offset for offset, _ in stretches]
        self._ends = list(accumulate(length for _, length in stretches))

    def places(self, first: int, last: int) -> Iterator[tuple[int, int]]:
        """Offsets in the file and lengths of the bytes first <= n < last."""
        at = bisect_right(self._ends, first)
        while first < last:
            begin = self._ends[at - 1] if at else 0
            end = min(last, self._ends[at])
            yield self._offsets[at] + first - begin, end - first
            first, at = end, at + 1


@dataclass(frozen=True)
class Stored:
    """An array (nk, nj, ni) of a block in a file.

    Attributes
    ----------
    plane : (nj, ni)
    start : first byte of plane k = 0, counted in ``within``
    step : bytes from one plane to the next
    within : the bytes of the file to which offsets refer; ``None``: all
    """

    path: Path
    dtype: np.dtype[Any]
    plane: tuple[int, int]
    start: int
    step: int
    within: Stretches | None = None

    def read(self, first: int, last: int) -> NDArray[Any]:
        """The planes first <= k < last.

        Raises
        ------
        FormatError
            When the file ends before them or cannot be read.
        """
        values = np.empty((last - first, *self.plane), self.dtype)
        try:
            with self.path.open("rb", buffering=0) as file:
                for at, part in self._parts(first, values):
                    self._read(file, at, part)
        except OSError as error:
            raise FormatError(f"cannot read {self.path}: {error.strerror or error}") from error
        return values

    def _read(self, file: Any, at: int, part: memoryview) -> None:
        file.seek(at)
        while part:
            done = file.readinto(part)
            if not done:
                raise FormatError(f"{self.path} ends before all of its coordinates: it was cut while it was read")
            part = part[done:]

    def write(self, first: int, values: NDArray[Any], synchronous: bool = False) -> None:
        """Write planes (n, nj, ni) from k = ``first`` on into the file, which the first rank has created.

        Raises
        ------
        FormatError
            When the file does not exist for this process.
        """
        stored = np.ascontiguousarray(values, self.dtype)
        flags = os.O_WRONLY | getattr(os, "O_BINARY", 0) | (getattr(os, "O_DSYNC", 0) if synchronous else 0)
        try:
            number = os.open(self.path, flags)
        except FileNotFoundError as error:
            raise FormatError(
                f"a rank does not see {self.path}, to which all ranks write; choose an output folder that all machines "
                f"share"
            ) from error
        with open(number, "wb", buffering=0) as file:
            for at, part in self._parts(first, stored):
                file.seek(at)
                left = part
                while left:
                    left = left[file.write(left) :]

    def _parts(self, first: int, values: NDArray[Any]) -> Iterator[tuple[int, memoryview]]:
        """Offsets in the file, and the bytes at each, of planes from k = ``first`` on."""
        count, size = len(values), values[0].nbytes
        if self.step == size:
            count, size = 1, values.nbytes
        data = values.reshape(-1).view(np.uint8).data
        for number in range(count):
            begin, plane = (
                self.start + first * self.step + number * self.step,
                data[number * size : (number + 1) * size],
            )
            for at, length in self.within.places(begin, begin + size) if self.within else [(begin, size)]:
                yield at, plane[:length]
                plane = plane[length:]


def ranges_of(blocks: Sequence[tuple[int, Shape]]) -> list[Planes]:
    """Ranges of planes of blocks, given by number and shape; they do not depend on threads and ranks."""
    found = []
    for block, (ni, nj, nk) in blocks:
        step = max(_PLANES, _NODES // (ni * nj))
        found += [Planes(block, first, min(first + step, nk)) for first in range(0, nk, step)]
    return found


def read_planes(grid: Grid, part: Planes, arrays: Sequence[Stored]) -> None:
    """Fill planes of a block, as far as this rank holds them, from the arrays of its components; those that are missing
    become zero."""
    own = grid.planes(part.block)
    block = grid.in_planes(part.block)[:, :, part.first : part.last]
    merge(block, (array.read(part.first, part.last)[:, :, own] for array in arrays), len(arrays))
    block[..., len(arrays) :] = 0.0


def write_coordinates(grid: Grid, arrays: Mapping[int, Sequence[Stored]]) -> None:
    """Write the components of some blocks, by number, to their places in a file; all ranks together those of a grid in
    parts."""
    if isinstance(grid.points, Part):
        write_parts(grid, grid.points, arrays)
        return

    def put(part: Planes) -> None:
        places = arrays[part.block]
        kind = common_type(places)
        block = grid.block(part.block)[:, :, part.first : part.last]
        for place, values in zip(places, split(block, kind, len(places)), strict=True):
            place.write(part.first, values)

    for_ranges(put, [(block, grid.shapes[block]) for block in arrays])


def write_parts(grid: Grid, points: Part, arrays: Mapping[int, Sequence[Stored]]) -> None:
    """As :func:`write_coordinates`, for a grid in parts: ranks that share a block exchange their parts of k planes.

    Raises
    ------
    OSError, FormatError
        On all ranks, the first error of any of them.
    """
    ranks, failures = points.ranks, list[Exception]()
    # Clients of a network file system may otherwise write whole pages, with old bytes of other machines in them.
    synchronous = ranks.count > ranks.on_machine
    for turn in _turns(grid, points.bounds, arrays):
        sends, receives, own = {}, {}, None
        for writer, (part, owners) in turn.items():
            places = arrays[part.block]
            kind = common_type(places)
            if ranks.number in owners:
                block = grid.in_planes(part.block)[:, :, part.first : part.last]
                sends[writer] = np.stack(list(split(block, kind, len(places))))
            if writer == ranks.number:
                nj, planes = grid.shapes[part.block][1], part.last - part.first
                receives = {rank: np.empty((len(places), planes, nj, width), kind) for rank, width in owners.items()}
                own = part, places
        if own:
            receives[ranks.number] = sends.pop(ranks.number)
        ranks.swap(sends, {rank: values for rank, values in receives.items() if rank != ranks.number})
        if own and not failures:
            part, places = own
            try:
                for component, place in enumerate(places):
                    values = np.concatenate([receives[rank][component] for rank in sorted(receives)], axis=-1)
                    place.write(part.first, values, synchronous)
            except (OSError, FormatError) as error:
                failures.append(error)
    for failure in ranks.gather(failures):
        raise failure


def _turns(grid: Grid, bounds: IntArray, blocks: Iterable[int]) -> list[dict[int, tuple[Planes, dict[int, int]]]]:
    """Units of writing, one after the other: for each writing rank, a range of k planes of a block, and the ranks that
    hold parts of it, with the number of i planes of each."""
    queues: dict[int, list[tuple[Planes, dict[int, int]]]] = {}
    for block in blocks:
        ni, nj, nk = grid.shapes[block]
        ends = np.clip((bounds - grid.offsets[block]) // (nj * nk), 0, ni)
        owners = {rank: width for rank, width in enumerate(np.diff(ends).tolist()) if width}
        for number, part in enumerate(ranges_of([(block, (ni, nj, nk))])):
            queues.setdefault(list(owners)[number % len(owners)], []).append((part, owners))
    most = max((len(queue) for queue in queues.values()), default=0)
    return [{rank: queue[n] for rank, queue in queues.items() if n < len(queue)} for n in range(most)]


def for_ranges(put: Callable[[Planes], None], blocks: Sequence[tuple[int, Shape]]) -> None:
    """Call ``put`` for all ranges of planes of some blocks, spread over the threads."""
    parts = ranges_of(blocks)
    for_items(lambda number: put(parts[number]), len(parts), threads=None)
