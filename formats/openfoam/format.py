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
from meshdeform_core.parallel import ONE_PROCESS, Ranks

from ..files import checked_options
from .block_mesh import block_mesh
from .block_mesh_dict import read_block_mesh_dict
from .case import POLY_MESH, case_folder, dictionary_of, is_case, mesh_files, replaced_mesh
from .dictionary import read_dictionary, written_entry
from .foam_files import read_points, with_points_of, write_points
from .poly_mesh import PolyMesh, extruded, poly_mesh

_OPTIONS = {"encoding": ("binary", "ascii")}
_OF_FACES = ("type", "name", "faces", "nFaces", "startFace")


@dataclass(frozen=True)
class FoamFormat(FileFormat):
    """Format of a grid from a dictionary: the entries of its patches other than type and faces, by name.

    Of a case with a mesh also the folder of the mesh, and the point of every node (n_nodes,).
    """

    entries: Mapping[str, tuple[str, ...]] | None = dataclasses.field(default=None, compare=False, repr=False)
    mesh: Path | None = None
    numbering: IntArray | None = dataclasses.field(default=None, compare=False, repr=False)


def read(path: Path, ranks: Ranks = ONE_PROCESS) -> Grid:
    """Read a blockMeshDict: the file itself, or a case (folder or ``.foam`` file) that has one.

    Patches keep their names, which are their families, too, and their types; cyclic patches become periodic
    connections. Regions that no block side joins are components. Coordinates are in metres. If the case has a mesh, its
    points are the coordinates.
    """
    ranks.require_one(f"{path} is read as a whole")
    dictionary = dictionary_of(path) if is_case(path) else path
    if dictionary is None:
        only = "has an unstructured mesh only" if mesh_files(path) else "has no system/blockMeshDict"
        raise FormatError(f"{case_folder(path)} {only}; expected an OpenFOAM case with a system/blockMeshDict")
    layout = read_block_mesh_dict(read_dictionary(dictionary))
    grid = block_mesh(layout)
    entries = {}
    for patch in layout.patches:
        own = ((key, value) for key, value in patch.content.entries.items() if key not in _OF_FACES)
        entries[patch.name] = tuple(written_entry(key, value) for key, value in own)
    form = FoamFormat("openfoam", "float64", {"kind": "blockMeshDict"}, entries)
    mesh = case_folder(path) / POLY_MESH
    if is_case(path) and any(file.name.startswith("points") for file in mesh_files(path)):
        grid, numbering = with_points_of(grid, mesh)
        form = dataclasses.replace(form, options={"kind": "case"}, mesh=mesh, numbering=numbering)
    return dataclasses.replace(grid, format=form, path=path)


def variant(grid: Grid, path: Path, options: Mapping[str, Any]) -> FileFormat:
    """How to write ``grid``: ``encoding`` (binary, ascii), ``thickness`` of a 2-D grid."""
    rest = {key: value for key, value in options.items() if key != "thickness"}
    known = {**_OPTIONS, **({"thickness": ("a length",)} if grid.dimension == 2 else {})}
    chosen = {key: values[0] for key, values in _OPTIONS.items()} | checked_options(f"cannot write {path}", rest, known)
    if grid.dimension == 2:
        given = options.get("thickness", 1.0)
        try:
            thickness = float(given)
        except ValueError:
            thickness = 0.0
        if not 0 < thickness < 1e30:
            raise FormatError(f"cannot write {path}: thickness = {given!r}; expected a length")
        chosen["thickness"] = repr(thickness)
    elif "thickness" in options:
        raise FormatError(f"cannot write {path}: thickness is for 2-D grids; this one is 3-D")
    own = grid.format if isinstance(grid.format, FoamFormat) else FoamFormat("openfoam")
    return dataclasses.replace(own, precision="float64", options=chosen)


def write(grid: Grid, path: Path, variant: FileFormat) -> None:
    """Write ``grid`` as the mesh of the case whose ``.foam`` file is ``path``, or only its points (see above)."""
    writer = MeshWriter(grid, variant)
    with replaced_mesh(Path(path)) as folder:
        writer.write(folder, grid)


class MeshWriter:
    """Writes the mesh of a grid, and the points of grids that differ from it in coordinates only."""

    def __init__(self, grid: Grid, variant: FileFormat):
        assert isinstance(variant, FoamFormat)
        self._binary = variant.options["encoding"] == "binary"
        self._thickness = float(variant.options.get("thickness", 1.0))
        self._copied = variant.mesh
        self._mesh: PolyMesh | None = None
        if variant.numbering is not None:
            self._numbering = variant.numbering
            self._nodes: IntArray = np.empty(int(variant.numbering.max()) + 1, dtype=np.int64)
            self._nodes[variant.numbering] = np.arange(grid.n_nodes)
        else:
            self._mesh = poly_mesh(grid, self._thickness, variant.entries)
            self._nodes, self._numbering = self._mesh.nodes, self._mesh.numbering

    def write(self, folder: Path, grid: Grid) -> None:
        """All files of the mesh in an existing folder, once."""
        if self._mesh is not None:
            self._mesh.write(folder, self._binary)
            # Faces take several times the memory of points.
            self._mesh = None
        elif self._copied is not None:
            for file in mesh_files(self._copied.parents[1]):
                if not file.name.startswith("points"):
                    shutil.copyfile(file, folder / file.name)
        self.write_points(folder / "points", grid, POLY_MESH.as_posix())

    def write_points(self, path: Path, grid: Grid, place: str) -> None:
        """The points only; ``place`` is the folder that their header names."""
        write_points(path, extruded(grid, self._thickness).points[self._nodes], place, self._binary)

    def read_points(self, path: Path) -> FloatArray:
        """Coordinates (n_nodes, 3) of the nodes of the grid from a file of points."""
        points = read_points(path, len(self._nodes))
        if len(points) != len(self._nodes):
            raise FormatError(f"{path} has {len(points):,} points, this mesh has {len(self._nodes):,}")
        return points[self._numbering]
