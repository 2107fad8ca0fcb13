"""Constraints on the boundary: nodes that slide in planes, symmetry planes among them, and on curved surfaces; periodic
nodes, which move alike; grids of one layer of cells, whose end planes mirror each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..errors import CaseError
from ..grid import BoolArray, FloatArray, Grid, IntArray, Side
from ..grid.connections import connected_nodes, periodic_rotation
from ..grid.planes import FLATNESS, Plane, plane_normal, plane_of, snapped
from ..grid.topology import RELATIVE_TOLERANCE, Topology
from ..grid.windows import end_planes, side_numbers
from ..numerics.arrays import lengths
from ..numerics.geometry.coincidence import close_pairs, one_side
from ..parallel import Nodes
from ..wording import counted, vector

if TYPE_CHECKING:
    from ..numerics.geometry.surface import TriangleTree

_ON_EDGE = 1e-12
"""Barycentric weights below this are zero but for round-off."""
_CREASE = np.cos(np.deg2rad(30.0))
"""Where triangles deviate from their mean by a larger angle, sliding would cut off the edge of the surface."""
_MIRRORED = 1e-9
"""Largest difference of mirrored displacements, relative to the largest displacement."""


@dataclass(frozen=True, eq=False)
class CurvedSurface:
    """The curved slip surface of the boundary ``name``: triangles of its undeformed face quads.

    Attributes
    ----------
    nodes : (n,) unique numbers of the nodes that slide on it
    corners, points : (m,) unique numbers and (m, 3) undeformed coordinates of all nodes of the surface
    triangles : (k, 3) rows of ``points``, counter-clockwise as seen from outside the blocks; in a plane grid those of
        edges, without width
    rim : (m,) points at edges with moving walls, beyond which the surface continues as the planes of its triangles
    normal : (3,) of a plane grid, zero in space
    """

    name: str
    nodes: IntArray
    corners: IntArray
    points: FloatArray
    triangles: IntArray
    rim: BoolArray
    normal: FloatArray

    def closest(self, targets: FloatArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Numbers (k,) of the triangles with the points closest to ``targets`` (k, 3), the weights (k, 3) of their
        corners at these points, some of them negative beyond a moving rim, and the distances (k,) from the triangles.
        """
        triangle, weights, distance = self._tree.closest(targets)
        corners = self.triangles[triangle]
        beyond = np.flatnonzero((self.rim[corners] | (weights < _ON_EDGE)).all(axis=1))
        x = self.points[corners[beyond]]
        along = np.linalg.pinv((x[:, 1:] - x[:, :1]).transpose(0, 2, 1))
        weights[beyond, 1:] = np.einsum("nij,nj->ni", along, targets[beyond] - x[:, 0])
        weights[beyond, 0] = 1.0 - weights[beyond, 1:].sum(axis=1)
        return triangle, weights, distance

    def project(self, targets: FloatArray) -> FloatArray:
        """The points (k, 3) of the surface closest to ``targets`` (k, 3)."""
        triangle, weights, _ = self.closest(targets)
        return np.asarray(np.einsum("nc,ncd->nd", weights, self.points[self.triangles[triangle]]))

    def normals(self, targets: FloatArray) -> FloatArray:
        """Unit normals (k, 3) of the surface at its points closest to ``targets`` (k, 3)."""
        mean = self._mean_normals(targets)[0]
        return np.asarray(mean / np.maximum(lengths(mean), 1e-300)[:, None])

    def slopes(self, targets: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k, 3, 3) of :meth:`project` and :meth:`normals` at ``targets`` (k, 3), within their
        triangles."""
        mean, normals, triangle = self._mean_normals(targets)
        corners = self.points[self.triangles[triangle]]
        sides = (corners[:, 1:] - corners[:, :1]).transpose(0, 2, 1)
        # Derivatives of the weights of the second and third corner; that of the first is minus their sum.
        weights, size = np.linalg.pinv(sides), np.maximum(lengths(mean), 1e-300)[:, None, None]
        change = (normals[:, 1:] - normals[:, :1]).transpose(0, 2, 1) @ weights / size
        normal = mean[:, :, None] / size
        return sides @ weights, change - normal @ (normal.transpose(0, 2, 1) @ change)

    @cached_property
    def creased(self) -> BoolArray:
        """Whether a triangle at each of the points (m,) deviates by more than 30 degrees from their mean direction, as
        both sides of a fold of 60 degrees do."""
        length = lengths(self._triangle_normals)
        unit = self._triangle_normals / np.maximum(length, 1e-300)[:, None]
        lowest = np.ones(len(self.points))
        for at in self.triangles.T:
            cosine = np.einsum("nd,nd->n", unit, self._vertex_normals[at])
            np.minimum.at(lowest, at, np.where(length > 0.0, cosine, 1.0))
        return np.asarray(lowest <= _CREASE)

    def _mean_normals(self, targets: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
        """Mean (k, 3) of the unit normals at the corners of the triangles closest to ``targets`` (k, 3), with
        barycentric weights; these normals (k, 3, 3); and the numbers (k,) of the triangles."""
        triangle, weights, _ = self.closest(targets)
        normals = self._vertex_normals[self.triangles[triangle]]
        return np.einsum("nc,ncd->nd", weights, normals), normals, triangle

    @cached_property
    def _triangle_normals(self) -> FloatArray:
        """Normals (k, 3) whose length is the area of each triangle, or the length of each segment of a plane curve, up
        to a factor."""
        a, b, c = (self.points[at] for at in self.triangles.T)
        return np.asarray(np.cross(b - a, self.normal if self.normal.any() else c - a))

    @cached_property
    def _vertex_normals(self) -> FloatArray:
        """Mean directions (m, 3) of the normals of the triangles at each point; zero where these cancel out."""
        total = np.zeros_like(self.points)
        for at in self.triangles.T:
            np.add.at(total, at, self._triangle_normals)
        return np.asarray(total / np.maximum(lengths(total), 1e-300)[:, None])

    @cached_property
    def _tree(self) -> TriangleTree:
        from ..numerics.geometry.surface import TriangleTree

        return TriangleTree(self.points, self.triangles)


@dataclass(frozen=True)
class Slip:
    """Nodes that slide: in planes (up to three at a node), on curved surfaces, or both.

    Attributes
    ----------
    planes : (unit normal (3,), node numbers) of slip and symmetry planes, those with the same normal together, with all
        unique nodes that lie on them, sources included
    groups : (node numbers (n,), removed directions (3, 3)) for each set of planes that meet at a node; the displacement
        loses its components along the removed directions: ``d - d @ removed``
    sides : (unit normal (3,), face quads) of plane slip sides, those with the same normal together; none of symmetries
    curved : curved slip surfaces
    """

    planes: tuple[tuple[FloatArray, IntArray], ...] = ()
    groups: tuple[tuple[IntArray, FloatArray], ...] = ()
    sides: tuple[tuple[FloatArray, IntArray], ...] = ()
    curved: tuple[CurvedSurface, ...] = ()

    def constrain(self, displacement: FloatArray, points: FloatArray, first: IntArray) -> None:
        """Make ``displacement`` (n_unique, 3) obey the constraints, in place.

        The nodes are the rows ``first`` (n_unique,) of the undeformed ``points`` (n_nodes, 3).
        """
        for surface in self.curved:
            moving = surface.nodes[(displacement[surface.nodes] != 0.0).any(axis=1)]
            if moving.size:
                start = Nodes.of(points).at(first[moving])
                displacement[moving] = surface.project(start + displacement[moving]) - start
        for nodes, removed in self.groups:
            given = displacement.take(nodes, axis=0)
            # Not a product of matrices: threads of a BLAS take longer to begin.
            displacement[nodes] = given - np.einsum("nd,de->ne", given, removed)

    def departure(self, displacement: FloatArray) -> float:
        """Largest displacement of a node out of a plane that it lies on (grid length unit)."""
        return max((float(np.abs(displacement[nodes] @ normal).max()) for normal, nodes in self.planes), default=0.0)


def find_sliding(
    grid: Grid, topology: Topology, slipping: Sequence[tuple[str, IntArray, bool]], free: BoolArray, moving: BoolArray
) -> tuple[Slip, tuple[Plane, ...]]:
    """Slip constraints and symmetry planes. Raises CaseError when a symmetry boundary is not plane.

    ``slipping`` has name, face quads and "is a symmetry" of every slip or symmetry boundary; ``free`` and ``moving``
    (n_unique,) are the nodes that belong to no stronger boundary, and those of moving ones.
    """
    curved, mirrors = list[CurvedSurface](), list[Plane]()
    # The different normals of planes, and the quads of the planes and of the slip sides with each of them.
    normals, on_planes, on_sides = list[FloatArray](), list[list[IntArray]](), dict[int, list[IntArray]]()
    flat, corners = plane_normal(grid), topology.quads.corners
    for name, quads, symmetry in slipping:
        bent = []
        for side, part in topology.quads.by_side(quads):
            x = grid.nodes.at(topology.first[np.unique(corners[part])])
            plane = plane_of(x, flat)
            if plane is None and symmetry:
                arms = x - x.mean(axis=0)
                axes = np.linalg.svd(arms, full_matrices=False)[2]
                off = np.abs(arms @ (axes[-1] if flat is None else np.cross(flat, axes[0])))
                raise CaseError(
                    f"boundary {name!r} is a symmetry but not plane: {grid.names[side // 6]}.{Side(side % 6).label} "
                    f"lies up to {off.max():.3g} off its mean plane, at {vector(x[int(off.argmax())])}; "
                    f'use kind = "slip" for curved surfaces'
                )
            if plane is None:
                bent.append(part)
                continue
            same = [n for n, normal in enumerate(normals) if abs(normal @ plane.normal) > 1 - FLATNESS**2 * 8]
            if not same:
                normals.append(plane.normal)
                on_planes.append([])
            number = same[0] if same else len(normals) - 1
            on_planes[number].append(part)
            if not symmetry:
                on_sides.setdefault(number, []).append(part)
                continue
            near = 1e-6 * max(float(np.abs(plane.point).max()), 1e-300)
            parallel = [other for other in mirrors if abs(other.normal @ plane.normal) > 1 - 1e-9]
            if not any(abs(other.normal @ (other.point - plane.point)) < near for other in parallel):
                mirrors.append(plane)
        if bent:
            curved.append(_curved_surface(name, grid, topology, np.concatenate(bent), free, moving))
    nodes = [np.unique(corners[np.concatenate(parts)]) for parts in on_planes]
    slip = Slip(
        tuple(zip(normals, nodes, strict=True)),
        _slip_groups(normals, nodes, free),
        tuple((normals[number], np.concatenate(parts)) for number, parts in on_sides.items()),
        tuple(curved),
    )
    return slip, tuple(mirrors)


def crease_notes(grid: Grid, topology: Topology, slip: Slip) -> list[str]:
    """Warnings about creases of curved slip surfaces that begin at moving walls."""
    notes = []
    for surface in slip.curved:
        nodes = surface.corners[surface.rim & surface.creased] if surface.rim.any() else surface.nodes[:0]
        if nodes.size:
            first = int(topology.first[nodes[0]])
            notes.append(
                f"the slip boundary {surface.name!r} has creases of more than 30 degrees that begin at moving walls, "
                f"at {counted(nodes.size, 'node')}, first {grid.node_label(first)} = {vector(grid.points[first])}; "
                f"nodes on them may leave them and cut off the edge: give both sides boundary entries of their own"
            )
    return notes


def _curved_surface(
    name: str, grid: Grid, topology: Topology, quads: IntArray, free: BoolArray, moving: BoolArray
) -> CurvedSurface:
    corners = topology.quads.corners[quads]
    corners = corners[one_side(corners)]
    nodes, local = np.unique(corners, return_inverse=True)
    local = local.reshape(corners.shape)
    # Edges, in 2-D end nodes, of one quad only.
    ends = [local, np.roll(local, 1, axis=1)] if grid.dimension == 3 else [local]
    edges = np.sort(np.stack(ends, axis=-1).reshape(-1, len(ends)), axis=1)
    edges, count = np.unique(edges, axis=0, return_counts=True)
    edges = edges[(count == 1) & moving[nodes[edges]].all(axis=1)]
    rim = np.zeros(len(nodes), dtype=bool)
    rim[edges] = True
    points = grid.nodes.at(topology.first[nodes])
    normal = plane_normal(grid)
    plane = np.zeros(3) if normal is None else normal
    return CurvedSurface(name, nodes[free[nodes]], nodes, points, triangles_of(local), rim, plane)


def triangles_of(quads: IntArray) -> IntArray:
    """Two triangles (2 n, 3) for each of the quads (n, 4); of cell edges (n, 2) in 2-D, triangles without width."""
    split = ([0, 1, 2], [0, 2, 3]) if quads.shape[1] == 4 else ([0, 1, 1],)
    return np.concatenate([quads[:, which] for which in split])


def _slip_groups(
    normals: Sequence[FloatArray], nodes: Sequence[IntArray], free: BoolArray
) -> tuple[tuple[IntArray, FloatArray], ...]:
    """Free nodes grouped by the set of ``normals`` of the planes that meet at them; ``nodes`` are those on the planes
    with each normal."""
    on = np.zeros((len(free), len(normals)), dtype=bool)
    for index, members in enumerate(nodes):
        on[members, index] = True
    touched = np.flatnonzero(on.any(axis=1) & free)
    if touched.size == 0:
        return ()
    sets, member = np.unique(on[touched], axis=0, return_inverse=True)
    groups = []
    for number, chosen in enumerate(sets):
        # Orthogonal projector on the span of the normals; those that nearly repeat others count as the same.
        basis: list[FloatArray] = []
        for normal in np.array(normals)[chosen]:
            rest = normal - sum((b * (b @ normal) for b in basis), np.zeros(3))
            if (length := float(np.linalg.norm(rest))) > 1e-6:
                basis.append(rest / length)
        groups.append((touched[member == number], np.sum([np.outer(b, b) for b in basis], axis=0)))
    return tuple(groups)


@dataclass(frozen=True)
class Periodic:
    """Periodic nodes, which move alike up to rotations: ``d[nodes] = turn @ d[root]``.

    ``nodes`` (n,) are unique numbers, ascending; ``root`` (n,) is the smallest node among the images of each, ``turn``
    (n, 3, 3) the rotation from it.
    """

    nodes: IntArray
    root: IntArray
    turn: FloatArray

    @classmethod
    def of(cls, pairs: Sequence[Pairs], n_unique: int) -> Periodic:
        """The periodic nodes of all ``pairs``; those at corners have several images, found by following the pairs until
        nothing changes."""
        root, turn = np.arange(n_unique), np.tile(np.eye(3), (n_unique if pairs else 0, 1, 1))
        both = [ends for one, two, turns in pairs for ends in ((one, two, turns), (two, one, turns.transpose(0, 2, 1)))]
        changed = True
        while changed:
            changed = False
            for source, target, rotation in both:
                better = root[source] < root[target]
                if better.any():
                    s, t = source[better], target[better]
                    root[t] = root[s]
                    turn[t] = rotation[better] @ turn[s]
                    changed = True
        nodes = np.unique(np.concatenate([np.empty(0, dtype=np.int64), *(one for one, _, _ in both)]))
        return cls(nodes, root[nodes], turn[nodes])

    def at_roots(self, values: FloatArray, some: IntArray | BoolArray | slice = slice(None)) -> FloatArray:
        """Sums (n_unique, 3) at the roots, in their frames, of ``values`` (n_unique, 3) of all images or ``some``."""
        total = np.zeros_like(values)
        np.add.at(total, self.root[some], np.einsum("nji,nj->ni", self.turn[some], values[self.nodes[some]]))
        return total

    def at_images(self, values: FloatArray) -> FloatArray:
        """``values`` (n_unique, 3) at the roots in the frames of all images (n, 3)."""
        return np.asarray(np.einsum("nij,nj->ni", self.turn, values[self.root]))

    def count(self, n_unique: int, some: BoolArray | slice = slice(None)) -> FloatArray:
        """Number (n_unique, 1) of images of each root, or of ``some`` images, at least 1."""
        return np.maximum(np.bincount(self.root[some], minlength=n_unique), 1.0)[:, None]

    def constrain(self, displacement: FloatArray, free: BoolArray) -> None:
        """Give all images of a node the mean of their displacements, in place, where they are ``free`` (n_unique,).

        The mean is taken in the frame of one image; the choice of image does not matter.
        """
        if self.nodes.size:
            mean = self.at_images(self.at_roots(displacement) / self.count(len(displacement)))
            displacement[self.nodes[free[self.nodes]]] = mean[free[self.nodes]]


Pairs = tuple[IntArray, IntArray, FloatArray]
"""Unique numbers (n,) of periodic nodes, ``one`` and ``two``, and (n, 3, 3): ``d[two] = rotation @ d[one]``."""


def find_periodicity(
    grid: Grid, topology: Topology, name: str, quads: IntArray, sides: Sequence[IntArray]
) -> list[Pairs]:
    """Pairs of one periodic boundary with these face ``quads``: as declared in the file, otherwise by matching its two
    ``sides``, the quads of its ``select`` patterns. Raises CaseError when the file declares nothing and there are not
    two sides that match."""
    nodes = np.unique(topology.quads.corners[quads])
    declared, paired = list[Pairs](), np.zeros(topology.n_unique, dtype=bool)
    for connection in grid.connections:
        if connection.periodic is not None:
            own, donor = (topology.numbers_of(flat) for flat in connected_nodes(grid, connection))
            inside = np.isin(own, nodes) & np.isin(donor, nodes)
            rotation = np.tile(periodic_rotation(connection.periodic), (int(inside.sum()), 1, 1))
            declared.append((own[inside], donor[inside], rotation))
            paired[own[inside]] = paired[donor[inside]] = True
    if paired[nodes].all():
        return declared
    if len(sides) != 2:
        raise CaseError(
            f"boundary {name!r} is periodic but has {len(sides)} select patterns, and the file declares no "
            f"periodic connection for them; expected select = [one side, other side]"
        )
    one, two = (np.unique(topology.quads.corners[np.intersect1d(quads, side)]) for side in sides)
    # The translation, or the rotation about a coordinate axis, that maps one side onto the other by their centroids.
    p, q = grid.nodes.at(topology.first[one]), grid.nodes.at(topology.first[two])
    centers = p.mean(axis=0), q.mean(axis=0)
    changes = [(np.eye(3), centers[1] - centers[0])]
    for axis in range(3):
        a, b = (axis + 1) % 3, (axis + 2) % 3
        before, after = (np.arctan2(center[b], center[a]) for center in centers)
        cos, sin = np.cos(after - before), np.sin(after - before)
        rotation = np.eye(3)
        rotation[[a, a, b, b], [a, b, a, b]] = [cos, -sin, sin, cos]
        changes.append((rotation, np.zeros(3)))
    tolerance = np.r_[topology.edge[one], topology.edge[two]] * RELATIVE_TOLERANCE
    for rotation, shift in changes if len(one) == len(two) else []:
        pairs = np.sort(close_pairs(np.concatenate([p @ rotation.T + shift, q]), tolerance), axis=1)
        pairs = pairs[(pairs[:, 0] < len(one)) & (pairs[:, 1] >= len(one))]
        if len(pairs) == len(one):
            return [(one[pairs[:, 0]], two[pairs[:, 1] - len(one)], np.tile(rotation, (len(one), 1, 1)))]
    raise CaseError(
        f"boundary {name!r}: its two periodic sides ({len(one)} and {len(two)} nodes) do not match by a translation "
        f"or by a rotation about a coordinate axis; expected select = [one side, other side] with equal node layouts"
    )


@dataclass(frozen=True)
class Layer:
    """A grid of one layer of cells whose two end planes mirror each other, a straight extrusion or a wedge: pairs of
    nodes (n, 2), by unique numbers, of which the second is the mirror image of the first.

    Where the motion of the boundary is mirrored, too, so is that of all nodes: a straight extrusion that moves in its
    plane, a wedge that moves along its planes. Nodes of one plane are then computed, and those of the other follow them
    to the last bit, whatever the errors of approximated sums.

    ``free`` are those whose displacement is sought, ``known`` those of sources; ``normal`` is that of the plane between
    the two, ``middle`` (k,) are nodes in it, such as those on the axis of a wedge.
    """

    free: IntArray
    known: IntArray
    middle: IntArray
    normal: FloatArray

    @property
    def followers(self) -> IntArray:
        """The nodes that follow others."""
        return np.asarray(self.free[:, 1])

    def follow(self, displacement: FloatArray) -> None:
        """Give the followers, in place, the mirrored displacement (n_unique, 3) of those that they follow."""
        displacement[self.followers] = self._mirrored(displacement[self.free[:, 0]])
        own = displacement[self.middle]
        displacement[self.middle] = 0.5 * (own + self._mirrored(own))

    def mirrors(self, displacement: FloatArray) -> bool:
        """Whether the displacement (n_unique, 3) of the sources is mirrored."""
        one, two = displacement[self.known[:, 0]], displacement[self.known[:, 1]]
        largest = float(lengths(displacement).max(initial=0.0))
        return bool(np.abs(two - self._mirrored(one)).max(initial=0.0) <= _MIRRORED * largest)

    def _mirrored(self, vectors: FloatArray) -> FloatArray:
        return np.asarray(vectors - np.outer(2.0 * (vectors @ self.normal), self.normal))


def find_layer(grid: Grid, topology: Topology, kinds: np.ndarray, sources: BoolArray) -> Layer | None:
    """The layer that a grid consists of; ``None`` if it is thicker, or its planes do not mirror each other in position
    or in the ``kinds`` (n_unique,) of nodes, of which the ``sources`` (n_unique,) have a prescribed displacement."""
    sides = end_planes(grid, topology)
    if not sides:
        return None
    planes = [[side_numbers(grid, topology, n // 6, Side(n % 6)).ravel() for n in sides[end::2]] for end in (0, 1)]
    pairs = np.unique(np.stack([np.concatenate(plane) for plane in planes], axis=1), axis=0)
    x = grid.nodes.at(topology.first)
    across = x[pairs[:, 1]] - x[pairs[:, 0]]
    longest = across[int(np.argmax(lengths(across)))]
    normal = snapped(longest[None] / np.linalg.norm(longest))[0]
    pairs = np.where((across @ normal < 0.0)[:, None], pairs[:, ::-1], pairs)
    one, two = x[pairs[:, 0]], x[pairs[:, 1]]
    thickness, middle = (two - one) @ normal, 0.5 * (one + two) @ normal
    off = np.abs(two - one - np.outer(thickness, normal)).max(), np.ptp(middle)
    if max(off) > FLATNESS * float(np.ptp(x, axis=0).max()):
        return None
    same = pairs[:, 0] == pairs[:, 1]
    middle, pairs = pairs[same, 0], np.unique(pairs[~same], axis=0)
    kind = kinds[pairs]
    if len(np.unique(pairs)) < pairs.size or (kind[:, 0] != kind[:, 1]).any():
        return None
    known = sources[pairs[:, 1]]
    free = middle[~sources[middle]]
    return None if known.all() else Layer(pairs[~known], pairs[known], free, normal)
