"""Derivative of :mod:`...beside_slip` with respect to the grid: through the distances that the correction depends on.

The planes are fixed; nodes, walls and the borders of slip sides move.
"""

from __future__ import annotations

import numpy as np

from ....grid import FloatArray, IntArray
from ...beside_slip import WIDTH, lost, place
from ...composite import _Scattered


class BesideSlipGridDerivative:
    """Derivative at the interpolated displacement for one displacement (n_sources, 3) of the sources."""

    def __init__(self, mover: _Scattered, displacement: FloatArray) -> None:
        method, flat, first = mover.beside_slip, mover.flat, mover.problem.topology.first
        self._method, self._flat, self._first = method, flat, first
        if not len(method.normals):
            return
        points = mover.problem.grid.points
        x, every, moved = points[flat], points[first], np.empty_like(points)
        mover.interpolate(displacement, moved)
        self._near = [_Nearest(x, every, tree.triangles, *tree.closest(x)) for tree in method.trees]
        wall, *sides = (near.distance for near in self._near)
        at = np.stack([place(wall, side) for side in sides], axis=1)
        both = wall[:, None] + np.stack(sides, axis=1)
        steepness = -np.where(at < 1.0 - WIDTH, 1.0 / (1.0 - 0.5 * WIDTH), 2.0 * (1.0 - at) / (WIDTH * (2.0 - WIDTH)))
        scale = np.divide(steepness, both, out=np.zeros_like(both), where=both > 0.0)
        # Slopes of the lost parts with respect to the distances from slip sides, and from walls.
        self._slopes = scale * (1.0 - at), -scale * at
        self._ways = _ways(method.normals, lost(at))
        self._along = np.einsum("nki,ni->nk", self._ways, moved[flat])

    def push(self, out: FloatArray, dx: FloatArray) -> None:
        """Damp the change ``out`` (n_nodes, 3) of the nodes, in place, for a change ``dx`` of the grid."""
        self._method.damp(out)
        if not len(self._method.normals):
            return
        wall, *sides = (near.push(dx[self._flat], dx[self._first]) for near in self._near)
        parts = self._slopes[0] * np.stack(sides, axis=1) + self._slopes[1] * wall[:, None]
        out[self._flat] -= np.einsum("nk,nki->ni", parts * self._along, self._ways)

    def pull(self, gradient: FloatArray, of_grid: FloatArray) -> None:
        """Transpose of :meth:`push`, in place; adds the gradient of the grid to ``of_grid``."""
        if len(self._method.normals):
            parts = -self._along * np.einsum("nki,ni->nk", self._ways, gradient[self._flat])
            of_distance = [(parts * self._slopes[1]).sum(axis=1), *(parts * self._slopes[0]).T]
            of_x, of_first = np.zeros((len(self._flat), 3)), np.zeros((len(self._first), 3))
            for near, each in zip(self._near, of_distance, strict=True):
                near.pull(each, of_x, of_first)
            of_grid[self._flat] += of_x
            of_grid[self._first] += of_first
        self._method.damp(gradient)


class _Nearest:
    """The nearest points of a surface, and the distances from them."""

    def __init__(
        self, x: FloatArray, points: FloatArray, triangles: IntArray, which: IntArray, weights: FloatArray,
        distance: FloatArray,
    ) -> None:  # fmt: skip
        self._corners, self._weights, self.distance = triangles[which], weights, distance
        away = x - np.einsum("nc,ncd->nd", weights, points[self._corners])
        self._away = np.divide(away, distance[:, None], out=np.zeros_like(away), where=distance[:, None] > 0.0)

    def push(self, dx: FloatArray, change: FloatArray) -> FloatArray:
        """Change (n,) of the distances for changes ``dx`` (n, 3) of the nodes and ``change`` of the surface points."""
        apart = dx - np.einsum("nc,ncd->nd", self._weights, change[self._corners])
        return np.asarray(np.einsum("ni,ni->n", self._away, apart))

    def pull(self, gradient: FloatArray, of_x: FloatArray, of_points: FloatArray) -> None:
        """Transpose of :meth:`push`: add the gradients of nodes and surface points."""
        pulled = gradient[:, None] * self._away
        of_x += pulled
        np.subtract.at(of_points, self._corners, self._weights[:, :, None] * pulled[:, None])


def _ways(normals: FloatArray, parts: FloatArray) -> FloatArray:
    """Directions q (n, k, 3): a unit change of part k changes the displacement by -(q . u) q."""
    found = np.empty((*parts.shape, 3))
    for last in range(len(normals)):
        ways: list[tuple[FloatArray, FloatArray]] = []
        for k in [*(k for k in range(len(normals)) if k != last), last]:
            way = np.tile(normals[k], (len(parts), 1))
            for other, factor in ways:
                way -= (factor * (other @ normals[k]))[:, None] * other
            rest = 1.0 - parts[:, k] + parts[:, k] * (way @ normals[k])
            inverse = np.divide(1.0, rest, out=np.zeros_like(rest), where=rest > 1e-12)
            ways.append((way, parts[:, k] * inverse))
        found[:, last] = ways[-1][0] * inverse[:, None]
    return found
