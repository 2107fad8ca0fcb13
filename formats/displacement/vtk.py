"""Displacement tables as VTK surfaces: polygons (.vtp, legacy) and unstructured cells (.vtu)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from ..vtk.legacy import LegacyFile
from ..vtk.xml_arrays import ArrayReader, read_section
from ..vtk.xml_tags import Element, read_tags
from .table import NO_TRIANGLES, DisplacementTable, fans, surface_table

# Corners of VTK's two-dimensional cells, by type; nodes on edges and inside follow them.
_CORNERS = {5: 3, 22: 3, 34: 3, 9: 4, 23: 4, 28: 4}
_POLYGON, _STRIP = 7, 6
_TYPES = 81
"""Largest code of a cell type."""


def read_vtk_xml(path: Path) -> DisplacementTable:
    """Read polygons (.vtp) or unstructured cells (.vtu) of VTK."""
    file = read_tags(path)
    with path.open("rb") as stream:
        reader = ArrayReader(file, stream)
        pieces = [piece for piece in file.data_set().all("Piece") if reader.number(piece, "NumberOfPoints")]
        if len(pieces) != 1:
            what = f"{len(pieces)} pieces; merge them into one" if pieces else "no points"
            raise FormatError(f"{path} has {what}")
        (piece,) = pieces
        size = reader.number(piece, "NumberOfPoints")
        points = reader.values(reader.array_of_points(piece), size, 3)
        arrays = {array.name: array.values for array in read_section(reader, piece, "PointData", size, [])}
        if file.kind == "PolyData":
            kinds = [
                _cell_lists(reader, piece, tag, _count(reader, piece, f"NumberOf{tag}")) for tag in ("Polys", "Strips")
            ]
            triangles = np.concatenate([fans(*kinds[0]), fans(*kinds[1], strip=True)])
        else:
            triangles = _cells(reader, piece)
    return surface_table(path, points, arrays, triangles)


def _cells(reader: ArrayReader, piece: Element) -> IntArray:
    number = _count(reader, piece, "NumberOfCells")
    connectivity, first, size = _cell_lists(reader, piece, "Cells", number)
    if not number:
        return NO_TRIANGLES.copy()
    kind = reader.values(_named(reader, piece, "Cells", "types"), number, 1)
    if (wrong := kind[(kind < 0) | (kind > _TYPES)]).size:
        raise FormatError(
            f"{reader.file.path} has cells of type {wrong[0]}, which VTK does not have; the file is damaged"
        )
    corners = np.where(kind == _POLYGON, size, 0)
    for code, count in _CORNERS.items():
        corners[kind == code] = count
    if (corners > size).any():
        raise FormatError(f"{reader.file.path} has cells with fewer nodes than corners; the file is damaged")
    strips = np.where(kind == _STRIP, size, 0)
    return np.concatenate([fans(connectivity, first, corners), fans(connectivity, first, strips, strip=True)])


def _count(reader: ArrayReader, piece: Element, name: str) -> int:
    return reader.number(piece, name) if piece.get(name) else 0


def _named(reader: ArrayReader, piece: Element, tag: str, name: str) -> Element:
    for section in piece.all(tag):
        for array in section.arrays():
            if array.get("Name") == name:
                return array
    raise reader.error(piece, f"has no array {name} in {tag}")


def _cell_lists(reader: ArrayReader, piece: Element, tag: str, number: int) -> tuple[IntArray, IntArray, IntArray]:
    """Node numbers of all cells, and first entry and size of each; the file stores the end of each cell."""
    if not number:
        none: IntArray = np.empty(0, dtype=np.int64)
        return none, none, none
    ends = reader.values(_named(reader, piece, tag, "offsets"), number, 1).astype(np.int64)
    starts = np.append(0, ends)
    _check_offsets(reader.file.path, starts, int(ends[-1]))
    array = _named(reader, piece, tag, "connectivity")
    connectivity = reader.values(array, int(ends[-1]), 1).astype(np.int64)
    points = reader.number(piece, "NumberOfPoints")
    if connectivity.size and not 0 <= connectivity.min() <= connectivity.max() < points:
        raise FormatError(
            f"{reader.file.path}, line {array.line}: triangles refer to points {connectivity.min()} to "
            f"{connectivity.max()} of {points}"
        )
    return connectivity, starts[:-1], np.diff(starts)


def _check_offsets(path: Path, offsets: NDArray[Any], size: int) -> None:
    if len(offsets) and (offsets[0] != 0 or offsets[-1] != size or (np.diff(offsets) < 0).any()):
        raise FormatError(f"{path}: the offsets of the cells do not ascend from 0 to {size}; the file is damaged")


def read_vtk_legacy(path: Path) -> DisplacementTable:
    """Read the polygons of a legacy VTK file (DATASET POLYDATA)."""
    with path.open("rb") as stream:
        file = LegacyFile(path, stream)
        points: NDArray[Any] = np.empty((0, 3))
        triangles = [NO_TRIANGLES]
        while words := file.words():
            keyword = words[0].upper()
            if keyword == "POINTS" and len(words) == 3:
                points = file.values(3 * file.number(words[1]), words[2], keyword).reshape(-1, 3)
                file.skip_metadata()
            elif keyword in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS") and len(words) == 3:
                cells = _legacy_cells(file, keyword, *map(file.number, words[1:]))
                if keyword in ("POLYGONS", "TRIANGLE_STRIPS"):
                    triangles.append(fans(*cells, strip=keyword == "TRIANGLE_STRIPS"))
            else:
                file.read_section(words)
    arrays = {array.name: array.values for array in file.arrays if array.location == "node"}
    return surface_table(path, points, arrays, np.concatenate(triangles))


def _legacy_cells(file: LegacyFile, keyword: str, n: int, size: int) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Node numbers of all cells, and first entry and size of each: ``n`` lists, or ``n`` offsets (version 5.1)."""
    position = file.stream.tell()
    words = file.words()
    if words[:1] == ["OFFSETS"] and len(words) == 2:
        offsets = file.values(n, words[1], f"offsets of {keyword}").astype(np.int64)
        words = file.words()
        if words[:1] != ["CONNECTIVITY"] or len(words) != 2:
            raise file.error(f"expected 'CONNECTIVITY type' of {keyword}, found {' '.join(words)[:60]!r}")
        connectivity = file.values(size, words[1], f"connectivity of {keyword}")
        _check_offsets(file.path, offsets, size)
        return connectivity, offsets[:-1], np.diff(offsets)
    file.stream.seek(position)
    entries = file.values(size, "int", keyword).astype(np.int64)
    sizes, found, at = entries.tolist(), list[int](), 0
    while at < size:
        found.append(at)
        at += 1 + max(sizes[at], 0)
    starts = np.array(found, dtype=np.int64)
    if len(starts) != n or (n and starts[-1] + 1 + entries[starts[-1]] != size):
        raise file.error(f"{keyword}: the {size} entries are not {n} cells, each preceded by its number of corners")
    return entries, starts + 1, entries[starts]
