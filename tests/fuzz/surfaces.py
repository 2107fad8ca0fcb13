"""Surfaces with displacements in every format, written and read independently of the program."""

from __future__ import annotations

import contextlib
import io
from pathlib import Path

import meshio
import numpy as np

Surface = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Points (n, 3), displacements (n, 3), triangles (m, 3)."""


# --- writing --------------------------------------------------------------------------------------------------------


def write(path: Path, surface: Surface, kind: str) -> None:
    """Write a surface; ``kind`` tells which variant of the format."""
    if path.suffix in (".vtu", ".vtp", ".vtk"):
        _write_vtk(path, surface, kind)
    elif path.suffix == ".avs":
        points, moves, triangles = surface
        mesh = meshio.Mesh(points, [("triangle", triangles)], point_data={"displacement": moves})
        # It says on stdout what it adds of its own.
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            meshio.avsucd.write(str(path), mesh)
    else:
        _write_msh(path, surface)


def _write_msh(path: Path, surface: Surface) -> None:
    """Gmsh's version 2.2 as text."""
    points, moves, triangles = (values.tolist() for values in surface)
    nodes = [f"{n + 1} " + " ".join(map(repr, row)) for n, row in enumerate(points)]
    cells = [f"{n + 1} 2 2 0 1 " + " ".join(str(node + 1) for node in row) for n, row in enumerate(triangles)]
    cells = cells or ["1 15 2 0 1 1"]
    data = [f"{n + 1} " + " ".join(map(repr, row)) for n, row in enumerate(moves)]
    head = ["1", '"displacement"', "1", "0.0", "3", "0", "3", str(len(data))]
    sections = {
        "MeshFormat": ["2.2 0 8"],
        "Nodes": [str(len(nodes)), *nodes],
        "Elements": [str(len(cells)), *cells],
        "NodeData": [*head, *data],
    }
    path.write_text("".join("\n".join([f"${k}", *lines, f"$End{k}\n"]) for k, lines in sections.items()))


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


# --- reading --------------------------------------------------------------------------------------------------------


def read(path: Path) -> Surface | None:
    """The surface as something else than the program reads it; none if that finds no surface."""
    return _msh(path) if path.suffix == ".msh" else _vtk(path)


def _vtk(path: Path) -> Surface | None:
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


def _section(words: list[str], name: str) -> list[str]:
    return words[words.index(f"${name}") + 1 : words.index(f"$End{name}")]


def _msh(path: Path) -> Surface:
    """Version 2.2 as text."""
    text = path.read_text("utf-8", "replace")
    nodes = np.array(_section(text.split(), "Nodes")[1:], dtype=float).reshape(-1, 4)
    lines = text.partition("$NodeData")[2].partition("$EndNodeData")[0].split("\n")
    data = [line for line in lines if line.strip()]
    at = 1 + int(data[0])
    at += 1 + int(data[at])
    at += 1 + int(data[at])
    # Values count, wherever lines end.
    moves = np.array(" ".join(data[at:]).split(), dtype=float).reshape(int(data[at - 1]), -1)
    number = {identity: row for row, identity in enumerate(nodes[:, 0].tolist())}
    by_node = {row[0]: row[1:] for row in moves.tolist()}
    triangles = []
    for line in text.partition("$Elements")[2].partition("$EndElements")[0].split("\n")[2:]:
        words = [int(word) for word in line.split()]
        if len(words) > 3 and words[1] == 2:
            triangles.append([number[node] for node in words[-3:]])
    displacement = np.array([by_node[identity] for identity in nodes[:, 0].tolist()])
    return nodes[:, 1:], displacement, np.array(triangles, dtype=int).reshape(-1, 3)
