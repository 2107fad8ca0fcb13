"""The nodes that a repair moves: those around weak cells, as a region with an energy."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np

from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_axes, plane_normal
from ..numerics.cell.foldover.hexahedra import Unknowns
from ..numerics.cell.foldover.samples import cell_samples, samples_with_any, sound_samples
from ..numerics.cell.layers import cells_at, layers_from
from .constraints import Constraints
from .energy.elements import COLLAPSED, Energy, Hexahedra, Triangles
from .energy.region import Region, Slide
from .sliding import Sliding
from .walls import UNLIMITED, nearness, weigh


class Plot(NamedTuple):
    """A region of a grid.

    ``nodes`` (n,): one representative block node per node of the region; ``moved`` (k,): block nodes that follow node
    ``at`` (k,) of the region. The region's coordinates are the components along ``axes`` (d, 3).
    """

    region: Region
    nodes: IntArray
    moved: IntArray
    at: IntArray
    axes: FloatArray

    def inside(self, points: FloatArray) -> FloatArray:
        """Coordinates (n, d) of the region's nodes."""
        return np.asarray(points[self.nodes] @ self.axes.T)

    def shift(self, change: FloatArray) -> FloatArray:
        """Shift (k, 3) of the block nodes ``moved`` for a change (n, d) of the region's coordinates."""
        return np.asarray(change[self.at] @ self.axes)


