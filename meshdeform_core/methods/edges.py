"""TFI of block interfaces: vertices from the graph of block edges, edges from vertices, faces from edges.

The paper does not say how TFI-TFI moves block vertices that lie on no wall; here they are harmonic on the graph of
block edges with weights 1/length (spec section 2).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, IntArray, Side
from ..numerics.blend import blend_face, plane_coordinates
from ..numerics.parallel import current_ranks
from ..numerics.rows import put_rows
from ..topology import side_nodes
from ..windows import windows_of_quads
from .base import Account, Problem, Progress
from .forecast import TFI_ROTATION, warn_of_rotation


@dataclass(frozen=True)
class Segment:
    """A stretch of a block edge between two nodes that are known before its inside is.

    ``nodes`` (n,) unique node numbers, ends included; ``arc`` (n,) from 0 to 1; ``length`` in grid length units.
    """

    nodes: IntArray
    arc: FloatArray
    length: float


@dataclass(frozen=True)
class FacePart:
    """A rectangle of face nodes to be blended from its edges: node numbers (na, nb) and arc coordinates."""

    nodes: IntArray
    unknown: np.ndarray
    s: FloatArray
    t: FloatArray


class PreparedEdgeGraph:
    """The block edges and faces of one undeformed grid, ready to move with the sources."""

    account: Account

    def __init__(self, problem: Problem):
        self.account = Account()
        self._problem = problem
        known = problem.boundary.known.copy()
        corner = np.zeros(len(known), dtype=bool)
        lines = list(_block_edges(problem))
        points = problem.grid.points[problem.topology.first]
        for line in lines:
            corner[line[[0, -1]]] = True
        self._segments = _segments(points, lines, known | corner)
        self._free = np.flatnonzero(corner & ~known)
        self._graph = _Graph.of(self._segments, self._free, len(known))
        reached = known | corner
        for segment in self._segments:
            reached[segment.nodes] = True
        self._parts = []
        for part, borders in _face_parts(problem, reached.copy()):
            self._parts.append(part)
            # A rectangle of an L-shaped face has a border that is no block edge.
            self._segments += _segments(points, [b for b in borders if not reached[b].all()], reached)
        # Between neighbours there is nothing to fill.
        self._segments = [segment for segment in self._segments if len(segment.nodes) > 2]

    def foresee(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """What is bound to go wrong with a displacement (n_sources, 3) of which ``step`` is imposed first."""
        # Steps do not help: blending is linear, they lead to the same grid.
        return warn_of_rotation(self._problem, motion, TFI_ROTATION, "TFI crosses cells", "use idw-tfi")

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> None:
        """Displacement of all face nodes from that of the sources (n_sources, 3), into ``out`` (n_nodes, 3)."""
        topology = self._problem.topology
        d = np.zeros((topology.n_unique, 3))
        d[self._problem.source_numbers] = displacement
        if self._free.size:
            d[self._free] = self._graph.solve(d)
        for segment in self._segments:
            first, last = d[segment.nodes[0]], d[segment.nodes[-1]]
            d[segment.nodes[1:-1]] = first + segment.arc[1:-1, None] * (last - first)
        for part in self._parts:
            blend_face(d, part.nodes, part.unknown, part.s, part.t)
        current_ranks().alter(out, lambda: put_rows(d, topology.first, out))


def _block_edges(problem: Problem) -> Iterator[IntArray]:
    """Unique node numbers along every block edge."""
    grid, topology = problem.grid, problem.topology
    for block, shape in enumerate(grid.shapes):
        for side in Side:
            if shape[side.axis] == 1:
                continue
            nodes = topology.numbers_of(side_nodes(grid, block, side).ravel())
            nodes = nodes.reshape([shape[a] for a in side.tangential])
            if grid.dimension == 2:
                yield nodes.ravel()
            elif side.axis < 2:
                # The four edges of the i faces and the k edges of the j faces cover all twelve.
                yield from (nodes[0], nodes[-1])
                yield from (nodes[:, 0], nodes[:, -1])


def _segments(points: FloatArray, lines: list[IntArray], knot: np.ndarray) -> list[Segment]:
    """Stretches of ``lines`` between the nodes where ``knot`` holds; ``points`` (n_unique, 3)."""
    found: dict[tuple[int, int, int], Segment] = {}
    for line in lines:
        step = np.linalg.norm(np.diff(points[line], axis=0), axis=1)
        at = np.flatnonzero(knot[line])
        for first, last in zip(at[:-1].tolist(), at[1:].tolist(), strict=True):
            nodes, steps = line[first : last + 1], step[first:last]
            length = float(steps.sum())
            if nodes[0] == nodes[-1] or length == 0.0:
                continue
            arc = np.concatenate([[0.0], np.cumsum(steps)]) / length
            # Blocks that share an edge see it once each, in either direction.
            key = (int(min(nodes[0], nodes[-1])), int(max(nodes[0], nodes[-1])), int(nodes[1:-1].min(initial=2**62)))
            found.setdefault(key, Segment(nodes, arc, length))
    return list(found.values())


@dataclass(frozen=True)
class _Graph:
    """Harmonic extension to the free vertices: ``inverse @ sum(weight * d[known])`` per row.

    ``row``, ``known``, ``weight`` (m,) list the edges from free vertices to nodes that are known.
    """

    inverse: FloatArray
    row: IntArray
    known: IntArray
    weight: FloatArray

    @classmethod
    def of(cls, segments: list[Segment], free: IntArray, n: int) -> _Graph:
        index = np.full(n, -1)
        index[free] = np.arange(len(free))
        system = np.zeros((len(free), len(free)))
        links = []
        for segment in segments:
            a, b = int(segment.nodes[0]), int(segment.nodes[-1])
            for one, two in ((a, b), (b, a)):
                if index[one] < 0:
                    continue
                system[index[one], index[one]] += 1 / segment.length
                if index[two] >= 0:
                    system[index[one], index[two]] -= 1 / segment.length
                else:
                    links.append((int(index[one]), two, 1 / segment.length))
        # The pseudo-inverse leaves vertices that are tied to nothing known where they are.
        table = np.array(links).reshape(-1, 3)
        inverse = np.asarray(np.linalg.pinv(system), dtype=np.float64)
        return cls(inverse, table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), table[:, 2])

    def solve(self, d: FloatArray) -> FloatArray:
        pull = np.zeros((len(self.inverse), 3))
        np.add.at(pull, self.row, self.weight[:, None] * d[self.known])
        return np.asarray(self.inverse @ pull)


def _face_parts(problem: Problem, done: np.ndarray) -> Iterator[tuple[FacePart, list[IntArray]]]:
    """Rectangles of each face with one neighbour, and their borders: block edges of one block or the other."""
    grid, topology = problem.grid, problem.topology
    if grid.dimension == 2:
        return
    for block, shape in enumerate(grid.shapes):
        for side in Side:
            quads = topology.quads.of_side(block, side)
            partner = topology.partner[quads]
            neighbour = np.where(partner >= 0, topology.quads.block_side[np.maximum(partner, 0)], partner)
            counts = tuple(topology.quads.counts[block, side])
            numbers = topology.numbers_of(side_nodes(grid, block, side).ravel())
            numbers = numbers.reshape([shape[a] for a in side.tangential])
            for label in np.unique(neighbour):
                for window in windows_of_quads(shape, block, side, (neighbour == label).reshape(counts)):
                    (a0, b0), (a1, b1) = window.low, window.high
                    nodes = numbers[a0 : a1 + 1, b0 : b1 + 1]
                    if not done[nodes].all():
                        unknown = ~done[nodes]
                        done[nodes] = True
                        part = FacePart(nodes, unknown, *plane_coordinates(grid.points[topology.first[nodes]]))
                        yield part, [nodes[0], nodes[-1], nodes[:, 0], nodes[:, -1]]
