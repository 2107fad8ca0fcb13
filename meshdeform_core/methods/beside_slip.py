"""Displacements near plane slip boundaries, whose component normal to the plane fades out towards it.

A node on a slip plane moves only within the plane, which interpolation ignores: where it displaces the neighbouring
nodes away from the plane or towards it, the cells in between stretch or fold.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np

from ..boundary import Kind
from ..boundary.slip import triangles_of
from ..grid import FloatArray, IntArray
from ..numerics.geometry.surface import TriangleTree
from ..parallel import Nodes, for_chunks
from .base import Problem, Progress, of_stage

WIDTH = 0.3
"""Length of the parabolic end at the walls relative to the distance from wall to slip side (studies/slip_sides.py)."""
_CHUNK = 4096
# Relative to the extent of the sources.
_ROUND_OFF = 1e-13
# Data are kept between displacements only if they take at most one part in this many of the memory limit.
_KEPT = 8


class BesideSlip:
    """Corrects the interpolated displacement u of nodes near slip sides with normals n_k:

        v = (I + sum_k c_k n_k n_k^T)^-1 u,    1 / (1 + c_k) = f(d_k / (d + d_k))

    with the distance d of the undeformed node from the nearest moving face, and d_k from the nearest slip face with
    normal n_k. f rises from 0 to 1, linearly except for a parabolic end at the walls. For one plane, v . n = f u . n:
    zero in the plane, and unchanged at the walls. v is linear in u; motions along the planes remain unchanged.

    Parameters
    ----------
    flat : (n,) nodes of the grid, none of them a source
    """

    def __init__(self, problem: Problem, flat: IntArray) -> None:
        self._problem, self._flat = problem, flat
        sides = problem.boundary.slip.sides
        self.normals: FloatArray = np.array([normal for normal, _ in sides]).reshape(-1, 3)
        # Stored from the second displacement on, as a single one needs no store.
        self._parts: dict[int, FloatArray] = {}
        self._stores = False

    def apply(self, out: FloatArray, progress: Progress | None = None) -> None:
        """Damp the rows of ``out`` (n_nodes, 3) of these nodes, in place."""
        # Round-off in a motion along the planes is left as it is.
        self.damp(out, _ROUND_OFF * float(np.ptp(self._problem.source_points, axis=0).max()), progress)

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
