"""Displacement tables, the boundary nodes that need a displacement, and the transfer from one to the other: exact,
nearest or interpolated; tables that name points by number, like SU2's surface_positions.dat."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ..errors import CaseError, MotionError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.planes import plane_normal
from ..grid.topology import RELATIVE_TOLERANCE, Topology, side_nodes
from ..numerics.arrays import extent, lengths, places_among
from ..numerics.geometry.coincidence import distinct
from ..numerics.geometry.vectors import doubled_areas, unit
from ..parallel import Nodes
from ..wording import counted, literal, vector
from .frames import other_frame

HOW = ("exact", "nearest", "interpolate")
_LARGEST = 1e100
_TOGETHER = 1 << 14
"""Faces processed at a time, which bounds the memory."""
AUTOMATIC = "automatic"
"""``nearest`` for a table of the grid's own nodes, else ``interpolate``; only for tables that select their nodes."""
# Two displacements at one point are the same up to this fraction of the largest one.
_ALIKE = 1e-6
_INTERPOLATE = ', match = "interpolate"'
# Points of a table closer than the first fraction of its extent are treated as one point if the surface between them
# would be stretched by more than the second factor.
_ONE_POINT, _STRETCH = 1e-6, 10.0
COUNTED = 20
"""Up to this number of points, whole numbers that all differ as first coordinates may be chance; of more points, they
are point numbers."""
_ROUGH = 3.0
"""If the displacements of neighbours typically differ by more than this many edges, the numbers of the points belong to
another mesh."""


@dataclass(frozen=True)
class SurfaceData:
    """Displacements known at scattered points, with the surface between them where the file has one.

    Attributes
    ----------
    points, displacement : (n, 3) float64, grid length unit
    triangles : (m, 3) int64, indices into ``points``; (0, 3) when the file has points only
    label : name for messages, usually the file name
    plane : whether the file has two components of the displacement only; the third one is zero
    numbered : whether the file has three or four columns without names, which may be the number and position of each
        point; read as x, y, dx and, if ``plane``, dy
    """

    points: FloatArray
    displacement: FloatArray
    triangles: IntArray
    label: str
    plane: bool = False
    numbered: bool = False

    def __post_init__(self) -> None:
        """Refuse numbers whose squares overflow."""
        for what, values in (("coordinates", self.points), ("displacements", self.displacement)):
            largest = float(np.abs(values).max(initial=0.0))
            if largest > _LARGEST:
                raise MotionError(f"{self.label} has {what} of {largest:.3g}; expected lengths below {_LARGEST:g}")


@dataclass(frozen=True)
class Positions:
    """New positions (n, 3), or (n, 2) in a plane grid, of the points with these numbers (n,)."""

    numbers: IntArray
    positions: FloatArray
    label: str

    def displacements(self, grid: Grid, topology: Topology) -> SurfaceData:
        """The displacements of the points; numbering is that of the unstructured files that this program writes. Raises
        MotionError when a number does not denote a point on a block face, or neighbours move so differently that the
        numbers must belong to another mesh."""
        numbers, corners = self.numbers, topology.quads.corners[:, :2]
        beyond = np.flatnonzero((numbers < 0) | (numbers >= topology.n_unique))
        if beyond.size:
            raise MotionError(
                f"{self.label}: {beyond.size} numbers are not of points on block faces, the first "
                f"{numbers[beyond[0]]}; these have 0 to {topology.n_unique - 1}"
            )
        points = grid.nodes.at(topology.first[numbers])
        moved, (low, high) = points.copy(), extent(grid.points)
        moved[:, np.sort(np.argsort(high - low)[3 - self.positions.shape[1] :])] = self.positions
        row = places_among(numbers, topology.n_unique)
        a, b = row[corners[(row[corners] >= 0).all(axis=1)]].T
        displacement = moved - points
        apart = np.linalg.norm(displacement[a] - displacement[b], axis=1)
        if a.size and float(np.median(apart - _ROUGH * np.linalg.norm(points[a] - points[b], axis=1))) > 0:
            raise MotionError(
                f"{self.label}: neighbours move apart by several edges almost everywhere; its numbers seem to be those "
                "of another mesh than the one that `meshdeform convert` writes"
            )
        return SurfaceData(points, displacement, np.empty((0, 3), dtype=np.int64), self.label)


