"""Transfinite interpolation: block interiors from block faces, and faces from edges (Sen et al. section 2.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, IntArray
from ..numerics.blend import arc_coordinates, blend_block, blend_plane, plane_coordinates
from ..numerics.parallel import Shared, for_chunks
from .base import Account, Problem, Progress, Setting
from .options import option, positive, used
from .skeleton import Skeleton, SubBlock, make_skeleton

DEFAULT_MAX_CELLS = 16


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
        self._arc = np.empty((grid.n_nodes, 3)) if grid.dimension == 3 else np.empty((0, 3))
        self._planes: list[_Plane] = []
        if grid.dimension == 3:
            for_chunks(self._arcs, grid.n_blocks, 1)
        else:
            self._planes = [_Plane.of(problem, sub) for sub in self._subs]
        self.account = Account()
        self.account.settings |= used(options, "max_cells")
        self.account.settings["sub_blocks"] = Setting(len(self._subs))

    def _arcs(self, first: int, last: int) -> None:
        for block in range(first, last):
            arc_coordinates(self._grid.block(block), *self._skeleton.cuts[block], self._grid.block(block, self._arc))

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Interior of every sub-block from its faces, in place in ``displacement`` (n_nodes, 3)."""
        if self._grid.dimension == 2:
            for plane in self._planes:
                plane.fill(displacement)
            return

        def work(lo: int, hi: int) -> None:
            for sub in self._subs[lo:hi]:
                (i0, j0, k0), (i1, j1, k1) = sub.low, sub.high
                blend_block(
                    self._grid.block(sub.block, displacement),
                    self._grid.block(sub.block, self._arc),
                    i0, i1, j0, j1, k0, k1,
                )  # fmt: skip

        report = None if progress is None else (lambda done, total: progress("tfi", done, total))
        for_chunks(work, len(self._subs), 1, report, [Shared(displacement, self._interior)])

    def _interior(self, first: int, last: int) -> IntArray:
        """Flat indices of the nodes inside some sub-blocks."""
        return np.concatenate([sub.interior(self._grid) for sub in self._subs[first:last]])


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
