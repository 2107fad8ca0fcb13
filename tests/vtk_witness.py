"""VTK's own classes as witnesses for what we read and write."""

from pathlib import Path

import numpy as np
from vtkmodules.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray, vtk_to_numpy
from vtkmodules.vtkCommonCore import vtkPoints, vtkStringArray
from vtkmodules.vtkCommonDataModel import vtkStructuredGrid
from vtkmodules.vtkIOLegacy import vtkStructuredGridReader, vtkStructuredGridWriter
from vtkmodules.vtkIOXML import vtkXMLStructuredGridReader, vtkXMLStructuredGridWriter, vtkXMLWriter

ROLES = {"Scalars": 0, "Vectors": 1, "Normals": 2, "TCoords": 3, "Tensors": 4, "GlobalIds": 5}

COMPRESSIONS = ("none", "zlib", "lzma")


def structured_grid(points, origin=(0, 0, 0)):
    """vtkStructuredGrid of points (ni, nj, nk, 3)."""
    grid = vtkStructuredGrid()
    ni, nj, nk = points.shape[:3]
    i, j, k = origin
    grid.SetExtent(i, i + ni - 1, j, j + nj - 1, k, k + nk - 1)
    nodes = vtkPoints()
    nodes.SetData(numpy_to_vtk(points.swapaxes(0, 2).reshape(-1, 3), deep=True))
    grid.SetPoints(nodes)
    return grid


def add_array(attributes, name, values, role=None, components=()):
    """Add values (ni, nj, nk[, c]) to point or cell data, or (n,) to field data."""
    run = values.swapaxes(0, 2).reshape(-1, *values.shape[3:]) if values.ndim > 2 else values
    convert = numpy_to_vtkIdTypeArray if role == "GlobalIds" else numpy_to_vtk
    array = convert(np.ascontiguousarray(run), deep=True)
    array.SetName(name)
    for index, component in enumerate(components):
        array.SetComponentName(index, component)
    attributes.AddArray(array)
    if role:
        attributes.SetActiveAttribute(name, ROLES[role])


def add_text(attributes, name, *words):
    array = vtkStringArray()
    array.SetName(name)
    for word in words:
        array.InsertNextValue(word)
    attributes.AddArray(array)


def write_legacy(path: Path, grid, binary=True, version=51):
    writer = vtkStructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(path))
    writer.SetFileType(2 if binary else 1)
    writer.SetFileVersion(version)
    assert writer.Write()


def write_xml(path: Path, grid, encoding="appended", compression="ZLIB", header="UInt32", big_endian=False):
    writer = vtkXMLStructuredGridWriter()
    writer.SetInputData(grid)
    writer.SetFileName(str(path))
    writer.SetDataMode({"ascii": 0, "binary": 1}.get(encoding, 2))
    writer.SetEncodeAppendedData(encoding == "appended-base64")
    writer.SetCompressorType(getattr(vtkXMLWriter, compression))
    (writer.SetHeaderTypeToUInt64 if header == "UInt64" else writer.SetHeaderTypeToUInt32)()
    if big_endian:
        writer.SetByteOrderToBigEndian()
    assert writer.Write()


def read(path: Path):
    """Points (ni, nj, nk, 3) in the file's type, and arrays by location and name, as VTK reads them."""
    legacy = path.read_bytes().startswith(b"# vtk")
    reader = vtkStructuredGridReader() if legacy else vtkXMLStructuredGridReader()
    reader.SetFileName(str(path))
    if legacy:
        reader.ReadAllScalarsOn()
        reader.ReadAllVectorsOn()
    reader.Update()
    grid = reader.GetOutput()
    nodes = [0, 0, 0]
    grid.GetDimensions(nodes)
    points = _in_order(vtk_to_numpy(grid.GetPoints().GetData()), nodes)
    arrays = {}
    for location, attributes in (("node", grid.GetPointData()), ("cell", grid.GetCellData())):
        shape = nodes if location == "node" else tuple(max(n - 1, 1) for n in nodes)
        for index in range(attributes.GetNumberOfArrays()):
            array = attributes.GetArray(index)
            arrays[location, array.GetName()] = _in_order(vtk_to_numpy(array), shape)
    return points, arrays


def _in_order(run, shape):
    return run.reshape(*shape[::-1], *run.shape[1:]).swapaxes(0, 2)
