"""The boundary of a polyMesh: patches with their types, and pairs of cyclic patches whose faces correspond."""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from meshdeform_core.grid import BoolArray, FloatArray, Grid, IntArray, Side
from meshdeform_core.grid.connectivity.declared import periodic_image, periodic_rotation
from meshdeform_core.grid.faces.roles import Role, role_of_patch
from meshdeform_core.grid.planes import plane_of
from meshdeform_core.grid.sides import end_planes
from meshdeform_core.grid.topology import Topology, is_wall, side_nodes

from ..markers import Marker, find_markers

# Characters that a word of a dictionary may not have.
_FORBIDDEN = re.compile(r"[\s\"'/;{}()$#\[\]]+")
_ALONG_AXIS = 1e-6
"""Deviation of the direction across the layer from an axis, relative to the thickness."""


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
        markers = [part for marker in markers for part in _parted(marker, ends)]
    names = dict(zip((marker.name for marker in markers), _words([marker.name for marker in markers]), strict=True))
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


def _parted(marker: Marker, ends: BoolArray) -> list[Marker]:
    """Split off the faces of a family that lie on the two sides of a plane grid."""
    own = ends[marker.quads]
    if marker.partner or own.all() or not own.any():
        return [marker]
    rest = Marker(marker.name, marker.quads[~own], marker.patch)
    return [rest, Marker(f"{marker.name}_empty", marker.quads[own], marker.patch)]


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


def _words(names: Sequence[str]) -> list[str]:
    """The names converted to distinct words of OpenFOAM."""
    found: list[str] = []
    for name in names:
        word = plain = name if not _FORBIDDEN.search(name) else _FORBIDDEN.sub("_", name).strip("_") or "patch"
        count = 1
        while word in found:
            count += 1
            word = f"{plain}_{count}"
        found.append(word)
    return found


def _cyclic_entries(marker: Marker, markers: Sequence[Marker], names: Mapping[str, str]) -> tuple[str, ...]:
    if not marker.partner:
        return ()
    motion = marker.motion or next(other.motion for other in markers if other.name == marker.partner)
    assert motion is not None
    sign = 1.0 if marker.motion is not None else -1.0
    lines = [f"neighbourPatch  {names[marker.partner]};", "matchTolerance  0.0001;"]
    turn, shift = (
        scipy.spatial.transform.Rotation.from_matrix(periodic_rotation(motion)).as_rotvec(),
        np.array(motion.translation),
    )
    if not np.any(turn):
        return (*lines, "transform       translational;", f"separationVector {_vector(sign * shift)};")
    if np.any(shift):
        return (*lines, "transform       unknown;")
    axis = turn / np.linalg.norm(turn)
    return (
        *lines, "transform       rotational;", f"rotationAxis    {_vector(axis)};",
        f"rotationCentre  {_vector(np.array(motion.rotation_center))};",
    )  # fmt: skip


def _vector(values: FloatArray) -> str:
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
