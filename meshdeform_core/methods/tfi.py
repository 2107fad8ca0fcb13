"""Transfinite interpolation: block interiors from block faces, and faces from edges (Sen et al. section 2.1)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..numerics.blend import arcs_along_i, arcs_along_j_and_k, blend_plane, blend_slabs, plane_coordinates
from ..numerics.parallel import Shared, current_ranks, empty, for_chunks
from .base import Account, Problem, Progress, Setting
from .options import option, positive, used
from .skeleton import Skeleton, SubBlock, make_skeleton

DEFAULT_MAX_CELLS = 16
# Planes filled by one call, and calls of a whole grid: enough to share evenly, few enough to cost nothing.
_PLANES, _CHUNKS = 32, 64


@dataclass(frozen=True)
class TFI:
    """Linear blending of face displacements by arc length; cost N_v, a few operations per node.

    Keeps the clustering of the grid. Loses wall orthogonality and crosses cells when a body rotates by more than
    some 40 degrees, and kinks grid lines at block interfaces when it moves the interfaces too.

    Attributes
    ----------
    max_cells : as the second step of a hybrid: blocks are cut into virtual sub-blocks of at most this many cells per
        direction, whose faces the first step moves; 0 never cuts
    """

    max_cells: int = option(DEFAULT_MAX_CELLS, "walls as with IDW alone (hemisphere: 2.6 degrees off, 10.3 uncut)")

    def __post_init__(self) -> None:
        positive("tfi.max_cells", self.max_cells, whole=True, zero=True)

    def skeleton(self, problem: Problem) -> Skeleton:
        """What the first step has to move for this second step."""
        return make_skeleton(problem, self.max_cells)

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedTFI:
        """Arc-length coordinates of all sub-blocks."""
        return PreparedTFI(self, problem, skeleton)


class PreparedTFI:
    """Arc-length coordinates of one undeformed grid, (n_nodes, 3) in all."""

    def __init__(self, options: TFI, problem: Problem, skeleton: Skeleton):
        grid = problem.grid
        self._grid, self._skeleton = grid, skeleton
        self._subs = list(skeleton.sub_blocks())
        self._arc = empty((grid.n_nodes if grid.dimension == 3 else 0, 3))
        self._planes: list[_Plane] = []
        if grid.dimension == 3:
            for block in range(grid.n_blocks):
                self._arcs(block)
        else:
            self._planes = [_Plane.of(problem, sub) for sub in self._subs]
        self._slabs = _slabs(grid, self._subs)
        self.account = Account()
        self.account.settings |= used(options, "max_cells")
        self.account.settings["sub_blocks"] = Setting(len(self._subs))

    def _arcs(self, block: int) -> None:
        points, arc = self._grid.block(block), self._grid.block(block, self._arc)
        along_i, along_j, along_k = self._skeleton.cuts[block]
        ni, nj = points.shape[:2]
        for_chunks(lambda lo, hi: arcs_along_i(points, along_i, lo, hi, arc), nj, -(-nj // 8), common=[arc])
        for_chunks(
            lambda lo, hi: arcs_along_j_and_k(points, along_j, along_k, lo, hi, arc), ni, -(-ni // 8), common=[arc]
        )

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Interior of every sub-block from its faces, in place in ``displacement`` (n_nodes, 3)."""
        if self._grid.dimension == 2:
            for plane in self._planes:
                current_ranks().alter(displacement, partial(plane.fill, displacement))
            return

        def work(lo: int, hi: int) -> None:
            blend_slabs(displacement, self._arc, self._slabs[lo:hi])

        report = None if progress is None else (lambda done, total: progress("tfi", done, total))
        chunk = 1 + len(self._slabs) // _CHUNKS
        for_chunks(work, len(self._slabs), chunk, report, [Shared(displacement, self._interior)])

    def _interior(self, first: int, last: int) -> IntArray:
        """Flat indices of the nodes inside some slabs."""
        return np.concatenate([_nodes_of(slab) for slab in self._slabs[first:last]])


def _slabs(grid: Grid, subs: list[SubBlock]) -> IntArray:
    """Planes i0 <= i < i1 of the interiors of sub-blocks, at most some at a time so that threads can share.

    One row each: first node and shape of the block, low and high node of the sub-block, i0, i1.
    """
    rows = [
        (grid.offsets[sub.block], *grid.shapes[sub.block], *sub.low, *sub.high, i, min(i + _PLANES, sub.high[0]))
        for sub in subs
        for i in range(sub.low[0] + 1, sub.high[0], _PLANES)
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, 12)


def _nodes_of(slab: IntArray) -> IntArray:
    """Flat indices of the nodes that one row of :func:`_slabs` moves."""
    offset, shape, low, high = int(slab[0]), slab[1:4], slab[4:7], slab[7:10]
    j, k = (np.arange(low[axis] + 1, high[axis]) for axis in (1, 2))
    i = np.arange(slab[10], slab[11])
    return np.asarray(offset + ((i[:, None, None] * shape[1] + j[:, None]) * shape[2] + k).ravel())


@dataclass(frozen=True)
class _Plane:
    """A sub-block of a 2-D grid: flat indices (na, nb) and arc coordinates."""

    nodes: IntArray
    s: FloatArray
    t: FloatArray

    @classmethod
    def of(cls, problem: Problem, sub: SubBlock) -> _Plane:
        shape = problem.grid.shapes[sub.block]
        numbers = np.arange(problem.grid.offsets[sub.block], problem.grid.offsets[sub.block + 1]).reshape(shape)
        window = tuple(slice(lo, hi + 1) for lo, hi in zip(sub.low, sub.high, strict=True))
        nodes = numbers[window].squeeze(axis=shape.index(1))
        return cls(nodes, *plane_coordinates(problem.grid.points[nodes]))

    def fill(self, displacement: FloatArray) -> None:
        values = displacement[self.nodes]
        blend_plane(values, self.s, self.t)
        displacement[self.nodes] = values
