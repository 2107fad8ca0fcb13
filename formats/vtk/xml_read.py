"""Structured grids in VTK's XML files: .vts, with .vtr and .vti read as structured grids.

The pieces of a file may overlap in nodes, but must agree there, and together they must cover every node and cell of the
whole extent.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Shape
from meshdeform_core.parallel import require_undivided

from .dataset import DataArray, DataSet, Values, lattice, require_plausible_lattice
from .xml_arrays import LARGEST_RATIO, ArrayReader, joined, read_section
from .xml_tags import Element, read_tags

_KINDS = ("StructuredGrid", "RectilinearGrid", "ImageData")

_OTHER_KINDS = {
    "PolyData": "a polygon surface",
    "UnstructuredGrid": "an unstructured grid",
    "PStructuredGrid": "the index of a parallel data set; merge its pieces into one .vts",
    "vtkMultiBlockDataSet": "a multi-block set",
    "vtkPartitionedDataSetCollection": "a partitioned collection; save it as a multi-block set (.vtm)",
}

# Nodes that an extent may have regardless of the size of the file.
_ALWAYS_ALLOWED = 1_000_000


@dataclass(frozen=True)
class Extent:
    """First and last node along i, j, k."""

    low: Shape
    high: Shape

    def shape(self, location: str = "node") -> Shape:
        """Number of nodes or cells along k, j, i."""
        ni, nj, nk = (b - a + 1 for a, b in zip(self.low, self.high, strict=True))
        return (nk, nj, ni) if location == "node" else (max(nk - 1, 1), max(nj - 1, 1), max(ni - 1, 1))

    def empty(self) -> bool:
        return min(self.shape()) < 1

    def fits(self, whole: Extent) -> bool:
        """Whether this is a part of ``whole`` and at least one cell wide wherever ``whole`` is."""
        bounds = zip(self.low, self.high, whole.low, whole.high, strict=True)
        return all(c <= a and b <= d and (a < b or c == d) for a, b, c, d in bounds)

    def window(self, whole: Extent, location: str) -> tuple[slice, ...]:
        """Slices of the nodes or cells in an array ``(nk, nj, ni)`` of ``whole``."""
        starts = [a - b for a, b in zip(self.low, whole.low, strict=True)][::-1]
        return tuple(slice(start, start + n) for start, n in zip(starts, self.shape(location), strict=True))

    def __str__(self) -> str:
        return " ".join(f"{a} {b}" for a, b in zip(self.low, self.high, strict=True))


@dataclass(frozen=True)
class _Piece:
    """The contents of one Piece element; ``points`` is ``(nk, nj, ni, 3)``."""

    extent: Extent
    line: int
    points: Values
    nodes: list[DataArray]
    cells: list[DataArray]


def read(path: Path) -> DataSet:
    """Read the structured data set of an XML file.

    Raises
    ------
    FormatError
        When the file is truncated or damaged, a node or cell is missing, or the data set is of another kind.
    """
    file = read_tags(path)
    if file.kind not in _KINDS:
        other = _OTHER_KINDS.get(file.kind, "another kind of data set")
        raise FormatError(f"{path} is {other} (VTKFile type {file.kind}); expected a structured grid")
    data_set = file.data_set()
    notes = [] if file.kind == "StructuredGrid" else [f"{file.kind} is read as a structured grid"]
    with path.open("rb") as stream:
        reader = ArrayReader(file, stream)
        whole = _extent(reader, data_set, "WholeExtent")
        found = _pieces(reader, data_set, whole)
        later = len(found) == 1 and file.kind == "StructuredGrid" and _extent(reader, found[0], "Extent") == whole
        if not later or file.options["encoding"] != "appended" or file.compression != "none":
            require_undivided(f"{path} is text, compressed or in several pieces")
        pieces = []
        for piece in found:
            extent = _extent(reader, piece, "Extent")
            n_nodes, n_cells = (math.prod(extent.shape(location)) for location in ("node", "cell"))
            points = _piece_points(reader, data_set, piece, extent, later)
            nodes = read_section(reader, piece, "PointData", n_nodes, notes, later)
            cells = read_section(reader, piece, "CellData", n_cells, notes, later)
            pieces.append(_Piece(extent, piece.line, points, nodes, cells))
        field_data = read_section(reader, data_set, "FieldData", 0, notes)
        reader.require_no_rest()
    if len(pieces) > 1 or pieces[0].extent != whole:
        pieces = [_put_together(path, whole, pieces)]
    arrays = (*pieces[0].nodes, *pieces[0].cells, *field_data)
    return DataSet(pieces[0].points, arrays, file.options, whole.low, notes=tuple(dict.fromkeys(notes)))


def _extent(reader: ArrayReader, element: Element, name: str) -> Extent:
    words = element.get(name).split()
    if len(words) != 6 or not all(re.fullmatch(r"[+-]?\d{1,9}", word) for word in words):
        raise reader.error(element, f"has {name} {element.get(name)!r}, expected six whole numbers")
    i, last_i, j, last_j, k, last_k = map(int, words)
    extent = Extent((i, j, k), (last_i, last_j, last_k))
    count, size = math.prod(max(n, 0) for n in extent.shape()), reader.file.size
    if count > max(_ALWAYS_ALLOWED, size * LARGEST_RATIO[reader.file.compression]):
        raise FormatError(
            f"{reader.file.path} has {element.tag} {name} {element.get(name)!r}: a file of {size} bytes cannot hold "
            f"{count} entries"
        )
    return extent


def _pieces(reader: ArrayReader, data_set: Element, whole: Extent) -> list[Element]:
    """The Piece elements that are not empty, each inside ``whole``."""
    found = []
    for piece in data_set.all("Piece"):
        extent = _extent(reader, piece, "Extent")
        if extent.empty():
            continue
        if not extent.fits(whole):
            raise reader.error(piece, f"has Extent {extent}, which does not fit into the WholeExtent {whole}")
        found.append(piece)
    if whole.empty() or not found:
        raise FormatError(f"{reader.file.path} is an empty grid: it has no nodes")
    if reader.file.kind != "StructuredGrid":
        nodes = sum(math.prod(_extent(reader, piece, "Extent").shape()) for piece in found)
        require_plausible_lattice(reader.file.path, nodes, reader.file.size)
    return found


def _piece_points(reader: ArrayReader, data_set: Element, piece: Element, extent: Extent, later: bool) -> Values:
    """Coordinates of a piece, ``(nk, nj, ni, 3)``."""
    shape = extent.shape()
    if reader.file.kind == "StructuredGrid":
        (array,) = reader.arrays_of(piece, "Points", 1)
        return reader.values(array, math.prod(shape), 3, later).reshape(*shape, 3)
    if reader.file.kind == "RectilinearGrid":
        arrays = reader.arrays_of(piece, "Coordinates", 3)
        return lattice(*(reader.values(array, n, 1) for array, n in zip(arrays, shape[::-1], strict=True)))
    origin = _numbers(reader, data_set, "Origin", "0 0 0")
    spacing = _numbers(reader, data_set, "Spacing", "1 1 1")
    direction = _numbers(reader, data_set, "Direction", "1 0 0 0 1 0 0 0 1").reshape(3, 3)
    indices = lattice(*(np.arange(n) + low for n, low in zip(shape[::-1], extent.low, strict=True)))
    return indices @ (direction * spacing).T + origin


def _numbers(reader: ArrayReader, element: Element, name: str, otherwise: str) -> NDArray[np.float64]:
    words = (element.get(name) or otherwise).split()
    try:
        numbers = np.array(words, dtype=np.float64)
    except ValueError:
        numbers = np.empty(0)
    if numbers.size != len(otherwise.split()):
        raise reader.error(element, f"has {name} {element.get(name)!r}, expected {len(otherwise.split())} numbers")
    return numbers


def _put_together(path: Path, whole: Extent, pieces: list[_Piece]) -> _Piece:
    """The contents of the whole extent; pieces that share a node must agree on its coordinates."""
    points = np.zeros((*whole.shape(), 3), pieces[0].points.dtype)
    given = {location: np.zeros(whole.shape(location), bool) for location in ("node", "cell")}
    for piece in pieces:
        window = piece.extent.window(whole, "node")
        differs = given["node"][window] & (points[window] != piece.points).any(axis=-1)
        if differs.any():
            node = _first(differs, piece.extent.low)
            raise FormatError(f"cannot read {path}, line {piece.line}: another Piece places node {node} elsewhere")
        points[window] = piece.points
        for location, found in given.items():
            found[piece.extent.window(whole, location)] = True
    for location, found in given.items():
        if not found.all():
            raise FormatError(
                f"cannot read {path}: no Piece gives {(~found).sum()} of the {found.size} {location}s of the "
                f"WholeExtent {whole}; the first is the {location} at {_first(~found, whole.low)}"
            )
    nodes, cells = (_joined_arrays(path, whole, pieces, location) for location in given)
    return _Piece(whole, pieces[0].line, points, nodes, cells)


def _first(marked: NDArray[np.bool_], low: Shape) -> Shape:
    """Index (i, j, k), as in the file, of the first marked one."""
    k, j, i = np.unravel_index(int(np.argmax(marked)), marked.shape)
    return low[0] + int(i), low[1] + int(j), low[2] + int(k)


def _joined_arrays(path: Path, whole: Extent, pieces: list[_Piece], location: str) -> list[DataArray]:
    shape, found = whole.shape(location), []
    try:
        for array, values in joined([piece.nodes if location == "node" else piece.cells for piece in pieces]):
            all_values = np.empty((*shape, *array.values.shape[1:]), array.values.dtype)
            for piece, part in zip(pieces, values, strict=True):
                window = all_values[piece.extent.window(whole, location)]
                window[...] = part.reshape(window.shape)
            found.append(array._replace(values=all_values.reshape(-1, *array.values.shape[1:])))
    except ValueError as error:
        raise FormatError(f"cannot read {path}: the {location} {error}") from error
    return found
