"""Which nodes may move, and how the ranks of a repair share a region of them and the cells around them."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from ...grid import BoolArray, IntArray
from ...parallel import Halo, OneRank, Part, of_all, rows_of
from ..constraints import Constraints

ROWS = 1 << 15
"""Ranks own whole ranges of this many unknowns; sums over unknowns are taken range by range."""
CELLS = 4096
"""Energies are summed over this many cells at a time."""
_TOGETHER = 1 << 16
"""Cells whose corners are looked at together."""


class Near(NamedTuple):
    """Block nodes within ``most`` cells of some; ``layers`` (n_nodes,) are their distances, in parts if the grid is."""

    layers: Any
    most: int

    def __call__(self, nodes: Any) -> BoolArray:
        """Whether block nodes belong to them: a slice of this rank's nodes and those beside, or a :class:`Halo`."""
        layers = nodes.of(self.layers) if isinstance(nodes, Halo) else rows_of(self.layers)[nodes]
        return np.asarray(layers <= self.most)


class Share(NamedTuple):
    """What belongs to this rank of a region: all nodes that may move, or those of them that are ``near``.

    A rank owns the nodes of its part of the grid. The region's cells, and its unknowns, by the nodes with the smallest
    number that they move, are counted in the order of these numbers; a rank owns those that follow from its part,
    rounded to CELLS and to ROWS. Shares do not decide the last bit of a result, as sums are taken over the same ranges
    for any number of ranks.

    Attributes
    ----------
    near : of the region, ``None`` for all nodes that may move
    moved : block nodes of this rank's part, ascending
    total : number of block nodes of all ranks
    rows : (n_ranks + 1,) first unknown of every rank
    cells : cells of this rank, and cells at its nodes or at nodes with its unknowns, ascending
    ends : positions in ``cells`` at which this rank's ranges of CELLS cells begin, and the end of the last
    """

    near: Near | None
    moved: IntArray
    total: int
    rows: list[int]
    cells: IntArray
    ends: IntArray


