"""Constraints on displacements: slip, periodicity and coincidence of face nodes, and what follows from slip for nodes
beside it; and their derivatives."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..boundary import Kind
from ..boundary.constraints import triangles_of
from ..grid import FloatArray, IntArray
from ..grid.topology import Topology
from ..numerics.geometry.surface import TriangleTree
from ..parallel import Nodes, for_chunks
from .base import Kinks, Problem, Progress, of_stage
from .limits import EDGES

# Face nodes per chunk: large enough to outweigh the cost of starting a thread.
_NODES = 100_000
WIDTH = 0.3
"""Length of the parabolic end at the walls relative to the distance from wall to slip side (studies/slip_sides.py)."""
_CHUNK = 4096
# Relative to the extent of the sources.
_ROUND_OFF = 1e-13
# Data are kept between displacements only if they take at most one part in this many of the memory limit.
_KEPT = 8


def impose(problem: Problem, face: FloatArray, out: FloatArray | None = None) -> None:
    """Impose slip and periodicity on ``face`` (n_unique, 3), in place, and copy it to all coincident nodes of ``out``
    (n_nodes, 3)."""
    topology, boundary = problem.topology, problem.boundary
    if problem.layer and out is not None:
        problem.layer.follow(face)
    boundary.slip.constrain(face, problem.grid.points, topology.first)
    boundary.periodic.constrain(face, ~boundary.known)
    if out is not None:
        put_on_faces(face, out, problem)


def put_on_faces(face: FloatArray, out: FloatArray, problem: Problem) -> None:
    """Copy displacements (n_unique, 3) to all coincident nodes in the rows of ``out`` (n_nodes, 3)."""
    number, nodes = own_face_nodes(problem.topology, out)
    rows = Nodes.of(out).rows

    def work(lo: int, hi: int) -> None:
        # Component by component: numpy copies short rows one by one.
        for c in range(3):
            rows[nodes[lo:hi], c] = face[:, c].take(number[lo:hi])

    for_chunks(work, len(nodes), _NODES)


class Constraints:
    """Slip and periodicity at one displacement ``face`` (n_unique, 3), given before the constraints are imposed on it;
    ``kinks`` counts nodes that slide on a curved surface and are at the edge of a flat face."""

    def __init__(self, problem: Problem, face: FloatArray) -> None:
        self._problem = problem
        self.kinks = Kinks()
        # Sliding nodes, and projectors (n, 3, 3) onto the triangle or the edge on which each of them lies.
        self._sliding = list[tuple[IntArray, FloatArray]]()
        for surface in problem.boundary.slip.curved:
            # Nodes on sides that the second step fills have no displacement yet.
            nodes = surface.nodes[np.isfinite(face[surface.nodes, 0])]
            target = problem.grid.points[problem.topology.first[nodes]] + face[nodes]
            triangle, weights, distance = surface.closest(target)
            corners = surface.points[surface.triangles[triangle]]
            # Beyond a moving rim the whole plane of a triangle belongs to the surface.
            positive = (weights > 1e-9) | (weights.min(axis=1, keepdims=True) < -1e-9)
            count, size = positive.sum(axis=1), np.ptp(corners, axis=1).max(axis=1)
            # Plane curves are represented by triangles of zero width.
            whole = 2 if (surface.triangles[:, 1] == surface.triangles[:, 2]).all() else 3
            edge = (count < whole) & (distance <= 1e-9 * size)
            self.kinks += Kinks({EDGES: int(np.count_nonzero(edge))})
            # Free directions: within the triangle, along the edge, or none at a vertex.
            base = np.where(positive | (edge & (count == 1))[:, None], 1.0, 0.0)
            middle = np.einsum("nc,ncd->nd", base, corners) / base.sum(axis=1)[:, None]
            left, length, _ = np.linalg.svd(((corners - middle[:, None]) * base[:, :, None]).transpose(0, 2, 1))
            kept = left[:, :, :2] * (length[:, None, :2] > 1e-9 * size[:, None, None])
            self._sliding.append((nodes, np.asarray(kept @ kept.transpose(0, 2, 1))))

    def push(self, face: FloatArray) -> None:
        """Impose the constraints on a change ``face`` (n_unique, 3), in place."""
        problem = self._problem
        for nodes, tangent in self._sliding:
            face[nodes] = np.einsum("nij,nj->ni", tangent, face[nodes])
        for nodes, removed in problem.boundary.slip.groups:
            face[nodes] -= face[nodes] @ removed
        problem.boundary.periodic.constrain(face, ~problem.boundary.known)

    def pull(self, face: FloatArray) -> None:
        """Transpose of :meth:`push`, in place."""
        problem = self._problem
        periodic, known = problem.boundary.periodic, problem.boundary.known
        if periodic.nodes.size:
            free = ~known[periodic.nodes]
            mean = periodic.at_images(periodic.at_roots(face, free) / periodic.count(len(face)))
            face[periodic.nodes[free]] = 0.0
            face[periodic.nodes] += mean
        for nodes, removed in problem.boundary.slip.groups:
            face[nodes] -= face[nodes] @ removed.T
        for nodes, tangent in self._sliding:
            face[nodes] = np.einsum("nji,nj->ni", tangent, face[nodes])

    def impose(self, face: FloatArray, out: FloatArray) -> None:
        """Impose the constraints on a change ``face``, and copy it to all coincident nodes of ``out`` (n_nodes, 3)."""
        self.push(face)
        put_on_faces(face, out, self._problem)

    def gathered(self, gradient: FloatArray) -> FloatArray:
        """Transpose of :meth:`impose`: gradient (n_unique, 3) of the face nodes, with the rows of coincident nodes in
        ``gradient`` (n_nodes, 3) added up and set to zero."""
        topology = self._problem.topology
        face: FloatArray = np.empty((topology.n_unique, 3))
        # All ranks add up the same rows, in the order of a whole grid.
        values = gradient[topology.face_nodes]
        for c in range(3):
            face[:, c] = np.bincount(topology.number, values[:, c], topology.n_unique)
        _, own = own_face_nodes(topology, gradient)
        Nodes.of(gradient).rows[own] = 0.0
        self.pull(face)
        return face


def own_face_nodes(topology: Topology, values: FloatArray) -> tuple[IntArray, IntArray]:
    """Unique numbers (n,) and flat indices (n,) of the nodes on block faces; of a grid in parts, of this rank."""
    begin, end = np.searchsorted(topology.face_nodes, Nodes.of(values).ends).tolist()
    return topology.number[begin:end], topology.face_nodes[begin:end]


def add_to_faces(face: FloatArray, topology: Topology, gradient: FloatArray) -> None:
    """Add ``face`` (n_unique, 3) to the rows of one copy of each face node in ``gradient`` (n_nodes, 3)."""
    (low, high), first = Nodes.of(gradient).ends, topology.first
    own = (first >= low) & (first < high)
    Nodes.of(gradient).rows[first[own]] += face[own]


class BesideSlip:
    """Corrects the interpolated displacement u of nodes near slip sides with normals n_k:

        v = (I + sum_k c_k n_k n_k^T)^-1 u,    1 / (1 + c_k) = f(d_k / (d + d_k))

    with the distance d of the undeformed node from the nearest moving face, and d_k from the nearest slip face with
    normal n_k. f rises from 0 to 1, linearly except for a parabolic end at the walls. For one plane, v . n = f u . n:
    zero in the plane, and unchanged at the walls. v is linear in u; motions along the planes remain unchanged.

    A node on a slip plane moves only within the plane, which interpolation ignores: where it displaces the neighbouring
    nodes away from the plane or towards it, the cells in between stretch or fold. None of the nodes ``flat`` (n,) is a
    source.
    """

    def __init__(self, problem: Problem, flat: IntArray) -> None:
        self._problem, self._flat = problem, flat
        sides = problem.boundary.slip.sides
        self.normals: FloatArray = np.array([normal for normal, _ in sides]).reshape(-1, 3)
        # Round-off in a motion along the planes is left as it is.
        self._round_off = _ROUND_OFF * float(np.ptp(problem.source_points, axis=0).max()) if sides else 0.0
        # Stored from the second displacement on, as a single one needs no store.
        self._parts: dict[int, FloatArray] = {}
        self._stores = False

    def apply(self, out: FloatArray, progress: Progress | None = None) -> None:
        """Damp the rows of ``out`` (n_nodes, 3) of these nodes, in place."""
        self.damp(out, self._round_off, progress)

    def damp(self, out: FloatArray, least: float = 0.0, progress: Progress | None = None) -> None:
        """As :meth:`apply`, where a normal component is larger than ``least``; by default for changes or gradients of
        any magnitude."""
        if not len(self.normals):
            return
        rows = Nodes.of(out).rows
        # Sent to all ranks; only those where a node is damped need the trees.
        self._points = self._problem.grid.nodes.at(self._problem.topology.first)

        def work(lo: int, hi: int) -> None:
            flat = self._flat[lo:hi]
            if np.abs(rows[flat] @ self.normals.T).max() > least:
                _damp(rows, flat, self.normals, self._part(lo, flat), least)

        for_chunks(work, len(self._flat), _CHUNK, of_stage(progress, "beside slip sides"))
        self.__dict__.pop("trees", None)
        del self._points
        self._stores = self.normals.shape[0] * 8 * len(self._flat) * _KEPT <= self._problem.memory.size

    def _part(self, first: int, flat: IntArray) -> FloatArray:
        """The part 1 - f (n, k) of its normal components that the displacement of each node loses; ``first`` is the
        number of the first of these nodes."""
        found = self._parts.get(first)
        if found is None:
            x = self._problem.grid.nodes.rows[flat]
            to_wall, *to_sides = (tree.closest(x)[2] for tree in self.trees)
            lost = []
            for to_side in to_sides:
                # Position between the side, 0, and the wall, 1.
                both = to_wall + to_side
                at = np.divide(to_side, both, out=np.ones_like(both), where=both > 0.0)
                linear, end = 1.0 - at / (1.0 - 0.5 * WIDTH), (1.0 - at) ** 2 / (WIDTH * (2.0 - WIDTH))
                lost.append(np.where(at < 1.0 - WIDTH, linear, end))
            found = np.stack(lost, axis=1)
            if self._stores:
                self._parts[first] = found
        return found

    @cached_property
    def trees(self) -> Sequence[TriangleTree]:
        """Search trees, over unique nodes, of the moving faces and of the slip sides of each normal."""
        problem, corners = self._problem, self._problem.topology.quads.corners
        walls = triangles_of(corners[problem.boundary.quad_kind == Kind.MOVING])
        # Moving nodes that belong to no moving face.
        alone = np.setdiff1d(np.flatnonzero(problem.boundary.kind == Kind.MOVING), walls)
        walls = np.concatenate([walls, np.repeat(alone, 3).reshape(-1, 3)])
        every = [walls, *(triangles_of(corners[quads]) for _, quads in problem.boundary.slip.sides)]
        return [TriangleTree(self._points, triangles) for triangles in every]


def _damp(values: FloatArray, rows: IntArray, normals: FloatArray, parts: FloatArray, least: float) -> None:
    """``values[r] = (I + sum_k c_k n_k n_k^T)^-1 values[r]`` for the given rows, each once; c = part / (1 - part).

    ``normals`` (k, 3) are unit vectors; ``parts`` (n, k) is the part of the component along each normal to be removed,
    from 0 (none) to 1 (all). Rows without a component larger than ``least`` remain unchanged. The inverse is built up
    normal by normal with the Sherman-Morrison formula.
    """
    # No matrix products, whose last bits depend on how many rows there are.
    given = values[rows]
    acts = (np.abs(np.einsum("nd,kd->nk", given, normals)) > least).any(axis=1)
    rows, given, parts = rows[acts], given[acts], parts[acts]
    x, before = given.copy(), list[tuple[FloatArray, FloatArray]]()
    for normal, part in zip(normals, parts.T, strict=True):
        way = np.tile(normal, (len(given), 1))
        for other, factor in before:
            way -= (factor * np.einsum("nd,d->n", other, normal))[:, None] * other
        rest = 1.0 - part + part * np.einsum("nd,d->n", way, normal)
        # Zero where the preceding normals leave no component along this one.
        factor = np.divide(part, rest, out=np.zeros_like(rest), where=rest > 1e-12)
        x -= (factor * np.einsum("nd,nd->n", way, given))[:, None] * way
        before.append((way, factor))
    values[rows] = x
