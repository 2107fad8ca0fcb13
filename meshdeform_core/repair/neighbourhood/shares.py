"""Which nodes may move, and how these nodes and the cells around them are shared among the ranks of a repair."""

from __future__ import annotations

from bisect import bisect_left
from functools import cached_property

import numpy as np

from ...grid import BoolArray, IntArray
from ...parallel import Halo, OneRank, Part
from ..constraints import Constraints

ROWS = 1 << 15
"""Ranks own whole ranges of this many unknowns; sums over unknowns are taken range by range."""
CELLS = 4096
"""Energies are summed over this many cells at a time."""


class Shares:
    """The region of all nodes that may move, as far as it belongs to this rank.

    A rank owns the nodes of its part of the grid. Unknowns are numbered like the nodes with the smallest number that
    they move; a rank owns those that follow from its part, rounded to ranges of ROWS, and the cells of its part,
    rounded to CELLS. Shares do not decide the last bit of a result, as sums are taken over the same ranges for any
    number of ranks.
    """

    def __init__(self, constraints: Constraints) -> None:
        self._constraints, self._grid, self._topology = constraints, constraints.grid, constraints.topology
        points = self._grid.points
        self._ranks = points.ranks if isinstance(points, Part) else OneRank()
        bounds = points.bounds if isinstance(points, Part) else np.array([0, len(points)])
        self._bounds: list[int] = bounds.tolist()

    @cached_property
    def rows(self) -> list[int]:
        """First unknown (n_ranks + 1,) of every rank."""
        face, roots = self._topology.face_nodes, self._face_roots

        def before(node: int) -> int:
            """Number of unknowns with smaller numbers than a node."""
            return int(node - np.searchsorted(face, node) + np.searchsorted(roots, node))

        every, n = range(self._bounds[-1] + 1), self._bounds[-1]
        inner = [bisect_left(every, -(-before(bound) // ROWS) * ROWS, key=before) for bound in self._bounds[1:-1]]
        return [0, *(min(each, n) for each in inner), n]

    @cached_property
    def _face_roots(self) -> IntArray:
        """Unknowns on block faces, ascending."""
        constraints = self._constraints
        return np.unique(self._topology.first[constraints.root[~constraints.held]])

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns of all ranks."""
        return self._bounds[-1] - len(self._topology.face_nodes) + len(self._face_roots)

    @property
    def largest(self) -> int:
        """Largest number of nodes that the share of a rank may have, planes of its neighbours included."""
        shapes = np.array(self._grid.shapes)
        beside = ROWS + 2 * int((shapes[:, 1] * shapes[:, 2]).max())
        return int(np.diff(self._bounds).max()) + (beside if len(self._bounds) > 2 else 0)

    def halos(self, roots: IntArray, nodes: IntArray) -> tuple[Halo, Halo]:
        """Unknowns and nodes around this rank's share, some of which belong to other ranks."""
        return Halo(roots, self._ranks, np.array(self.rows)), Halo(nodes, self._ranks, np.array(self._bounds))

    @property
    def _own(self) -> tuple[int, int]:
        return self._bounds[self._ranks.number], self._bounds[self._ranks.number + 1]

    def elsewhere(self, nodes: IntArray) -> BoolArray:
        """Whether nodes belong to other ranks."""
        low, high = self._own
        return np.asarray((nodes < low) | (nodes >= high))

    @cached_property
    def moved(self) -> IntArray:
        """Block nodes of this rank's part that may move."""
        nodes = np.arange(*self._own)
        return nodes[self.may_move(nodes)]

    @cached_property
    def _cell_bounds(self) -> list[int]:
        """First cell (n_ranks + 1,) of every rank."""
        firsts = [self._cell_from(bound) for bound in self._bounds[:-1]]
        last = self._grid.n_cells
        return [*(min(-(-first // CELLS) * CELLS, last) for first in firsts), last]

    def ends_among(self, cells: IntArray) -> IntArray:
        """Positions in ``cells``, ascending, at which this rank's ranges of CELLS cells begin, and the end of the
        last."""
        first, last = self._cell_bounds[self._ranks.number : self._ranks.number + 2]
        return np.searchsorted(cells, [*range(first, last, CELLS), last])

    @cached_property
    def cells(self) -> IntArray:
        """Cells of this rank, and cells at its nodes or at nodes with its unknowns; some of them may have no node that
        may move."""
        if self._ranks.count == 1:
            return np.arange(self._grid.n_cells)
        (low, high), here = self._nodes_of_rank, self._ranks.number
        first, last = self._cell_bounds[here : here + 2]
        if low < high:
            first, last = min(first, self._cell_from(low, -1)), max(last, self._cell_from(high - 1, 1))
        more = self._cells_beyond(low, high)
        return np.concatenate([more[more < first], np.arange(first, last), more[more >= last]])

    @property
    def _nodes_of_rank(self) -> tuple[int, int]:
        """The range of nodes that contains those of this rank and its unknowns."""
        here = self._ranks.number
        runs = [(b[here], b[here + 1]) for b in (self._bounds, self.rows) if b[here] < b[here + 1]]
        return (min(run[0] for run in runs), max(run[1] for run in runs)) if runs else (0, 0)

    def _cell_from(self, node: int, beside: int = 0) -> int:
        """First cell of the plane of cells that begins at that of a node (-1: ends there; 1: the next one)."""
        grid = self._grid
        block = int(np.searchsorted(grid.offsets, node, side="right")) - 1
        if block == grid.n_blocks:
            return grid.n_cells
        _, nj, nk = grid.shapes[block]
        ci, cj, ck = grid.cell_shapes[block]
        plane = (node - int(grid.offsets[block])) // (nj * nk)
        plane = min(max(plane + beside, 0), ci) if beside else min(plane, ci)
        return int(grid.cell_offsets[block]) + plane * cj * ck

    def _cells_beyond(self, low: int, high: int) -> IntArray:
        """Cells at all block nodes that coincide with a node low <= n < high or share its unknown."""
        topology, constraints = self._topology, self._constraints
        near = (topology.first >= low) & (topology.first < high)
        roots = topology.first[constraints.root]
        near |= ~constraints.held & (roots >= low) & (roots < high)
        nodes = topology.face_nodes[near[topology.number]]
        return self._cells_at(nodes)

    def _cells_at(self, nodes: IntArray) -> IntArray:
        """The cells at some block nodes."""
        grid = self._grid
        block = np.searchsorted(grid.offsets, nodes, side="right") - 1
        shapes, cells = np.array(grid.shapes)[block], np.array(grid.cell_shapes)[block]
        rest = nodes - grid.offsets[block]
        (_, nj, nk), found = shapes.T, []
        ijk = np.stack([rest // (nj * nk), rest // nk % nj, rest % nk], axis=1)
        for step in np.ndindex(2, 2, 2):
            at = ijk - step
            inside = ((at >= 0) & (at < cells)).all(axis=1)
            i, j, k = at[inside].T
            _, cj, ck = cells[inside].T
            found.append(grid.cell_offsets[block[inside]] + (i * cj + j) * ck + k)
        return np.unique(np.concatenate(found))

    @cached_property
    def _window(self) -> tuple[int, IntArray]:
        """First of the nodes that this rank asks for most, and their unique numbers, -1 inside blocks."""
        topology, (low, high) = self._topology, self._nodes_of_rank
        if self._ranks.count > 1 and low < high:
            block, last = (int(np.searchsorted(self._grid.offsets, n, side="right")) - 1 for n in (low, high - 1))
            low -= int(np.prod(self._grid.shapes[block][1:]))
            high += int(np.prod(self._grid.shapes[last][1:]))
        low, high = max(low, 0), min(high, self._bounds[-1])
        found = np.full(high - low, -1, dtype=np.int64)
        some = slice(*np.searchsorted(topology.face_nodes, [low, high]).tolist())
        found[topology.face_nodes[some] - low] = topology.number[some]
        return low, found

    def numbers(self, nodes: IntArray) -> IntArray:
        """Unique numbers of block nodes, -1 inside blocks."""
        low, window = self._window
        at = nodes - low
        if not len(nodes) or (at.min() >= 0 and at.max() < len(window)):
            return np.asarray(window[at])
        face = self._topology.face_nodes
        place = np.minimum(np.searchsorted(face, nodes), len(face) - 1)
        return np.where(face[place] == nodes, self._topology.number[place], -1)

    def may_move(self, nodes: IntArray) -> BoolArray:
        """Whether block nodes may move."""
        number = self.numbers(nodes)
        return np.asarray((number < 0) | ~self._constraints.held[number])

    def owners(self, nodes: IntArray) -> IntArray:
        """The block node that represents each of ``nodes``."""
        number = self.numbers(nodes)
        return np.where(number >= 0, self._topology.first[number], nodes)

    def roots(self, nodes: IntArray) -> IntArray:
        """The block node that has the unknown of each of ``nodes``."""
        number = self.numbers(nodes)
        return np.where(number >= 0, self._topology.first[self._constraints.root[number]], nodes)
