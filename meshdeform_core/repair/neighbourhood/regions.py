"""The nodes that a repair moves: those around weak cells, as a region with an energy."""

from __future__ import annotations

from collections.abc import Iterator
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from ...grid import BoolArray, FloatArray, IntArray
from ...grid.planes import plane_axes, plane_normal
from ...numerics.cell.foldover.hexahedra import Unknowns
from ...numerics.cell.foldover.samples import cell_samples, samples_with_any, sound_samples
from ...parallel import Halo, of_all
from ..constraints import Constraints
from ..energy.elements import COLLAPSED, Energy, Hexahedra, Triangles
from ..energy.region import Dealt, Region, Slide
from ..sliding import Sliding
from .reach import Reach
from .shares import Near, Share, Shares
from .walls import FARTHEST, nearness, weigh


class Plot(NamedTuple):
    """A region of a grid, or this rank's share of it.

    ``moved`` (k,): block nodes of this rank that follow the region's nodes ``at`` (k,). The region's coordinates are
    the components along ``axes`` (d, 3).
    """

    region: Region
    moved: IntArray
    at: IntArray
    axes: FloatArray

    @property
    def nodes(self) -> IntArray:
        """One block node (n,) for each node of the region."""
        return self.region.dealt.nodes.numbers

    def inside(self, points: FloatArray) -> FloatArray:
        """Coordinates (n, d) of the region's nodes."""
        return components(self.region.dealt.nodes.of(points), self.axes)

    def shift(self, change: FloatArray) -> FloatArray:
        """Shift (k, 3) of the block nodes ``moved`` for a change (n, d) of the region's coordinates."""
        return components(change[self.at], self.axes.T)


def components(vectors: FloatArray, axes: FloatArray) -> FloatArray:
    """Products (n, d) of vectors (n, e) and ``axes`` (d, e); the same to the last bit for any n, unlike ``@``."""
    return np.asarray(sum(vectors[:, e, None] * axes[:, e] for e in range(axes.shape[1])))


