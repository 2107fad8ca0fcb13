"""Constraints on the displacement of face nodes: slip, periodicity, coincidence; and their derivatives."""

from __future__ import annotations

import numpy as np

from ..grid import FloatArray, IntArray
from ..grid.topology import Topology
from ..parallel import Nodes, for_chunks
from .base import Kinks, Problem
from .limits import EDGES

# Face nodes per chunk: large enough to outweigh the cost of starting a thread.
_NODES = 100_000


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
        rows[nodes[lo:hi]] = face.take(number[lo:hi], axis=0)

    for_chunks(work, len(nodes), _NODES)


class Constraints:
    """Slip and periodicity at one displacement ``face`` (n_unique, 3), given before the constraints are imposed on it.

    Attributes
    ----------
    kinks : nodes that slide on a curved surface and are at the edge of a flat face
    """

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
        if periodic.one.size:
            nodes, root, turn = periodic.frames(len(face))
            free = ~known[nodes]
            total, count = np.zeros_like(face), np.bincount(root, minlength=len(face))
            np.add.at(total, root[free], np.einsum("nji,nj->ni", turn[free], face[nodes[free]]))
            face[nodes[free]] = 0.0
            face[nodes] += np.einsum("nij,nj->ni", turn, total[root] / count[root, None])
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
