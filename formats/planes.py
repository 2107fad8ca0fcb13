"""Arrays stored uncompressed in a file, of which every thread and rank reads and writes its own ranges of planes.

Most formats store the values of a block with k running slowest, so that a range of planes k is one stretch of bytes,
and coordinates component after component. A grid holds x, y and z of a node together, with k running fastest:
converting a component at a time would load every cache line three times, so a few lines along j are converted at a
time, which stay in the cache between uses.
"""

from __future__ import annotations

import dataclasses
import math
import os
from bisect import bisect_right
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray, Planes, Shape
from meshdeform_core.parallel import for_chunks, for_items

# Smallest numbers of nodes and planes per range, so that reads are large and cache lines of the grid are not split.
_NODES, _PLANES = 1 << 18, 8
# Larger blocks are converted component by component, without a copy of the block.
_TOGETHER = 1 << 28
_LINES = 8


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
    """An array (nk, nj, ni) of a block in a file, or (nk, nj, ni, n_components).

    Attributes
    ----------
    plane : (nj, ni), or (nj, ni, n_components)
    start : first byte of plane k = 0, counted in ``within``
    step : bytes from one plane to the next
    within : the bytes of the file to which offsets refer; ``None``: all
    core : the lines j and nodes i of a plane that belong to the grid; ``None``: all
    size : bytes that the file has for all planes of the block; ``None``: what is written follows from the same numbers
    """

    path: Path
    dtype: np.dtype[Any]
    plane: tuple[int, ...]
    start: int
    step: int
    within: Stretches | None = None
    core: tuple[slice, slice] | None = None
    size: int | None = None

    @classmethod
    def within_rind(
        cls,
        path: Path,
        dtype: np.dtype[Any],
        dims: Sequence[int],
        at: int,
        own: Sequence[slice] | None = None,
        size: int | None = None,
    ) -> Stored:
        """An array of ``dims`` (ni, nj, nk) or (ni, nj) from byte ``at`` on, of which the ``own`` ranges count, by
        default all. ``size`` are the bytes that the file has for all of it."""
        ni, nj = dims[:2]
        own = own or [slice(0, n) for n in dims]
        step = ni * nj * dtype.itemsize
        core = None if (own[0].stop - own[0].start, own[1].stop - own[1].start) == (ni, nj) else (own[1], own[0])
        if size is not None:
            size -= sum(n - (each.stop - each.start) for n, each in zip(dims[2:], own[2:], strict=True)) * step
        return cls(path, dtype, (nj, ni), at + sum(each.start for each in own[2:]) * step, step, core=core, size=size)

    def read(self, first: int, last: int) -> NDArray[Any]:
        """The planes first <= k < last."""
        values = np.empty((last - first, *self.plane), self.dtype)
        try:
            with self.path.open("rb", buffering=0) as file:
                for at, part in self._parts(first, values):
                    file.seek(at)
                    while part:
                        done = file.readinto(part)
                        if not done:
                            raise FormatError(
                                f"{self.path} ends before all of its coordinates: it was cut while it was read"
                            )
                        part = part[done:]
        except OSError as error:
            raise FormatError(f"cannot read {self.path}: {error.strerror or error}") from error
        return values[:, *self.core] if self.core else values

    def write(self, first: int, values: NDArray[Any], synchronous: bool = False) -> None:
        """Write planes (n, *plane) from k = ``first`` on into the file, which the first rank has created."""
        stored = np.ascontiguousarray(values, self.dtype)
        if self.core:
            around = dataclasses.replace(self, core=None).read(first, first + len(values))
            around[:, *self.core] = stored
            stored = around
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


@dataclass(frozen=True)
class Output:
    """Values of a block on their way into arrays of a file.

    Attributes
    ----------
    shape : of all values in the block, those of other ranks included
    places : the arrays, of one type
    take : the planes first <= k < last that this rank holds, as arrays (nk, nj, ni, ...), one for each place
    """

    block: int
    shape: Shape
    places: Sequence[Stored]
    take: Callable[[int, int], Iterable[NDArray[Any]]]

    @classmethod
    def of_coordinates(cls, grid: Grid, block: int, places: Sequence[Stored]) -> Output:
        """Coordinates, component by component."""
        kind = common_type(places)

        def take_component(first: int, last: int) -> Iterable[NDArray[Any]]:
            return split(grid.in_planes(block)[:, :, first:last], kind, len(places))

        return cls(block, grid.shapes[block], places, take_component)

    @classmethod
    def of_values(cls, block: int, shape: Shape, own: NDArray[Any], places: Sequence[Stored]) -> Output:
        """Values ``own`` (ni, nj, nk, ...) that this rank holds: into one array, or component by component."""

        def take_component(first: int, last: int) -> Iterable[NDArray[Any]]:
            planes = own[:, :, first:last].swapaxes(0, 2)
            if len(places) == 1:
                return [planes.reshape(*planes.shape[:3], *places[0].plane[2:])]
            flat = planes.reshape(*planes.shape[:3], len(places))
            return (flat[..., component] for component in range(len(places)))

        return cls(block, shape, places, take_component)


def common_type(stored: Iterable[Any]) -> np.dtype[Any]:
    """The native type of numbers that holds those of all ``stored`` arrays or datasets."""
    return np.result_type(*(each.dtype.newbyteorder("=") for each in stored))


