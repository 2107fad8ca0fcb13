"""Displacement tables as VTK surfaces: polygons (.vtp, legacy) and unstructured cells (.vtu)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkVersion
from vtkmodules.vtkIOXML import vtkXMLPolyDataReader, vtkXMLUnstructuredGridReader

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray

from ..vtk.legacy_attributes import Attributes
from ..vtk.legacy_file import LegacyFile
from ..vtk.messages import vtk_errors
from ..vtk.xml import data_arrays
from ..vtk.xml_header import read_header
from .cells import fans, starts_of_list
from .table import NO_TRIANGLES, Table, surface_table

# Corners of VTK's cells with two dimensions, by type; nodes on edges and inside come after them.
_CORNERS = {5: 3, 22: 3, 34: 3, 9: 4, 23: 4, 28: 4}
_POLYGON, _STRIP = 7, 6


def read_vtk_xml(path: Path) -> Table:
    """Read polygons (.vtp) or unstructured cells (.vtu) of VTK.

    Raises
    ------
    FormatError
        When the file is truncated or damaged, or has no displacement.
    """
    polygons = read_header(path).kind == "PolyData"
    reader = vtkXMLPolyDataReader() if polygons else vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    with vtk_errors() as errors:
        reader.Update()
    if errors:
        raise FormatError(f"cannot read {path}: {errors[0]}")
    data_set = reader.GetOutput()
    if data_set.GetNumberOfPoints() == 0:
        raise FormatError(f"{path} has no points")
    arrays = {array.name: array.values for array in data_arrays(data_set, []) if array.location == "node"}
    triangles = (_polygon_triangles if polygons else _cell_triangles)(path, data_set)
    return surface_table(path, vtk_to_numpy(data_set.GetPoints().GetData()), arrays, triangles)


def _polygon_triangles(path: Path, data_set: Any) -> IntArray:
    polygons, strips = (_cell_lists(path, cells) for cells in (data_set.GetPolys(), data_set.GetStrips()))
    return np.concatenate([fans(*polygons), fans(*strips, strip=True)])


def _cell_triangles(path: Path, data_set: Any) -> IntArray:
    connectivity, first, size = _cell_lists(path, data_set.GetCells())
    kind = vtk_to_numpy(_cell_types(data_set))
    corners = np.where(kind == _POLYGON, size, 0)
    for number, count in _CORNERS.items():
        corners[kind == number] = count
    if (corners > size).any():
        raise FormatError(f"{path} has cells with fewer nodes than corners; the file is damaged")
    strips = np.where(kind == _STRIP, size, 0)
    return np.concatenate([fans(connectivity, first, corners), fans(connectivity, first, strips, strip=True)])


def _cell_types(data_set: Any) -> Any:
    # VTK 9.6 gave the method a new name, which had been that of another one.
    if (vtkVersion.GetVTKMajorVersion(), vtkVersion.GetVTKMinorVersion()) >= (9, 6):
        return data_set.GetCellTypes()
    return data_set.GetCellTypesArray()


def _cell_lists(path: Path, cells: Any) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
    """Node numbers of all cells, and first entry and size of each."""
    offsets, connectivity = vtk_to_numpy(cells.GetOffsetsArray()), vtk_to_numpy(cells.GetConnectivityArray())
    _check_offsets(path, offsets, len(connectivity))
    return connectivity, offsets[:-1], np.diff(offsets)


def _check_offsets(path: Path, offsets: NDArray[Any], size: int) -> None:
    if len(offsets) and (offsets[0] != 0 or offsets[-1] != size or (np.diff(offsets) < 0).any()):
        raise FormatError(f"{path}: the offsets of the cells do not ascend from 0 to {size}; the file is damaged")


def read_vtk_legacy(path: Path) -> Table:
    """Read the polygons of a legacy VTK file (DATASET POLYDATA).

    Raises
    ------
    FormatError
        When the file is truncated or damaged, or has no displacement.
    """
    with path.open("rb") as stream:
        file = LegacyFile(path, stream)
        attributes = Attributes(file)
        points: NDArray[Any] = np.empty((0, 3))
        triangles = [NO_TRIANGLES]
        while words := file.words():
            keyword = words[0].upper()
            if keyword == "POINTS" and len(words) == 3:
                points = file.values(3 * file.number(words[1]), words[2], keyword).reshape(-1, 3)
                file.component_names()
            elif keyword in ("VERTICES", "LINES", "POLYGONS", "TRIANGLE_STRIPS") and len(words) == 3:
                cells = _legacy_cells(file, keyword, *map(file.number, words[1:]))
                if keyword in ("POLYGONS", "TRIANGLE_STRIPS"):
                    triangles.append(fans(*cells, strip=keyword == "TRIANGLE_STRIPS"))
            else:
                attributes.read(words)
    arrays = {array.name: array.values for array in attributes.arrays if array.location == "node"}
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
    starts = starts_of_list(entries)
    if len(starts) != n or (n and starts[-1] + 1 + entries[starts[-1]] != size):
        raise file.error(f"{keyword}: the {size} entries are not {n} cells, each with its number of corners first")
    return entries, starts + 1, entries[starts]
