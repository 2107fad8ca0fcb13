"""The contents of one VTK data set from any kind of file, and its conversion to a block of a grid.

VTK stores nodes with i fastest: a run of ``n`` values is ``(nk, nj, ni, ...)``. The grid has ``(ni, nj, nk, ...)``.
"""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import Field, FileFormat, Grid, Planes, Shape
from meshdeform_core.parallel import Ranks, empty

from ..planes import Output, Stored, ranges_of, write_outputs
from ..text import number_lines


@dataclass(frozen=True)
class Run:
    """Values that lie in a file as they are, from byte ``start`` on, and have not been read yet."""

    path: Path
    dtype: np.dtype[Any]
    start: int
    shape: tuple[int, ...]

    @property
    def ndim(self) -> int:
        return len(self.shape)

    def __len__(self) -> int:
        return self.shape[0]

    def reshape(self, *shape: int) -> Run:
        return Run(self.path, self.dtype, self.start, shape)

    @property
    def planes_in_file(self) -> Stored:
        """The values as planes k, of a run of the shape (nk, nj, ni, ...)."""
        step = math.prod(self.shape[1:]) * self.dtype.itemsize
        return Stored(self.path, self.dtype, self.shape[1:], self.start, step)


Values = NDArray[Any] | Run


class DataArray(NamedTuple):
    """A data array as VTK stores it.

    ``location`` is ``node``, ``cell`` or, in field data of the whole data set, which are not kept, empty; ``values`` is
    ``(n,)`` or ``(n, components)``, possibly still to be read.
    """

    name: str
    location: str
    values: Any


@dataclass(frozen=True)
class DataSet:
    """One structured data set as stored in a file.

    ``points`` is ``(nk, nj, ni, 3)`` in the file's own type and byte order; ``options`` are those of the file variant.
    """

    points: Values
    arrays: tuple[DataArray, ...]
    options: Mapping[str, str]
    notes: tuple[str, ...] = ()


def assemble(path: Path, kind: str, ranks: Ranks, data_sets: Sequence[DataSet], names: Sequence[str] = ()) -> Grid:
    """Make a grid of data sets; ``kind`` is the kind of file: ``legacy``, ``vts``, ``vtm``, ..."""
    file_format = FileFormat(
        name="vtk",
        precision="float32" if all(d.points.dtype.itemsize == 4 for d in data_sets) else "float64",
        options={"kind": kind, **data_sets[0].options},
    )
    shapes: list[Shape] = [(d.points.shape[2], d.points.shape[1], d.points.shape[0]) for d in data_sets]
    notes = tuple(note for d in data_sets for note in d.notes)
    try:
        grid = Grid.allocate(shapes, names or None, ranks, format=file_format, path=path, notes=notes)
    except GridError as error:
        raise GridError(f"{path}: {error}") from error
    # For each block, fields with room for the values of its arrays, and these along k, j, i.
    fields: list[list[tuple[Field, Any]]] = [[] for _ in shapes]
    for block, data_set in enumerate(data_sets):
        for array in (each for each in data_set.arrays if each.location):
            ni, nj, nk = grid.shapes[block] if array.location == "node" else grid.cell_shapes[block]
            if len(array.values) != ni * nj * nk:
                raise FormatError(
                    f"{path}: {array.location} array {array.name!r} has {len(array.values)} values; "
                    f"{ni} x {nj} x {nk} {array.location}s are expected"
                )
            components, stored = array.values.shape[1:], array.values.dtype.newbyteorder("=")
            room = empty((*grid.own_shape(block, (ni, nj, nk)), *components), stored)
            field = Field(array.name, array.location, block, grid.spread(room, ni))
            fields[block].append((field, array.values.reshape(nk, nj, ni, *components)))

    def put(part: Planes) -> None:
        """Fill some planes k of all arrays of a block, as far as this rank holds them, from values along k, j, i."""
        own, (block, first, last) = grid.planes(part.block), part
        pairs = [(field.own, values) for field, values in fields[block]]
        for target, values in [(grid.in_planes(block), data_sets[block].points), *pairs]:
            end = min(last, target.shape[2])
            if first < end:
                read = values.planes_in_file.read(first, end) if isinstance(values, Run) else values[first:end]
                target[:, :, first:end] = read[:, :, own.start : own.start + len(target)].swapaxes(0, 2)

    grid.fill_planes(put, ranges_of(list(enumerate(shapes))))
    return dataclasses.replace(grid, fields=tuple(field for found in fields for field, _ in found))


@dataclass(frozen=True, eq=False)
class StoredArray:
    """An array to be written to a file.

    Attributes
    ----------
    values : (nk, nj, ni) for nodes, cells and faces, of a grid in parts those in the planes i of this rank; with an
        additional axis for several components. A view of the grid's own memory
    shape : of the values on all ranks
    precision : type in which they are written
    """

    name: str
    location: str
    values: NDArray[Any]
    shape: tuple[int, ...]
    precision: np.dtype[Any]

    @property
    def components(self) -> int:
        return math.prod(self.shape[3:])

    @property
    def tuples(self) -> int:
        return math.prod(self.shape[:3])

    @property
    def nbytes(self) -> int:
        return self.tuples * self.components * self.precision.itemsize

    def output(self, block: int, path: Path, place: tuple[int, np.dtype[Any]]) -> Output:
        """The values, to be written from a byte of a file on, in a type of another byte order."""
        (start, kind), (nk, nj, ni) = place, self.shape[:3]
        rest = () if self.components == 1 else (self.components,)
        stored = Stored(path, kind, (nj, ni, *rest), start, ni * nj * self.components * kind.itemsize)
        return Output.of_values(block, (ni, nj, nk), self.values.swapaxes(0, 2), [stored])