class Neighbourhood:
    """Data shared by all regions of one undeformed grid.

    A *class* consists of the unique nodes that one unknown moves: a single node, or all periodic images of one.
    """

    def __init__(self, constraints: Constraints):
        self.constraints, self.grid, self.topology = constraints, constraints.grid, constraints.topology
        normal = plane_normal(self.grid)
        self.normal = np.zeros(3) if normal is None else normal
        self.axes = np.eye(3) if normal is None else plane_axes(normal)
        self._shapes = np.array(self.grid.shapes, dtype=np.int64)

    @cached_property
    def number(self) -> IntArray:
        """Unique node number of every block node (n_nodes,), -1 inside blocks."""
        number = np.full(self.grid.n_nodes, -1, dtype=np.int64)
        number[self.topology.face_nodes] = self.topology.number
        return number

    @cached_property
    def _classes(self) -> tuple[IntArray, IntArray, IntArray]:
        """Class of every block node (n_nodes,), -1 inside blocks, and the nodes of every class:
        ``nodes[start[c]:start[c + 1]]``."""
        root, n = self.constraints.root, self.topology.n_unique
        of = root[self.topology.number]
        start = np.zeros(n + 1, dtype=np.int64)
        np.cumsum(np.bincount(of, minlength=n), out=start[1:])
        classes = np.where(self.number >= 0, root[self.number], -1)
        return classes, start, self.topology.face_nodes[np.argsort(of, kind="stable")]

    @cached_property
    def _from_walls(self) -> FloatArray:
        """:func:`.walls.nearness` (n_nodes,) of every block node."""
        walls = self.topology.face_nodes[self.constraints.walls[self.topology.number]]
        return nearness(self._layers(walls, UNLIMITED))

    def around(self, cells: IntArray, layers: int | None) -> IntArray:
        """Block nodes that may move within ``layers`` (``None``: any) cells of ``cells``, with coincident ones."""
        near = np.arange(self.grid.n_nodes)
        if layers is not None:
            near = np.flatnonzero(self._layers(self._corners(cells).ravel(), layers) >= 0)
        on_face = self.number[near] >= 0
        return near[~on_face | ~self.constraints.held[self.number[near]]]

    def plot(self, free: IntArray, even: bool = False) -> Plot:
        """The region of the block nodes ``free``, from :meth:`around`; ``even``: without larger weights near walls."""
        owners = self._owners(free)
        touched = cells_at(free, self._shapes, self.grid.offsets, self.grid.n_cells)
        corners = self._corners(touched)
        nodes, local = np.unique(self._owners(corners.ravel()), return_inverse=True)
        unknowns, freedom = self._unknowns(nodes, owners)
        start, cells = self.grid.points[nodes] @ self.axes.T, local.reshape(corners.shape)
        walls = self._from_walls
        weight = np.ones(len(cells)) if even else weigh(walls[corners], float(walls.min()), start, cells)
        energy = self._energy(start, cells, self._signs(touched), weight, unknowns.number >= 0)
        slides = tuple(self._slides(nodes, unknowns))
        return Plot(Region(energy, unknowns, freedom, slides), nodes, free, np.searchsorted(nodes, owners), self.axes)

    def _slides(self, nodes: IntArray, unknowns: Unknowns) -> Iterator[Slide]:
        """The slides of the region's nodes, see :class:`Region`."""
        for each in self.constraints.sliding:
            local = np.flatnonzero(np.isin(nodes, self.topology.first[each.nodes]) & (unknowns.number >= 0))
            if local.size:
                yield Slide(local, partial(self._normals, each), partial(self._onto, each))

    def _normals(self, sliding: Sliding, x: FloatArray) -> FloatArray:
        """Unit normals (k, d) of a surface nearest to coordinates (k, d) of the region."""
        return np.asarray(sliding.normals(self._outside(x)) @ self.axes.T)

    def _onto(self, sliding: Sliding, x: FloatArray) -> FloatArray:
        """Coordinates (k, d) of the region projected onto a surface."""
        return np.asarray(sliding.project(self._outside(x)) @ self.axes.T)

    def _outside(self, x: FloatArray) -> FloatArray:
        """Coordinates in space (k, 3) from those of a region (k, d)."""
        return np.asarray(x @ self.axes + self.grid.points[0] - self.axes.T @ (self.axes @ self.grid.points[0]))

    def _layers(self, seeds: IntArray, layers: int) -> np.ndarray:
        found: np.ndarray = layers_from(seeds, layers, self._shapes, self.grid.offsets, *self._classes)
        return found

    def _energy(
        self, start: FloatArray, cells: IntArray, sign: FloatArray, weight: FloatArray, moves: BoolArray
    ) -> Energy:
        """The energy of the samples that depend on a node that ``moves`` (n,); the others are constant."""
        if self.grid.dimension == 2:
            return Triangles.at_corners(start, cells, sign, weight).with_any(moves)
        samples = cell_samples()
        mask = sound_samples(start, cells, samples, sign, COLLAPSED)
        mask &= samples_with_any(moves[cells], samples)
        return Hexahedra(start, cells, cells, mask, samples, weight, np.ones(len(cells)))

    def _owners(self, flat: IntArray) -> IntArray:
        """The block node that represents each of ``flat``."""
        number = self.number[flat]
        return np.where(number >= 0, self.topology.first[number], flat)

    def _corners(self, cells: IntArray) -> IntArray:
        """Block nodes (m, 8), in 2-D (m, 4), at the corners of cells."""
        found = np.empty((len(cells), 2**self.grid.dimension), dtype=np.int64)
        starts = cell_starts(self.grid)
        ends = np.searchsorted(cells, starts)
        for block, shape in enumerate(self.grid.shapes):
            mine = slice(ends[block], ends[block + 1])
            ijk = np.unravel_index(cells[mine] - starts[block], self.grid.cell_shapes[block])
            strides = [step for step, n in zip((shape[1] * shape[2], shape[2], 1), shape, strict=True) if n > 1]
            low = np.ravel_multi_index(ijk, shape) + self.grid.offsets[block]
            found[mine] = low[:, None] + np.array([sum(c) for c in itertools.product(*((0, s) for s in strides))])
        return found

    def _signs(self, cells: IntArray) -> FloatArray:
        """Sign (m,) of the determinants of sound cells, with edges in the order of their index axes."""
        block = np.searchsorted(cell_starts(self.grid), cells, side="right") - 1
        sign = self.topology.handedness.astype(np.float64)
        if self.grid.dimension == 2:
            flat = np.array([shape.index(1) for shape in self.grid.shapes])
            # As in quality.measures.cells: the normal is positive for axes (i, j) and (j, k), negative for (i, k).
            sign *= np.where(flat == 1, -1.0, 1.0) * np.sign(self.normal[np.argmax(np.abs(self.normal))])
        return sign[block]

    def _unknowns(self, nodes: IntArray, free: IntArray) -> tuple[Unknowns, FloatArray]:
        """Unknowns of a region's ``nodes``, given the ``free`` ones, and their projectors; see :class:`Region`."""
        constraints, axes = self.constraints, self.axes
        number = self.number[nodes]
        on_face = number >= 0
        root = nodes.copy()
        root[on_face] = self.topology.first[constraints.root[number[on_face]]]
        moves = np.isin(nodes, free)
        roots, of_node = np.unique(root[moves], return_inverse=True)
        unknown = np.full(len(nodes), -1, dtype=np.int64)
        unknown[moves] = of_node
        one = np.eye(len(axes))
        freedom = np.tile(one, (len(roots), 1, 1))
        at = self.number[roots]
        freedom[at >= 0] -= axes @ constraints.removed[at[at >= 0]] @ axes.T
        frame = np.tile(one, (len(nodes), 1, 1))
        frame[moves] = freedom[of_node]
        for local in np.flatnonzero(on_face & moves) if constraints.turn else ():
            turn = constraints.turn.get(int(number[local]))
            if turn is not None:
                frame[local] = axes @ turn @ axes.T @ frame[local]
        return Unknowns(unknown, frame, (frame == one).all(axis=(1, 2))), freedom


def cell_starts(grid: Grid) -> IntArray:
    """Number (n_blocks + 1,) of the first cell of every block."""
    return np.concatenate([[0], np.cumsum([a * b * c for a, b, c in grid.cell_shapes])])
