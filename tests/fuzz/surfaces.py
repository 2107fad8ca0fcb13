"""Surfaces with displacements, written and read independently of the program."""

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
    points, moves, triangles = surface
    if path.suffix in (".vtu", ".vtp", ".vtk"):
        import pyvista

        mesh = pyvista.PolyData.from_regular_faces(points, triangles) if len(triangles) else pyvista.PolyData(points)
        mesh.point_data["displacement"] = moves
        mesh = mesh if path.suffix == ".vtp" or "poly" in kind else mesh.cast_to_unstructured_grid()
        return mesh.save(path, binary="ascii" not in kind)
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


def read(path: Path) -> Surface | None:
    """The surface as vtk reads it; none if it finds no surface."""
    import pyvista

    from .judges import silent_vtk

    try:
        with silent_vtk():
            mesh = pyvista.read(path)
        vectors = [np.asarray(values) for values in mesh.point_data.values() if values.shape[1:] == (3,)]
    except Exception:
        return None
    triangles = []
    for cell in map(mesh.get_cell, range(mesh.n_cells)):
        if cell.type in (pyvista.CellType.TRIANGLE, pyvista.CellType.POLYGON):
            corners = list(cell.point_ids)
            triangles += [[corners[0], *corners[n : n + 2]] for n in range(1, len(corners) - 1)]
    found = np.array(triangles, dtype=int).reshape(-1, 3)
    return (np.asarray(mesh.points, float), vectors[0].astype(float), found) if vectors else None
