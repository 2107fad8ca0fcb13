"""OpenFOAM's mesh (constant/polyMesh) of a grid, and its files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.grid.topology import cells_behind, find_topology

from ...unstructured.numbering import point_numbers
from .boundary import BoundaryPatch, boundary_patches
from .extrusion import extruded
from .lists import write_dictionary, write_faces, write_labels, write_points
from .numbering import internal_faces, kept_corners

PLACE = "constant/polyMesh"
_LARGEST_LABEL = 2**31 - 1


@dataclass(frozen=True, eq=False)
class PolyMesh:
    """Points, faces and patches.

    Attributes
    ----------
    nodes : (n_points,) the node of the grid, extruded if it is 2-D, that each point was taken from
    numbering : (n_nodes,) the point of every node of the grid itself
    corners : (n_faces, 4) points of the faces, internal ones first; ``kept`` which of them count (triangles: three)
    owner : (n_faces,) cells; neighbour : (n_internal,)
    patches : name, type, further entries, and number of faces of each patch, in order
    """

    nodes: IntArray
    numbering: IntArray
    corners: IntArray
    kept: np.ndarray
    owner: IntArray
    neighbour: IntArray
    patches: tuple[tuple[BoundaryPatch, int], ...]
    n_cells: int

    @property
    def note(self) -> str:
        """The sizes, as OpenFOAM writes them into the headers of owner and neighbour."""
        return (
            f"nPoints: {len(self.nodes)}  nCells: {self.n_cells}  nFaces: {len(self.owner)}  "
            f"nInternalFaces: {len(self.neighbour)}"
        )


def poly_mesh(grid: Grid, thickness: float) -> PolyMesh:
    """The mesh of a grid; a 2-D grid becomes one layer of cells of this thickness.

    Raises
    ------
    FormatError
        When the grid cannot be such a mesh, or is too large for labels of 32 bits.
    """
    solid = extruded(grid, thickness)
    topology = find_topology(solid)
    number, nodes = point_numbers(solid, topology)
    cells = cells_behind(solid, topology, np.arange(len(topology.partner)))
    inside = internal_faces(solid, topology, number)
    patches = boundary_patches(solid, topology, cells)
    corners = np.concatenate([inside.corners, *(patch.corners for patch in patches)])
    owner = np.concatenate([inside.owner, *(cells[patch.quads] for patch in patches)])
    if corners.size > _LARGEST_LABEL:
        raise FormatError(f"a mesh of {len(owner):,} faces is too large for labels of 32 bits")
    return PolyMesh(
        nodes, _of_plane(grid, solid, number), corners, kept_corners(corners), owner, inside.neighbour,
        tuple((patch, len(patch.quads)) for patch in patches), solid.n_cells,
    )  # fmt: skip


def _of_plane(grid: Grid, solid: Grid, number: NDArray[Any]) -> IntArray:
    """The numbers of the nodes of a 2-D grid, which are the first layer of the extruded one."""
    if grid.dimension == 3:
        return number
    layers = [np.take(solid.block(b, number), 0, axis=shape.index(1)).ravel() for b, shape in enumerate(grid.shapes)]
    return np.concatenate(layers)


def write_mesh(folder: Path, mesh: PolyMesh, points: FloatArray, binary: bool, packed: bool) -> None:
    """The files of a mesh in an existing folder; ``points`` (n_points, 3)."""
    suffix = ".gz" if packed else ""
    write_faces(folder / f"faces{suffix}", mesh.corners, mesh.kept, PLACE, binary)
    write_labels(folder / f"owner{suffix}", mesh.owner, PLACE, binary, mesh.note)
    write_labels(folder / f"neighbour{suffix}", mesh.neighbour, PLACE, binary, mesh.note)
    text = _boundary_text(mesh.patches, len(mesh.neighbour))
    write_dictionary(folder / "boundary", "polyBoundaryMesh", PLACE, text)
    write_points(folder / f"points{suffix}", points, PLACE, binary)


def _boundary_text(patches: Sequence[tuple[BoundaryPatch, int]], first: int) -> str:
    lines = [f"{len(patches)}", "("]
    for patch, count in patches:
        entries = [f"type            {patch.type};", f"nFaces          {count};", f"startFace       {first};"]
        lines += [f"    {patch.name}", "    {", *(f"        {entry}" for entry in (*entries, *patch.entries)), "    }"]
        first += count
    return "\n".join([*lines, ")", ""])
