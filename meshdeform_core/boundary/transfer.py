"""From a surface displacement to the boundary nodes of the grid: exact, nearest, or interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import CaseError, MotionError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.topology import RELATIVE_TOLERANCE, Topology, side_nodes

HOW = ("exact", "nearest", "interpolate")
_NEIGHBOURS = 12


@dataclass(frozen=True)
class SurfaceData:
    """Displacements known at scattered points, with the surface between them where the file has one.

    Attributes
    ----------
    points, displacement : (n, 3) float64, grid length unit
    triangles : (m, 3) int64, indices into ``points``; (0, 3) when the file has points only
    label : what to call it in messages, usually the file name
    """

    points: FloatArray
    displacement: FloatArray
    triangles: IntArray
    label: str


@dataclass(frozen=True)
class Nodes:
    """Undeformed boundary nodes that want a displacement.

    Attributes
    ----------
    points : (n, 3), grid length unit
    numbers : (n,) unique node numbers
    edge : (n,) shortest edge of the boundary's faces at each node: the scale of matching tolerances
    grid, topology : where they come from
    """

    points: FloatArray
    numbers: IntArray
    edge: FloatArray
    grid: Grid
    topology: Topology

    def label(self, index: int) -> str:
        """Readable place of one node."""
        return self.grid.node_label(int(self.topology.first[self.numbers[index]]))


@dataclass(frozen=True)
class Matching:
    """How boundary nodes find their displacement in a table.

    Attributes
    ----------
    how : ``exact`` (the same points), ``nearest`` (the closest point's value) or ``interpolate`` (the closest point of
        the table's surface; without a surface a local linear fit)
    tolerance : largest distance, grid length unit; ``None`` for 1e-3 of the shortest surface edge at the node (exact),
        half of it (nearest) or a tenth of the table's diagonal (interpolate)
    partial : nodes without a match are allowed; they are not moved by the table
    """

    how: str = "nearest"
    tolerance: float | None = None
    partial: bool = False

    def __post_init__(self) -> None:
        if self.how not in HOW:
            raise CaseError(f"match = {self.how!r} is unknown; known are {', '.join(HOW)}")
        if self.tolerance is not None and not (np.isfinite(self.tolerance) and self.tolerance > 0):
            raise CaseError(f"tolerance = {self.tolerance} of a displacement table; expected a positive length")


@dataclass(frozen=True)
class Transfer:
    """Displacement of nodes from a table.

    Attributes
    ----------
    displacement : (n, 3), zero where nothing matched
    matched : (n,) bool
    distance : (n,) from each node to the point or surface that gave its displacement
    label, how, used : the table's name, the matching, and how many of its points were used of how many
    """

    displacement: FloatArray
    matched: BoolArray
    distance: FloatArray
    label: str
    how: str
    used: tuple[int, int]


def transfer(data: SurfaceData | Grid, matching: Matching, nodes: Nodes) -> Transfer:
    """Displacement of boundary nodes from a table, or from a grid with the deformed positions of the same nodes.

    Raises
    ------
    MotionError
        When no node matches, or some do not although ``matching.partial`` does not allow it.
    """
    if isinstance(data, Grid):
        result = _from_deformed_grid(data, nodes)
    elif matching.how == "interpolate":
        result = _interpolate(data, matching, nodes.points)
    else:
        result = _from_points(data, matching, nodes)
    _require_matches(result, matching, nodes, data)
    return result


def _from_points(data: SurfaceData, matching: Matching, nodes: Nodes) -> Transfer:
    reach = nodes.edge * (RELATIVE_TOLERANCE if matching.how == "exact" else 0.5)
    if matching.tolerance is not None:
        reach = np.full(len(nodes.points), matching.tolerance)
    distance, nearest = scipy.spatial.cKDTree(data.points).query(nodes.points)
    matched = distance <= reach
    displacement = np.where(matched[:, None], data.displacement[nearest], 0.0)
    used = len(np.unique(nearest[matched])), len(data.points)
    return Transfer(displacement, matched, distance, data.label, matching.how, used)


def _interpolate(data: SurfaceData, matching: Matching, points: FloatArray) -> Transfer:
    reach = matching.tolerance or 0.1 * float(np.linalg.norm(np.ptp(data.points, axis=0)))
    if len(data.triangles):
        from ..numerics.surface import TriangleTree

        triangle, weights, distance = TriangleTree(data.points, data.triangles).closest(points)
        corners = data.displacement[data.triangles[triangle]]
        displacement = np.einsum("nc,ncd->nd", weights, corners)
    else:
        displacement, distance = _local_fit(data, points)
    matched = distance <= reach
    displacement = np.where(matched[:, None], displacement, 0.0)
    return Transfer(displacement, matched, distance, data.label, matching.how, (len(data.points),) * 2)


def _local_fit(data: SurfaceData, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Moving least squares: a linear function fitted to the nearest table points, close ones weighing more.

    Directions in which the neighbours do not spread (the surface normal) are left out of the fit.
    """
    k = min(_NEIGHBOURS, len(data.points))
    distance, near = scipy.spatial.cKDTree(data.points).query(points, k=k)
    distance, near = distance.reshape(len(points), k), near.reshape(len(points), k)
    scale = np.maximum(distance[:, -1:], np.finfo(float).tiny)
    weight = np.sqrt(1.0 / ((distance / scale) ** 2 + 1e-12))
    arm = (data.points[near] - points[:, None]) / scale[..., None]
    design = np.concatenate([np.ones((len(points), k, 1)), arm], axis=2) * weight[..., None]
    # Truncated pseudo-inverse: a flat patch of neighbours says nothing about the normal direction.
    inverse = np.linalg.pinv(design, rcond=1e-3)
    displacement = np.einsum("nk,nkd->nd", inverse[:, 0], weight[..., None] * data.displacement[near])
    return displacement, distance[:, 0]


def _from_deformed_grid(deformed: Grid, nodes: Nodes) -> Transfer:
    label = deformed.path.name if deformed.path else "deformed grid"
    if deformed.shapes == nodes.grid.shapes:
        displacement = deformed.points[nodes.topology.first[nodes.numbers]] - nodes.points
        matched = np.ones(len(displacement), dtype=bool)
    else:
        displacement, matched = _from_surface_blocks(deformed, nodes)
    used = int(matched.sum()), deformed.n_nodes
    return Transfer(displacement, matched, np.zeros(len(displacement)), label, "same nodes", used)


def _from_surface_blocks(surface: Grid, nodes: Nodes) -> tuple[FloatArray, BoolArray]:
    """Each block of the surface grid is the block face of the same size that lies closest to it."""
    moved = np.full((nodes.topology.n_unique, 3), np.nan)
    taken: set[tuple[int, Side]] = set()
    for index, shape in enumerate(surface.shapes):
        new = surface.block(index).reshape([n for n in shape if n > 1] + [3])
        moved[_closest_face(new, surface.names[index], nodes, taken)] = new
    displacement = moved[nodes.numbers] - nodes.points
    matched: BoolArray = np.asarray(np.isfinite(displacement).all(axis=1))
    return np.where(matched[:, None], displacement, 0.0), matched


def _closest_face(new: FloatArray, name: str, nodes: Nodes, taken: set[tuple[int, Side]]) -> IntArray:
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
                gap = np.sqrt(np.mean((grid.points[flat] - new) ** 2))
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


def _require_matches(result: Transfer, matching: Matching, nodes: Nodes, data: SurfaceData | Grid) -> None:
    missing = np.flatnonzero(~result.matched)
    if len(missing) == 0 or (matching.partial and result.matched.any()):
        return
    worst = missing[np.argmax(result.distance[missing])]
    raise MotionError(
        f"{result.label}: {len(missing)} of {len(nodes.points)} selected nodes have no match ({result.how}); the "
        f"farthest is {nodes.label(worst)} = {nodes.points[worst].tolist()}, {result.distance[worst]:.3g} away. "
        f"The table spans {_span(data.points)}, the nodes {_span(nodes.points)}"
        f"{_unit_hint(data.points, nodes.points)}. "
        f'Set a larger tolerance, match = "interpolate", or a selection that the table covers'
    )


def _span(points: FloatArray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(low, high, strict=True))


def _unit_hint(table: FloatArray, points: FloatArray) -> str:
    one, two = (float(np.linalg.norm(np.ptp(p, axis=0))) for p in (table, points))
    if min(one, two) > 0 and not 0.03 < one / two < 30:
        return f" (sizes differ by a factor {max(one / two, two / one):.3g}: different length units?)"
    return ""
