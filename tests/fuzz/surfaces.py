"""Surfaces with displacements in every format, written and read independently of the program."""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path

import meshio
import numpy as np

Surface = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points (n, 3), displacements (n, 3), triangles (m, 3)."""


def write(path: Path, surface: Surface, kind: str) -> None:
    """Write a surface; ``kind`` tells which variant of the format."""
    if path.suffix in (".vtu", ".vtp", ".vtk"):
        return _write_vtk(path, surface, kind)
    points, moves, triangles = surface
    mesh = meshio.Mesh(points, [("triangle", triangles)], point_data={"displacement": moves})
    # It says on stdout what it adds of its own.
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        if path.suffix == ".avs":
            meshio.avsucd.write(str(path), mesh)
        else:
            meshio.gmsh.write(str(path), mesh, "2.2", binary=False)
            # As numpy 2 shows numbers to its users.
            path.write_text(re.sub(r"np\.float64\((.*?)\)", r"\1", path.read_text()))
    return None


def _write_vtk(path: Path, surface: Surface, kind: str) -> None:
    from vtkmodules.util.numpy_support import numpy_to_vtk
    from vtkmodules.vtkCommonCore import vtkPoints
    from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData, vtkUnstructuredGrid
    from vtkmodules.vtkIOLegacy import vtkPolyDataWriter, vtkUnstructuredGridWriter
    from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter, vtkXMLUnstructuredGridWriter

    points, moves, triangles = surface
    nodes = vtkPoints()
    nodes.SetData(numpy_to_vtk(points, deep=True))
    cells = vtkCellArray()
    for triangle in triangles.tolist():
        cells.InsertNextCell(len(triangle), triangle)
    flat = path.suffix == ".vtp" or (path.suffix == ".vtk" and "poly" in kind)
    mesh = vtkPolyData() if flat else vtkUnstructuredGrid()
    mesh.SetPoints(nodes)
    if not len(triangles):
        for node in range(len(points)):
            cells.InsertNextCell(1, [node])
        mesh.SetVerts(cells) if flat else mesh.SetCells(1, cells)
    else:
        mesh.SetPolys(cells) if flat else mesh.SetCells(5, cells)
    array = numpy_to_vtk(moves, deep=True)
    array.SetName("displacement")
    mesh.GetPointData().AddArray(array)
    if path.suffix == ".vtk":
        writer = vtkPolyDataWriter() if flat else vtkUnstructuredGridWriter()
        writer.SetFileType(2 if "binary" in kind else 1)
        writer.SetFileVersion(42 if "old" in kind else 51)
    else:
        writer = vtkXMLPolyDataWriter() if flat else vtkXMLUnstructuredGridWriter()
        writer.SetDataMode({"ascii": 0, "binary": 1}.get(kind, 2))
        writer.SetEncodeAppendedData(kind == "base64")
    writer.SetInputData(mesh)
    writer.SetFileName(str(path))
    assert writer.Write()


def read(path: Path) -> Surface | None:
    """The surface as vtk reads it; none if it finds no surface."""
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOLegacy import vtkDataSetReader
    from vtkmodules.vtkIOXML import vtkXMLGenericDataObjectReader

    from .judges import silent_vtk

    reader = vtkDataSetReader() if path.read_bytes().startswith(b"# vtk") else vtkXMLGenericDataObjectReader()
    reader.SetFileName(str(path))
    with silent_vtk():
        reader.Update()
    mesh = reader.GetOutput()
    if mesh is None:
        return None
    triangles = []
    for cell in range(mesh.GetNumberOfCells()):
        if mesh.GetCellType(cell) in (5, 7):
            ids = mesh.GetCell(cell).GetPointIds()
            corners = [ids.GetId(n) for n in range(ids.GetNumberOfIds())]
            triangles += [[corners[0], *corners[n : n + 2]] for n in range(1, len(corners) - 1)]
    arrays = [mesh.GetPointData().GetArray(n) for n in range(mesh.GetPointData().GetNumberOfArrays())]
    vectors = [vtk_to_numpy(array) for array in arrays if array is not None and array.GetNumberOfComponents() == 3]
    if not vectors or mesh.GetPoints() is None:
        return None
    moves = vectors[0]
    points = vtk_to_numpy(mesh.GetPoints().GetData())
    return points.astype(float), moves.astype(float), np.array(triangles, dtype=int).reshape(-1, 3)