class Neighbourhood:
    """Data shared by all regions of one undeformed grid."""

    def __init__(self, constraints: Constraints):
        self.constraints, self.grid, self.topology = constraints, constraints.grid, constraints.topology
        normal = plane_normal(self.grid)
        self.normal = np.zeros(3) if normal is None else normal
        self.axes = np.eye(3) if normal is None else plane_axes(normal)
        self.shares = Shares(constraints)

    @cached_property
    def _reach(self) -> Reach:
        return Reach(self.constraints)

    @cached_property
    def _from_walls(self) -> tuple[Any, int]:
        """Distance of every block node (n_nodes,) from walls, in cells, and the largest one."""
        walls = self.topology.face_nodes[self.constraints.walls[self.topology.number]]
        return self._reach.layers(walls, FARTHEST)

    def around(self, cells: IntArray, layers: int) -> Share:
        """The share of the nodes that may move within ``layers`` cells of ``cells``, of which each rank gives those in
        its part, ascending."""
        seeds = self.shares.corners(cells).ravel()
        known = (self.shares.numbers(seeds) < 0) & ~self.shares.elsewhere(seeds)
        seeds = np.concatenate([seeds[known], *of_all(self.grid.points, np.unique(seeds[~known]))])
        return self.shares.share(Near(self._reach.layers(seeds, layers)[0], layers))

    def plot(self, share: Share | None = None, even: bool = False) -> Plot:
        """The region that a share is part of, by default of all nodes that may move; ``even``: cells at walls count
        like others."""
        shares = self.shares
        share = share or shares.share()
        corners, owners = shares.corners(share.cells), shares.owners(share.moved)
        at_cells = np.append(shares.owners(corners.ravel()), owners[shares.elsewhere(owners)])
        nodes, local = np.unique(at_cells, return_inverse=True)
        held = shares.halo(nodes)
        moves = shares.may_move(nodes)
        if share.near:
            moves &= share.near(held)
        roots, unknowns, freedom = self._unknowns(nodes, moves)
        start, cells = components(held.of(self.grid.points), self.axes), local[: corners.size].reshape(corners.shape)
        weight = np.ones(len(cells)) if even else self._weights(held, start, cells)
        energy, of_cell = self._energy(start, cells, self._signs(share.cells), weight, unknowns.number >= 0)
        dealt = Dealt(shares.unknowns(roots, share), held, np.unique(np.searchsorted(of_cell, share.ends)))
        region = Region(energy, unknowns, freedom, dealt, tuple(self._slides(nodes, unknowns)))
        return Plot(region, share.moved, np.searchsorted(nodes, owners), self.axes)

    def _weights(self, nodes: Halo, start: FloatArray, cells: IntArray) -> FloatArray:
        layers, most = self._from_walls
        share, first = nearness(nodes.of(layers), most)
        return weigh(share[cells], first, start, cells)

    def _slides(self, nodes: IntArray, unknowns: Unknowns) -> Iterator[Slide]:
        """The slides of the region's nodes, see :class:`Region`."""
        for each in self.constraints.sliding:
            local = np.flatnonzero(np.isin(nodes, self.topology.first[each.nodes]) & (unknowns.number >= 0))
            if local.size:
                slopes = partial(self._slopes, each)
                yield Slide(local, partial(self._normals, each), partial(self._onto, each), slopes)

    def _normals(self, sliding: Sliding, x: FloatArray) -> FloatArray:
        """Unit normals (k, d) of a surface nearest to coordinates (k, d) of the region."""
        return components(sliding.normals(self._outside(x)), self.axes)

    def _onto(self, sliding: Sliding, x: FloatArray) -> FloatArray:
        """Coordinates (k, d) of the region projected onto a surface."""
        return components(sliding.project(self._outside(x)), self.axes)

    def _slopes(self, sliding: Sliding, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (k, d, d) of the projection onto a surface, and of its normals."""
        onto, normals = sliding.slopes(self._outside(x))
        return self.axes @ onto @ self.axes.T, self.axes @ normals @ self.axes.T

    def _outside(self, x: FloatArray) -> FloatArray:
        """Coordinates in space (k, 3) from those of a region (k, d)."""
        origin = self.grid.points[0]
        return components(x, self.axes.T) + origin - self.axes.T @ (self.axes @ origin)

    def _energy(
        self, start: FloatArray, cells: IntArray, sign: FloatArray, weight: FloatArray, moves: BoolArray
    ) -> tuple[Energy, IntArray]:
        """The energy of the samples that depend on a node that ``moves`` (n,), as all others are constant; and the cell
        of each element."""
        if self.grid.dimension == 2:
            return Triangles.at_corners(start, cells, sign, weight, moves)
        samples = cell_samples()
        mask = sound_samples(start, cells, samples, sign, COLLAPSED)
        mask &= samples_with_any(moves[cells], samples)
        energy = Hexahedra(start, cells, cells, mask, samples, weight, np.ones(len(cells)))
        return energy, np.arange(len(cells))

    def _signs(self, cells: IntArray) -> FloatArray:
        """Sign (m,) of the determinants of sound cells, with edges in the order of their index axes."""
        block = np.searchsorted(self.grid.cell_offsets, cells, side="right") - 1
        sign = self.topology.handedness.astype(np.float64)
        if self.grid.dimension == 2:
            flat = np.array([shape.index(1) for shape in self.grid.shapes])
            # As in quality.measures.cells: the normal is positive for axes (i, j) and (j, k), negative for (i, k).
            sign *= np.where(flat == 1, -1.0, 1.0) * np.sign(self.normal[np.argmax(np.abs(self.normal))])
        return sign[block]

    def _unknowns(self, nodes: IntArray, moves: BoolArray) -> tuple[IntArray, Unknowns, FloatArray]:
        """The unknowns of a region's ``nodes``, identified by the nodes that have them, and the dependence of ``nodes``
        on them; see :class:`Region`."""
        constraints, axes = self.constraints, self.axes
        number = self.shares.numbers(nodes)
        on_face = number >= 0
        roots, of_node = np.unique(self.shares.roots(nodes[moves]), return_inverse=True)
        unknown = np.full(len(nodes), -1, dtype=np.int64)
        unknown[moves] = of_node
        one = np.eye(len(axes))
        freedom = np.tile(one, (len(roots), 1, 1))
        at = self.shares.numbers(roots)
        freedom[at >= 0] -= axes @ constraints.removed[at[at >= 0]] @ axes.T
        frame = np.tile(one, (len(nodes), 1, 1))
        frame[moves] = freedom[of_node]
        for local in np.flatnonzero(on_face & moves) if constraints.turn else ():
            turn = constraints.turn.get(int(number[local]))
            if turn is not None:
                frame[local] = axes @ turn @ axes.T @ frame[local]
        return roots, Unknowns(unknown, frame, (frame == one).all(axis=(1, 2))), freedom
