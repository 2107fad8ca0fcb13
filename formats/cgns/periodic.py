"""The rigid motion of a periodic connection (Periodic_t), with its angles in degrees."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, FloatArray, Grid, Periodicity

from .notes import Notes
from .tree import Node

_ANGLE = 4  # position of the angle among the five units of DimensionalUnits_t


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
    center = _vector(found[0], "RotationCenter")
    angle = _vector(found[0], "RotationAngle")
    translation = _vector(found[0], "Translation")
    degrees = np.degrees(angle)
    unit = _angle_unit([*found[0].labelled("DataArray_t"), found[0], *outer])
    if unit == "Degree":
        degrees = angle
    elif unit != "Radian" and angle.any():
        fits = [_misfit(connection, grid, center, value, translation) for value in (degrees, angle)]
        degrees = angle if fits[1] < fits[0] else degrees
        word = "degrees" if fits[1] < fits[0] else "radians"
        notes.add(f"periodic angles without a unit are read as {word}, which matches the coordinates", node.name)
    (cx, cy, cz), (ax, ay, az), (tx, ty, tz) = (v.tolist() for v in (center, degrees, translation))
    return Periodicity((cx, cy, cz), (ax, ay, az), (tx, ty, tz))


def rotation_matrix(degrees: FloatArray) -> FloatArray:
    """Rotation about the x axis, then y, then z, by ``degrees`` (3,) (SIDS 8.5.1)."""
    (sx, sy, sz), (cx, cy, cz) = np.sin(np.radians(degrees)), np.cos(np.radians(degrees))
    about_x = np.array([[1, 0, 0], [0, cx, -sx], [0, sx, cx]])
    about_y = np.array([[cy, 0, sy], [0, 1, 0], [-sy, 0, cy]])
    about_z = np.array([[cz, -sz, 0], [sz, cz, 0], [0, 0, 1]])
    return np.asarray(about_z @ about_y @ about_x)


def _vector(periodic: Node, name: str) -> FloatArray:
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


def _angle_unit(places: Sequence[Node]) -> str:
    """The unit of angles that the innermost DimensionalUnits_t declares; empty if there is none."""
    for place in places:
        for units in place.labelled("DimensionalUnits_t"):
            names = units.words()
            return names[_ANGLE] if len(names) > _ANGLE else ""
    return ""


def _misfit(
    connection: Connection, grid: Grid, center: FloatArray, degrees: FloatArray, translation: FloatArray
) -> float:
    """Largest distance between the moved corners of a connection and their donors."""
    own, donor = grid.block(connection.block), grid.block(connection.donor_block)
    here = np.array([own[connection.begin], own[connection.end]])
    there = np.array([donor[connection.donor_begin], donor[connection.donor_end]])
    moved = (here - center) @ rotation_matrix(degrees).T + center + translation
    return float(np.linalg.norm(moved - there, axis=1).max())


def inverse_motion(periodic: Periodicity) -> Periodicity:
    """The motion back from the donor: ``x = R^T (x' - c - t) + c``."""
    back = rotation_matrix(np.array(periodic.rotation_angle)).T
    x, y, z = (-back @ np.array(periodic.translation)).tolist()
    return Periodicity(periodic.rotation_center, _angles(back, periodic), (x, y, z))


def _angles(matrix: FloatArray, forward: Periodicity) -> tuple[float, float, float]:
    """Angles about x, y, z in turn that give ``matrix``; for a single axis simply the opposite angle."""
    if np.count_nonzero(forward.rotation_angle) <= 1:
        x, y, z = (-angle for angle in forward.rotation_angle)
        return x, y, z
    about_x = np.arctan2(matrix[2, 1], matrix[2, 2])
    about_y = np.arctan2(-matrix[2, 0], np.hypot(matrix[2, 1], matrix[2, 2]))
    about_z = np.arctan2(matrix[1, 0], matrix[0, 0])
    x, y, z = np.degrees([about_x, about_y, about_z]).tolist()
    return x, y, z
