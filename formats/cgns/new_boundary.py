"""Patches as boundary conditions (BC_t) and families."""

from __future__ import annotations

import numpy as np

from meshdeform_core.grid import Grid, Patch, Shape, Window

from .tree import Node, make, unique_names

_BC_TYPES = (
    "UserDefined",
    "BCAxisymmetricWedge",
    "BCDegenerateLine",
    "BCDegeneratePoint",
    "BCDirichlet",
    "BCExtrapolate",
    "BCFarfield",
    "BCGeneral",
    "BCInflow",
    "BCInflowSubsonic",
    "BCInflowSupersonic",
    "BCNeumann",
    "BCOutflow",
    "BCOutflowSubsonic",
    "BCOutflowSupersonic",
    "BCSymmetryPlane",
    "BCSymmetryPolar",
    "BCTunnelInflow",
    "BCTunnelOutflow",
    "BCWall",
    "BCWallInviscid",
    "BCWallViscous",
    "BCWallViscousHeatFlux",
    "BCWallViscousIsothermal",
)
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
        conditions = [
            _condition(name, patch, window, grid.shapes[block], families)
            for name, (patch, window) in zip(names, part, strict=True)
        ]
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


def point_range(shape: Shape, begin: Shape, end: Shape) -> np.ndarray:
    """1-based node range ``(axes, 2)`` without the axis of a single node."""
    axes = [axis for axis in range(3) if shape[axis] > 1]
    return np.array([[begin[axis] + 1, end[axis] + 1] for axis in axes], np.int32)


def _family(patch: Patch) -> str:
    """The family of a patch; a patch that becomes several BC_t can still be selected as one by its family."""
    return patch.family or (patch.name if len(patch.windows) > 1 else "")


def _condition(name: str, patch: Patch, window: Window, shape: Shape, families: dict[str, str]) -> Node:
    begin, end = _corners(window, shape)
    children = [make("PointRange", "IndexRange_t", point_range(shape, begin, end))]
    if _family(patch):
        children.append(make("FamilyName", "FamilyName_t", families[_family(patch)]))
    kind = bc_type(patch.bc_type)
    if patch.bc_type and kind != patch.bc_type:
        children.append(make("BoundaryCondition", "Descriptor_t", patch.bc_type))
    return make(name, "BC_t", kind, children)


def _corners(window: Window, shape: Shape) -> tuple[Shape, Shape]:
    begin, end = [0, 0, 0], [0, 0, 0]
    begin[window.side.axis] = end[window.side.axis] = window.side.layer(shape)
    for axis, low, high in zip(window.side.tangential, window.low, window.high, strict=True):
        begin[axis], end[axis] = low, high
    return (begin[0], begin[1], begin[2]), (end[0], end[1], end[2])
