"""The boundary of a polyMesh: patches with their types, and pairs of cyclic patches whose faces correspond."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from meshdeform_core.grid import FloatArray, Grid, IntArray, Periodicity
from meshdeform_core.grid.connectivity.declared import periodic_rotation
from meshdeform_core.grid.faces.roles import Role, role_of_patch
from meshdeform_core.grid.planes import plane_of
from meshdeform_core.grid.topology import Topology

from ...unstructured.markers import Marker, find_markers
from .extrusion import empty_sides

_OWN_TYPES = ("patch", "wall", "symmetry", "symmetryPlane", "empty", "wedge")
# Characters that a word of a dictionary may not have.
_FORBIDDEN = re.compile(r"[\s\"'/;{}()$#\[\]]+")


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


def boundary_patches(grid: Grid, topology: Topology, cells: IntArray) -> list[BoundaryPatch]:
    """The patches of a grid; ``cells`` (n_quads,) are the cells beside its face quads, by which faces are ordered."""
    ends = np.isin(topology.quads.block_side, empty_sides(grid, topology))
    markers = [part for marker in find_markers(grid, topology) for part in _parted(marker, ends)]
    words = _words([marker.name for marker in markers])
    names = {marker.name: word for marker, word in zip(markers, words, strict=True)}
    order: dict[str, IntArray] = {}
    found = []
    for marker in markers:
        if marker.partner in order:
            rows = order[marker.partner]
        else:
            rows = order[marker.name] = np.argsort(cells[marker.quads], kind="stable")
        quads = marker.quads[rows]
        found.append(
            BoundaryPatch(names[marker.name], _type(grid, topology, marker, ends), quads, topology.quads.corners[quads],
                          _entries(marker, markers, names))
        )  # fmt: skip
    return _aligned(grid, topology, markers, found)


def _parted(marker: Marker, ends: np.ndarray) -> list[Marker]:
    """Split off the faces of a family that lie on the two sides of a plane grid."""
    own = ends[marker.quads]
    if marker.partner or own.all() or not own.any():
        return [marker]
    rest = Marker(marker.name, marker.quads[~own], marker.patch)
    return [rest, Marker(f"{marker.name}_empty", marker.quads[own], marker.patch)]


def _type(grid: Grid, topology: Topology, marker: Marker, ends: np.ndarray) -> str:
    if marker.partner:
        return "cyclic"
    if ends[marker.quads].all():
        return "empty"
    own = marker.patch.bc_type if marker.patch is not None else ""
    if own in _OWN_TYPES and own != "empty":
        return own
    role = role_of_patch(marker.patch) if marker.patch is not None else None
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
        word = plain = _FORBIDDEN.sub("_", name).strip("_") or "patch"
        count = 1
        while word in found:
            count += 1
            word = f"{plain}_{count}"
        found.append(word)
    return found


def _entries(marker: Marker, markers: Sequence[Marker], names: dict[str, str]) -> tuple[str, ...]:
    if not marker.partner:
        return ()
    motion = marker.motion or next(other.motion for other in markers if other.name == marker.partner)
    assert motion is not None
    sign = 1.0 if marker.motion is not None else -1.0
    lines = [f"neighbourPatch  {names[marker.partner]};", "matchTolerance  0.0001;"]
    turn, shift = Rotation.from_matrix(periodic_rotation(motion)).as_rotvec(), np.array(motion.translation)
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


def _aligned(
    grid: Grid, topology: Topology, markers: Sequence[Marker], patches: list[BoundaryPatch]
) -> list[BoundaryPatch]:
    """The second patch of each pair, with every face starting at the image of the first corner of its partner."""
    by_name = {marker.name: number for number, marker in enumerate(markers)}
    points = grid.points[topology.first]
    for number, marker in enumerate(markers):
        if marker.motion is None:
            continue
        other = by_name[marker.partner]
        corners = patches[other].corners
        image = _moved(points[patches[number].corners[:, 0]], marker.motion)
        nearest = np.linalg.norm(points[corners] - image[:, None], axis=2).argmin(axis=1)
        turned = np.take_along_axis(corners, (nearest[:, None] + np.arange(4)) % 4, axis=1)
        patches[other] = BoundaryPatch(
            patches[other].name, "cyclic", patches[other].quads, turned, patches[other].entries
        )
    return patches


def _moved(points: FloatArray, motion: Periodicity) -> FloatArray:
    center = np.array(motion.rotation_center)
    return np.asarray((points - center) @ periodic_rotation(motion).T + center + np.array(motion.translation))
