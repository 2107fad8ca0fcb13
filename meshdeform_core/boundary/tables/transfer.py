"""From a surface displacement to the boundary nodes of the grid: exact, nearest, or interpolated."""

from __future__ import annotations

import dataclasses

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import BoolArray, FloatArray, Grid, IntArray, Side
from ...grid.topology import RELATIVE_TOLERANCE, side_nodes
from ...numerics.geometry.vectors import unit
from ...parallel import Nodes
from ...wording import counted, vector
from .frames import other_frame
from .matching import BoundaryNodes, Matching, SurfaceData, Transfer, spacings
from .numbered import by_place

# Two displacements at one point are the same up to this fraction of the largest one.
_ALIKE = 1e-6
_INTERPOLATE = ', match = "interpolate"'
# Points of a table closer than the first fraction of its extent are treated as one point if the surface between them
# would be stretched by more than the second factor.
_ONE_POINT, _STRETCH = 1e-6, 10.0


def transfer(data: SurfaceData | Grid, matching: Matching, nodes: BoundaryNodes) -> Transfer:
    """Displacement of boundary nodes from a table, or from a grid with the deformed positions of the same nodes.

    Raises
    ------
    MotionError
        When no node matches, or when some do not and ``matching.partial`` is false.
    """
    if not isinstance(data, Grid):
        data = by_place(data, nodes.grid, nodes.topology)
    if isinstance(data, Grid):
        result = _from_deformed_grid(data, matching, nodes)
    elif matching.how == "interpolate":
        result = _interpolate(data, matching, nodes)
    else:
        reach = nodes.edge * (RELATIVE_TOLERANCE if matching.how == "exact" else 0.5)
        if matching.tolerance is not None:
            reach = np.full(len(nodes.points), matching.tolerance)
        tree = scipy.spatial.cKDTree(data.points)
        distance, nearest = tree.query(nodes.points)
        matched = distance <= reach
        _require_one_displacement(data, nodes, tree)
        used = len(np.unique(nearest[matched]))
        result = _of_table(data, matching, data.displacement[nearest], matched, distance, used, np.zeros(len(distance)))
    missing = np.flatnonzero(~result.matched)
    if len(missing) and not (matching.partial and result.matched.any()):
        worst = missing[np.argmax(result.distance[missing])]
        raise MotionError(
            f"{result.label}: {len(missing)} of {len(nodes.points)} selected nodes have no match ({result.how}); the "
            f"farthest is {nodes.label(worst)} = {vector(nodes.points[worst])}, {result.distance[worst]:.3g} away. "
            f"The table spans {_span(data.points)}, the nodes {_span(nodes.points)}"
            f"{other_frame(data.points, nodes)}. "
            f"Set a larger tolerance{'' if result.how == 'interpolate' else _INTERPOLATE}, or a selection that the "
            f"table covers"
        )
    return dataclasses.replace(result, walls=matching.walls)


def _of_table(
    data: SurfaceData, matching: Matching, displacement: FloatArray, matched: BoolArray, distance: FloatArray,
    used: int, beyond: FloatArray,
) -> Transfer:  # fmt: skip
    n = len(data.points)
    return Transfer(
        np.where(matched[:, None], displacement, 0.0), matched, distance, data.label, matching.how, (used, n),
        data.points, beyond, matching.partial, data.plane,
    )  # fmt: skip


def _require_one_displacement(data: SurfaceData, nodes: BoundaryNodes, tree: scipy.spatial.cKDTree) -> None:
    """Refuse a table with different displacements within a small fraction of an edge of one node."""
    if len(data.points) < 2:
        return
    distance, pair = tree.query(nodes.points, k=2)
    apart = np.abs(data.displacement[pair[:, 0]] - data.displacement[pair[:, 1]]).max(axis=1)
    both = distance[:, 1] <= RELATIVE_TOLERANCE * nodes.edge
    conflict = both & (apart > _ALIKE * np.abs(data.displacement).max())
    if conflict.any():
        node = int(np.argmax(conflict))
        one, other = pair[node]
        raise MotionError(
            f"{data.label} has two displacements at {nodes.label(node)} = {vector(nodes.points[node])}, "
            f"{vector(data.displacement[one])} and {vector(data.displacement[other])} ({int(conflict.sum())} such "
            f"nodes); expected one"
        )


