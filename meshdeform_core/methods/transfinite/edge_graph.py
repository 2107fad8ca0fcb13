"""TFI of block interfaces: vertices from the graph of block edges, edges from vertices, faces from edges.

The paper does not say how TFI-TFI moves block vertices that are not on a wall; here their displacement is harmonic on
the graph of block edges with weights 1/length.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ...grid import BoolArray, FloatArray, IntArray, Side
from ...grid.sides import side_numbers
from ...grid.windows import windows_of_quads
from ...numerics.rows import put_rows
from ..base import Account, Problem, Progress
from ..limits import TFI_ROTATION, warn_of_rotation
from .faces import Faces, Lines

if TYPE_CHECKING:
    from scipy.sparse.linalg import SuperLU


@dataclass(frozen=True)
class Segment:
    """A section of a block edge whose two end nodes are moved before the nodes in between.

    ``nodes`` (n,) unique node numbers, ends included; ``arc`` (n,) from 0 to 1; ``length`` in grid length units.
    """

    nodes: IntArray
    arc: FloatArray
    length: float


class PreparedEdgeGraph:
    """The block edges and faces of one undeformed grid, ready to move with the sources."""

    account: Account

    def __init__(self, problem: Problem):
        self.account = Account()
        self._problem = problem
        known = problem.boundary.known
        reached = known.copy()
        lines = list(_block_edges(problem))
        for line in lines:
            reached[line[[0, -1]]] = True
        points = problem.grid.points[problem.topology.first]
        self._free = np.flatnonzero(reached & ~known)
        segments = _segments(points, lines, reached, known)
        self._graph = _Graph.of(segments, self._free, len(known)) if self._free.size else None
        for segment in segments:
            reached[segment.nodes] = True
        nodes, wanted = _face_parts(problem, reached)
        for part in nodes:
            # L-shaped faces are divided into rectangles, some borders of which are not block edges.
            borders = [b for b in (part[0], part[-1], part[:, 0], part[:, -1]) if not reached[b].all()]
            segments += _segments(points, borders, reached, reached)
        self._lines = Lines.of([segment.nodes for segment in segments], [segment.arc for segment in segments])
        self._faces = Faces.of(points, nodes, wanted)

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        # Steps do not help: blending is linear, so they lead to the same grid.
        return warn_of_rotation(self._problem, motion, TFI_ROTATION, "TFI crosses cells", "use idw-tfi")

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_unique, 3) of all face nodes from that of the sources (n_sources, 3); nothing to ``out``."""
        # NaN marks nodes that are not reached; zero would pass for a node that does not move.
        face = np.full((self._problem.topology.n_unique, 3), np.nan)
        put_rows(displacement, self._problem.source_numbers, face)
        if self._graph:
            face[self._free] = self._graph.solve(face)
        self._lines.blend(face)
        self._faces.blend(face)
        return face


def _block_edges(problem: Problem) -> Iterator[IntArray]:
    """Unique node numbers along every block edge."""
    grid = problem.grid
    for block, shape in enumerate(grid.shapes):
        for side in Side:
            if shape[side.axis] == 1:
                continue
            nodes = side_numbers(grid, problem.topology, block, side)
            if grid.dimension == 2:
                yield nodes.ravel()
            elif side.axis < 2:
                # The four edges of the i faces and the k edges of the j faces cover all twelve.
                yield from (nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1])


