"""The region that a repair may move: cells around the broken ones, their nodes, and how those are held."""

from __future__ import annotations

import itertools
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ..boundary import Boundary, Kind
from ..grid import BoolArray, FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..numerics.cell.foldover import cell_samples, sound_samples
from ..numerics.cell.layers import cells_at, grow
from .untangle import Region

_COLLAPSED = 1e-10
"""A Jacobian below this share of the product of the edges is that of a collapsed corner."""


class Plot(NamedTuple):
    """A region of a grid: the block nodes ``nodes`` (n,) that stand for its nodes, and all block nodes ``moved`` (k,)
    that move, as its nodes ``at`` (k,) do."""

    region: Region
    nodes: IntArray
    moved: IntArray
    at: IntArray


class Neighbourhood:
    """What all regions of one undeformed grid have in common.

    A *class* are all unique nodes that one unknown moves: one node, or all periodic images of one.
    """

    def __init__(self, grid: Grid, topology: Topology, boundary: Boundary):
        self.grid, self.topology, self.boundary = grid, topology, boundary
        self.dimension = grid.dimension
        normal = plane_normal(grid)
        self.normal = np.zeros(3) if normal is None else normal
        self.samples = cell_samples(self.dimension)
        self._shapes = np.array(grid.shapes, dtype=np.int64)
        self._root = np.arange(topology.n_unique)
        self._turn: dict[int, FloatArray] = {}
        if boundary.periodic.one.size:
            nodes, root, turn = boundary.periodic.frames(topology.n_unique)
            self._root[nodes] = root
            self._turn = dict(zip(nodes.tolist(), turn, strict=True))

    @cached_property
    def number(self) -> IntArray:
        """Unique node number of every block node (n_nodes,), -1 inside blocks."""
        number = np.full(self.grid.n_nodes, -1, dtype=np.int64)
        number[self.topology.face_nodes] = self.topology.number
        return number

    @cached_property
    def _copies(self) -> tuple[IntArray, IntArray]:
        """Block nodes of every class: ``nodes[start[c]:start[c + 1]]``."""
        of = self._root[self.topology.number]
        start = np.zeros(self.topology.n_unique + 1, dtype=np.int64)
        np.cumsum(np.bincount(of, minlength=self.topology.n_unique), out=start[1:])
        return start, self.topology.face_nodes[np.argsort(of, kind="stable")]

    @cached_property
    def _held(self) -> BoolArray:
        """(n_unique,) nodes that stay where they are: moving, fixed, and those on curved slip surfaces."""
        held = self.boundary.kind >= Kind.FIXED
        for surface in self.boundary.slip.curved:
            held[surface.nodes] = True
        return held

    @cached_property
    def _removed(self) -> FloatArray:
        """Directions in which unique nodes must not move: projectors (n_unique, 3, 3) on them, in the root's frame."""
        removed = np.tile(np.outer(self.normal, self.normal), (self.topology.n_unique, 1, 1))
        for nodes, projector in self.boundary.slip.groups:
            removed[nodes] += projector
        for node, turn in self._turn.items():
            if self._root[node] != node:
                removed[self._root[node]] += turn.T @ removed[node] @ turn
        several = np.flatnonzero(np.einsum("nii->n", removed) > 1.5)
        values, vectors = np.linalg.eigh(removed[several])
        kept = np.where(values[:, None, :] > 1e-9, vectors, 0.0)
        exact = np.abs(removed[several] - np.round(removed[several])).max(axis=(1, 2)) < 1e-12
        spans = kept @ kept.transpose(0, 2, 1)
        # Along axes there shall be no round-off.
        spans[exact] = np.round(spans[exact])
        removed[several] = spans
        return removed

    def around(self, cells: IntArray, layers: int) -> IntArray:
        """Block nodes that may move, all copies included, within ``layers`` cells of the given cells."""
        corner = self._corners(cells).ravel()
        start, copies = self._copies
        number = self.number
        classes = np.where(number >= 0, self._root[number], -1)
        near = grow(corner, layers, self._shapes, self.grid.offsets, classes, start, copies)
        on_face = number[near] >= 0
        return near[~on_face | ~self._held[number[near]]]

    def plot(self, free: IntArray) -> Plot:
        """The region that block nodes ``free`` from :meth:`around` span."""
        owners = self._owners(free)
        touched = cells_at(free, self._shapes, self.grid.offsets, self.grid.n_cells)
        nodes, local = np.unique(self._owners(self._corners(touched).ravel()), return_inverse=True)
        local = local.reshape(len(touched), -1)
        unknowns, freedom = self._unknowns(nodes, owners)
        start = self.grid.points[nodes]
        mask = sound_samples(start, local, self.samples, self.normal, self._signs(touched), _COLLAPSED)
        region = Region(touched, start, local, mask, self.samples, self.normal, unknowns, freedom)
        return Plot(region, nodes, free, np.searchsorted(nodes, owners))

    def _owners(self, flat: IntArray) -> IntArray:
        """The block node that stands for each of ``flat``."""
        number = self.number[flat]
        return np.where(number >= 0, self.topology.first[number], flat)

    def _corners(self, cells: IntArray) -> IntArray:
        """Block nodes (m, 8) or (m, 4) at the corners of cells."""
        found = np.empty((len(cells), 2**self.dimension), dtype=np.int64)
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
        """Sign of the determinants of sound cells in the order of their index axes."""
        block = np.searchsorted(cell_starts(self.grid), cells, side="right") - 1
        sign = self.topology.handedness.astype(np.float64)
        if self.dimension == 2:
            flat = np.array([shape.index(1) for shape in self.grid.shapes])
            # As in quality.cells: the positive normal of (i, j) and (j, k) follows their order, that of (i, k) not.
            sign *= np.where(flat == 1, -1.0, 1.0) * np.sign(self.normal[np.argmax(np.abs(self.normal))])
        return sign[block]

    def _unknowns(self, nodes: IntArray, free: IntArray) -> tuple[tuple[IntArray, FloatArray, BoolArray], FloatArray]:
        """How the ``nodes`` of a region follow its unknowns, given its ``free`` nodes; see :class:`Region`."""
        number = self.number[nodes]
        on_face = number >= 0
        root = nodes.copy()
        root[on_face] = self.topology.first[self._root[number[on_face]]]
        moves = np.isin(nodes, free)
        roots, of_node = np.unique(root[moves], return_inverse=True)
        unknown = np.full(len(nodes), -1, dtype=np.int64)
        unknown[moves] = of_node
        freedom = np.eye(3) - np.tile(np.outer(self.normal, self.normal), (len(roots), 1, 1))
        at = self.number[roots]
        freedom[at >= 0] = np.eye(3) - self._removed[at[at >= 0]]
        frame = np.tile(np.eye(3), (len(nodes), 1, 1))
        frame[moves] = freedom[of_node]
        for local in np.flatnonzero(on_face & moves) if self._turn else ():
            frame[local] = self._turn.get(int(number[local]), np.eye(3)) @ frame[local]
        plain = (frame == np.eye(3)).all(axis=(1, 2))
        return (unknown, frame, plain), freedom


def cell_starts(grid: Grid) -> IntArray:
    """Number (n_blocks + 1,) of the first cell of every block."""
    return np.concatenate([[0], np.cumsum([a * b * c for a, b, c in grid.cell_shapes])])
