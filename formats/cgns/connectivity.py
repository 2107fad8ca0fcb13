"""Connectivity of structured zones: one-to-one connections, including periodic ones; other types are only noted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, FloatArray, Grid, Periodicity, Shape
from meshdeform_core.grid.connections import periodic_image, periodic_rotation

from .file import Notes
from .tree import Node
from .zone import Base, Zone, declared_unit

_ANGLE = 4  # position of the angle among the five units of DimensionalUnits_t


def overset_only(zones: Sequence[Zone]) -> bool:
    """Whether several zones are connected only by overset (Chimera) interpolation: they overlap and share no nodes."""
    kinds = [_kind(node) for zone in zones for group in _groups(zone) for node in _members(group)]
    return len(zones) > 1 and "Overset" in kinds and not {"1to1", "Abutting1to1", "Abutting"} & set(kinds)


def zone_connections(base: Base, zones: Sequence[Zone], grid: Grid, notes: Notes) -> list[Connection]:
    """The GridConnectivity1to1_t of all zones in file order.

    Interfaces are found from the coordinates, so that a connection which does not match its zones is noted and
    ignored. ``grid`` has the coordinates, which resolve angles without a unit.
    """
    blocks = {zone.name: block for block, zone in enumerate(zones)}
    connections = []
    for block, zone in enumerate(zones):
        for group in _groups(zone):
            for node in _members(group):
                kind, place = _kind(node), f"{zone.name}/{node.name}"
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
                    notes.add(
                        f"{kind} connectivity is kept in the file but not used; coincident nodes stay joined", place
                    )
    return connections


def _groups(zone: Zone) -> list[Node]:
    return zone.node.labelled("ZoneGridConnectivity_t")


def _members(group: Node) -> Sequence[Node]:
    """The members of a ZoneGridConnectivity_t; broken links are refused, as they may be connections."""
    group.labelled("GridConnectivity1to1_t")
    return group.target.children


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
    center = _vector_of(found[0], "RotationCenter")
    angle = _vector_of(found[0], "RotationAngle")
    translation = _vector_of(found[0], "Translation")
    degrees = np.degrees(angle)
    unit = declared_unit([*found[0].labelled("DataArray_t"), found[0], *outer], _ANGLE)
    if unit == "Degree":
        degrees = angle
    elif unit != "Radian" and angle.any():
        own, donor = grid.block(connection.block), grid.block(connection.donor_block)
        here = np.array([own[connection.begin], own[connection.end]])
        there = np.array([donor[connection.donor_begin], donor[connection.donor_end]])
        # Largest distances between the moved corners of the connection and their donors.
        images = (periodic_image(here, _periodicity_of(center, value, translation)) for value in (degrees, angle))
        fits = [np.linalg.norm(image - there, axis=1).max() for image in images]
        degrees = angle if fits[1] < fits[0] else degrees
        word = "degrees" if fits[1] < fits[0] else "radians"
        notes.add(f"periodic angles without a unit are read as {word}, which matches the coordinates", node.name)
    return _periodicity_of(center, degrees, translation)


def _periodicity_of(center: FloatArray, degrees: FloatArray, translation: FloatArray) -> Periodicity:
    (cx, cy, cz), (ax, ay, az), (tx, ty, tz) = (v.tolist() for v in (center, degrees, translation))
    return Periodicity((cx, cy, cz), (ax, ay, az), (tx, ty, tz))


def _vector_of(periodic: Node, name: str) -> FloatArray:
    """A vector with as many components as the base has coordinates, padded with zeros."""
    child = periodic.child(name)
    values = np.zeros(3)
    if child is None:
        return values
    data = child.data()
    if data.ndim != 1 or data.size not in (2, 3) or data.dtype.kind != "f":
        raise FormatError(f"{child.path} holds {data.shape} {data.dtype} values; expected 2 or 3 real numbers")
    values[: data.size] = data
    return values


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
