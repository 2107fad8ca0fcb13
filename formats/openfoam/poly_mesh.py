"""OpenFOAM's mesh (constant/polyMesh) of a grid, and its files.

Cells are numbered block after block. Internal faces are sorted by their owner, the adjacent cell with the smaller
number, then by their neighbour; their normals point from the owner to the neighbour. Source: the OpenFOAM user guide,
"Mesh description".
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, IntArray, Patch, Shape, Side
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.topology import Topology, cells_behind, find_topology, separated

from ..markers import point_numbers
from .lists import write_boundary, write_faces, write_labels
from .patches import BoundaryPatch, boundary_patches

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
    patches : in order
    """

    nodes: IntArray
    numbering: IntArray
    corners: IntArray
    kept: np.ndarray
    owner: IntArray
    neighbour: IntArray
    patches: tuple[BoundaryPatch, ...]
    n_cells: int

    def write(self, folder: Path, binary: bool, suffix: str) -> None:
        """All files but the points in an existing folder."""
        note = (
            f"nPoints: {len(self.nodes)}  nCells: {self.n_cells}  nFaces: {len(self.owner)}  "
            f"nInternalFaces: {len(self.neighbour)}"
        )
        write_faces(folder / f"faces{suffix}", self.corners, self.kept, binary)
        write_labels(folder / f"owner{suffix}", self.owner, binary, note)
        write_labels(folder / f"neighbour{suffix}", self.neighbour, binary, note)
        first = len(self.neighbour) + np.cumsum([0, *(len(patch.quads) for patch in self.patches)])
        texts = [patch.text(start) for patch, start in zip(self.patches, first.tolist(), strict=False)]
        write_boundary(folder / "boundary", texts)


def poly_mesh(grid: Grid, thickness: float, declared: Mapping[str, tuple[str, ...]] | None) -> PolyMesh:
    """The mesh of a grid; a 2-D grid becomes one layer of cells of this thickness.

    ``declared``: as of :func:`.patches.boundary_patches`.

    Raises FormatError when the grid cannot be such a mesh, or is too large for labels of 32 bits.
    """
    solid = extruded(grid, thickness)
    topology = separated(solid, find_topology(solid))
    number, nodes = point_numbers(solid, topology)
    cells = cells_behind(solid, topology, np.arange(len(topology.partner)))
    inside = _internal_faces(solid, topology, number)
    patches = boundary_patches(solid, topology, cells, declared)
    corners = np.concatenate([inside.corners, *(patch.corners for patch in patches)])
    owner = np.concatenate([inside.owner, *(cells[patch.quads] for patch in patches)])
    if corners.size > _LARGEST_LABEL:
        raise FormatError(f"a mesh of {len(owner):,} faces is too large for labels of 32 bits")
    if grid.dimension == 2:
        # The nodes of a 2-D grid are the first layer of the extruded one.
        number = np.concatenate(
            [solid.block(b, number).take(0, axis=shape.index(1)).ravel() for b, shape in enumerate(grid.shapes)]
        )
    kept = _kept_corners(corners)
    return PolyMesh(nodes, number, corners, kept, owner, inside.neighbour, tuple(patches), solid.n_cells)


@dataclass(frozen=True)
class _Faces:
    """Faces of cells.

    Attributes
    ----------
    corners : (n, 4) point numbers, right-handed about the normal; two successive equal ones in triangles
    owner, neighbour : (n,) cells
    """

    corners: IntArray
    owner: IntArray
    neighbour: IntArray


def _internal_faces(grid: Grid, topology: Topology, number: NDArray[Any]) -> _Faces:
    """All faces between two cells, in order; ``number`` as from :func:`point_numbers`."""
    if topology.crowded:
        raise FormatError(
            f"{topology.crowded} cell faces are shared by more than two blocks; OpenFOAM has no such mesh"
        )
    first = grid.cell_offsets
    parts = [
        _within_block(grid.block(b, number), int(first[b]), axis, int(topology.handedness[b]))
        for b in range(grid.n_blocks)
        for axis in range(3)
    ]
    parts.append(_between_blocks(grid, topology))
    corners, owner, neighbour = (
        np.concatenate([getattr(part, name) for part in parts]) for name in ("corners", "owner", "neighbour")
    )
    order = np.argsort(owner * int(first[-1]) + neighbour, kind="stable")
    # Some are collapsed to lines or points.
    order = order[np.count_nonzero(np.diff(np.sort(corners[order], axis=1), axis=1), axis=1) >= 2]
    return _Faces(corners[order], owner[order], neighbour[order])


