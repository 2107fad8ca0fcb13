"""Which nodes the first step of a hybrid moves: block faces and the faces of virtual sub-blocks."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from ..boundary import Kind
from ..grid import Grid, IntArray, Shape, Side
from ..topology import side_nodes
from .base import Problem

Cuts = tuple[IntArray, IntArray, IntArray]


@dataclass(frozen=True)
class SubBlock:
    """A virtual sub-block: nodes ``low`` to ``high`` (inclusive) of one block."""

    block: int
    low: Shape
    high: Shape


@dataclass(frozen=True)
class Skeleton:
    """The index planes at which blocks are cut, and the end planes that need no interpolation of their own.

    Attributes
    ----------
    cuts : for every block the node indices of the cutting planes along i, j, k, both ends included
    flat_ends : block sides whose interior is blended from the edges of their sub-faces instead of being interpolated:
        slip planes at both ends of a span without cuts
    """

    grid: Grid
    cuts: tuple[Cuts, ...]
    flat_ends: frozenset[tuple[int, Side]]

    def sub_blocks(self) -> Iterator[SubBlock]:
        """All sub-blocks of all blocks."""
        for block, axes in enumerate(self.cuts):
            spans = [list(zip(c[:-1].tolist(), c[1:].tolist(), strict=True)) or [(0, 0)] for c in axes]
            for i in spans[0]:
                for j in spans[1]:
                    for k in spans[2]:
                        yield SubBlock(block, (i[0], j[0], k[0]), (i[1], j[1], k[1]))

    def nodes(self) -> IntArray:
        """Flat indices of all nodes that the first step moves, coincident ones included, ascending."""
        return np.concatenate([self._of_block(b) for b in range(self.grid.n_blocks)])

    def _of_block(self, block: int) -> IntArray:
        shape = self.grid.shapes[block]
        on = [np.zeros(n, dtype=bool) for n in shape]
        for axis, cut in enumerate(self.cuts[block]):
            # The one plane of a 2-D block is not a cut: it holds the interior.
            on[axis][cut if shape[axis] > 1 else []] = True
        mask = on[0][:, None, None] | on[1][:, None] | on[2]
        for side in Side:
            if (block, side) in self.flat_ends:
                a, b = side.tangential
                edges = on[a][:, None] | on[b]
                plane: list[slice | int] = [slice(None)] * 3
                plane[side.axis] = shape[side.axis] - 1 if side % 2 else 0
                mask[tuple(plane)] = edges
        return np.asarray(self.grid.offsets[block] + np.flatnonzero(mask), dtype=np.int64)


def make_skeleton(problem: Problem, max_cells: int) -> Skeleton:
    """Cut every block into sub-blocks of at most ``max_cells`` cells per direction; 0 cuts nothing."""
    cuts = tuple(_cuts(shape, max_cells) for shape in problem.grid.shapes)
    flat = _flat_ends(problem, cuts) if max_cells else frozenset()
    return Skeleton(problem.grid, cuts, flat)


def _cuts(shape: Shape, max_cells: int) -> Cuts:
    def along(n: int) -> IntArray:
        if n == 1:
            return np.zeros(1, dtype=np.int64)
        parts = -(-(n - 1) // max_cells) if max_cells else 1
        return np.round(np.linspace(0, n - 1, parts + 1)).astype(np.int64)

    i, j, k = (along(n) for n in shape)
    return i, j, k


def _flat_ends(problem: Problem, cuts: tuple[Cuts, ...]) -> frozenset[tuple[int, Side]]:
    kind, quads = problem.boundary.quad_kind, problem.topology.quads
    in_plane = np.zeros(problem.topology.n_unique, dtype=bool)
    for nodes, _ in problem.boundary.slip.groups:
        in_plane[nodes] = True
    in_plane |= problem.boundary.known
    found = set()
    for block, axes in enumerate(cuts):
        for axis in range(3):
            pair = (Side(2 * axis), Side(2 * axis + 1))
            if len(axes[axis]) == 2 and all(
                np.isin(kind[quads.of_side(block, side)], (Kind.SLIP, Kind.SYMMETRY)).all()
                and in_plane[problem.topology.numbers_of(side_nodes(problem.grid, block, side).ravel())].all()
                for side in pair
            ):
                found |= {(block, side) for side in pair}
    return frozenset(found)
