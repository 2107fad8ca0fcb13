"""Transfinite interpolation: block interiors from block faces, and faces from edges (Sen et al. section 2.1)."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np

from ...grid import FloatArray, Grid, IntArray
from ...numerics.transfinite.arcs import arc_coordinates, arc_numbers, arc_parts
from ...numerics.transfinite.blend import blend_slabs
from ...parallel import Shared, current_ranks, empty, for_chunks
from ..base import Account, Problem, Progress, Setting, of_stage
from ..options import option, positive, used
from .curved import CurvedLines
from .faces import Faces
from .skeleton import Skeleton, SubBlock, make_skeleton

FEW_PAIRS = (5e7, 4), (2e8, 8), (np.inf, 16)
"""Automatic ``max_cells``: largest number of pairs of nodes and sources, and cells per direction up to it.

Sums over 5e7 pairs take less than a tenth of a second. Small grids are coarse: where a motion changes within a few
cells, smaller sub-blocks follow it.
"""
# Planes and nodes per chunk, and chunks per grid: enough to balance the load at negligible cost.
_PLANES, _NODES, _CHUNKS = (8, 32), 65536, 64


@dataclass(frozen=True)
class TFI:
    """Linear blending of face displacements by arc length; cost N_v, a few operations per node.

    Keeps the clustering of the grid. Loses wall orthogonality, crosses cells when a body rotates by more than about 40
    degrees, and kinks grid lines at block interfaces if it also moves the interfaces.

    Attributes
    ----------
    max_cells : as the second step of a hybrid: blocks are cut into virtual sub-blocks of at most this many cells per
        direction, whose faces the first step moves; 0 never cuts; ``"auto"``: 16, and 8 or 4 in small grids
    """

    max_cells: int | Literal["auto"] = option(
        "auto", "keeps wall angles close to pure IDW (2.6 degrees deviation; 10.3 without sub-blocks)"
    )

    def __post_init__(self) -> None:
        positive("tfi.max_cells", self.max_cells, whole=True, zero=True, auto=True)

    def cells(self, problem: Problem) -> int:
        """Cells per direction of a sub-block."""
        if self.max_cells != "auto":
            return int(self.max_cells)
        pairs = float(problem.n_unique_nodes) * len(problem.source_numbers)
        return next(cells for limit, cells in FEW_PAIRS if pairs <= limit)

    def skeleton(self, problem: Problem) -> Skeleton:
        """The nodes that the first step has to move."""
        return make_skeleton(problem, self.cells(problem))

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedTFI:
        """Arc-length coordinates of all sub-blocks."""
        return PreparedTFI(self, problem, skeleton)


class PreparedTFI:
    """Arc-length coordinates of one undeformed grid: three numbers per node inside sub-blocks."""

    def __init__(self, options: TFI, problem: Problem, skeleton: Skeleton):
        grid = problem.grid
        subs = list(skeleton.sub_blocks())
        self.account = Account()
        cells = options.cells(problem)
        self.account.settings["max_cells"] = dataclasses.replace(used(options, "max_cells")["max_cells"], value=cells)
        self.account.settings["sub_blocks"] = Setting(len(subs))
        planes = [_plane_nodes(grid, sub) for sub in subs] if grid.dimension == 2 else []
        self._planes = Faces.of(grid.points, planes, [np.ones(nodes.shape, dtype=bool) for nodes in planes])
        self._subs = _table(grid, subs if grid.dimension == 3 else [])
        self._slabs = _slabs(self._subs)
        self._arc = empty([int(arc_numbers(self._subs).sum())])

        parts = arc_parts(self._subs)

        def work(lo: int, hi: int) -> None:
            arc_coordinates(grid.points, self._subs, parts[lo:hi], self._arc)

        for_chunks(work, len(parts), 1 + len(parts) // _CHUNKS, common=[self._arc])
        self._curved = CurvedLines.of(grid, _table(grid, subs), self._blend) if cells else None

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Interior of every sub-block from its faces, in place in ``displacement`` (n_nodes, 3)."""
        self._blend(displacement, self._slabs, progress)
        if self._curved:
            self._curved.add(displacement)

    def _blend(self, displacement: FloatArray, slabs: IntArray, progress: Progress | None = None) -> None:
        """Some planes of 3-D sub-blocks, see :func:`_slabs`; in a 2-D grid everything."""
        current_ranks().alter(displacement, partial(self._planes.blend, displacement))
        slabs = slabs if len(self._subs) else self._slabs

        def work(lo: int, hi: int) -> None:
            blend_slabs(displacement, self._arc, self._subs, slabs[lo:hi])

        def filled(lo: int, hi: int) -> IntArray:
            return np.concatenate([_nodes_of(self._subs[n], i0, i1) for n, i0, i1 in slabs[lo:hi].tolist()])

        report = of_stage(progress, "tfi")
        for_chunks(work, len(slabs), 1 + len(slabs) // _CHUNKS, report, [Shared(displacement, filled)])


def _table(grid: Grid, subs: list[SubBlock]) -> IntArray:
    """Sub-blocks in the form of the compiled loops, see :mod:`..numerics.transfinite.arcs`."""
    rows = [(grid.offsets[sub.block], *grid.shapes[sub.block], *sub.low, *sub.high, 0) for sub in subs]
    table = np.array(rows, dtype=np.int64).reshape(-1, 11)
    numbers = arc_numbers(table)
    table[:, 10] = np.cumsum(numbers) - numbers
    return table


def _slabs(subs: IntArray) -> IntArray:
    """Sub-block and planes i0 <= i < i1 of its interior, a few at a time so that threads can share the work."""
    planes = np.clip(_NODES // np.prod(subs[:, 8:10] - subs[:, 5:7], axis=1), *_PLANES)
    rows = [
        (n, i, min(i + step, end))
        for n, (low, end, step) in enumerate(np.column_stack([subs[:, [4, 7]], planes]).tolist())
        for i in range(low + 1, end, step)
    ]
    return np.array(rows, dtype=np.int64).reshape(-1, 3)


def _nodes_of(sub: IntArray, i0: int, i1: int) -> IntArray:
    """Flat indices of the nodes that a slab moves."""
    offset, shape, low, high = int(sub[0]), sub[1:4], sub[4:7], sub[7:10]
    j, k = (np.arange(low[axis] + 1, high[axis]) for axis in (1, 2))
    return np.asarray(offset + ((np.arange(i0, i1)[:, None, None] * shape[1] + j[:, None]) * shape[2] + k).ravel())


def _plane_nodes(grid: Grid, sub: SubBlock) -> IntArray:
    """Flat indices (na, nb) of a sub-block of a 2-D grid."""
    shape = grid.shapes[sub.block]
    numbers = np.arange(grid.offsets[sub.block], grid.offsets[sub.block + 1]).reshape(shape)
    window = tuple(slice(lo, hi + 1) for lo, hi in zip(sub.low, sub.high, strict=True))
    return np.asarray(numbers[window].squeeze(axis=shape.index(1)))