def _within_block(number: NDArray[Any], first: int, axis: int, handedness: int) -> _Faces:
    """The faces inside a block between neighbours along ``axis``."""
    ni, nj, nk = number.shape
    cells = first + np.arange((ni - 1) * (nj - 1) * (nk - 1)).reshape(ni - 1, nj - 1, nk - 1)
    inside = np.moveaxis(number, axis, 0)[1:-1]
    # With the other two axes in cyclic order, going round their quads in index order turns about +axis.
    if axis == 1:
        inside = inside.swapaxes(1, 2)
    corners = np.stack([inside[:, :-1, :-1], inside[:, 1:, :-1], inside[:, 1:, 1:], inside[:, :-1, 1:]], axis=-1)
    if axis == 1:
        corners = corners.swapaxes(1, 2)
    corners = corners.reshape(-1, 4)
    low, high = (np.moveaxis(cells, axis, 0)[part].ravel() for part in (slice(None, -1), slice(1, None)))
    return _Faces(corners if handedness > 0 else corners[:, ::-1], low, high)


def _between_blocks(grid: Grid, topology: Topology) -> _Faces:
    """The faces between blocks; the corners of the owner's quad turn about the outward normal."""
    quads = np.flatnonzero(topology.partner >= 0)
    here, there = (cells_behind(grid, topology, own) for own in (quads, topology.partner[quads]))
    if (here == there).any():
        quad = int(quads[int(np.argmax(here == there))])
        block, side = divmod(int(topology.quads.block_side[quad]), 6)
        raise FormatError(
            f"{grid.names[block]}.{Side(side).label}: a cell is its own neighbour; OpenFOAM has no such mesh, use two "
            "cells"
        )
    own = here < there
    return _Faces(topology.quads.corners[quads[own]], here[own], there[own])


def _kept_corners(corners: IntArray) -> np.ndarray:
    """(n, 4) bool: corners that differ from the one before, which are those of the polygon."""
    folded = np.flatnonzero((corners[:, 0] == corners[:, 2]) | (corners[:, 1] == corners[:, 3]))
    if folded.size:
        raise FormatError(
            f"{folded.size} cell faces pass through one point twice, the first {corners[folded[0]].tolist()}; OpenFOAM "
            "has no such faces"
        )
    return corners != np.roll(corners, 1, axis=1)


def extruded(grid: Grid, thickness: float) -> Grid:
    """A 2-D grid as one layer of cells of this thickness along the normal of its plane; 3-D grids are unchanged."""
    normal = plane_normal(grid)
    if normal is None:
        return grid
    flat = [shape.index(1) for shape in grid.shapes]
    blocks = [grid.block(b) for b in range(grid.n_blocks)]
    layers = [np.concatenate([x, x + thickness * normal], axis=axis) for x, axis in zip(blocks, flat, strict=True)]
    return Grid.from_blocks(
        layers, grid.names, patches=tuple(_extruded_patch(patch, flat) for patch in grid.patches),
        connections=tuple(_extruded_connection(each, flat[each.block], flat[each.donor_block])
                          for each in grid.connections),
        format=grid.format, path=grid.path, components=grid.components,
    )  # fmt: skip


def _extruded_patch(patch: Patch, flat: list[int]) -> Patch:
    windows = []
    for window in patch.windows:
        a, b = (1 if axis == flat[window.block] else high
                for axis, high in zip(window.side.tangential, window.high, strict=True))  # fmt: skip
        windows.append(dataclasses.replace(window, high=(a, b)))
    return dataclasses.replace(patch, windows=tuple(windows))


def _extruded_connection(connection: Connection, flat: int, donor: int) -> Connection:
    def far(index: Shape, axis: int) -> Shape:
        i, j, k = (1 if a == axis else n for a, n in enumerate(index))
        return i, j, k

    i, j, k = (donor + 1 if axis == flat else along for axis, along in enumerate(connection.transform))
    return dataclasses.replace(
        connection, end=far(connection.end, flat), donor_end=far(connection.donor_end, donor), transform=(i, j, k)
    )