class Shares:
    """The nodes that may move, and the ranks that own them."""

    def __init__(self, constraints: Constraints) -> None:
        self._constraints, self._grid, self._topology = constraints, constraints.grid, constraints.topology
        points = self._grid.points
        self._ranks = points.ranks if isinstance(points, Part) else OneRank()
        bounds = points.bounds if isinstance(points, Part) else np.array([0, len(points)])
        self._bounds: list[int] = bounds.tolist()

    @property
    def n_unknowns(self) -> int:
        """Number of unknowns of all nodes that may move."""
        constraints = self._constraints
        on_faces = len(np.unique(constraints.root[~constraints.held]))
        return self._bounds[-1] - len(self._topology.face_nodes) + on_faces

    @property
    def largest(self) -> int:
        """Largest number of nodes that the share of a rank may have, planes of its neighbours included."""
        shapes = np.array(self._grid.shapes)
        beside = ROWS + 2 * int((shapes[:, 1] * shapes[:, 2]).max())
        return int(np.diff(self._bounds).max()) + (beside if len(self._bounds) > 2 else 0)

    def share(self, near: Near | None = None) -> Share:
        """This rank's share of a region; all ranks must call this."""
        moved, own = (np.concatenate(each) for each in zip(*self._by_block(near), strict=True))
        total = sum(of_all(self._grid.points, len(moved)))
        rows = self._ranges(self._roots_of(moved), ROWS, self._bounds[-1])
        bounds = self._ranges(own, CELLS, self._grid.n_cells)
        cells = own if self._ranks.count == 1 else self._gathered(own, rows, bounds)
        first, last = np.searchsorted(cells, bounds[self._ranks.number : self._ranks.number + 2]).tolist()
        return Share(near, moved, total, rows, cells, np.array([*range(first, last, CELLS), last]))

    def halo(self, nodes: IntArray) -> Halo:
        """Nodes around this rank's share, some of which belong to other ranks."""
        return Halo(nodes, self._ranks, np.array(self._bounds))

    def unknowns(self, roots: IntArray, share: Share) -> Halo:
        """Unknowns around this rank's share, some of which belong to other ranks."""
        return Halo(roots, self._ranks, np.array(share.rows))

    def _by_block(self, near: Near | None) -> Iterator[tuple[IntArray, IntArray]]:
        """Nodes of a region, and the cells at nodes of it, of this rank's part of every block."""
        grid = self._grid
        for block, (ni, nj, nk) in enumerate(grid.shapes):
            own, start = grid.planes(block), int(grid.offsets[block])
            last = min(own.stop + 1, ni) if own.stop > own.start else own.stop
            rows = slice(start + own.start * nj * nk, start + last * nj * nk)
            moves = self.may_move(np.arange(rows.start, rows.stop))
            if near:
                moves &= near(rows)
            touched, size = moves.reshape(-1, nj, nk), (own.stop - own.start) * nj * nk
            for axis, n in enumerate((ni, nj, nk)):
                low, high = (tuple(slice(*ends) if axis == a else slice(None) for a in range(3)) for ends in _ENDS)
                touched = touched[low] | touched[high] if n > 1 else touched
            _, cj, ck = grid.cell_shapes[block]
            first = int(grid.cell_offsets[block]) + own.start * cj * ck
            yield rows.start + np.flatnonzero(moves[:size]), first + np.flatnonzero(touched)

    def _roots_of(self, moved: IntArray) -> IntArray:
        """Nodes of this rank's part, ascending, that have the unknowns of nodes ``moved`` of any rank."""
        low, high = self._bounds[self._ranks.number : self._ranks.number + 2]
        roots, has = self.roots(moved), np.zeros(high - low, dtype=bool)
        away = self.elsewhere(roots)
        for each in (roots[~away], *of_all(self._grid.points, np.unique(roots[away]))):
            has[each[~self.elsewhere(each)] - low] = True
        return low + np.flatnonzero(has)

    def _ranges(self, own: IntArray, size: int, end: int) -> list[int]:
        """First item (n_ranks + 1,) of every rank, if ranks take whole ranges of ``size`` from the items of all.

        ``own`` are the numbers of the items in this rank's part, ascending.
        """
        points = self._grid.points
        before = [0, *itertools.accumulate(of_all(points, len(own)))]
        here, starts = self._ranks.number, [-(-count // size) * size for count in before[:-1]]
        held = {n: int(own[at - before[here]]) for n, at in enumerate(starts) if before[here] <= at < before[here + 1]}
        found = {n: number for each in of_all(points, held) for n, number in each.items()}
        return [0, *(found.get(n, end) for n in range(1, len(starts))), end]

    def _gathered(self, own: IntArray, rows: list[int], bounds: list[int]) -> IntArray:
        """The cells of a region that this rank needs, from the ranks in whose parts they are: ``own`` in this one's."""
        ranks, wanted = self._ranks, [list[IntArray]() for _ in range(self._ranks.count)]
        for low in range(0, len(own), _TOGETHER):
            cells = own[low : low + _TOGETHER]
            corners = self.corners(cells)
            by_node = _owner(self._bounds, self.owners(corners))
            by_unknown = np.where(self.may_move(corners), _owner(rows, self.roots(corners)), -1)
            needed = np.column_stack([by_node, by_unknown, _owner(bounds, cells)])
            for number in np.unique(needed[needed >= 0]).tolist():
                wanted[number].append(cells[(needed == number).any(axis=1)])
        sends = {n: np.concatenate([np.empty(0, dtype=np.int64), *each]) for n, each in enumerate(wanted)}
        counts = ranks.gather([[len(sends[n]) for n in range(ranks.count)]])
        found = {n: np.empty(counts[n][ranks.number], np.int64) for n in sends if n != ranks.number}
        here = sends.pop(ranks.number)
        ranks.swap(sends, found)
        # Ascending, as those of lower ranks have smaller numbers.
        return np.concatenate([found.get(n, here) for n in range(ranks.count)])

    def corners(self, cells: IntArray) -> IntArray:
        """Block nodes (m, 8), in 2-D (m, 4), at the corners of cells, ascending."""
        grid = self._grid
        found = np.empty((len(cells), 2**grid.dimension), dtype=np.int64)
        ends = np.searchsorted(cells, grid.cell_offsets)
        for block in np.flatnonzero(np.diff(ends)).tolist():
            shape, mine = grid.shapes[block], slice(ends[block], ends[block + 1])
            ijk = np.unravel_index(cells[mine] - grid.cell_offsets[block], grid.cell_shapes[block])
            strides = [step for step, n in zip((shape[1] * shape[2], shape[2], 1), shape, strict=True) if n > 1]
            low = np.ravel_multi_index(ijk, shape) + grid.offsets[block]
            found[mine] = low[:, None] + np.array([sum(c) for c in itertools.product(*((0, s) for s in strides))])
        return found

    def elsewhere(self, nodes: IntArray) -> BoolArray:
        """Whether nodes belong to other ranks."""
        low, high = self._bounds[self._ranks.number : self._ranks.number + 2]
        return np.asarray((nodes < low) | (nodes >= high))

    @cached_property
    def _window(self) -> tuple[int, IntArray]:
        """First of the nodes that this rank asks for most, and their unique numbers, -1 inside blocks."""
        topology, (low, high) = self._topology, self._bounds[self._ranks.number : self._ranks.number + 2]
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
        if not nodes.size or (at.min() >= 0 and at.max() < len(window)):
            return np.asarray(window[at])
        found, outside = np.empty_like(nodes), (at < 0) | (at >= len(window))
        found[~outside] = window[at[~outside]]
        face, rest = self._topology.face_nodes, nodes[outside]
        place = np.minimum(np.searchsorted(face, rest), len(face) - 1)
        found[outside] = np.where(face[place] == rest, self._topology.number[place], -1)
        return found

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


_ENDS = ((None, -1), (1, None))


def _owner(bounds: list[int], numbers: IntArray) -> IntArray:
    """The rank that owns each number, if rank r owns those from ``bounds[r]`` to ``bounds[r + 1]``."""
    return np.searchsorted(bounds, numbers, side="right") - 1
