"""TFI of block interfaces: vertices from the graph of block edges, edges from vertices, faces from edges.

The paper does not say how TFI-TFI moves block vertices that are not on a wall; here their displacement is harmonic on
the graph of block edges with weights 1/length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy

from ...grid import BoolArray, FloatArray, Grid, IntArray
from ...grid.topology import Topology
from ...grid.windows import rectangles
from ...numerics.arrays import distinct_rows, spans
from ..base import Account, Linearised, Problem, Progress
from ..limits import TFI_ROTATION, warn_of_rotation
from .tfi import Faces

if TYPE_CHECKING:
    from ...boundary.constraints import Slip


@dataclass(frozen=True)
class _Rows:
    """Rows of different lengths of unique numbers of ``nodes``, one after the other; row n begins at ``start[n]``."""

    start: IntArray
    nodes: IntArray

    @classmethod
    def of(cls, sizes: IntArray, nodes: IntArray) -> _Rows:
        return cls(np.append(0, np.cumsum(sizes)), nodes)

    def __len__(self) -> int:
        return len(self.start) - 1

    def chosen(self, some: IntArray | BoolArray) -> _Rows:
        """Some of the rows."""
        sizes = np.diff(self.start)[some]
        row, place = spans(sizes)
        return _Rows.of(sizes, self.nodes[self.start[:-1][some][row] + place])

    def ends(self) -> IntArray:
        """First and last node (n, 2) of every row."""
        return np.stack([self.nodes[self.start[:-1]], self.nodes[self.start[1:] - 1]], axis=1)

    def any(self, marked: BoolArray) -> BoolArray:
        """Whether each row (n,) has any ``marked`` node."""
        return np.logical_or.reduceat(marked, self.start[:-1]) if len(self) else np.zeros(0, dtype=bool)


class PreparedEdgeGraph:
    """The block edges and faces of one undeformed grid, ready to move with the sources."""

    account: Account

    def __init__(self, problem: Problem):
        self.account = Account()
        self._problem = problem
        grid, topology = problem.grid, problem.topology
        known = problem.boundary.known
        reached = known.copy()
        sides = np.flatnonzero(grid.sides.has_quads)
        if grid.dimension == 3:
            # The four edges of the i faces and the k edges of the j faces cover all twelve.
            sides = sides[sides % 6 < 4]
        high = grid.sides.nodes[sides] - 1
        whole, across = _nodes_of(topology, sides, np.zeros_like(high), high)
        edges = whole if grid.dimension == 2 else _borders(whole, across)[0]
        reached[edges.ends()] = True
        points = grid.nodes.at(topology.first)
        self._free = np.flatnonzero(reached & ~known)
        segments, length = _segments(points, edges, np.zeros(len(edges), dtype=np.int64), reached, known)
        self._graph = None
        if self._free.size:
            self._graph = _Graph(segments.ends(), length, self._free, len(known), problem.boundary.slip)
        reached[segments.nodes] = True
        parts, width, wanted = _face_parts(grid, topology, reached)
        # L-shaped faces are divided into rectangles, some borders of which are not block edges.
        borders, part = _borders(parts, width)
        inside = borders.any(~reached[borders.nodes])
        rest, _ = _segments(points, borders.chosen(inside), part[inside], reached, reached)
        rows, lines = (segments, rest, parts), len(segments) + len(rest)
        self._faces = Faces(
            points,
            np.append(0, np.cumsum(np.concatenate([np.diff(each.start) for each in rows]))),
            np.append(np.ones(lines, dtype=np.int64), width),
            np.concatenate([each.nodes for each in rows]),
            np.append(np.ones(len(segments.nodes) + len(rest.nodes), dtype=bool), wanted),
        )

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        # Steps do not help: blending is linear, so several steps lead to the same grid.
        return warn_of_rotation(self._problem, motion, TFI_ROTATION, "TFI crosses cells", "use idw-tfi")

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_unique, 3) of all face nodes from that of the sources (n_sources, 3); ``out`` is not used."""
        # NaN marks nodes not reached; zero could be mistaken for a node at rest.
        face = np.full((self._problem.topology.n_unique, 3), np.nan)
        face[self._problem.source_numbers] = displacement
        if self._graph:
            face[self._free] = self._graph.solve(face)
        self._faces.blend(face)
        return face

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative, which is the same at all displacements."""
        return Linearised(self.move, self.pull)

    def pull(self, face: FloatArray, gradient: FloatArray) -> FloatArray:
        """Transpose of :meth:`move`: gradient (n_sources, 3) from that of the face nodes (n_unique, 3), which is
        overwritten; no other node is moved here."""
        self._faces.pull(face)
        if self._graph:
            graph = self._graph
            found = graph.harmonic(face[self._free])
            face[self._free] = 0.0
            np.add.at(face, graph.known, graph.weight[:, None] * found[graph.row])
        return face[self._problem.source_numbers]


def _nodes_of(topology: Topology, side: IntArray, low: IntArray, high: IntArray) -> tuple[_Rows, IntArray]:
    """Node numbers of rectangles on block sides, and the number of nodes along the second index of each."""
    counts = high - low + 1
    sizes = counts.prod(axis=1)
    rectangle, place = spans(sizes)
    u, v = np.divmod(place, counts[rectangle, 1])
    at = side[rectangle], low[rectangle, 0] + u, low[rectangle, 1] + v
    return _Rows.of(sizes, topology.quads.numbers_at(*at)), counts[:, 1]


def _borders(rectangles: _Rows, width: IntArray) -> tuple[_Rows, IntArray]:
    """The four borders of every rectangle (low and high first index, then second), and the rectangle of each (4 n,)."""
    start, size = rectangles.start[:-1], np.diff(rectangles.start)
    first = np.stack([start, start + size - width, start, start + width - 1], axis=1).ravel()
    step = np.stack([np.ones_like(width), np.ones_like(width), width, width], axis=1).ravel()
    count = np.stack([width, width, size // width, size // width], axis=1).ravel()
    border, place = spans(count)
    nodes = rectangles.nodes[first[border] + place * step[border]]
    return _Rows.of(count, nodes), np.repeat(np.arange(len(rectangles)), 4)


def _segments(
    points: FloatArray, lines: _Rows, group: IntArray, knot: BoolArray, known: BoolArray
) -> tuple[_Rows, FloatArray]:
    """Sections of ``lines`` between nodes that are ``knot``, which are moved before the nodes in between, with these
    ends, and their lengths (n,); ``points`` (n_unique, 3).

    Adjacent ``known`` nodes form no segment, as there is nothing between them to fill. Blocks that share an edge all
    contribute it, in either direction; only the first of those with equal ``group`` is kept.
    """
    line = np.repeat(np.arange(len(lines)), np.diff(lines.start))
    at = np.flatnonzero(knot[lines.nodes])
    first, last = at[:-1], at[1:]
    between = (last - first > 1) | ~(known[lines.nodes[first]] & known[lines.nodes[last]])
    chosen = np.flatnonzero((line[first] == line[last]) & between)
    first, sizes = first[chosen], last[chosen] - first[chosen] + 1
    row, place = spans(sizes)
    rows = _Rows.of(sizes, lines.nodes[first[row] + place])
    steps = np.linalg.norm(points[rows.nodes[1:]] - points[rows.nodes[:-1]], axis=1)
    inner = place[1:] > 0
    length: FloatArray = np.bincount(row[1:][inner], steps[inner], len(rows)).astype(np.float64, copy=False)
    ends, middle = rows.ends(), (place > 0) & (place < sizes[row] - 1)
    lowest = np.minimum.reduceat(np.where(middle, rows.nodes, len(points)), rows.start[:-1]) if len(rows) else sizes
    sound = np.flatnonzero(length > 0.0)
    keys = np.stack([group[line[first]], ends.min(axis=1), ends.max(axis=1), lowest], axis=1)
    sound = sound[distinct_rows(keys[sound])]
    return rows.chosen(sound), length[sound]


class _Graph:
    """Harmonic extension to the free vertices, from the ends (n, 2) of all edges between vertices and their lengths
    (n,).

    ``row``, ``known``, ``weight`` (m,) list the edges from free vertices to known nodes. Vertices on slip planes remain
    in them: ``removed`` lists sets of such vertices with the projector (3, 3) onto the directions that are removed from
    their motion; the Laplacian then covers all three components.
    """

    def __init__(self, ends: IntArray, length: FloatArray, free: IntArray, n_unique: int, slip: Slip) -> None:
        n = len(free)
        index = np.full(n_unique, -1)
        index[free] = np.arange(n)
        weight = np.tile(1 / length, 2)
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
        sliding = [(index[nodes], span) for nodes, span in slip.groups]
        self.removed = [(rows[rows >= 0], span) for rows, span in sliding if (rows >= 0).any()]
        if self.removed:
            # The Laplacian (3 n, 3 n) of all components, row 3 m + c for component c of vertex m, restricted to motions
            # along the planes; for the removed directions it is the identity.
            blocks = np.zeros((n, 3, 3))
            for rows, span in self.removed:
                blocks[rows] = span
            off = scipy.sparse.bsr_array((blocks, np.arange(n), np.arange(n + 1)), shape=(3 * n, 3 * n))
            along = scipy.sparse.eye_array(3 * n) - off
            laplacian = scipy.sparse.csc_array(along @ scipy.sparse.kron(laplacian, np.eye(3)) @ along + off)
        self._factor = scipy.sparse.linalg.splu(laplacian)
        self.row, self.known, self.weight, self._n_free = one[outer], two[outer], weight[outer], len(free)

    def solve(self, d: FloatArray) -> FloatArray:
        """Displacement of the free vertices from ``d`` (n_unique, 3) of the known nodes."""
        pull = [np.bincount(self.row, self.weight * d[self.known, c], self._n_free) for c in range(3)]
        return self.harmonic(np.stack(pull, axis=1))

    def harmonic(self, right: FloatArray) -> FloatArray:
        """Displacement of the free vertices for right-hand sides ``right`` (n, 3); a symmetric map."""
        if not self.removed:
            return np.asarray(self._factor.solve(right))
        along = right.copy()
        for rows, span in self.removed:
            along[rows] -= along[rows] @ span
        return np.asarray(self._factor.solve(along.ravel())).reshape(right.shape)


def _face_parts(grid: Grid, topology: Topology, reached: BoolArray) -> tuple[_Rows, IntArray, BoolArray]:
    """Rectangles of faces that share one neighbour: their nodes, widths, and which of its nodes each one moves."""
    quads, partner = topology.quads, topology.partner
    if grid.dimension == 2:
        return _Rows.of(*np.zeros((2, 0), dtype=np.int64)), np.zeros(0, dtype=np.int64), np.zeros(0, dtype=bool)
    neighbour = np.where(partner >= 0, quads.block_side[partner], partner)
    found = rectangles(grid, quads, neighbour - neighbour.min())
    parts, width = _nodes_of(topology, found.side, found.low, found.high)
    number = np.repeat(np.arange(len(parts)), np.diff(parts.start))
    owner = np.full(topology.n_unique, len(parts))
    np.minimum.at(owner, parts.nodes, number)
    wanted = (owner[parts.nodes] == number) & ~reached[parts.nodes]
    some = parts.any(wanted)
    return parts.chosen(some), width[some], wanted[some[number]]
