"""Displacement tables, the boundary nodes that need a displacement, and the result of matching them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from ...errors import CaseError, MotionError
from ...grid import BoolArray, FloatArray, Grid, IntArray
from ...grid.planes import plane_normal
from ...grid.topology import Topology
from ...numerics.arrays import places_among
from ...numerics.geometry.coincidence import distinct
from ...numerics.geometry.vectors import doubled_areas, unit
from ...wording import literal

HOW = ("exact", "nearest", "interpolate")
_LARGEST = 1e100
AUTOMATIC = "automatic"
"""``nearest`` for a table of the grid's own nodes, else ``interpolate``; only for tables that select their nodes."""


@dataclass(frozen=True)
class SurfaceData:
    """Displacements known at scattered points, with the surface between them where the file has one.

    Attributes
    ----------
    points, displacement : (n, 3) float64, grid length unit
    triangles : (m, 3) int64, indices into ``points``; (0, 3) when the file has points only
    label : name for messages, usually the file name
    plane : whether the file has two components of the displacement only; the third one is zero
    numbered : whether the file has three columns only, the number and position of each point; read as x, y and dx
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
class BoundaryNodes:
    """Undeformed boundary nodes that need a displacement.

    Attributes
    ----------
    points : (n, 3), grid length unit
    numbers : (n,) unique node numbers
    edge, longest : (n,) shortest and longest edge of the boundary's faces at each node: scales of matching
    faces : (m, 4) corners of the boundary's faces, indices into ``points``; (m, 2) in 2-D
    grid, topology : to which they belong
    """

    points: FloatArray
    numbers: IntArray
    edge: FloatArray
    longest: FloatArray
    faces: IntArray
    grid: Grid
    topology: Topology

    @classmethod
    def of_quads(cls, grid: Grid, topology: Topology, quads: IntArray) -> BoundaryNodes:
        """The nodes of face quads (m,)."""
        corners = topology.quads.corners[quads]
        points = grid.nodes.at(topology.first)
        edge, longest = np.full(topology.n_unique, np.inf), np.zeros(topology.n_unique)
        for one in range(corners.shape[1]):
            a, b = corners[:, one], corners[:, (one + 1) % corners.shape[1]]
            length = np.linalg.norm(points[a] - points[b], axis=1)
            for end in (a, b):
                np.minimum.at(edge, end, np.where(a == b, np.inf, length))
                np.maximum.at(longest, end, length)
        numbers = distinct(corners, topology.n_unique)
        local = places_among(numbers, topology.n_unique)
        return cls(points[numbers], numbers, edge[numbers], longest[numbers], local[corners], grid, topology)

    @property
    def face_normals(self) -> FloatArray:
        """Unit normals (m, 3) of the faces, out of the grid."""
        corners, plane = self.points[self.faces], plane_normal(self.grid)
        return unit(doubled_areas(corners) if plane is None else np.cross(corners[:, 1] - corners[:, 0], plane))

    @property
    def normals(self) -> FloatArray:
        """Unit normals (n, 3) at the nodes: mean of those of their faces."""
        total, faces = np.zeros((len(self.points), 3)), self.face_normals
        for column in self.faces.T:
            np.add.at(total, column, faces)
        return unit(total)

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
    label, how, used : name of the table, the matching, and the number of its points that were used, of how many
    points : (m, 3) of the table; (0, 3) for a grid of the same nodes
    beyond : (n,) distance of the node beyond the edge of the table's surface
    partial : whether nodes without a match are allowed
    plane : whether the table has two components of the displacement only
    walls : see :class:`Matching`
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
    plane: bool = False
    walls: tuple[str, ...] = ()


def spacings(tree: scipy.spatial.cKDTree) -> FloatArray:
    """Distance (n,) of every point of a tree from its fourth nearest neighbour, or from the last of fewer."""
    return np.asarray(tree.query(tree.data, k=min(5, tree.n))[0].reshape(tree.n, -1)[:, -1])
