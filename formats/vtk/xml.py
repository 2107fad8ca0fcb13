"""Structured grids in VTK's XML files through VTK: .vts, with .vtr and .vti read as structured grids."""

from __future__ import annotations

from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkDataSetAttributes, vtkStructuredGrid
from vtkmodules.vtkIOXML import (
    vtkXMLImageDataReader,
    vtkXMLRectilinearGridReader,
    vtkXMLStructuredGridReader,
    vtkXMLStructuredGridWriter,
    vtkXMLWriter,
)

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid

from .dataset import DataArray, DataSet, VtkFormat, arrays_to_write, lattice, points_to_write
from .messages import vtk_errors
from .xml_header import read_header

_READERS: dict[str, Any] = {
    "StructuredGrid": vtkXMLStructuredGridReader,
    "RectilinearGrid": vtkXMLRectilinearGridReader,
    "ImageData": vtkXMLImageDataReader,
}

_OTHER_KINDS = {
    "PolyData": "a polygon surface",
    "UnstructuredGrid": "an unstructured grid",
    "PStructuredGrid": "the index of a parallel data set; merge its pieces to one .vts",
    "vtkMultiBlockDataSet": "a multi-block set",
    "vtkPartitionedDataSetCollection": "a partitioned collection; save it as a multi-block set (.vtm)",
}

_ROLES = tuple(map(vtkDataSetAttributes.GetAttributeTypeAsString, range(vtkDataSetAttributes.NUM_ATTRIBUTES)))
_ID_ROLES = {"GlobalIds", "PedigreeIds"}

_COMPRESSOR_TYPES = {
    "none": vtkXMLWriter.NONE,
    "zlib": vtkXMLWriter.ZLIB,
    "lz4": vtkXMLWriter.LZ4,
    "lzma": vtkXMLWriter.LZMA,
}


def read(path: Path) -> DataSet:
    """Read the structured data set of an XML file.

    Raises
    ------
    FormatError
        When the file is truncated or damaged, with VTK's own message, or holds another kind of data set.
    """
    header = read_header(path)
    if header.kind not in _READERS:
        other = _OTHER_KINDS.get(header.kind, "another kind of data set")
        raise FormatError(f"{path} is {other} (VTKFile type {header.kind}); expected a structured grid")
    reader = _READERS[header.kind]()
    reader.SetFileName(str(path))
    with vtk_errors() as errors:
        reader.Update()
    # Keys are ranges of values, which VTK writes but cannot read where they are not finite.
    errors = [error for error in errors if "InformationKey" not in error]
    if errors:
        raise FormatError(f"cannot read {path}: {errors[0]}")
    data_set = reader.GetOutput()
    if data_set.GetNumberOfPoints() == 0 or (data_set.IsA("vtkStructuredGrid") and data_set.GetPoints() is None):
        raise FormatError(f"{path} is an empty grid: it has no nodes")
    notes = [] if header.kind == "StructuredGrid" else [f"{header.kind} is read as a structured grid"]
    arrays = list(data_arrays(data_set, notes))
    i, _, j, _, k, _ = data_set.GetExtent()
    return DataSet(_points(path, data_set), tuple(arrays), header.options, (i, j, k), notes=tuple(notes))


def _points(path: Path, data_set: Any) -> NDArray[Any]:
    """Coordinates, ``(nk, nj, ni, 3)``."""
    low_i, high_i, low_j, high_j, low_k, high_k = data_set.GetExtent()
    shape = (high_k - low_k + 1, high_j - low_j + 1, high_i - low_i + 1)
    if data_set.IsA("vtkStructuredGrid"):
        points = vtk_to_numpy(data_set.GetPoints().GetData())
    elif data_set.IsA("vtkRectilinearGrid"):
        axes = (data_set.GetXCoordinates(), data_set.GetYCoordinates(), data_set.GetZCoordinates())
        points = lattice(*map(vtk_to_numpy, axes))
    else:
        matrix = data_set.GetIndexToPhysicalMatrix()
        rows = np.array([[matrix.GetElement(row, column) for column in range(4)] for row in range(3)])
        indices = lattice(*(np.arange(n) + low for n, low in zip(shape[::-1], (low_i, low_j, low_k), strict=True)))
        points = indices @ rows[:, :3].T + rows[:, 3]
    if points.size != 3 * shape[0] * shape[1] * shape[2]:
        raise FormatError(
            f"{path} has {points.size // 3} points; its extent is of {' x '.join(map(str, shape[::-1]))} nodes"
        )
    return points.reshape(*shape, 3)


