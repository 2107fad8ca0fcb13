"""What keeps boundary nodes where they belong: slip planes and surfaces, mirror planes, periodic pairs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import CaseError
from .grid import FloatArray, Grid, IntArray
from .numerics.coincidence import close_pairs
from .topology import RELATIVE_TOLERANCE, Topology

# A surface whose nodes leave its mean plane by less than this fraction of its size is a plane.
_FLATNESS = 1e-6


@dataclass(frozen=True)
class Plane:
    """A plane through ``point`` with unit ``normal``; normals along an axis are exact unit vectors."""

    point: FloatArray
    normal: FloatArray


@dataclass(frozen=True)
class CurvedSurface:
    """A curved slip surface: triangles of its undeformed face quads, and the nodes that slide on it.

    ``nodes`` (n,) are unique node numbers; ``points`` (m, 3) and ``triangles`` (k, 3) describe the surface.
    """

    nodes: IntArray
    points: FloatArray
    triangles: IntArray


@dataclass(frozen=True)
class Slip:
    """Nodes that slide: in planes (up to three at a node), on curved surfaces, or both.

    Attributes
    ----------
    groups : (node numbers (n,), removed directions (3, 3)) for each set of planes that meet at a node; the displacement
        loses its components along the removed directions: ``d - d @ removed``
    curved : curved slip surfaces
    """

    groups: tuple[tuple[IntArray, FloatArray], ...] = ()
    curved: tuple[CurvedSurface, ...] = ()

    def constrain(self, displacement: FloatArray, points: FloatArray) -> None:
        """Make ``displacement`` (n_unique, 3) of the undeformed ``points`` obey the constraints, in place."""
        for surface in self.curved:
            self._slide(surface, displacement, points)
        for nodes, removed in self.groups:
            moved = displacement[nodes]
            displacement[nodes] = moved - moved @ removed

    @staticmethod
    def _slide(surface: CurvedSurface, displacement: FloatArray, points: FloatArray) -> None:
        from .numerics.surface import TriangleTree

        moving = surface.nodes[(displacement[surface.nodes] != 0.0).any(axis=1)]
        if moving.size:
            target = points[moving] + displacement[moving]
            triangle, weights, _ = TriangleTree(surface.points, surface.triangles).closest(target)
            corners = surface.points[surface.triangles[triangle]]
            displacement[moving] = np.einsum("nc,ncd->nd", weights, corners) - points[moving]


def plane_of(points: FloatArray, plane_normal: FloatArray | None) -> Plane | None:
    """The plane that holds all ``points`` (n, 3), or ``None`` when they are curved.

    In a 2-D grid (``plane_normal`` given) the "plane" is the straight line through the points.
    """
    center = points.mean(axis=0)
    arms = points - center
    size = float(np.abs(arms).max())
    if size == 0.0:
        return None
    _, _, directions = np.linalg.svd(arms, full_matrices=False)
    normal = directions[-1] if plane_normal is None else np.cross(plane_normal, directions[0])
    normal = _snapped(normal / np.linalg.norm(normal))
    if float(np.abs(arms @ normal).max()) > _FLATNESS * size:
        return None
    return Plane(center, normal)


def _snapped(normal: FloatArray) -> FloatArray:
    axis = int(np.argmax(np.abs(normal)))
    unit = np.zeros(3)
    unit[axis] = 1.0
    if np.linalg.norm(normal * np.sign(normal[axis]) - unit) < _FLATNESS:
        return unit
    return normal * np.sign(normal[axis])


def slip_groups(planes: list[tuple[Plane, IntArray]], n_unique: int) -> tuple[tuple[IntArray, FloatArray], ...]:
    """Nodes grouped by the set of slip directions that meet at them.

    Parameters
    ----------
    planes : planes with the unique node numbers that lie on them
    """
    normals: list[FloatArray] = []
    member = []
    for plane, nodes in planes:
        same = [i for i, n in enumerate(normals) if abs(n @ plane.normal) > 1 - _FLATNESS**2 * 8]
        if not same:
            normals.append(plane.normal)
            same = [len(normals) - 1]
        member.append((same[0], nodes))
    on = np.zeros((n_unique, len(normals)), dtype=bool)
    for index, nodes in member:
        on[nodes, index] = True
    touched = np.flatnonzero(on.any(axis=1))
    if touched.size == 0:
        return ()
    sets, which = np.unique(on[touched], axis=0, return_inverse=True)
    return tuple((touched[which == s], _span_projector(np.array(normals)[chosen])) for s, chosen in enumerate(sets))


def _span_projector(normals: FloatArray) -> FloatArray:
    """Orthogonal projector (3, 3) on the span of the rows of ``normals``."""
    basis: list[FloatArray] = []
    for normal in normals:
        rest = normal - sum((b * (b @ normal) for b in basis), np.zeros(3))
        length = float(np.linalg.norm(rest))
        if length > 1e-6:
            basis.append(rest / length)
    return np.sum([np.outer(b, b) for b in basis], axis=0)


@dataclass(frozen=True)
class Periodic:
    """Pairs of unique nodes that move alike up to a rotation: ``d[two] = rotation @ d[one]``.

    Attributes
    ----------
    one, two : (n,) unique node numbers
    rotation : (n, 3, 3)
    """

    one: IntArray
    two: IntArray
    rotation: FloatArray

    @classmethod
    def none(cls) -> Periodic:
        empty = np.empty(0, dtype=np.int64)
        return cls(empty, empty, np.empty((0, 3, 3)))

    def __add__(self, other: Periodic) -> Periodic:
        return Periodic(
            np.concatenate([self.one, other.one]),
            np.concatenate([self.two, other.two]),
            np.concatenate([self.rotation, other.rotation]),
        )

    def frames(self, n_unique: int) -> tuple[IntArray, IntArray, FloatArray]:
        """Nodes that take part, the smallest node of each one's ring of images, and the rotation from it.

        Corner nodes have several images; they are reached by walking the pairs until nothing changes.
        """
        nodes = np.unique(np.r_[self.one, self.two])
        root = np.arange(n_unique)
        turn = np.tile(np.eye(3), (n_unique, 1, 1))
        pairs = (
            (self.one, self.two, self.rotation),
            (self.two, self.one, self.rotation.transpose(0, 2, 1)),
        )
        changed = True
        while changed:
            changed = False
            for source, target, rotation in pairs:
                better = root[source] < root[target]
                if better.any():
                    s, t = source[better], target[better]
                    root[t] = root[s]
                    turn[t] = rotation[better] @ turn[s]
                    changed = True
        return nodes, root[nodes], turn[nodes]

    def constrain(self, displacement: FloatArray, free: np.ndarray) -> None:
        """Give all images of a node the mean of their displacements, in place, where they are ``free`` (n_unique,).

        The mean is taken in the frame of one image, so that it does not depend on which.
        """
        if self.one.size == 0:
            return
        nodes, root, turn = self.frames(len(displacement))
        total = np.zeros_like(displacement)
        count = np.zeros(len(displacement))
        np.add.at(total, root, np.einsum("nji,nj->ni", turn, displacement[nodes]))
        np.add.at(count, root, 1.0)
        mean = np.einsum("nij,nj->ni", turn, total[root] / count[root, None])
        displacement[nodes[free[nodes]]] = mean[free[nodes]]


def periodic_pairs(grid: Grid, topology: Topology, one: IntArray, two: IntArray, owner: str) -> Periodic:
    """Pair the nodes of two periodic boundaries by the translation or rotation that maps one onto the other.

    Parameters
    ----------
    one, two : unique node numbers of the two sides

    Raises
    ------
    CaseError
        When no translation, and no rotation about a coordinate axis, maps one side onto the other.
    """
    p, q = grid.points[topology.first[one]], grid.points[topology.first[two]]
    gap = np.inf
    if len(one) == len(two):
        for rotation in [np.eye(3), *_axis_rotations(p, q)]:
            image = p @ rotation.T
            shift = q.mean(axis=0) - image.mean(axis=0) if np.array_equal(rotation, np.eye(3)) else np.zeros(3)
            tolerance = np.r_[topology.edge[one], topology.edge[two]] * RELATIVE_TOLERANCE
            pairs = close_pairs(np.concatenate([image + shift, q]), tolerance)
            pairs = np.sort(pairs, axis=1)
            pairs = pairs[(pairs[:, 0] < len(one)) & (pairs[:, 1] >= len(one))]
            if len(pairs) == len(one):
                matched = two[pairs[:, 1] - len(one)]
                return Periodic(one[pairs[:, 0]], matched, np.tile(rotation, (len(one), 1, 1)))
            gap = min(gap, len(one) - len(pairs))
    raise CaseError(
        f"boundary {owner!r}: its two periodic sides ({len(one)} and {len(two)} nodes) do not match by a translation "
        f"or by a rotation about a coordinate axis; expected select = [one side, other side] with equal node layouts"
    )


def _axis_rotations(p: FloatArray, q: FloatArray) -> list[FloatArray]:
    """Rotations about x, y and z through the origin that carry the centroid of ``p`` over that of ``q``."""
    rotations = []
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        angles = [np.arctan2(c[b], c[a]) for c in (p.mean(axis=0), q.mean(axis=0))]
        cos, sin = np.cos(angles[1] - angles[0]), np.sin(angles[1] - angles[0])
        rotation = np.eye(3)
        rotation[[a, a, b, b], [a, b, a, b]] = [cos, -sin, sin, cos]
        rotations.append(rotation)
    return rotations