def _require_continuous(data: SurfaceData) -> None:
    """Refuse different displacements of nearly coincident points, which would stretch the surface beyond reason."""
    points, displacement = data.points, data.displacement
    if len(points) < 2:
        return
    near = _ONE_POINT * float(np.ptp(points, axis=0).max())
    distance, pair = scipy.spatial.cKDTree(points).query(points, k=2, distance_upper_bound=near)
    close = np.flatnonzero(np.isfinite(distance[:, 1]) & (distance[:, 1] > 0.0))
    apart = np.abs(displacement[pair[close, 0]] - displacement[pair[close, 1]]).max(axis=1, initial=0.0)
    conflict = (apart > _STRETCH * distance[close, 1]) & (apart > _ALIKE * np.abs(displacement).max())
    if conflict.any():
        one, other = sorted(pair[close[int(np.argmax(conflict))]].tolist())
        raise MotionError(
            f"{data.label} has the points {vector(points[one])} and {vector(points[other])}, "
            f"{float(np.linalg.norm(points[one] - points[other])):.2g} apart, with the displacements "
            f"{vector(displacement[one])} and {vector(displacement[other])} "
            f"({counted(int(conflict.sum()), 'such point')}); expected one displacement at one place"
        )


def _interpolate(data: SurfaceData, matching: Matching, nodes: BoundaryNodes) -> Transfer:
    if len(data.triangles):
        displacement, distance, beyond = _on_triangles(data, nodes.points)
    else:
        _require_continuous(data)
        displacement, distance, beyond = _between_points(data, nodes)
    reach: FloatArray | float
    if matching.tolerance is not None:
        reach = matching.tolerance
    elif matching.partial:
        # The table alone selects the nodes, from the whole boundary: those that are not on it must not match.
        reach = 0.5 * nodes.edge
    else:
        reach = 0.1 * min(float(np.linalg.norm(np.ptp(points, axis=0))) for points in (data.points, nodes.points))
    return _of_table(data, matching, displacement, np.asarray(distance <= reach), distance, len(data.points), beyond)


