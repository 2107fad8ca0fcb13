"""Patches as boundary conditions (BC_t) and families; connections as GridConnectivity1to1_t, in both directions as CGNS
requires."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from meshdeform_core.grid import Connection, Grid, Patch, Shape, Window

from .boundary import inverse_motion
from .tree import NAME_LENGTH, Node, make, unique_names

_BC_TYPES = {
    *("UserDefined", "BCAxisymmetricWedge", "BCDegenerateLine", "BCDegeneratePoint", "BCDirichlet"),
    *("BCExtrapolate", "BCFarfield", "BCGeneral", "BCInflow", "BCInflowSubsonic", "BCInflowSupersonic"),
    *("BCNeumann", "BCOutflow", "BCOutflowSubsonic", "BCOutflowSupersonic", "BCSymmetryPlane"),
    *("BCSymmetryPolar", "BCTunnelInflow", "BCTunnelOutflow", "BCWall", "BCWallInviscid", "BCWallViscous"),
    *("BCWallViscousHeatFlux", "BCWallViscousIsothermal"),
}
# First letters of boundary condition names in other formats (NASA neutral map files, common names).
_WORDS = {
    "viscous": "BCWallViscous",
    "tangency": "BCWallInviscid",
    "inviscid": "BCWallInviscid",
    "wall": "BCWall",
    "farfield": "BCFarfield",
    "symmetry": "BCSymmetryPlane",
    "inflow": "BCInflow",
    "outflow": "BCOutflow",
    "back_pressure": "BCOutflow",
    "extrapolat": "BCExtrapolate",
}


def family_names(grid: Grid, zones: tuple[str, ...]) -> dict[str, str]:
    """Node name of each family, in the order of the patches; distinct from those of zones, which are siblings."""
    families = dict.fromkeys(_family(patch) for patch in grid.patches)
    families.pop("", None)
    return dict(zip(families, unique_names(families, "Family", zones), strict=True))


def boundary_nodes(grid: Grid, families: dict[str, str]) -> list[list[Node]]:
    """For each block its ZoneBC_t with one BC_t per window, or an empty list."""
    parts: list[list[tuple[Patch, Window]]] = [[] for _ in grid.shapes]
    for patch in grid.patches:
        for window in patch.windows:
            if grid.shapes[window.block][window.side.axis] > 1:
                parts[window.block].append((patch, window))
    nodes = []
    for block, part in enumerate(parts):
        names = unique_names((patch.name for patch, _ in part), "BC")
        conditions = []
        for name, (patch, window) in zip(names, part, strict=True):
            begin, end = [0, 0, 0], [0, 0, 0]
            begin[window.side.axis] = end[window.side.axis] = window.side.layer(grid.shapes[block])
            for axis, low, high in zip(window.side.tangential, window.low, window.high, strict=True):
                begin[axis], end[axis] = low, high
            children = [make("PointRange", "IndexRange_t", point_range(grid.shapes[block], begin, end))]
            if _family(patch):
                children.append(make("FamilyName", "FamilyName_t", families[_family(patch)]))
            kind = bc_type(patch.bc_type)
            if patch.bc_type and kind != patch.bc_type:
                children.append(make("BoundaryCondition", "Descriptor_t", patch.bc_type))
            conditions.append(make(name, "BC_t", kind, children))
        nodes.append([make("ZoneBC", "ZoneBC_t", None, conditions)] if conditions else [])
    return nodes


def family_nodes(grid: Grid, families: dict[str, str]) -> list[Node]:
    """Every family with the boundary condition of its first patch."""
    types = {_family(patch): bc_type(patch.bc_type) for patch in reversed(grid.patches)}
    return [
        make(name, "Family_t", None, [make("FamilyBC", "FamilyBC_t", types[family])])
        for family, name in families.items()
    ]


def bc_type(word: str) -> str:
    """The CGNS name of a boundary condition; ``UserDefined`` if there is none."""
    if word in _BC_TYPES:
        return word
    return next((kind for start, kind in _WORDS.items() if word.lower().startswith(start)), "UserDefined")


def point_range(shape: Shape, begin: Sequence[int], end: Sequence[int]) -> np.ndarray:
    """1-based node range ``(axes, 2)`` without the axis of a single node."""
    axes = [axis for axis in range(3) if shape[axis] > 1]
    return np.array([[begin[axis] + 1, end[axis] + 1] for axis in axes], np.int32)


def _family(patch: Patch) -> str:
    """The family of a patch; a patch that becomes several BC_t can still be selected as one by its family."""
    return patch.family or (patch.name if len(patch.windows) > 1 else "")


def connectivity_nodes(grid: Grid, zones: tuple[str, ...]) -> list[list[Node]]:
    """For each block its ZoneGridConnectivity_t with all connections that start there, or an empty list."""
    declared = [_ascending(connection) for connection in grid.connections]
    known = {_key(connection) for connection in declared}
    reverse = []
    for one in declared:
        # The connection as seen from its donor.
        inverse = [0, 0, 0]
        for axis, donor in enumerate(one.transform):
            inverse[abs(donor) - 1] = int(np.sign(donor)) * (axis + 1)
        i, j, k = inverse
        ends = one.donor_block, one.donor_begin, one.donor_end, one.block, one.begin, one.end
        back = _ascending(Connection(one.name, *ends, (i, j, k), one.periodic and inverse_motion(one.periodic)))
        reverse += [] if _key(back) in known else [back]
    parts: list[list[Connection]] = [[] for _ in grid.shapes]
    for connection in declared + reverse:
        parts[connection.block].append(connection)
    nodes = []
    for part in parts:
        names = unique_names((connection.name for connection in part), "Connection")
        children = [_connection_node(name, each, grid, zones) for name, each in zip(names, part, strict=True)]
        nodes.append([make("ZoneGridConnectivity", "ZoneGridConnectivity_t", None, children)] if children else [])
    return nodes


def _key(connection: Connection) -> tuple[int, Shape, Shape, int]:
    return connection.block, connection.begin, connection.end, connection.donor_block


def _ascending(connection: Connection) -> Connection:
    """The connection described with ``begin <= end`` along every axis."""
    own = np.array([connection.begin, connection.end])
    donor = np.array([connection.donor_begin, connection.donor_end])
    turned = np.flatnonzero(own[0] > own[1])
    there = np.abs(connection.transform)[turned] - 1
    own[:, turned], donor[:, there] = own[::-1, turned], donor[::-1, there]
    ends: list[Any] = [tuple(index) for index in [*own.tolist(), *donor.tolist()]]
    return replace(connection, begin=ends[0], end=ends[1], donor_begin=ends[2], donor_end=ends[3])


def _connection_node(name: str, connection: Connection, grid: Grid, zones: tuple[str, ...]) -> Node:
    shape, donor_shape = grid.shapes[connection.block], grid.shapes[connection.donor_block]
    own = point_range(shape, connection.begin, connection.end)
    donor = point_range(donor_shape, connection.donor_begin, connection.donor_end)
    # Signed donor axes, counted without the axes of a single node.
    number = {axis: place + 1 for place, axis in enumerate(a for a in range(3) if donor_shape[a] > 1)}
    donors = [connection.transform[axis] for axis in range(3) if shape[axis] > 1]
    transform = np.array([int(np.sign(each)) * number[abs(each) - 1] for each in donors], np.int32)
    children = [
        make("Transform", '"int[IndexDimension]"', transform),
        make("PointRange", "IndexRange_t", own),
        make("PointRangeDonor", "IndexRange_t", donor),
    ]
    if connection.periodic:
        # Angles are in radians, declared explicitly because readers' defaults differ: five words of 32 characters.
        words = "".join(word.ljust(NAME_LENGTH) for word in ("Null", "Null", "Null", "Null", "Radian")).encode()
        units = make("DimensionalUnits", "DimensionalUnits_t", np.frombuffer(words, np.int8).reshape(5, NAME_LENGTH).T)
        motion = connection.periodic
        angle = np.radians(motion.rotation_angle).astype(np.float32)
        members = [
            make("RotationCenter", "DataArray_t", np.array(motion.rotation_center, np.float32)),
            make("RotationAngle", "DataArray_t", angle, [units]),
            make("Translation", "DataArray_t", np.array(motion.translation, np.float32)),
        ]
        periodic = make("Periodic", "Periodic_t", None, members)
        children.append(make("GridConnectivityProperty", "GridConnectivityProperty_t", None, [periodic]))
    return make(name, "GridConnectivity1to1_t", zones[connection.donor_block], children)
