"""Boundary conditions (BC_t) of structured zones as patches: their point sets as rectangles of nodes on block faces.

One-to-one connections, including periodic ones; other types are only noted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Grid, IntArray, Patch, Periodicity, Shape, Side, Window
from meshdeform_core.grid.connections import periodic_image, periodic_rotation
from meshdeform_core.grid.windows import windows_of_quads

from .tree import Node
from .zone import Base, Notes, Zone, declared_unit

_POINT_SETS = ("PointRange", "PointList", "ElementRange", "ElementList")
# Index axis normal to the faces of each location; for the first two it follows from the indices.
_FACE_LOCATIONS = {"FaceCenter": None, "EdgeCenter": None, "IFaceCenter": 0, "JFaceCenter": 1, "KFaceCenter": 2}


def zone_patches(zone: Zone, block: int, families: Mapping[str, str], notes: Notes) -> list[Patch]:
    """One patch per BC_t of the zone, in file order, with its name; names are unique only within a zone.

    ``families`` are the boundary conditions that families prescribe.
    """
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
        if is_range:
            windows, unused = windows_of_range(zone.shape, block, points), 0
        else:
            windows, unused = windows_of_nodes(zone.shape, block, points)
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
        return windows_of_range(zone.shape, block, np.array([points.min(axis=0), last])), 0
    windows, used = [], 0
    for side in (Side(2 * axis), Side(2 * axis + 1)):
        a, b = side.tangential
        on_side = points[:, axis] == side.layer(faces.tolist())
        quads = np.zeros((faces[a], faces[b]), bool)
        quads[points[on_side, a], points[on_side, b]] = True
        windows += windows_of_quads(zone.shape, block, side, quads)
        used += int(on_side.sum())
    return windows, len(points) - used


def windows_of_range(shape: Shape, block: int, points: IntArray) -> list[Window]:
    """The window of the nodes between the lowest and the highest of ``points`` (n, 3), or none if not on a block face.

    The range must be constant along one index axis of more than one node, at its first or last node.
    """
    low, high = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    constant = [axis for axis in range(3) if low[axis] == high[axis] and shape[axis] > 1]
    if len(constant) != 1 or low[constant[0]] not in (0, shape[constant[0]] - 1):
        return []
    axis = constant[0]
    side = Side(2 * axis + (low[axis] > 0))
    a, b = side.tangential
    return [Window(block, side, (low[a], low[b]), (high[a], high[b]))]


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


# --- connections

_ANGLE = 4  # position of the angle among the five units of DimensionalUnits_t


def zone_connections(base: Base, zones: Sequence[Zone], grid: Grid, notes: Notes) -> tuple[list[Connection], bool]:
    """The GridConnectivity1to1_t of all zones in file order, and whether several zones are connected only by overset
    (Chimera) interpolation: they overlap and share no nodes.

    Interfaces are found from the coordinates, so that a connection which does not match its zones is noted and
    ignored. ``grid`` has the coordinates, which resolve angles without a unit.
    """
    blocks = {zone.name: block for block, zone in enumerate(zones)}
    connections, kinds = [], set[str]()
    for block, zone in enumerate(zones):
        groups = zone.node.labelled("ZoneGridConnectivity_t")
        for group in groups:
            # A broken link is refused, as it may be a connection.
            group.labelled("GridConnectivity1to1_t")
        for node in (each for group in groups for each in group.target.children):
            kind, place = _kind(node), f"{zone.name}/{node.name}"
            kinds.add(kind)
            if kind == "1to1":
                # Base/Zone is accepted for the same base.
                donor = blocks.get(node.text().removeprefix(f"{base.node.name}/"))
                connection = None if donor is None else _declared_connection(node, block, donor, zones)
                if connection is None:
                    notes.add("connections that do not match their zones are not used", place)
                    continue
                periodic = periodicity(node, connection, (zone.node, base.node), grid, notes)
                connections.append(replace(connection, periodic=periodic))
            elif kind:
                notes.add(f"{kind} connectivity is kept in the file but not used; coincident nodes stay joined", place)
    joined = {"1to1", "Abutting1to1", "Abutting"} & kinds
    return connections, len(zones) > 1 and "Overset" in kinds and not joined


def _kind(node: Node) -> str:
    """``1to1``, or the type of a general connectivity (Overset if it has none, SIDS 8.4), or nothing."""
    label = node.target.label
    if label == "GridConnectivity1to1_t":
        return "1to1"
    if label == "GridConnectivity_t":
        types = node.labelled("GridConnectivityType_t")
        return types[0].text() if types else "Overset"
    return "Overset" if label == "OversetHoles_t" else ""


def _declared_connection(node: Node, block: int, donor: int, zones: Sequence[Zone]) -> Connection | None:
    axes = len(zones[block].core)
    begin, end = _node_range(node, "PointRange", axes)
    donor_begin, donor_end = _node_range(node, "PointRangeDonor", axes)
    signed = node.child("Transform")
    # Without one the axes correspond in order (SIDS 8.2).
    transform = _three(signed.integers(axes).tolist(), 3) if signed else (1, 2, 3)
    if sorted(abs(axis) for axis in transform) != [1, 2, 3]:
        return None
    reached = list(donor_begin)
    for axis, first, last in zip(transform, begin, end, strict=True):
        reached[abs(axis) - 1] += last - first if axis > 0 else first - last
    shape, donor_shape = zones[block].shape, zones[donor].shape
    corners = (begin, shape), (end, shape), (donor_begin, donor_shape), (donor_end, donor_shape)
    if tuple(reached) != donor_end or not all(
        0 <= p < n for at, size in corners for p, n in zip(at, size, strict=True)
    ):
        return None
    return Connection(node.name, block, begin, end, donor, donor_begin, donor_end, transform)


def _node_range(node: Node, name: str, axes: int) -> tuple[Shape, Shape]:
    """First and last node, 0-based."""
    child = node.child(name)
    if child is None:
        raise FormatError(f"the connection {node.path} has no {name}; every GridConnectivity1to1_t needs one")
    first, last = child.integers(axes, 2).T.tolist()
    return _three([n - 1 for n in first], 0), _three([n - 1 for n in last], 0)


def _three(numbers: Sequence[int], *others: int) -> Shape:
    """Numbers of two or three axes, those of missing axes from the ``others``."""
    a, b, c = (*numbers, *others)[:3]
    return a, b, c


def periodicity(
    node: Node, connection: Connection, outer: Sequence[Node], grid: Grid, notes: Notes
) -> Periodicity | None:
    """The motion that maps the connection's own nodes onto the donor's; ``None`` if it is not periodic.

    Angles are in the unit declared by Periodic_t or ``outer`` (zone, base). Without a declaration both radians (the SI
    unit) and degrees are in use; the one that matches the coordinates of ``grid`` better is taken.
    """
    found = [p for group in node.labelled("GridConnectivityProperty_t") for p in group.labelled("Periodic_t")]
    if not found:
        return None
    center, angle, translation = (
        _vector_of(found[0], name) for name in ("RotationCenter", "RotationAngle", "Translation")
    )
    x, y, z = np.degrees(angle).tolist()
    in_degrees, in_radians = Periodicity(center, angle, translation), Periodicity(center, (x, y, z), translation)
    unit = declared_unit([*found[0].labelled("DataArray_t"), found[0], *outer], _ANGLE)
    if unit in ("Degree", "Radian") or not any(angle):
        return in_degrees if unit == "Degree" else in_radians
    own, donor = grid.block(connection.block), grid.block(connection.donor_block)
    here = np.array([own[connection.begin], own[connection.end]])
    there = np.array([donor[connection.donor_begin], donor[connection.donor_end]])
    # Largest distances between the moved corners of the connection and their donors.
    fits = [np.linalg.norm(periodic_image(here, each) - there, axis=1).max() for each in (in_radians, in_degrees)]
    word, motion = ("degrees", in_degrees) if fits[1] < fits[0] else ("radians", in_radians)
    notes.add(f"periodic angles without a unit are read as {word}, which matches the coordinates", node.name)
    return motion


def _vector_of(periodic: Node, name: str) -> tuple[float, float, float]:
    """A vector with as many components as the base has coordinates, padded with zeros."""
    child = periodic.child(name)
    data = np.zeros(3) if child is None else child.data()
    if child and (data.ndim != 1 or data.size not in (2, 3) or data.dtype.kind != "f"):
        raise FormatError(f"{child.path} holds {data.shape} {data.dtype} values; expected 2 or 3 real numbers")
    x, y, z = (*data.astype(float).tolist(), 0.0)[:3]
    return x, y, z


def inverse_motion(periodic: Periodicity) -> Periodicity:
    """The motion back from the donor: ``x = R^T (x' - c - t) + c``."""
    back = periodic_rotation(periodic).T
    x, y, z = (-back @ np.array(periodic.translation)).tolist()
    about_x, about_y, about_z = (-angle for angle in periodic.rotation_angle)
    if np.count_nonzero(periodic.rotation_angle) > 1:
        # Angles about x, y, z in turn that give the matrix.
        sines = back[2, 1], -back[2, 0], back[1, 0]
        cosines = back[2, 2], np.hypot(back[2, 1], back[2, 2]), back[0, 0]
        about_x, about_y, about_z = np.degrees(np.arctan2(sines, cosines)).tolist()
    return Periodicity(periodic.rotation_center, (about_x, about_y, about_z), (x, y, z))
