"""OpenFOAM's mesh (constant/polyMesh) of a grid: its faces, its patches with their types, and its files.

Cells are numbered block after block. Internal faces are sorted by their owner, the adjacent cell with the smaller
number, then by their neighbour; their normals point from the owner to the neighbour. Source: the OpenFOAM user guide,
"Mesh description".
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray, Side
from meshdeform_core.grid.connections import periodic_image, periodic_rotation
from meshdeform_core.grid.faces import Role, role_of_patch
from meshdeform_core.grid.planes import plane_normal, plane_of
from meshdeform_core.grid.topology import Topology, cells_behind, find_topology, is_wall, separated, side_nodes
from meshdeform_core.grid.windows import end_planes

from ..markers import Marker, find_markers, point_numbers
from ..text import distinct
from .foam_files import write_boundary, write_faces, write_labels

_LARGEST_LABEL = 2**31 - 1
# Characters that a word of a dictionary may not have.
_FORBIDDEN = re.compile(r"[\s\"'/;{}()$#\[\]]+")
_ALONG_AXIS = 1e-6
"""Deviation of the direction across the layer from an axis, relative to the thickness."""


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

    def write(self, folder: Path, binary: bool) -> None:
        """All files but the points in an existing folder."""
        note = (
            f"nPoints: {len(self.nodes)}  nCells: {self.n_cells}  nFaces: {len(self.owner)}  "
            f"nInternalFaces: {len(self.neighbour)}"
        )
        write_faces(folder / "faces", self.corners, self.kept, binary)
        write_labels(folder / "owner", self.owner, binary, note)
        write_labels(folder / "neighbour", self.neighbour, binary, note)
        first = len(self.neighbour) + np.cumsum([0, *(len(patch.quads) for patch in self.patches)])
        texts = [patch.text(start) for patch, start in zip(self.patches, first.tolist(), strict=False)]
        write_boundary(folder / "boundary", texts)


def poly_mesh(grid: Grid, thickness: float, declared: Mapping[str, tuple[str, ...]] | None) -> PolyMesh:
    """The mesh of a grid; a 2-D grid becomes one layer of cells of this thickness.

    ``declared``: as of :func:`boundary_patches`.
    """
    solid = extruded(grid, thickness)
    topology = separated(solid, find_topology(solid))
    number, nodes = point_numbers(solid, topology)
    cells = cells_behind(solid, topology, np.arange(len(topology.partner)))
    corners, owner, neighbour = _internal_faces(solid, topology, number)
    patches = boundary_patches(solid, topology, cells, declared)
    corners = np.concatenate([corners, *(patch.corners for patch in patches)])
    owner = np.concatenate([owner, *(cells[patch.quads] for patch in patches)])
    if corners.size > _LARGEST_LABEL:
        raise FormatError(f"a mesh of {len(owner):,} faces is too large for labels of 32 bits")
    if grid.dimension == 2:
        # The nodes of a 2-D grid are the first layer of the extruded one.
        number = np.concatenate(
            [solid.block(b, number).take(0, axis=shape.index(1)).ravel() for b, shape in enumerate(grid.shapes)]
        )
    folded = np.flatnonzero((corners[:, 0] == corners[:, 2]) | (corners[:, 1] == corners[:, 3]))
    if folded.size:
        raise FormatError(
            f"{folded.size} cell faces pass through one point twice, the first {corners[folded[0]].tolist()}; OpenFOAM "
            "has no such faces"
        )
    kept = corners != np.roll(corners, 1, axis=1)
    return PolyMesh(nodes, number, corners, kept, owner, neighbour, tuple(patches), solid.n_cells)


Faces = tuple[IntArray, IntArray, IntArray]
"""Corners (n, 4), point numbers that turn right-handed about the normal (two successive equal ones in triangles), owner
and neighbour (n,) of faces between cells."""


def _internal_faces(grid: Grid, topology: Topology, number: NDArray[Any]) -> Faces:
    """All faces between two cells, in order; ``number`` as from :func:`point_numbers`."""
    if topology.crowded:
        crowded = f"{topology.crowded} cell faces are shared by more than two blocks"
        raise FormatError(f"{crowded}; OpenFOAM has no such mesh")
    first = grid.cell_offsets
    parts = [
        _within_block(grid.block(b, number), int(first[b]), axis, int(topology.handedness[b]))
        for b in range(grid.n_blocks)
        for axis in range(3)
    ]
    # The faces between blocks; the corners of the owner's quad turn about the outward normal.
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
    parts.append((topology.quads.corners[quads[own]], here[own], there[own]))
    corners, owner, neighbour = (np.concatenate(each) for each in zip(*parts, strict=True))
    order = np.argsort(owner * int(first[-1]) + neighbour, kind="stable")
    # Some are collapsed to lines or points.
    order = order[np.count_nonzero(np.diff(np.sort(corners[order], axis=1), axis=1), axis=1) >= 2]
    return corners[order], owner[order], neighbour[order]


def _within_block(number: NDArray[Any], first: int, axis: int, handedness: int) -> Faces:
    """The faces inside a block between neighbours along ``axis``."""
    ni, nj, nk = number.shape
    cells = first + np.arange((ni - 1) * (nj - 1) * (nk - 1)).reshape(ni - 1, nj - 1, nk - 1)
    inside = np.moveaxis(number, axis, 0)[1:-1]
    # With the other two axes in cyclic order, which they are not across j, their quads turn about +axis.
    turns = ((0, 0), (0, 1), (1, 1), (1, 0)) if axis == 1 else ((0, 0), (1, 0), (1, 1), (0, 1))
    ends = slice(None, -1), slice(1, None)
    corners = np.stack([inside[:, ends[a], ends[b]] for a, b in turns], axis=-1).reshape(-1, 4)
    low, high = (np.moveaxis(cells, axis, 0)[end].ravel() for end in ends)
    return corners if handedness > 0 else corners[:, ::-1], low, high


def extruded(grid: Grid, thickness: float) -> Grid:
    """A 2-D grid as one layer of cells of this thickness along the normal of its plane; 3-D grids are unchanged."""
    normal = plane_normal(grid)
    if normal is None:
        return grid
    flat = [shape.index(1) for shape in grid.shapes]
    blocks = [grid.block(b) for b in range(grid.n_blocks)]
    layers = [np.concatenate([x, x + thickness * normal], axis=axis) for x, axis in zip(blocks, flat, strict=True)]

    def far(block: int, axes: Sequence[int], index: Sequence[int]) -> Any:
        """The index along these axes of a block, in the second layer."""
        return tuple(1 if axis == flat[block] else n for axis, n in zip(axes, index, strict=True))

    patches = [
        dataclasses.replace(patch, windows=tuple(
            dataclasses.replace(w, high=far(w.block, w.side.tangential, w.high)) for w in patch.windows
        ))
        for patch in grid.patches
    ]  # fmt: skip
    connections = []
    for each in grid.connections:
        i, j, k = (flat[each.donor_block] + 1 if axis == flat[each.block] else along
                   for axis, along in enumerate(each.transform))  # fmt: skip
        end, donor_end = far(each.block, range(3), each.end), far(each.donor_block, range(3), each.donor_end)
        connections.append(dataclasses.replace(each, end=end, donor_end=donor_end, transform=(i, j, k)))
    return Grid.from_blocks(
        layers, grid.names, patches=tuple(patches), connections=tuple(connections), format=grid.format, path=grid.path,
        components=grid.components,
    )  # fmt: skip


# --- patches


@dataclass(frozen=True)
class BoundaryPatch:
    """A patch with its faces in order.

    Attributes
    ----------
    quads : (n,) face quads of the topology
    corners : (n, 4) their points, about the outward normal
    entries : lines of the dictionary other than type and ranges
    """

    name: str
    type: str
    quads: IntArray
    corners: IntArray
    entries: tuple[str, ...] = ()

    def text(self, first: int) -> str:
        """Its entry in the boundary file; ``first`` is the number of its first face."""
        lines = [f"type            {self.type};", *self.entries]
        lines += [f"nFaces          {len(self.quads)};", f"startFace       {first};"]
        return "\n".join([f"    {self.name}", "    {", *(f"        {line}" for line in lines), "    }"])


def boundary_patches(
    grid: Grid, topology: Topology, cells: IntArray, declared: Mapping[str, tuple[str, ...]] | None
) -> list[BoundaryPatch]:
    """The patches of a grid; ``cells`` (n_quads,) are the cells beside its face quads, by which faces are ordered.

    ``declared``: types are those of OpenFOAM, and these are further entries of the patches, by name.
    """
    markers = find_markers(grid, topology)
    ends = np.zeros(len(topology.partner), dtype=bool)
    if declared is None:
        ends = np.isin(topology.quads.block_side, empty_sides(grid, topology))
        walls = [marker.quads for marker in markers if marker.patch is not None and is_wall(marker.patch)]
        # Without OpenFOAM's own types, one layer of cells is taken for a plane grid, unless it is between walls.
        ends &= not ends[np.concatenate([np.empty(0, dtype=np.int64), *walls])].any()
        # The faces of a family that lie on the two sides of a plane grid are split off.
        whole, markers = markers, []
        for marker in whole:
            own = ends[marker.quads]
            if marker.partner or own.all() or not own.any():
                markers.append(marker)
            else:
                parts = (marker.name, marker.quads[~own]), (f"{marker.name}_empty", marker.quads[own])
                markers += [Marker(name, quads, marker.patch) for name, quads in parts]
    own_names = [marker.name for marker in markers]
    words = (_FORBIDDEN.sub("_", n).strip("_") or "patch" if _FORBIDDEN.search(n) else n for n in own_names)
    names = dict(zip(own_names, distinct(words), strict=True))
    order: dict[str, IntArray] = {}
    found: dict[str, BoundaryPatch] = {}
    for marker in markers:
        order[marker.name] = order.get(marker.partner, np.argsort(cells[marker.quads], kind="stable"))
        quads = marker.quads[order[marker.name]]
        kind, entries = _type(grid, topology, marker, ends), _cyclic_entries(marker, markers, names)
        if declared is not None and marker.patch is not None and not marker.partner:
            kind, entries = marker.patch.bc_type, declared.get(marker.patch.name, ())
        found[marker.name] = BoundaryPatch(names[marker.name], kind, quads, topology.quads.corners[quads], entries)
    points = grid.points[topology.first]
    for marker in markers:
        if marker.motion is not None:
            # Every face of the second patch begins at the image of the first corner of its partner.
            corners = found[marker.partner].corners
            image = periodic_image(points[found[marker.name].corners[:, 0]], marker.motion)
            nearest = np.linalg.norm(points[corners] - image[:, None], axis=2).argmin(axis=1)
            turned = np.take_along_axis(corners, (nearest[:, None] + np.arange(4)) % 4, axis=1)
            found[marker.partner] = dataclasses.replace(found[marker.partner], corners=turned)
    return list(found.values())


def _type(grid: Grid, topology: Topology, marker: Marker, ends: BoolArray) -> str:
    """The type of a patch that the source calls by the name of another format, or not at all."""
    if marker.partner:
        return "cyclic"
    if ends[marker.quads].all() and len(marker.quads):
        return "empty"
    role = role_of_patch(marker.patch) if marker.patch is not None else None
    if role is Role.END and marker.patch is not None:
        return marker.patch.bc_type
    if role is Role.WALL:
        return "wall"
    if role is not Role.SYMMETRY:
        return "patch"
    points = grid.points[topology.first[np.unique(topology.quads.corners[marker.quads])]]
    return "symmetryPlane" if plane_of(points, None) is not None else "symmetry"


def _cyclic_entries(marker: Marker, markers: Sequence[Marker], names: Mapping[str, str]) -> tuple[str, ...]:
    if not marker.partner:
        return ()
    motion = marker.motion or next(other.motion for other in markers if other.name == marker.partner)
    assert motion is not None
    sign = 1.0 if marker.motion is not None else -1.0
    lines = [f"neighbourPatch  {names[marker.partner]};", "matchTolerance  0.0001;"]
    turn = scipy.spatial.transform.Rotation.from_matrix(periodic_rotation(motion)).as_rotvec()
    shift = np.array(motion.translation)
    if not np.any(turn):
        return (*lines, "transform       translational;", f"separationVector {_vector_text(sign * shift)};")
    if np.any(shift):
        return (*lines, "transform       unknown;")
    axis = turn / np.linalg.norm(turn)
    center = _vector_text(np.array(motion.rotation_center))
    lines += ["transform       rotational;", f"rotationAxis    {_vector_text(axis)};", f"rotationCentre  {center};"]
    return tuple(lines)


def _vector_text(values: FloatArray) -> str:
    return "(" + " ".join(repr(value) for value in (values + 0.0).tolist()) + ")"


def empty_sides(grid: Grid, topology: Topology) -> list[int]:
    """The block sides (``6 * block + side``) on both sides of one layer of cells across an axis of coordinates.

    Empty if the grid is not such a layer: OpenFOAM solves in a plane only where it is normal to an axis.
    """
    ends = end_planes(grid, topology)
    if not ends:
        return []
    sides = [grid.points[side_nodes(grid, end // 6, Side(end % 6)).ravel()] for end in ends]
    across = np.concatenate([far - near for near, far in zip(sides[::2], sides[1::2], strict=True)])
    axis = int(np.argmax(np.abs(across).sum(axis=0)))
    uneven = [float(np.abs(np.delete(across, axis, axis=1)).max()), *(float(np.ptp(x[:, axis])) for x in sides)]
    return ends if max(uneven) <= _ALONG_AXIS * float(np.abs(across[:, axis]).min()) else []
