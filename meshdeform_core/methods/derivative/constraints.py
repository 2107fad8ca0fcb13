"""Derivatives of what is imposed on the displacement of face nodes: slip, periodicity, coincidence."""

from __future__ import annotations

import numpy as np

from ...boundary.slip import CurvedSurface
from ...grid import FloatArray, IntArray
from ..base import Problem


class Constraints:
    """Slip and periodicity at one displacement ``face`` (n_unique, 3), before they are imposed on it."""

    def __init__(self, problem: Problem, face: FloatArray) -> None:
        self._problem = problem
        self._sliding = [self._tangents(surface, face) for surface in problem.boundary.slip.curved]

    def _tangents(self, surface: CurvedSurface, face: FloatArray) -> tuple[IntArray, FloatArray]:
        """Nodes that slide and projectors (n, 3, 3) on the triangle, or the edge of one, on which they are."""
        problem = self._problem
        target = problem.grid.points[problem.topology.first[surface.nodes]] + face[surface.nodes]
        triangle, weights, _ = surface.tree.closest(target)
        corners = surface.points[surface.triangles[triangle]]
        inside = (weights > 1e-9).sum(axis=1) != 2
        # On an edge only the direction along it is left; at a vertex the whole triangle stands for the surface.
        base = np.where((weights > 1e-9) | inside[:, None], 1.0, 0.0)
        middle = np.einsum("nc,ncd->nd", base, corners) / base.sum(axis=1)[:, None]
        left, size, _ = np.linalg.svd(((corners - middle[:, None]) * base[:, :, None]).transpose(0, 2, 1))
        kept = left[:, :, :2] * (size[:, None, :2] > 1e-9 * size[:, None, :1])
        return surface.nodes, np.asarray(kept @ kept.transpose(0, 2, 1))

    def push(self, face: FloatArray) -> None:
        """Impose them on a change (n_unique, 3), in place."""
        problem = self._problem
        for nodes, tangent in self._sliding:
            face[nodes] = np.einsum("nij,nj->ni", tangent, face[nodes])
        for nodes, removed in problem.boundary.slip.groups:
            face[nodes] -= face[nodes] @ removed
        problem.boundary.periodic.constrain(face, ~problem.boundary.known)

    def pull(self, face: FloatArray) -> None:
        """The transpose, in place."""
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