Reserved = dict[int, tuple[int, np.dtype[Any]]]
"""First byte and type of arrays for which a file has room, by their number."""


class BlockOutput:
    """The file of a block being written: lines, and values as text, or room for those in a byte order, which all ranks
    write later."""

    def __init__(self, stream: BinaryIO, order: Literal["<", ">"], as_text: bool) -> None:
        self.stream, self.order, self.as_text = stream, order, as_text
        self._places: dict[StoredArray, tuple[int, np.dtype[Any]]] = {}

    def line(self, text: str) -> None:
        self.stream.write(f"{text}\n".encode())

    def values(self, array: StoredArray) -> None:
        """As text one per line; else only room."""
        if not self.as_text:
            self._places[array] = self.stream.tell(), array.precision.newbyteorder(self.order)
            self.stream.seek(array.nbytes, os.SEEK_CUR)
        for plane in array.values if self.as_text else ():
            # The writer of numbers knows no integers of 8 or 16 bits.
            kind = np.dtype(np.int64) if array.precision.itemsize < 4 else array.precision
            numbers = plane.astype(kind, order="C", copy=False).reshape(-1)
            lines = number_lines(numbers)
            if kind.kind == "f" and not np.isfinite(numbers).all():
                # VTK stumbles over longer words.
                lines = memoryview(bytes(lines).replace(b"Infinity", b"inf").replace(b"NaN", b"nan"))
            self.stream.write(lines)

    def reserved(self, contents: Sequence[StoredArray]) -> Reserved:
        """The places of those ``contents`` that have room."""
        return {number: self._places[one] for number, one in enumerate(contents) if one in self._places}


Begin = Callable[[Grid, int, Path, FileFormat, Sequence[StoredArray]], Reserved]


def write_blocks(grid: Grid, paths: Sequence[Path], variant: FileFormat, begin: Begin) -> None:
    """Write every block to its file: the first rank all but the values for which ``begin`` leaves room, then all ranks
    these.

    ``begin`` takes the arrays of a block, of which the first are the coordinates.
    """
    fields: list[list[Field]] = [[] for _ in grid.shapes]
    for field in grid.fields:
        fields[field.block].append(field)
    contents = [_arrays_to_write(grid, block, variant, own) for block, own in enumerate(fields)]

    def all_begun() -> list[Reserved]:
        return [begin(grid, block, paths[block], variant, arrays) for block, arrays in enumerate(contents)]

    outputs = [
        contents[block][number].output(block, paths[block], place)
        for block, places in enumerate(grid.nodes.ranks.on_first(all_begun))
        for number, place in places.items()
    ]
    write_outputs(grid, outputs)


def _arrays_to_write(grid: Grid, block: int, variant: FileFormat, fields: Sequence[Field]) -> list[StoredArray]:
    """Coordinates of a block and its arrays, the ``fields`` of the grid.

    Fields at faces become field data: ``NAME`` with the suffix I, J or K of the index axis across them.
    """
    found: dict[tuple[str, str], StoredArray] = {}
    for field in fields:
        label = f"{field.location} field {field.name!r} of {grid.names[block]}"
        values, whole = field.own.swapaxes(0, 2), (*field.values.shape[2::-1], *field.values.shape[3:])
        if field.location.endswith("face"):
            # VTK has no values at faces: one array for each index axis, i fastest like all others.
            name = f"{field.name}{field.location[0].upper()}"
            found["", name] = StoredArray(name, "", values, whole, storable_type(values, label))
            continue
        shape = grid.shapes[block] if field.location == "node" else grid.cell_shapes[block]
        if field.values.shape[:3] != shape or field.values.ndim > 4:
            raise FormatError(f"{label} has shape {field.values.shape}; expected {shape} and at most one more axis")
        if (field.location, field.name) in found:
            raise FormatError(f"{label} exists twice; a VTK data set needs unique names")
        kind = storable_type(values, label)
        found[field.location, field.name] = StoredArray(field.name, field.location, values, whole, kind)
    points = grid.in_planes(block).swapaxes(0, 2)
    return [
        StoredArray("Points", "node", points, (*grid.shapes[block][::-1], 3), np.dtype(variant.precision)),
        *found.values(),
    ]


def storable_type(values: NDArray[Any], label: str) -> np.dtype[Any]:
    """The type in which mesh files can hold the values: integers, float32, float64; bool as uint8."""
    if values.dtype.kind == "b":
        return np.dtype(np.uint8)
    if values.dtype.kind not in "iuf" or values.dtype.itemsize > 8 or values.dtype == np.float16:
        raise FormatError(f"{label} is of type {values.dtype}; expected integers, float32 or float64")
    return values.dtype.newbyteorder("=")
