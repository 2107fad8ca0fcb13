"""The grid: blocks of nodes in one array.

All blocks share one coordinate array ``points`` of shape ``(n_nodes, 3)``; ``grid.block(b)`` is the view
``(ni, nj, nk, 3)`` of block ``b`` in it, C-contiguous, so that node ``(i, j, k)`` of block ``b`` has the flat index
``offsets[b] + (i * nj + j) * nk + k``. A 2-D grid has exactly one node along one index of every block.
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import GridError
from ..numerics.arrays import FloatArray, IntArray, total
from ..numerics.pieces import bounds_of, pieces
from ..parallel import ONE_PROCESS, Nodes, Ranks, for_items
from .parts import BlockSizes, Connection, Field, FileFormat, OwnPlanes, Patch, Planes, Shape, SideLattice, Window


@dataclass(frozen=True, eq=False, repr=False)
class Grid(BlockSizes):
    """A block-structured grid.

    Attributes
    ----------
    points : (n_nodes, 3) float64
        Coordinates of all block nodes, block after block (grid length unit).
    shapes : block shapes in nodes ``(ni, nj, nk)``
    names : block names, unique
    patches, connections, fields : declarations and data from the file
    format, path : of the file; ``None`` for grids made in memory
    notes : warnings of the reader, for the report
    components : name of the overset component of every block; empty if the grid is not divided into components
    overset : whether the file connects its blocks by overset interpolation only
    """

    points: FloatArray
    shapes: tuple[Shape, ...]
    names: tuple[str, ...]
    patches: tuple[Patch, ...] = ()
    connections: tuple[Connection, ...] = ()
    fields: tuple[Field, ...] = ()
    format: FileFormat | None = None
    path: Path | None = None
    notes: tuple[str, ...] = ()
    components: tuple[str, ...] = ()
    overset: bool = False

    def __repr__(self) -> str:
        return f"Grid({self.n_blocks} blocks, {self.n_nodes} nodes)"

    def __post_init__(self) -> None:
        if not self.shapes:
            raise GridError("the grid has no blocks; expected at least one")
        self._check_points()
        if len(self.names) != len(self.shapes) or len(set(self.names)) != len(self.names):
            raise GridError(f"need one unique name per block, found {list(self.names)} for {len(self.shapes)} blocks")
        flat = [sum(n == 1 for n in shape) for shape in self.shapes]
        for shape, name, ones in zip(self.shapes, self.names, flat, strict=True):
            if min(shape) < 1 or ones > 1:
                raise GridError(f"{name}: {shape} nodes is not a block; expected at least 2 nodes along two indices")
        if len(set(flat)) > 1:
            two, three = self.names[flat.index(1)], self.names[flat.index(0)]
            raise GridError(f"the grid mixes 2-D and 3-D blocks ({two} is one plane of nodes, {three} is not)")

    def _check_points(self) -> None:
        expected = int(self.offsets[-1])
        if self.points.shape != (expected, 3) or self.points.dtype != np.float64:
            raise GridError(
                f"coordinate array is {self.points.shape} {self.points.dtype}; "
                f"blocks {self.shapes} need ({expected}, 3) float64"
            )

    @classmethod
    def allocate(
        cls, shapes: Sequence[Shape], names: Sequence[str] | None = None, ranks: Ranks = ONE_PROCESS, **rest: Any
    ) -> Grid:
        """Make a grid with uninitialised coordinates, in parts if there are several ranks, to be filled."""
        sizes: tuple[Shape, ...] = tuple((int(ni), int(nj), int(nk)) for ni, nj, nk in shapes)
        labels = tuple(names) if names is not None else tuple(f"block{b + 1}" for b in range(len(sizes)))
        return cls(_points_among(sizes, ranks), sizes, labels, **rest)

    @classmethod
    def from_blocks(cls, blocks: Sequence[FloatArray], names: Sequence[str] | None = None, **rest: Any) -> Grid:
        """Make a grid from block coordinate arrays ``(ni, nj, nk, 3)`` (copied)."""
        grid = cls.allocate([b.shape[:3] for b in blocks], names, **rest)

        def put(index: int) -> None:
            grid.block(index)[...] = blocks[index]

        grid.fill(put)
        return grid

    @property
    def nodes(self) -> Nodes:
        """The rows of ``points`` that this rank holds: all of them unless the grid is in parts."""
        return Nodes.of(self.points)

    @cached_property
    def sides(self) -> SideLattice:
        """Where the nodes of all block sides lie."""
        return SideLattice.of(self.shapes, self.offsets)

    @cached_property
    def component_numbers(self) -> IntArray:
        """(n_blocks,) number of the component of each block, from 0 in the order of their first blocks."""
        names = list(dict.fromkeys(self.components))
        return np.array([names.index(name) for name in self.components] or [0] * self.n_blocks, dtype=np.int64)

    def block(self, index: int, values: FloatArray | None = None) -> FloatArray:
        """View ``(ni, nj, nk, ...)`` of block ``index`` in ``points``, or in any array with one row per node."""
        array = self.points if values is None else values
        Nodes.of(array).require_whole("a block is read as a whole")
        lo, hi = self.offsets[index], self.offsets[index + 1]
        return array[lo:hi].reshape(self.shapes[index] + array.shape[1:])

    def total_of(self, values: FloatArray) -> FloatArray:
        """Sum (3,) of ``values`` (n_nodes, 3), piece by piece: the same to the last bit for any ranks."""
        pieces = self.own_pieces()
        sums = np.zeros((len(pieces), 3))

        def add(number: int) -> None:
            sums[number] = total(values[pieces[number]])

        for_items(add, len(pieces))
        return np.asarray(sum(each for found in Nodes.of(values).gather(sums) for each in found))

    def own_pieces(self) -> list[slice]:
        """Rows of the pieces of blocks, of this rank if the grid is in parts."""
        low, high = self.nodes.ends
        block, first, last = pieces(self.shapes).T
        size = np.prod(self.shapes, axis=1)[block] // np.array(self.shapes)[block, 0]
        rows = self.offsets[block] + np.stack([first, last]) * size
        own = rows[:, (rows[0] >= low) & (rows[1] <= high)].T
        return [slice(begin, end) for begin, end in own.tolist()]

    def planes(self, index: int) -> slice:
        """The planes i of a block that this rank owns; all of them unless the grid is in parts."""
        lo, hi = self.nodes.ends
        ni, nj, nk = self.shapes[index]
        first, last = np.clip((np.array([lo, hi]) - self.offsets[index]) // (nj * nk), 0, ni)
        return slice(int(first), int(last))

    def in_planes(self, index: int, values: FloatArray | None = None) -> FloatArray:
        """View of the planes i of a block that this rank owns, in ``points`` or in an array alike."""
        own, (_, nj, nk) = self.planes(index), self.shapes[index]
        start, stop = (int(self.offsets[index]) + plane * nj * nk for plane in (own.start, own.stop))
        array = self.points if values is None else values
        return array[start:stop].reshape(own.stop - own.start, nj, nk, *array.shape[1:])

    def own_shape(self, index: int, shape: Shape) -> Shape:
        """Shape of what this rank holds of values of ``shape`` in a block: at nodes, cells or faces.

        The cells and faces behind a plane i belong to the rank of that plane.
        """
        own = self.planes(index)
        return min(own.stop, shape[0]) - min(own.start, shape[0]), shape[1], shape[2]

    def spread(self, own: Any, count: int) -> Any:
        """Values that this rank holds of ``count`` planes i of a block, as values of a :class:`Field`."""
        return OwnPlanes(own, count) if self.nodes.divided else own

    def box(self, index: int, window: Sequence[slice], values: FloatArray | None = None) -> FloatArray:
        """Nodes (ni, nj, nk, ...) in a window of a block, which this rank holds, in ``points`` or an array alike."""
        array = self.points if values is None else values
        _, nj, nk = self.shapes[index]
        i, j, k = window
        first, last = (int(self.offsets[index]) + end * nj * nk for end in (i.start, i.stop))
        return array[first:last].reshape(i.stop - i.start, nj, nk, *array.shape[1:])[:, j, k]

    def few(self, index: int, window: Sequence[slice]) -> FloatArray:
        """Coordinates (ni, nj, nk, 3) of a small window of a block, on all ranks."""
        i, j, k = np.ix_(*(np.arange(n)[part] for n, part in zip(self.shapes[index], window, strict=True)))
        _, nj, nk = self.shapes[index]
        return np.asarray(self.points[self.offsets[index] + (i * nj + j) * nk + k])

    def hold_neighbours(self, values: FloatArray | None = None, after: int = 1) -> None:
        """Hold the plane before those of this rank and some ``after`` them, too, if the grid is in parts, of ``points``
        or an array alike."""
        if not self.nodes.divided:
            return
        low, high = ends = self.nodes.ends
        for block, shape in enumerate(self.shapes):
            first, last = self.offsets[[block, block + 1]].tolist()
            low -= shape[1] * shape[2] * (first < ends[0] < last)
            if first < ends[1] < last:
                high = min(high + after * shape[1] * shape[2], last)
        Nodes.of(self.points if values is None else values).widen(low, high)

    def fill(self, put: Callable[[int], None]) -> None:
        """Call ``put(b)``, which fills the block's rows of ``points``, for every block, in ascending order."""
        for block in range(self.n_blocks):
            put(block)

    def fill_planes(self, put: Callable[[Planes], None], parts: Sequence[Planes], threads: int | None = None) -> None:
        """Like :meth:`fill`, for ranges of planes that together cover the grid; on ``threads``, by default all.

        Of a grid in parts, every rank fills its own; an error on one of them is raised on all.
        """
        own = [part for part in parts if self.planes(part.block).start < self.planes(part.block).stop]
        self.nodes.on_each(lambda: for_items(lambda number: put(own[number]), len(own), threads=threads))

    def divided(self, ranks: Ranks) -> Grid:
        """The grid in parts, which several ranks that hold the whole of it take; otherwise the grid itself."""
        if ranks.count == 1 or self.nodes.divided:
            return self
        grid = self.moved(_points_among(self.shapes, ranks))
        grid.nodes.own[...] = self.points[slice(*grid.nodes.ends)]
        fields = tuple(
            dataclasses.replace(each, values=grid.spread(each.values[grid.planes(each.block)], len(each.values)))
            for each in self.fields
        )
        return dataclasses.replace(grid, fields=fields)

    def with_patches_of(self, other: Grid) -> Grid:
        """The grid; if it has no patches, with those of another grid with the same blocks."""
        return self if self.patches else dataclasses.replace(self, patches=other.patches)

    def moved(self, points: FloatArray) -> Grid:
        """The grid with other coordinates."""
        # A copy keeps the cached properties; recomputing them costs more than some loops over the nodes of a block.
        grid = copy.copy(self)
        object.__setattr__(grid, "points", points)
        grid._check_points()
        return grid

    def sample(self, count: int) -> FloatArray:
        """Coordinates (n, 3) of about ``count`` nodes, spread evenly over all."""
        return np.asarray(self.nodes.at(np.arange(0, self.n_nodes, max(1, self.n_nodes // count))))

    def locate(self, flat: int) -> tuple[int, Shape]:
        """Block and 0-based (i, j, k) of a flat node index."""
        block = int(np.searchsorted(self.offsets, flat, side="right")) - 1
        i, j, k = np.unravel_index(flat - self.offsets[block], self.shapes[block])
        return block, (int(i), int(j), int(k))

    def node_label(self, flat: int) -> str:
        """Name of a node, block and 1-based indices: ``wing (3, 1, 17)``."""
        return self.label(*self.locate(flat))

    def window_label(self, window: Window) -> str:
        """``block1.jmin``, with the nodes of the window (1-based) if it is not the whole side."""
        a, b = window.side.tangential
        shape = self.shapes[window.block]
        name = f"{self.names[window.block]}.{window.side.label}"
        whole = window.low == (0, 0) and window.high == (shape[a] - 1, shape[b] - 1)
        return name if whole else f"{name}[{window.ranges}]"

    def label(self, block: int, place: Shape) -> str:
        """Name of the node or cell at ``place``, 0-based: block and 1-based indices."""
        return f"{self.names[block]} ({', '.join(str(n + 1) for n in place)})"


def _points_among(shapes: tuple[Shape, ...], ranks: Ranks) -> Any:
    """Uninitialised coordinates (n_nodes, 3) of blocks of these shapes, of which every rank holds its part."""
    bounds = bounds_of(shapes, ranks.count)
    return Nodes.new(ranks, bounds, (int(bounds[-1]), 3))


def rounded(points: FloatArray, precision: str) -> FloatArray:
    """Coordinates (n_nodes, 3) rounded to ``precision``; returned as they are for ``float64``."""
    if precision != "float32":
        return points
    result: FloatArray = Nodes.of(points).like(3)
    Nodes.of(result).each(lambda rows: np.copyto(result[rows], points[rows].astype(np.float32)))
    return result