def edges_at_corners(points: FloatArray, faces: IntArray) -> tuple[FloatArray, FloatArray]:
    """Shortest edge longer than zero and longest edge (n,) of ``faces`` (m, corners) at each of ``points`` (n, 3)."""
    shortest, longest = np.full(len(points), np.inf), np.zeros(len(points))
    for lo in range(0, len(faces), _TOGETHER):
        corners = faces[lo : lo + _TOGETHER].T.astype(np.int64)
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            length = np.linalg.norm(points.take(a, axis=0) - points.take(b, axis=0), axis=1)
            apart = np.where(a == b, np.inf, length)
            for end in (a, b):
                np.minimum.at(shortest, end, apart)
                np.maximum.at(longest, end, length)
    return shortest, longest


@dataclass(frozen=True)
class BoundaryNodes:
    """Undeformed boundary nodes that need a displacement.

    Attributes
    ----------
    points : (n, 3), grid length unit
    numbers : (n,) unique node numbers
    edge, longest : (n,) shortest and longest edge of the boundary's faces at each node: scales of matching
    faces : (m, 4) corners of the boundary's faces, indices into ``points``; (m, 2) in 2-D
    quads, grid, topology : numbers (m,) of these faces, and to which they belong
    """

    points: FloatArray
    numbers: IntArray
    edge: FloatArray
    longest: FloatArray
    faces: IntArray
    quads: IntArray
    grid: Grid
    topology: Topology

    @classmethod
    def of_quads(cls, grid: Grid, topology: Topology, quads: IntArray) -> BoundaryNodes:
        """The nodes of face quads (m,)."""
        corners = topology.quads.corners[quads]
        numbers = distinct(corners, topology.n_unique)
        points, faces = grid.nodes.at(topology.first[numbers]), places_among(numbers, topology.n_unique)[corners]
        return cls(points, numbers, *edges_at_corners(points, faces), faces, quads, grid, topology)

    @property
    def face_normals(self) -> FloatArray:
        """Unit normals (m, 3) of the faces, out of the grid."""
        corners, plane = self.points[self.faces], plane_normal(self.grid)
        return unit(doubled_areas(corners) if plane is None else np.cross(corners[:, 1] - corners[:, 0], plane))

    @property
    def normals(self) -> FloatArray:
        """Unit normals (n, 3) at the nodes: mean of those of their faces."""
        return unit(self.summed(self.face_normals))

    def summed(self, values: FloatArray) -> FloatArray:
        """Sums (n, 3) at the nodes of ``values`` (m, 3) of their faces."""
        total = np.zeros((len(self.points), 3))
        for column in self.faces.T:
            np.add.at(total, column, values)
        return total

    def label(self, index: int) -> str:
        """Name of one node: block and 1-based indices."""
        return self.grid.node_label(int(self.topology.first[self.numbers[index]]))


