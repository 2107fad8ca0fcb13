"""Transfer of a surface displacement to the boundary nodes of the grid: exact, nearest, or interpolated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import CaseError, MotionError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.topology import RELATIVE_TOLERANCE, Topology, side_nodes

HOW = ("exact", "nearest", "interpolate")
# Two displacements at one point are the same up to this fraction of the largest one.
_ALIKE = 1e-6
_LARGEST = 1e100


@dataclass(frozen=True)
class SurfaceData:
    """Displacements known at scattered points, with the surface between them where the file has one.

    Attributes
    ----------
    points, displacement : (n, 3) float64, grid length unit
    triangles : (m, 3) int64, indices into ``points``; (0, 3) when the file has points only
    label : name for messages, usually the file name
    """

    points: FloatArray
    displacement: FloatArray
    triangles: IntArray
    label: str


@dataclass(frozen=True)
class Nodes:
    """Undeformed boundary nodes that need a displacement.

    Attributes
    ----------
    points : (n, 3), grid length unit
    numbers : (n,) unique node numbers
    edge, longest : (n,) shortest and longest edge of the boundary's faces at each node: scales of matching
    grid, topology : to which they belong
    """

    points: FloatArray
    numbers: IntArray
    edge: FloatArray
    longest: FloatArray
    grid: Grid
    topology: Topology

    def label(self, index: int) -> str:
        """Name of one node: block and 1-based indices."""
        return self.grid.node_label(int(self.topology.first[self.numbers[index]]))


@dataclass(frozen=True)
class Matching:
    """How boundary nodes find their displacement in a table.

    Attributes
    ----------
    how : ``exact`` (the same points), ``nearest`` (the closest point's value) or ``interpolate`` (the closest point of
        the table's surface; without a surface a thin plate spline through the nearest points)
    tolerance : largest distance, grid length unit; ``None`` for 1e-3 of the shortest surface edge at the node (exact),
        half of it (nearest, and interpolate if ``partial``) or a tenth of the diagonal of the table or of the nodes,
        whichever is smaller (interpolate)
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
    label, how, used : name of the table, the matching, and the number of its points that were used, of how many
    points : (m, 3) of the table; (0, 3) for a grid of the same nodes
    beyond : (n,) distance of the node beyond the edge of the table's surface
    partial : whether nodes without a match are allowed
    """

    displacement: FloatArray
    matched: BoolArray
    distance: FloatArray
    label: str
    how: str
    used: tuple[int, int]
    points: FloatArray
    beyond: FloatArray
    partial: bool


def transfer(data: SurfaceData | Grid, matching: Matching, nodes: Nodes) -> Transfer:
    """Displacement of boundary nodes from a table, or from a grid with the deformed positions of the same nodes.

    Raises
    ------
    MotionError
        When no node matches, or when some do not and ``matching.partial`` is false.
    """
    if not isinstance(data, Grid):
        _require_plausible(data)
    if isinstance(data, Grid):
        result = _from_deformed_grid(data, matching, nodes)
    elif matching.how == "interpolate":
        result = _interpolate(data, matching, nodes)
    else:
        result = _from_points(data, matching, nodes)
    _require_matches(result, matching, nodes, data)
    return result


def _require_plausible(data: SurfaceData) -> None:
    """Refuse numbers whose squares overflow."""
    for what, values in (("coordinates", data.points), ("displacements", data.displacement)):
        largest = float(np.abs(values).max(initial=0.0))
        if largest > _LARGEST:
            raise MotionError(f"{data.label} has {what} of {largest:.3g}; expected lengths below {_LARGEST:g}")


def _from_points(data: SurfaceData, matching: Matching, nodes: Nodes) -> Transfer:
    reach = nodes.edge * (RELATIVE_TOLERANCE if matching.how == "exact" else 0.5)
    if matching.tolerance is not None:
        reach = np.full(len(nodes.points), matching.tolerance)
    tree = scipy.spatial.cKDTree(data.points)
    distance, nearest = tree.query(nodes.points)
    matched = distance <= reach
    _require_one_displacement(data, nodes, tree)
    displacement = np.where(matched[:, None], data.displacement[nearest], 0.0)
    used = len(np.unique(nearest[matched])), len(data.points)
    beyond = np.zeros(len(distance))
    return Transfer(
        displacement, matched, distance, data.label, matching.how, used, data.points, beyond, matching.partial
    )


def _require_one_displacement(data: SurfaceData, nodes: Nodes, tree: scipy.spatial.cKDTree) -> None:
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
            f"{data.label} has two displacements at {nodes.label(node)} = {nodes.points[node].tolist()}, "
            f"{data.displacement[one].tolist()} and {data.displacement[other].tolist()} ({int(conflict.sum())} such "
            f"nodes); expected one"
        )


def _interpolate(data: SurfaceData, matching: Matching, nodes: Nodes) -> Transfer:
    if len(data.triangles):
        displacement, distance, beyond = _on_triangles(data, nodes.points)
    else:
        displacement, distance, beyond = _between_points(data, nodes.points)
    matched = distance <= _reach(data, matching, nodes)
    displacement = np.where(matched[:, None], displacement, 0.0)
    count = (len(data.points),) * 2
    return Transfer(
        displacement, matched, distance, data.label, matching.how, count, data.points, beyond, matching.partial
    )


def _reach(data: SurfaceData, matching: Matching, nodes: Nodes) -> FloatArray | float:
    if matching.tolerance is not None:
        return matching.tolerance
    if matching.partial:
        # The table alone selects the nodes, from the whole boundary: those that are not on it must not match.
        return 0.5 * nodes.edge
    return 0.1 * min(float(np.linalg.norm(np.ptp(points, axis=0))) for points in (data.points, nodes.points))


def _on_triangles(data: SurfaceData, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, distance, and distance beyond the edge, at the closest points of the table's surface."""
    from ..numerics.geometry.surface import TriangleTree

    triangle, weights, distance = TriangleTree(data.points, data.triangles).closest(points)
    corners = data.triangles[triangle]
    displacement = np.einsum("nc,ncd->nd", weights, data.displacement[corners])
    a, b, c = (data.points[corners[:, n]] for n in range(3))
    normal = np.cross(b - a, c - a)
    size = np.linalg.norm(normal, axis=1, keepdims=True)
    normal /= np.where(size > 0, size, 1.0)
    gap = points - np.einsum("nc,ncd->nd", weights, data.points[corners])
    aside = gap - (gap * normal).sum(axis=1, keepdims=True) * normal
    on_rim = ((weights <= 0) & _rim(data.triangles)[triangle]).any(axis=1)
    return displacement, distance, np.where(on_rim, np.linalg.norm(aside, axis=1), 0.0)


def _rim(triangles: IntArray) -> BoolArray:
    """(m, 3) bool: whether the edge opposite that corner belongs to only one triangle."""
    edges = np.sort(np.stack([triangles[:, [1, 2]], triangles[:, [2, 0]], triangles[:, [0, 1]]], axis=1), axis=2)
    _, number, count = np.unique(edges.reshape(-1, 2), axis=0, return_inverse=True, return_counts=True)
    return np.asarray(count[number.reshape(-1)].reshape(-1, 3) == 1)


def _between_points(data: SurfaceData, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement from a spline through the nearest points, distance to the nearest, and beyond their spacing."""
    from ..numerics.geometry.local_spline import local_spline

    known, first = np.unique(data.points, axis=0, return_index=True)
    displacement, distance = local_spline(known, data.displacement[first], points)
    tree = scipy.spatial.cKDTree(known)
    nearest = tree.query(points)[1]
    spacing = tree.query(known, k=min(5, len(known)))[0].reshape(len(known), -1)[:, -1]
    return displacement, distance, np.maximum(distance - spacing[nearest], 0.0)


def _from_deformed_grid(deformed: Grid, matching: Matching, nodes: Nodes) -> Transfer:
    label = deformed.path.name if deformed.path else "deformed grid"
    if deformed.shapes == nodes.grid.shapes:
        displacement = deformed.points[nodes.topology.first[nodes.numbers]] - nodes.points
        matched = np.ones(len(displacement), dtype=bool)
    else:
        displacement, matched = _from_surface_blocks(deformed, nodes)
    used = int(matched.sum()), deformed.n_nodes
    zero = np.zeros(len(displacement))
    return Transfer(displacement, matched, zero, label, "same nodes", used, np.empty((0, 3)), zero, matching.partial)


def _from_surface_blocks(surface: Grid, nodes: Nodes) -> tuple[FloatArray, BoolArray]:
    """Match each block of the surface grid with the closest block face of the same size."""
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
        f"{other_frame(data.points, nodes)}. "
        f'Set a larger tolerance, match = "interpolate", or a selection that the table covers'
    )


def _span(points: FloatArray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return " x ".join(f"[{a:.4g}, {b:.4g}]" for a, b in zip(low, high, strict=True))


# Conversion factors between length units: m and mm, cm, km, inch, foot, and inch in mm.
_FACTORS = (1e-3, 1e3, 1e-2, 1e2, 1e-6, 1e6, 0.0254, 1 / 0.0254, 25.4, 1 / 25.4, 0.3048, 1 / 0.3048)
_ORDERS = ((0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0))
_SAMPLE = 5000


def far_points(points: FloatArray, nodes: Nodes) -> BoolArray:
    """(n,) bool: points that are farther from every node than the longest face edge there."""
    distance, nearest = scipy.spatial.cKDTree(nodes.points).query(points)
    return np.asarray(distance > nodes.longest[nearest])


def other_frame(points: FloatArray, nodes: Nodes) -> str:
    """A hint on what would make table points match the nodes: another length unit or order of coordinates.

    The end of a message, empty if neither helps.
    """
    some = points[:: max(1, len(points) // _SAMPLE)]
    here = 1.0 - far_points(some, nodes).mean()
    tried = {f"multiplied by {factor:.6g}, {{}}: different length units?": some * factor for factor in _FACTORS}
    tried |= {
        f"with its coordinates in the order {' '.join('xyz'[axis] for axis in order)}, {{}}": some[:, order]
        for order in _ORDERS
    }
    for text, there in tried.items():
        hit = 1.0 - far_points(there, nodes).mean()
        if hit >= 0.9 and here < 0.5:
            return f" ({text.format(f'{hit:.0%} of its points would lie on the nodes')})"
    sizes = [float(np.linalg.norm(np.ptp(p, axis=0))) for p in (points, nodes.points)]
    if min(sizes) > 0 and not 1 / 30 < sizes[0] / sizes[1] < 30:
        return f" (sizes differ by a factor {max(sizes) / min(sizes):.3g}: different length units?)"
    return ""
