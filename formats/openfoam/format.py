"""OpenFOAM: blockMeshDict files and cases with one are read, polyMesh is written.

A case whose ``constant/polyMesh`` was generated from its ``blockMeshDict`` keeps its faces, patches and point numbers;
only the points change. Any other grid becomes a new mesh.
"""

from __future__ import annotations

import dataclasses
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, FloatArray, Grid, IntArray

from ..variant_options import checked_options
from .block_mesh import block_mesh
from .case import POLY_MESH, case_folder, dictionary_of, is_case, mesh_files, replaced_mesh
from .dictionary import read_dictionary
from .existing import points_file, with_points_of
from .layout import read_layout
from .poly_mesh.extrusion import extruded
from .poly_mesh.lists import read_points, write_points
from .poly_mesh.mesh import PLACE, PolyMesh, poly_mesh, write_mesh

_OPTIONS = {"encoding": ("binary", "ascii"), "compression": ("none", "gzip")}


@dataclass(frozen=True)
class FoamFormat(FileFormat):
    """Format of a grid from a case with a mesh: the folder of the mesh, and the point of every node (n_nodes,)."""

    mesh: Path | None = None
    numbering: IntArray | None = dataclasses.field(default=None, compare=False, repr=False)


def read(path: Path) -> Grid:
    """Read a blockMeshDict: the file itself, or a case (folder or ``.foam`` file) that has one.

    Patches keep their names, which are their families, too, and their types; cyclic patches become periodic
    connections. Coordinates are in metres. If the case has a mesh, its points are the coordinates.

    Raises
    ------
    FormatError
        When there is no blockMeshDict, or it is damaged, uses what is not supported, or is not that of the mesh.
    """
    path = Path(path)
    grid = block_mesh(read_layout(read_dictionary(dictionary_of(path) if is_case(path) else path)))
    form = FoamFormat("openfoam", "float64", {"kind": "blockMeshDict"})
    points = points_file(case_folder(path) / POLY_MESH) if is_case(path) else None
    if points is not None:
        grid, numbering = with_points_of(grid, points)
        form = FoamFormat("openfoam", "float64", {"kind": "case"}, points.parent, numbering)
    return dataclasses.replace(grid, format=form, path=path)


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How to write ``grid``: ``encoding`` (binary, ascii), ``compression`` (none, gzip), ``thickness`` of a 2-D grid.

    Raises
    ------
    FormatError
        For unknown options and values.
    """
    rest = {key: value for key, value in options.items() if key != "thickness"}
    known = {**_OPTIONS, **({"thickness": ("a length",)} if grid.dimension == 2 else {})}
    chosen = {key: values[0] for key, values in _OPTIONS.items()} | checked_options(path, rest, known)
    if grid.dimension == 2:
        chosen["thickness"] = repr(_thickness(path, options.get("thickness", 1.0)))
    elif "thickness" in options:
        raise FormatError(f"cannot write {path}: thickness is for 2-D grids; this one is 3-D")
    own = grid.format if isinstance(grid.format, FoamFormat) else None
    return FoamFormat("openfoam", "float64", chosen, own.mesh if own else None, own.numbering if own else None)


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid`` as the mesh of the case whose ``.foam`` file is ``path``, or only its points (see above).

    Raises
    ------
    FormatError
        When the grid cannot be such a mesh, or the files cannot be written.
    """
    path = Path(path)
    writer = MeshWriter(grid, variant)
    with replaced_mesh(path) as folder:
        writer.write(folder, grid)


class MeshWriter:
    """Writes the mesh of a grid, and the points of grids that differ from it in coordinates only."""

    def __init__(self, grid: Grid, variant: FileFormat):
        options = variant.options
        self._binary, self._packed = options["encoding"] == "binary", options["compression"] == "gzip"
        self._thickness = float(options.get("thickness", 1.0))
        self._copied = variant.mesh if isinstance(variant, FoamFormat) else None
        self._mesh: PolyMesh | None = None
        if isinstance(variant, FoamFormat) and variant.numbering is not None:
            self._numbering = variant.numbering
            self._nodes: IntArray = np.empty(int(variant.numbering.max()) + 1, dtype=np.int64)
            self._nodes[variant.numbering] = np.arange(grid.n_nodes)
        else:
            self._mesh = poly_mesh(grid, self._thickness)
            self._nodes, self._numbering = self._mesh.nodes, self._mesh.numbering

    def write(self, folder: Path, grid: Grid) -> None:
        """All files of the mesh in an existing folder."""
        if self._mesh is not None:
            write_mesh(folder, self._mesh, self._points(grid), self._binary, self._packed)
            # Faces take several times the memory of points.
            self._mesh = None
            return
        assert self._copied is not None, "the faces are written once"
        for file in mesh_files(self._copied.parents[1]):
            if not file.name.startswith("points"):
                shutil.copyfile(file, folder / file.name)
        self.write_points(folder / ("points.gz" if self._packed else "points"), grid, PLACE)

    def write_points(self, path: Path, grid: Grid, place: str) -> None:
        """The points only; ``place`` is the folder that their header names."""
        write_points(path, self._points(grid), place, self._binary)

    def read_points(self, path: Path) -> FloatArray:
        """Coordinates (n_nodes, 3) of the nodes of the grid from a file of points."""
        points = read_points(path, len(self._nodes))
        if len(points) != len(self._nodes):
            raise FormatError(f"{path} has {len(points):,} points, this mesh has {len(self._nodes):,}")
        return points[self._numbering]

    def _points(self, grid: Grid) -> FloatArray:
        return extruded(grid, self._thickness).points[self._nodes]


def _thickness(path: Path, value: Any) -> float:
    try:
        thickness = float(value)
    except ValueError:
        thickness = 0.0
    if not 0 < thickness < 1e30:
        raise FormatError(f"cannot write {path}: thickness = {value!r}; expected a length")
    return thickness
