"""From a surface displacement to the boundary nodes of the grid: exact, nearest, or interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import CaseError, MotionError
from .grid import BoolArray, FloatArray, Grid, IntArray, Side
from .topology import RELATIVE_TOLERANCE, side_nodes

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
class Matching:
    """How boundary nodes find their displacement in a table.

    Attributes
    ----------
    how : ``exact`` (the same points), ``nearest`` (the closest point's value) or ``interpolate`` (the closest point of
        the table's surface; without a surface a local linear fit)
    tolerance : largest distance, grid length unit; ``None`` for 1e-3 of the node's shortest edge (exact), that edge
        (nearest) or a tenth of the table's diagonal (interpolate)
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


def transfer(
    data: SurfaceData | Grid, matching: Matching, points: FloatArray, flat: IntArray, edge: FloatArray, grid: Grid
) -> Transfer:
    """Displacement of the boundary nodes ``points`` (n, 3) with flat indices ``flat`` and shortest edges ``edge``.

    Raises
    ------
    MotionError
        When no node matches, or some do not although ``matching.partial`` does not allow it.
    """
    if isinstance(data, Grid):
        result = _from_deformed_grid(data, flat, grid)
    elif matching.how == "interpolate":
        result = _interpolate(data, matching, points)
    else:
        result = _from_points(data, matching, points, edge)
    _require_matches(result, matching, points, flat, grid, data)
    return result


def _from_points(data: SurfaceData, matching: Matching, points: FloatArray, edge: FloatArray) -> Transfer:
    from scipy.spatial import cKDTree

    reach = edge * (RELATIVE_TOLERANCE if matching.how == "exact" else 1.0)
    if matching.tolerance is not None:
        reach = np.full(len(points), matching.tolerance)
    distance, nearest = cKDTree(data.points).query(points)
    matched = distance <= reach
    displacement = np.where(matched[:, None], data.displacement[nearest], 0.0)
    used = len(np.unique(nearest[matched])), len(data.points)
    return Transfer(displacement, matched, distance, data.label, matching.how, used)


def _interpolate(data: SurfaceData, matching: Matching, points: FloatArray) -> Transfer:
    reach = matching.tolerance or 0.1 * float(np.linalg.norm(np.ptp(data.points, axis=0)))
    if len(data.triangles):
        from .numerics.surface import TriangleTree

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
    from scipy.spatial import cKDTree

    k = min(_NEIGHBOURS, len(data.points))
    distance, near = cKDTree(data.points).query(points, k=k)
    distance, near = distance.reshape(len(points), k), near.reshape(len(points), k)
    scale = np.maximum(distance[:, -1:], np.finfo(float).tiny)
    weight = np.sqrt(1.0 / ((distance / scale) ** 2 + 1e-12))
    arm = (data.points[near] - points[:, None]) / scale[..., None]
    design = np.concatenate([np.ones((len(points), k, 1)), arm], axis=2) * weight[..., None]
    # Truncated pseudo-inverse: a flat patch of neighbours says nothing about the normal direction.
    inverse = np.linalg.pinv(design, rcond=1e-3)
    displacement = np.einsum("nk,nkd->nd", inverse[:, 0], weight[..., None] * data.displacement[near])
    return displacement, distance[:, 0]


def _from_deformed_grid(deformed: Grid, flat: IntArray, grid: Grid) -> Transfer:
    label = deformed.path.name if deformed.path else "deformed grid"
    if deformed.shapes == grid.shapes:
        displacement = deformed.points[flat] - grid.points[flat]
        matched = np.ones(len(flat), dtype=bool)
        used = len(flat), deformed.n_nodes
    else:
        displacement, matched = _from_surface_blocks(deformed, flat, grid)
        used = int(matched.sum()), deformed.n_nodes
    return Transfer(displacement, matched, np.zeros(len(flat)), label, "same nodes", used)


def _from_surface_blocks(surface: Grid, flat: IntArray, grid: Grid) -> tuple[FloatArray, BoolArray]:
    """Each block of the surface grid is the block face of the same size that lies closest to it."""
    moved = np.full((grid.n_nodes, 3), np.nan)
    taken: set[tuple[int, Side]] = set()
    for index, shape in enumerate(surface.shapes):
        new = surface.block(index).reshape([n for n in shape if n > 1] + [3])
        nodes = _closest_face(new, surface.names[index], flat, grid, taken)
        moved[nodes] = new
    displacement = moved[flat] - grid.points[flat]
    matched: BoolArray = np.asarray(np.isfinite(displacement).all(axis=1))
    return np.where(matched[:, None], displacement, 0.0), matched


def _closest_face(new: FloatArray, name: str, flat: IntArray, grid: Grid, taken: set[tuple[int, Side]]) -> IntArray:
    candidates = []
    for block in range(grid.n_blocks):
        for side in Side:
            nodes = side_nodes(grid, block, side)
            squeezed = nodes.reshape([n for n in nodes.shape if n > 1])
            if squeezed.shape == new.shape[:-1] and (block, side) not in taken and np.isin(squeezed, flat).all():
                gap = np.sqrt(np.mean((grid.points[squeezed] - new) ** 2))
                candidates.append((float(gap), block, side, squeezed))
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
    _, block, side, nodes = candidates[0]
    taken.add((block, side))
    return nodes


def _require_matches(
    result: Transfer, matching: Matching, points: FloatArray, flat: IntArray, grid: Grid, data: SurfaceData | Grid
) -> None:
    missing = np.flatnonzero(~result.matched)
    if len(missing) == 0 or (matching.partial and result.matched.any()):
        return
    worst = missing[np.argmax(result.distance[missing])]
    table = data.points
    raise MotionError(
        f"{result.label}: {len(missing)} of {len(points)} selected nodes have no match ({result.how}); the farthest is "
        f"{grid.node_label(int(flat[worst]))} = {points[worst].tolist()}, {result.distance[worst]:.3g} away. "
        f"The table spans {_span(table)}, the nodes {_span(points)}{_unit_hint(table, points)}. "
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