@dataclass(frozen=True)
class Matching:
    """How boundary nodes find their displacement in a table.

    Attributes
    ----------
    how : ``exact`` (the same points), ``nearest`` (the closest point's value) or ``interpolate`` (the closest point of
        the table's surface; without a surface a thin plate spline through the nearest points); ``AUTOMATIC`` if
        ``partial``
    tolerance : largest distance, grid length unit; ``None`` for 1e-3 of the shortest surface edge at the node (exact),
        half of it (nearest, and interpolate if ``partial``) or a tenth of the diagonal of the table or of the nodes,
        whichever is smaller (interpolate)
    partial : nodes without a match are allowed; they are not moved by the table
    walls : names of the surfaces that the table was found to fit, where the case does not select any
    """

    how: str = "nearest"
    tolerance: float | None = None
    partial: bool = False
    walls: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.how not in HOW and not (self.partial and self.how == AUTOMATIC):
            raise CaseError(f"match = {literal(self.how)} is unknown; known are {', '.join(HOW)}")
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
    label, matching, used : name of the table, the matching, and the number of its points that were used, of how many
    points : (m, 3) of the table; (0, 3) for a grid of the same nodes
    beyond : (n,) distance of the node beyond the edge of the table's surface
    plane : whether the table has two components of the displacement only
    """

    displacement: FloatArray
    matched: BoolArray
    distance: FloatArray
    label: str
    matching: Matching
    used: tuple[int, int]
    points: FloatArray
    beyond: FloatArray
    plane: bool = False

    @property
    def how(self) -> str:
        """How nodes found their displacement."""
        return self.matching.how if len(self.points) else "same nodes"


def spacings(tree: scipy.spatial.cKDTree) -> FloatArray:
    """Distance (n,) of every point of a tree from its fourth nearest neighbour, or from the last of fewer."""
    return np.asarray(tree.query(tree.data, k=min(5, tree.n))[0].reshape(tree.n, -1)[:, -1])


def transfer(data: SurfaceData | Grid | Positions, matching: Matching, nodes: BoundaryNodes) -> Transfer:
    """Displacement of boundary nodes from a table, from a grid with the deformed positions of the same nodes, or from
    positions by number. Raises MotionError when no node matches, or when some do not and ``matching.partial`` is false,
    and for positions as :meth:`.Positions.displacements`."""
    if isinstance(data, Positions):
        without = np.flatnonzero(~np.isin(nodes.numbers, data.numbers))
        label, data = data.label, data.displacements(nodes.grid, nodes.topology)
        if without.size:
            raise MotionError(
                f"{label} has no position for {without.size} of {len(nodes.numbers)} boundary nodes, the first "
                f"{nodes.label(int(without[0]))}, number {nodes.numbers[without[0]]}"
            )
    if isinstance(data, SurfaceData):
        data = by_place(data, nodes.grid, nodes.topology)
        result = _from_table(data, matching, nodes)
    else:
        moved = np.full((nodes.topology.n_unique, 3), np.nan)
        if data.shapes == nodes.grid.shapes:
            moved[nodes.numbers] = Nodes.of(data.points).at(nodes.topology.first[nodes.numbers])
        else:
            # Each block of a surface grid is the closest block face of the same size.
            taken: set[tuple[int, Side]] = set()
            for index, shape in enumerate(data.shapes):
                new = data.block(index).reshape([n for n in shape if n > 1] + [3])
                moved[_closest_face(new, data.names[index], nodes, taken)] = new
        found = moved[nodes.numbers] - nodes.points
        matched = np.asarray(np.isfinite(found).all(axis=1))
        label, zero = data.path.name if data.path else "deformed grid", np.zeros(len(found))
        displacement, used = np.where(matched[:, None], found, 0.0), (int(matched.sum()), data.n_nodes)
        result = Transfer(displacement, matched, zero, label, matching, used, np.empty((0, 3)), zero)
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
    return result


def _from_table(data: SurfaceData, matching: Matching, nodes: BoundaryNodes) -> Transfer:
    used, beyond = len(data.points), np.zeros(len(nodes.points))
    reach: FloatArray | float = 0.5 * nodes.edge
    if matching.how != "interpolate":
        tree = scipy.spatial.cKDTree(data.points)
        distance, nearest = tree.query(nodes.points)
        displacement = data.displacement[nearest]
        _require_one_displacement(data, tree, nodes.points, RELATIVE_TOLERANCE * nodes.edge)
        if matching.how == "exact":
            reach = nodes.edge * RELATIVE_TOLERANCE
        reach = matching.tolerance or reach
        used = len(np.unique(nearest[distance <= reach]))
    else:
        if len(data.triangles):
            displacement, distance, beyond = _on_triangles(data, nodes.points)
        else:
            near = _ONE_POINT * float(np.ptp(data.points, axis=0).max(initial=0.0))
            _require_one_displacement(data, scipy.spatial.cKDTree(data.points), data.points, near)
            displacement, distance, beyond = _between_points(data, nodes)
        if not matching.partial:
            # Otherwise the table alone selects the nodes, from the whole boundary: those that are not on it must not
            # match.
            reach = 0.1 * min(float(np.linalg.norm(np.ptp(x, axis=0))) for x in (data.points, nodes.points))
        reach = matching.tolerance or reach
    matched = np.asarray(distance <= reach)
    displacement = np.where(matched[:, None], displacement, 0.0)
    counts = used, len(data.points)
    return Transfer(displacement, matched, distance, data.label, matching, counts, data.points, beyond, data.plane)


def _require_one_displacement(
    data: SurfaceData, tree: scipy.spatial.cKDTree, places: FloatArray, near: FloatArray | float
) -> None:
    """Refuse different displacements of two points of the ``tree`` of the table that are ``near`` one of the ``places``
    (n, 3), if they would stretch the surface between them beyond reason."""
    if tree.n < 2:
        return
    beside, pairs = tree.query(places, k=2)
    points, moved = (values[pairs[beside[:, 1] <= near]] for values in (data.points, data.displacement))
    distance, apart = lengths(points[:, 1] - points[:, 0]), np.abs(moved[:, 1] - moved[:, 0]).max(axis=1)
    conflict = apart > np.maximum(_STRETCH * distance, _ALIKE * np.abs(data.displacement).max(initial=0.0))
    if conflict.any():
        first = int(np.argmax(conflict))
        (one, other), (here, there) = points[first], moved[first]
        raise MotionError(
            f"{data.label} has the points {vector(one)} and {vector(other)}, {distance[first]:.2g} apart, with the "
            f"displacements {vector(here)} and {vector(there)} ({counted(int(conflict.sum()), 'such point')}); "
            f"expected one displacement at one place"
        )


def _on_triangles(data: SurfaceData, points: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement, distance, and distance beyond the edge, at the closest points of the table's surface."""
    from ..numerics.geometry.surface import TriangleTree

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
    on_rim = ((weights < 1e-12) & rim[triangle]).any(axis=1)
    return displacement, distance, np.where(on_rim, np.linalg.norm(aside, axis=1), 0.0)