def _segments(points: FloatArray, lines: list[IntArray], knot: BoolArray, known: BoolArray) -> list[Segment]:
    """Segments of ``lines`` between the nodes where ``knot`` holds; ``points`` (n_unique, 3).

    Two ``known`` neighbours form no segment: there is nothing between them to fill.
    """
    found: dict[tuple[int, int, int], Segment] = {}
    for line in lines:
        at = np.flatnonzero(knot[line])
        ends = known[line[at]]
        chosen = np.flatnonzero((np.diff(at) > 1) | ~(ends[:-1] & ends[1:]))
        for first, last in zip(at[chosen].tolist(), at[chosen + 1].tolist(), strict=True):
            nodes = line[first : last + 1]
            arc = np.cumsum([0.0, *np.linalg.norm(np.diff(points[nodes], axis=0), axis=1)])
            if arc[-1] > 0.0:
                # Each block that shares an edge contributes it, in either direction.
                key = (int(min(nodes[[0, -1]])), int(max(nodes[[0, -1]])), int(nodes[1:-1].min(initial=2**62)))
                found.setdefault(key, Segment(nodes, arc / arc[-1], float(arc[-1])))
    return list(found.values())


@dataclass(frozen=True)
class _Graph:
    """Harmonic extension to the free vertices.

    ``row``, ``known``, ``weight`` (m,) list the edges from free vertices to nodes that are known; ``factor`` is the
    Laplacian of the free ones.
    """

    factor: SuperLU
    row: IntArray
    known: IntArray
    weight: FloatArray

    @classmethod
    def of(cls, segments: list[Segment], free: IntArray, n_unique: int) -> _Graph:
        n = len(free)
        index = np.full(n_unique, -1)
        index[free] = np.arange(n)
        ends = np.array([segment.nodes[[0, -1]] for segment in segments]).reshape(-1, 2)
        weight = np.tile([1 / segment.length for segment in segments], 2)
        one, two = index[np.r_[ends[:, 0], ends[:, 1]]], np.r_[ends[:, 1], ends[:, 0]]
        inner, outer = (one >= 0) & (index[two] >= 0), (one >= 0) & (index[two] < 0)
        diagonal = np.bincount(one[one >= 0], weight[one >= 0], n)
        # Vertices without a path to a known node do not move.
        ties = scipy.sparse.csc_array((weight[inner], (one[inner], index[two[inner]])), shape=(n, n))
        part = scipy.sparse.csgraph.connected_components(ties)[1]
        diagonal = diagonal + np.where(np.isin(part, part[one[outer]]), 0.0, 1.0)
        every = np.arange(n)
        values = np.r_[diagonal, -weight[inner]]
        places = np.r_[every, one[inner]], np.r_[every, index[two[inner]]]
        laplacian = scipy.sparse.csc_array((values, places), shape=(n, n))
        return cls(scipy.sparse.linalg.splu(laplacian), one[outer], two[outer], weight[outer])

    def solve(self, d: FloatArray) -> FloatArray:
        """Displacement of the free vertices from ``d`` (n_unique, 3) of the known nodes."""
        pull = [np.bincount(self.row, self.weight * d[self.known, c], self.factor.shape[0]) for c in range(3)]
        return np.asarray(self.factor.solve(np.stack(pull, axis=1)))


def _face_parts(problem: Problem, reached: BoolArray) -> tuple[list[IntArray], list[BoolArray]]:
    """Rectangles of each face with one neighbour: their nodes (na, nb), and which of them only this one moves."""
    grid, topology = problem.grid, problem.topology
    done, parts, wanted = reached.copy(), [], []
    for block, side in product(range(grid.n_blocks), Side) if grid.dimension == 3 else ():
        shape, quads = grid.shapes[block], topology.quads.of_side(block, side)
        numbers = side_numbers(grid, topology, block, side)
        if done[numbers].all():
            continue
        partner = topology.partner[quads]
        neighbour = np.where(partner >= 0, topology.quads.block_side[partner], partner)
        neighbour = neighbour.reshape(topology.quads.counts[block, side])
        for label in np.unique(neighbour):
            for window in windows_of_quads(shape, block, side, neighbour == label):
                (a0, b0), (a1, b1) = window.low, window.high
                nodes = numbers[a0 : a1 + 1, b0 : b1 + 1]
                if not done[nodes].all():
                    parts.append(nodes)
                    wanted.append(~done[nodes])
                    done[nodes] = True
    return parts, wanted
