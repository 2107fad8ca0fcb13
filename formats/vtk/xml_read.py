"""Structured grids in VTK's XML files (.vts)."""

from __future__ import annotations

import math
import re
from pathlib import Path

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Shape
from meshdeform_core.parallel import require_undivided

from .dataset import DataSet
from .xml_arrays import LARGEST_RATIO, ArrayReader, read_section
from .xml_tags import Element, read_tags

_OTHER_KINDS = {
    "PolyData": "a polygon surface",
    "UnstructuredGrid": "an unstructured grid",
    "RectilinearGrid": "a rectilinear grid; save it as a structured grid (.vts)",
    "ImageData": "an image; save it as a structured grid (.vts)",
    "PStructuredGrid": "the index of a parallel data set; merge its pieces into one .vts",
    "vtkMultiBlockDataSet": "a multi-block set",
    "vtkPartitionedDataSetCollection": "a partitioned collection; save it as a multi-block set (.vtm)",
}

# Nodes that an extent may have regardless of the size of the file.
_ALWAYS_ALLOWED = 1_000_000

Extent = tuple[Shape, Shape]
"""First node (i, j, k), and number of nodes along each index."""


def read(path: Path) -> DataSet:
    """Read the structured data set of an XML file.

    Raises FormatError when the file is truncated or damaged, its data set is of another kind, or not one Piece with all
    nodes.
    """
    file = read_tags(path)
    if file.kind != "StructuredGrid":
        other = _OTHER_KINDS.get(file.kind, "another kind of data set")
        raise FormatError(f"{path} is {other} (VTKFile type {file.kind}); expected a structured grid")
    data_set = file.data_set()
    notes: list[str] = []
    with path.open("rb") as stream:
        reader = ArrayReader(file, stream)
        low, (ni, nj, nk) = whole = _extent(reader, data_set, "WholeExtent")
        piece = _piece(reader, data_set, whole)
        if file.options["encoding"] != "appended" or file.compression != "none":
            require_undivided(f"{path} is text or compressed")
        (array,) = reader.arrays_of(piece, "Points", 1)
        points = reader.values(array, ni * nj * nk, 3, later=True).reshape(nk, nj, ni, 3)
        n_cells = math.prod(max(n - 1, 1) for n in (ni, nj, nk))
        arrays = [
            *read_section(reader, piece, "PointData", ni * nj * nk, notes, later=True),
            *read_section(reader, piece, "CellData", n_cells, notes, later=True),
            *read_section(reader, data_set, "FieldData", 0, notes),
        ]
        reader.require_no_rest()
    return DataSet(points, tuple(arrays), file.options, low, notes=tuple(dict.fromkeys(notes)))


def _extent(reader: ArrayReader, element: Element, name: str) -> Extent:
    words = element.get(name).split()
    if len(words) != 6 or not all(re.fullmatch(r"[+-]?\d{1,9}", word) for word in words):
        raise reader.error(element, f"has {name} {element.get(name)!r}, expected six whole numbers")
    i, last_i, j, last_j, k, last_k = map(int, words)
    shape = last_i - i + 1, last_j - j + 1, last_k - k + 1
    count, size = math.prod(max(n, 0) for n in shape), reader.file.size
    if count > max(_ALWAYS_ALLOWED, size * LARGEST_RATIO[reader.file.compression]):
        raise FormatError(
            f"{reader.file.path} has {element.tag} {name} {element.get(name)!r}: a file of {size} bytes cannot hold "
            f"{count} entries"
        )
    return (i, j, k), shape


def _piece(reader: ArrayReader, data_set: Element, whole: Extent) -> Element:
    """The Piece with all nodes; further ones may only be empty."""
    found = [(piece, _extent(reader, piece, "Extent")) for piece in data_set.all("Piece")]
    found = [(piece, extent) for piece, extent in found if min(extent[1]) > 0]
    if min(whole[1]) < 1 or not found:
        raise FormatError(f"{reader.file.path} is an empty grid: it has no nodes")
    for piece, extent in found:
        if extent != whole or len(found) > 1:
            raise reader.error(
                piece,
                f"has Extent {piece.get('Extent')}; expected one Piece with all nodes of the WholeExtent "
                f"{data_set.get('WholeExtent')}: merge the pieces",
            )
    return found[0][0]