def _between_points(data: SurfaceData, nodes: BoundaryNodes) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Displacement from a spline through the nearest points of the node's side of the body, distance to the nearest
    point, and beyond their spacing."""
    from ..numerics.geometry.local_spline import local_spline
    from ..numerics.geometry.surface import TriangleTree

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


def by_place(data: SurfaceData, grid: Grid, topology: Topology) -> SurfaceData:
    """The table itself; or what it means, if its first column numbers the points and positions follow.

    These are three columns without names, or four for a grid in space, which are read as x, y, dx and dy of a plane.
    Four stay what they are if most of these points lie at nodes of the boundary. Raises MotionError as above, and for
    three columns that are not a number, x and y in a plane grid.
    """
    if not data.numbered:
        return data
    first = data.points[:, 0]
    whole = bool((first == np.round(first)).all())
    if not data.plane and not (whole and grid.dimension == 2):
        raise MotionError(
            f"{data.label} has three columns without names, which are SU2's point number, x and y of a plane grid, but "
            f"{'this grid is in space' if grid.dimension == 3 else 'not all in the first are whole numbers'}; expected "
            "x y z dx dy dz (or x y dx dy), or the number of each point and all its new coordinates"
        )
    if data.plane:
        numbering = whole and len(first) > COUNTED and len(np.unique(first)) == len(first)
        if not numbering or grid.dimension == 2:
            return data
        distance, near = scipy.spatial.cKDTree(grid.nodes.at(topology.first)).query(data.points)
        if np.median(distance - topology.edge[near]) <= 0.0:
            return data
    positions = np.column_stack([data.points[:, 1], data.displacement])[:, : grid.dimension]
    return Positions(first.astype(np.int64), positions, data.label).displacements(grid, topology)