def data_arrays(data_set: Any, notes: list[str]) -> Iterator[DataArray]:
    """The node, cell and field data of a VTK data set; ``notes`` gets a line for each array that has no numbers."""
    places = (("node", data_set.GetPointData()), ("cell", data_set.GetCellData()), ("", data_set.GetFieldData()))
    for location, attributes in places:
        for index in range(attributes.GetNumberOfArrays()):
            array = attributes.GetAbstractArray(index)
            name = array.GetName() or f"array{index}"
            if not array.IsA("vtkDataArray"):
                notes.append(f"the text array {name!r} is not carried along")
                continue
            roles = _roles(attributes, array) if location else ()
            yield DataArray(name, location, vtk_to_numpy(array), roles, _component_names(array))


def _roles(attributes: Any, array: Any) -> tuple[str, ...]:
    return tuple(role for index, role in enumerate(_ROLES) if attributes.GetAbstractAttribute(index) is array)


def _component_names(array: Any) -> tuple[str, ...]:
    if not array.HasAComponentName():
        return ()
    return tuple(array.GetComponentName(c) or "" for c in range(array.GetNumberOfComponents()))


def write_block(grid: Grid, block: int, path: Path, variant: VtkFormat) -> None:
    """Write one block to a .vts file.

    Raises
    ------
    FormatError
        When a field cannot be stored in a VTK file.
    OSError
        When VTK cannot write the file, with VTK's own message.
    """
    # VTK reads these arrays where they are; they must live until it has written them.
    points, arrays = points_to_write(grid, block, variant.precision), arrays_to_write(grid, block, variant)
    data_set = vtkStructuredGrid()
    i, j, k = variant.origins[block] if variant.origins else (0, 0, 0)
    ni, nj, nk = grid.shapes[block]
    data_set.SetExtent(i, i + ni - 1, j, j + nj - 1, k, k + nk - 1)
    nodes = vtkPoints()
    nodes.SetData(numpy_to_vtk(points))
    data_set.SetPoints(nodes)
    for array in arrays:
        _add_array(data_set, array)
    writer = _writer(variant, max(values.nbytes for values in (points, *(array.values for array in arrays))))
    writer.SetFileName(str(path))
    writer.SetInputData(data_set)
    with vtk_errors() as errors:
        written = writer.Write()
    if errors or not written:
        raise OSError(errors[0] if errors else "VTK gives no reason; is the disk full?")


def _add_array(data_set: Any, array: DataArray) -> None:
    ids = array.values.dtype == np.int64 and not _ID_ROLES.isdisjoint(array.roles)
    stored = numpy_to_vtkIdTypeArray(array.values) if ids else numpy_to_vtk(array.values)
    # VTK writes names as they are into attributes of XML tags.
    name = escape(array.name)
    stored.SetName(name)
    for component, label in enumerate(array.components):
        stored.SetComponentName(component, escape(label))
    if not array.location:
        data_set.GetFieldData().AddArray(stored)
        return
    attributes = data_set.GetPointData() if array.location == "node" else data_set.GetCellData()
    attributes.AddArray(stored)
    for role in array.roles:
        attributes.SetActiveAttribute(name, _ROLES.index(role))


def _writer(variant: VtkFormat, largest: int) -> vtkXMLStructuredGridWriter:
    writer = vtkXMLStructuredGridWriter()
    encoding, compression = variant.options["encoding"], variant.options["compression"]
    if encoding == "ascii":
        writer.SetDataModeToAscii()
    elif encoding == "binary":
        writer.SetDataModeToBinary()
    else:
        writer.SetDataModeToAppended()
        writer.SetEncodeAppendedData(encoding == "appended-base64")
    writer.SetCompressorType(_COMPRESSOR_TYPES[compression])
    if variant.options["byte_order"] == "big":
        writer.SetByteOrderToBigEndian()
    else:
        writer.SetByteOrderToLittleEndian()
    # The size of an array stands before it: 4 bytes hold sizes below 4 GiB only.
    if variant.options["header_type"] == "UInt32" and largest < 2**32:
        writer.SetHeaderTypeToUInt32()
    else:
        writer.SetHeaderTypeToUInt64()
    return writer
