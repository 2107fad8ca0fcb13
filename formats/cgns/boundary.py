"""Boundary conditions (BC_t) of structured zones as patches: their point sets as rectangles of nodes on block faces."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import IntArray, Patch, Shape, Side, Window
from meshdeform_core.grid.windows import windows_of_quads

from .file import Notes
from .tree import Node
from .zone import Base, Zone

_POINT_SETS = ("PointRange", "PointList", "ElementRange", "ElementList")
# Index axis normal to the faces of each location; for the first two it follows from the indices.
_FACE_LOCATIONS: Mapping[str, int | None] = {
    "FaceCenter": None,
    "EdgeCenter": None,
    "IFaceCenter": 0,
    "JFaceCenter": 1,
    "KFaceCenter": 2,
}


def family_conditions(base: Base) -> dict[str, str]:
    """The boundary condition that each Family_t prescribes, by family name."""
    families = base.node.labelled("Family_t")
    return {node.name: condition.text() for node in families for condition in node.labelled("FamilyBC_t")[:1]}


def zone_patches(zone: Zone, block: int, families: Mapping[str, str], notes: Notes) -> list[Patch]:
    """One patch per BC_t of the zone, in file order, with its name; names are unique only within a zone."""
    patches = []
    for group in zone.node.labelled("ZoneBC_t"):
        for condition in group.labelled("BC_t"):
            windows = condition_windows(condition, zone, block, notes)
            if windows:
                named = condition.labelled("FamilyName_t") + condition.labelled("AdditionalFamilyName_t")
                family, bc_type = named[0].text() if named else "", condition.text()
                if bc_type == "FamilySpecified":
                    bc_type = families.get(family.rsplit("/", 1)[-1], bc_type)
                patches.append(Patch(condition.name, tuple(windows), family, bc_type))
    return patches


def condition_windows(condition: Node, zone: Zone, block: int, notes: Notes) -> list[Window]:
    """Windows of a boundary condition; points that are not on a block face are noted and ignored, indices beyond the
    zone refused: an ignored wall would not move with the others."""
    place = f"{zone.name}/{condition.name}"
    sets = [child for name in _POINT_SETS for child in condition.target.children if child.name == name]
    for child in sets:
        child.require_target()
    if not sets:
        notes.add("boundary conditions without a point set are not used", place)
        return []
    # ElementRange and ElementList are old names for face centres.
    location = "FaceCenter"
    if not sets[0].name.startswith("Element"):
        location = next((node.text() for node in condition.labelled("GridLocation_t")), "Vertex")
    axes, is_range = len(zone.core), sets[0].name.endswith("Range")
    if sets[0].target.dims == (axes,):  # a single point, stored without the second dimension
        indices = sets[0].integers(axes).reshape(axes, 1)
    else:
        indices = sets[0].integers(axes, 2 if is_range else -1)
    points = np.zeros((indices.shape[1], 3), np.int64)
    points[:, :axes] = indices.T - 1
    _require_inside(points, zone, np.array(zone.shape), sets[0].path)
    if location == "Vertex":
        windows, unused = _of_nodes(points, is_range, zone.shape, block)
    elif location in _FACE_LOCATIONS:
        axis = _FACE_LOCATIONS[location]
        if axis is None:
            # The axis at whose ends the faces lie; ``None`` if there is none or the indices allow several.
            ends = np.array(zone.shape) - 1
            constant = (points == points[0]).all(axis=0) if is_range else True
            at_end = ((points == 0) | (points == ends)).all(axis=0) & constant & (ends > 0)
            normal = np.flatnonzero(at_end)
            if len(normal) > 1:  # across a single layer of cells every face has the index 1
                normal = normal[ends[normal] > 1]
            axis = int(normal[0]) if len(normal) == 1 else None
        windows, unused = _of_faces(points, is_range, zone, block, axis, sets[0].path)
    else:
        notes.add(f"boundary conditions located at {location} are not used", place)
        return []
    if not windows:
        notes.add("boundary conditions that cover no part of a block face are not used", place)
    elif unused:
        notes.add("listed points that belong to no part of a block face are not used", f"{place} ({unused})")
    return windows


def _require_inside(points: IntArray, zone: Zone, sizes: IntArray, place: str) -> None:
    outside = ((points < 0) | (points >= sizes)).any(axis=1)
    if outside.any():
        axes = len(zone.core)
        raise FormatError(
            f"{place} has the index {(points[outside][0] + 1)[:axes].tolist()}; zone {zone.name} ends at "
            f"{sizes[:axes].tolist()}: correct the boundary condition"
        )


def _of_nodes(points: IntArray, is_range: bool, shape: Shape, block: int) -> tuple[list[Window], int]:
    """Windows, and the number of nodes that belong to none of them."""
    if not is_range:
        return windows_of_nodes(shape, block, points)
    window = window_of_range(shape, block, points.min(axis=0).tolist(), points.max(axis=0).tolist())
    return ([window] if window else []), 0


def _of_faces(
    points: IntArray, is_range: bool, zone: Zone, block: int, axis: int | None, place: str
) -> tuple[list[Window], int]:
    """Faces are numbered like their lowest node: by nodes along their normal, by cells along the other axes."""
    if axis is None:
        return [], len(points)
    faces = np.array([n if a == axis else max(n - 1, 1) for a, n in enumerate(zone.shape)])
    _require_inside(points, zone, faces, place)
    if is_range:
        last = points.max(axis=0) + [int(a != axis and n > 1) for a, n in enumerate(zone.shape)]
        return _of_nodes(np.array([points.min(axis=0), last]), True, zone.shape, block)
    windows, used = [], 0
    for side in (Side(2 * axis), Side(2 * axis + 1)):
        a, b = side.tangential
        on_side = points[:, axis] == side.layer(faces.tolist())
        quads = np.zeros((faces[a], faces[b]), bool)
        quads[points[on_side, a], points[on_side, b]] = True
        windows += windows_of_quads(zone.shape, block, side, quads)
        used += int(on_side.sum())
    return windows, len(points) - used


def window_of_range(shape: Shape, block: int, low: Sequence[int], high: Sequence[int]) -> Window | None:
    """The window of the nodes ``low`` .. ``high`` (i, j, k, 0-based, inclusive), or ``None`` if not on a block face.

    The range must be constant along one index axis of more than one node, at its first or last node.
    """
    constant = [axis for axis in range(3) if low[axis] == high[axis] and shape[axis] > 1]
    if len(constant) != 1 or low[constant[0]] not in (0, shape[constant[0]] - 1):
        return None
    axis = constant[0]
    side = Side(2 * axis + (low[axis] > 0))
    a, b = side.tangential
    return Window(block, side, (low[a], low[b]), (high[a], high[b]))


def windows_of_nodes(shape: Shape, block: int, nodes: IntArray) -> tuple[list[Window], int]:
    """Windows of the block faces' quads whose corners are all among ``nodes`` ``(n, 3)`` (0-based), as rectangles.

    Also returns the number of nodes that belong to none of them.
    """
    windows: list[Window] = []
    unused = np.ones(len(nodes), bool)
    for side in (side for side in Side if shape[side.axis] > 1):
        a, b = side.tangential
        on_side = nodes[:, side.axis] == side.layer(shape)
        member = np.zeros((shape[a], shape[b]), bool)
        member[nodes[on_side, a], nodes[on_side, b]] = True
        # Quads (edges in a 2-D grid) all of whose corners are members; then the corners of these.
        quads = member
        for axis in (0, 1):
            n = quads.shape[axis]
            if n > 1:
                quads = quads.take(range(1, n), axis) & quads.take(range(n - 1), axis)
        windows += windows_of_quads(shape, block, side, quads)
        corners = np.zeros(member.shape, bool)
        for i, j in np.ndindex(member.shape[0] - quads.shape[0] + 1, member.shape[1] - quads.shape[1] + 1):
            corners[i : i + quads.shape[0], j : j + quads.shape[1]] |= quads
        unused[on_side] &= ~corners[nodes[on_side, a], nodes[on_side, b]]
    return windows, int(unused.sum())