def split(block: FloatArray, kind: np.dtype[Any], count: int = 3) -> Iterator[NDArray[Any]]:
    """The first ``count`` components (nk, nj, ni) of a block (ni, nj, nk, 3), of type ``kind``."""
    for axes in _groups(block, count):
        out = np.empty((axes.stop - axes.start, *block.shape[2::-1]), kind)

        def work(lo: int, hi: int, out: NDArray[Any] = out, axes: slice = axes) -> None:
            out[:, :, lo:hi] = block[:, lo:hi, :, axes].T

        for_chunks(work, block.shape[1], _LINES)
        yield from out


def merge(block: FloatArray, components: Iterator[NDArray[Any]], count: int = 3) -> None:
    """Fill the first ``count`` components of a block (ni, nj, nk, 3) from arrays of nk nj ni numbers each."""
    for axes in _groups(block, count):
        arrays = [next(components).reshape(block.shape[2::-1]) for _ in range(axes.start, axes.stop)]

        def work(lo: int, hi: int, arrays: Sequence[NDArray[Any]] = arrays, first: int = axes.start) -> None:
            # NaN in the file is reported by the caller, not by a warning of the conversion.
            with np.errstate(invalid="ignore"):
                for axis, array in enumerate(arrays, first):
                    block[:, lo:hi, :, axis] = array[:, lo:hi].T

        for_chunks(work, block.shape[1], _LINES)


def _groups(block: FloatArray, count: int) -> list[slice]:
    if 8 * count * math.prod(block.shape[:3]) <= _TOGETHER:
        return [slice(0, count)]
    return [slice(axis, axis + 1) for axis in range(count)]


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


def write_outputs(grid: Grid, outputs: Sequence[Output]) -> None:
    """Write values to their places in files; all ranks together those of a grid in parts.

    Raises FormatError on all ranks, before anything is written, when values and the room for them differ in size.
    """
    for place, (ni, nj, nk) in ((place, output.shape) for output in outputs for place in output.places):
        plane = place.plane[:2] if place.core is None else tuple(part.stop - part.start for part in place.core)
        found, room = f"a plane has {ni} x {nj} values", f"{plane[1]} x {plane[0]}"
        if plane == (nj, ni):
            found, room = f"a block has {ni} x {nj} x {nk} values of {nk * place.step} bytes", f"{place.size} bytes"
            if place.size is None or nk * place.step == place.size:
                continue
        raise FormatError(f"cannot write {place.path}: {found}; the file has room for {room}")
    if grid.nodes.divided:
        _write_parts(grid, outputs)
        return

    parts = [(output, part) for output in outputs for part in ranges_of([(output.block, output.shape)])]

    def put(number: int) -> None:
        output, part = parts[number]
        for place, values in zip(output.places, output.take(part.first, part.last), strict=True):
            place.write(part.first, values)

    for_items(put, len(parts))


def _write_parts(grid: Grid, outputs: Sequence[Output]) -> None:
    """As :func:`write_outputs`, for a grid in parts: ranks that share a block exchange their parts of k planes."""
    ranks, failures = grid.nodes.ranks, list[Exception]()
    for turn in _turns(grid, grid.nodes.bounds, outputs):
        sends, receives, own = {}, {}, None
        for writer, (output, part, owners) in turn.items():
            kind, lines = common_type(output.places), (output.shape[1], *output.places[0].plane[1:])
            if ranks.number in owners:
                sends[writer] = np.stack([each.astype(kind) for each in output.take(part.first, part.last)])
            if writer == ranks.number:
                stack = len(output.places), part.last - part.first, lines[0]
                receives = {rank: np.empty((*stack, width, *lines[2:]), kind) for rank, width in owners.items()}
                own = part, output.places
        if own:
            receives[ranks.number] = sends.pop(ranks.number)
        ranks.swap(sends, {rank: values for rank, values in receives.items() if rank != ranks.number})
        if own and not failures:
            part, places = own
            try:
                for component, place in enumerate(places):
                    values = np.concatenate([receives[rank][component] for rank in sorted(receives)], axis=2)
                    # Clients of a network file system may otherwise write whole pages, with old bytes of other machines
                    # in them.
                    place.write(part.first, values, ranks.on_several_machines)
            except (OSError, FormatError) as error:
                failures.append(error)
    for failure in ranks.gather(failures):
        raise failure


Turn = dict[int, tuple[Output, Planes, dict[int, int]]]
"""For each writing rank: values, a range of their k planes, and the ranks that hold them with the number of i planes
of each."""


def _turns(grid: Grid, bounds: IntArray, outputs: Iterable[Output]) -> list[Turn]:
    """What is written at one time, one after the other."""
    queues: dict[int, list[tuple[Output, Planes, dict[int, int]]]] = {}
    for output in outputs:
        _, nj, nk = grid.shapes[output.block]
        ends = np.clip((bounds - grid.offsets[output.block]) // (nj * nk), 0, output.shape[0])
        # The ranks that hold some of the planes i of the block, and how many each.
        owners = {rank: width for rank, width in enumerate(np.diff(ends).tolist()) if width}
        for number, part in enumerate(ranges_of([(output.block, output.shape)])):
            queues.setdefault(list(owners)[number % len(owners)], []).append((output, part, owners))
    most = max((len(queue) for queue in queues.values()), default=0)
    return [{rank: queue[n] for rank, queue in queues.items() if n < len(queue)} for n in range(most)]