def _on_triangles(data: SurfaceData, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, distance, and distance beyond the edge, at the closest points of the table's surface."""
    from ...numerics.geometry.surface import TriangleTree

    triangle, weights, distance = TriangleTree(data.points, data.triangles).closest(points)
    corners = data.triangles[triangle]
    displacement = np.einsum("nc,ncd->nd", weights, data.displacement[corners])
    a, b, c = (data.points[corners[:, n]] for n in range(3))
    normal = unit(np.cross(b - a, c - a))
    gap = points - np.einsum("nc,ncd->nd", weights, data.points[corners])
    aside = gap - (gap * normal).sum(axis=1, keepdims=True) * normal
    # Edges, each opposite a corner of its triangle, that belong to no other triangle.
    t = data.triangles
    edges = np.sort(np.stack([t[:, [1, 2]], t[:, [2, 0]], t[:, [0, 1]]], axis=1), axis=2).reshape(-1, 2)
    _, number, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    rim = count[number.reshape(-1)].reshape(-1, 3) == 1
    on_rim = ((weights <= 0) & rim[triangle]).any(axis=1)
    return displacement, distance, np.where(on_rim, np.linalg.norm(aside, axis=1), 0.0)


def _between_points(data: SurfaceData, nodes: BoundaryNodes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement from a spline through the nearest points of the node's side of the body, distance to the nearest
    point, and beyond their spacing."""
    from ...numerics.geometry.local_spline import local_spline
    from ...numerics.geometry.surface import TriangleTree

    known, first = np.unique(data.points, axis=0, return_index=True)
    # Normals of the wall where it is closest to the points of the table.
    if nodes.faces.shape[1] == 2:
        normals = nodes.normals[scipy.spatial.cKDTree(nodes.points).query(known)[1]]
    else:
        triangles = np.ascontiguousarray(np.concatenate([nodes.faces[:, [0, 1, 2]], nodes.faces[:, [0, 2, 3]]]))
        normals = nodes.face_normals[TriangleTree(nodes.points, triangles).closest(known)[0] % len(nodes.faces)]
    displacement, distance = local_spline(
        known, data.displacement[first], nodes.points, normals=(normals, nodes.normals)
    )
    tree = scipy.spatial.cKDTree(known)
    nearest = tree.query(nodes.points)[1]
    return displacement, distance, np.maximum(distance - spacings(tree)[nearest], 0.0)


def _from_deformed_grid(deformed: Grid, matching: Matching, nodes: BoundaryNodes) -> Transfer:
    label = deformed.path.name if deformed.path else "deformed grid"
    if deformed.shapes == nodes.grid.shapes:
        displacement = Nodes.of(deformed.points).at(nodes.topology.first[nodes.numbers]) - nodes.points
        matched = np.ones(len(displacement), dtype=bool)
    else:
        # Each block of a surface grid is the closest block face of the same size.
        moved = np.full((nodes.topology.n_unique, 3), np.nan)
        taken: set[tuple[int, Side]] = set()
        for index, shape in enumerate(deformed.shapes):
            new = deformed.block(index).reshape([n for n in shape if n > 1] + [3])
            moved[_closest_face(new, deformed.names[index], nodes, taken)] = new
        found = moved[nodes.numbers] - nodes.points
        matched = np.asarray(np.isfinite(found).all(axis=1))
        displacement = np.where(matched[:, None], found, 0.0)
    used = int(matched.sum()), deformed.n_nodes
    zero = np.zeros(len(displacement))
    return Transfer(displacement, matched, zero, label, "same nodes", used, np.empty((0, 3)), zero, matching.partial)


def _closest_face(new: FloatArray, name: str, nodes: BoundaryNodes, taken: set[tuple[int, Side]]) -> IntArray:
    """Unique node numbers of the selected block face that a deformed surface ``new`` (na, nb, 3) belongs to."""
    grid, topology = nodes.grid, nodes.topology
    candidates = []
    for block in range(grid.n_blocks):
        for side in Side:
            flat = side_nodes(grid, block, side)
            flat = flat.reshape([n for n in flat.shape if n > 1])
            if flat.shape != new.shape[:-1] or (block, side) in taken:
                continue
            numbers = topology.numbers_of(flat.ravel()).reshape(flat.shape)
            if np.isin(numbers, nodes.numbers).all():
                gap = np.sqrt(np.mean((grid.nodes.at(flat) - new) ** 2))
                candidates.append((float(gap), block, side, numbers))
    candidates.sort(key=lambda entry: entry[:3])
    size = " x ".join(str(n) for n in new.shape[:-1])
    if not candidates:
        raise MotionError(
            f"the deformed surface {name} has {size} nodes, but no selected block face has this size; "
            f"expected a grid like the undeformed one or surfaces that are whole selected block faces"
        )
    if len(candidates) > 1 and candidates[1][0] < 2 * candidates[0][0]:
        faces = ", ".join(f"{grid.names[b]}.{s.label}" for _, b, s, _ in candidates[:4])
        raise MotionError(
            f"the deformed surface {name} ({size} nodes) could be any of the faces {faces}; "
            f"select one face per boundary entry, or give the displacement as a table"
        )
    _, block, side, numbers = candidates[0]
    taken.add((block, side))
    return numbers


def _span(points: FloatArray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(low, high, strict=True))
