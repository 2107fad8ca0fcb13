"""Transfinite interpolation: block interiors from block faces, and faces from edges (Sen et al. section 2.1)."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ...grid import FloatArray, IntArray
from ...numerics.arrays import batches
from ...numerics.transfinite.arcs import box_numbers
from ...parallel import Nodes, for_items
from ..base import Account, Problem, Progress, Setting, of_stage
from ..options import MethodOptions, option
from .groups import Bent, CurvedLines, Group
from .skeleton import Skeleton, make_skeleton

FEW_PAIRS = (5e7, 4), (2e8, 8), (np.inf, 16)
"""Automatic ``max_cells``: largest number of pairs of nodes and sources, and cells per direction up to that number.

Sums over 5e7 pairs take less than a tenth of a second. Small grids are coarse, and a motion may change within a few of
their cells; smaller sub-blocks follow it better.
"""
# Nodes in a group of sub-blocks, small enough for their coordinates to stay in the cache until they are used.
_TOGETHER = 1 << 17


@dataclass(frozen=True)
class TFI(MethodOptions):
    """Linear blending of face displacements by arc length; cost N_v, a few operations per node.

    Keeps the clustering of the grid. Loses wall orthogonality, crosses cells when a body rotates by more than about 40
    degrees, and kinks grid lines at block interfaces if it also moves the interfaces.

    Attributes
    ----------
    max_cells : as the second step of a hybrid: blocks are cut into virtual sub-blocks of at most this many cells per
        direction, whose faces the first step moves; 0 never cuts; ``"auto"``: 16, and 8 or 4 in small grids
    """

    max_cells: int | Literal["auto"] = option(
        "auto", "keeps wall angles close to pure IDW (2.6 degrees deviation; 10.3 without sub-blocks)", range="[0, inf)"
    )

    def cells(self, problem: Problem) -> int:
        """Cells per direction of a sub-block."""
        if self.max_cells != "auto":
            return int(self.max_cells)
        return next(cells for limit, cells in FEW_PAIRS if _pairs(problem) <= limit)

    def skeleton(self, problem: Problem) -> Skeleton:
        """The nodes that the first step must move."""
        return make_skeleton(problem, self.cells(problem))

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedTFI:
        """Bind to the undeformed grid."""
        return PreparedTFI(self, problem, skeleton)


def _pairs(problem: Problem) -> float:
    return float(problem.n_unique_nodes) * len(problem.source_numbers)


def _reason(problem: Problem, usual: str) -> str:
    """The reason for the number of cells per sub-block in this grid."""
    pairs = _pairs(problem)
    limit = next(limit for limit, _ in FEW_PAIRS if pairs <= limit)
    if np.isfinite(limit):
        return (
            f"{pairs:.1e} pairs of nodes and sources, up to {limit:.0e}: sub-blocks as small as this cost little "
            f"and follow a motion that changes within a few cells"
        )
    return f"{pairs:.1e} pairs of nodes and sources: smaller sub-blocks would take longer, and this {usual}"


class PreparedTFI:
    """The sub-blocks of one undeformed grid, filled group by group.

    Arc coordinates exist only while their group is filled: recomputing them takes less time than the blending, and for
    all nodes they would take as much memory as the grid.
    """

    def __init__(self, options: TFI, problem: Problem, skeleton: Skeleton):
        self.problem, self._skeleton = problem, skeleton
        self._points, self._subs = problem.grid.nodes.rows, skeleton.sub_blocks()
        self.account = Account()
        cells = options.cells(problem)
        setting = dataclasses.replace(options.used("max_cells")["max_cells"], value=cells)
        if options.max_cells == "auto":
            setting = dataclasses.replace(setting, reason=_reason(problem, setting.reason.removeprefix("default: ")))
        self.account.settings["max_cells"] = setting
        self.account.settings["sub_blocks"] = Setting(len(self._subs))
        # Rows of the nodes that this rank holds.
        self.rows = problem.grid.nodes.ends
        self._straight = cells == 0
        self._choose(inside=True)

    def _choose(self, inside: bool) -> None:
        """Keep the sub-blocks with nodes of this rank ``inside`` them or anywhere, if the grid is in parts."""
        nodes = self.problem.grid.nodes
        if nodes.divided:
            self._subs, self.rows = _subs_within(self._subs, *nodes.ends, inside)
            nodes.widen(*self.rows)
        self._groups = batches(box_numbers(self._subs), _TOGETHER)
        # The bent sub-blocks of each group, once it has been examined.
        self._bent: dict[int, Bent] = {}

    @cached_property
    def _touching(self) -> PreparedTFI:
        """The same for all sub-blocks with nodes of this rank, on their faces, too; all ranks must call this."""
        if not self.problem.grid.nodes.divided:
            return self
        found = copy.copy(self)
        found._subs = self._skeleton.sub_blocks()
        found._choose(inside=False)
        return found

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Fill the interior of every sub-block from its faces, in place in ``displacement`` (n_nodes, 3)."""
        Nodes.of(displacement).widen(*self.rows)
        values = Nodes.of(displacement).rows

        def work(number: int) -> None:
            group, curved = self.group(number)
            group.blend(values)
            if curved:
                curved.add(values)

        for_items(work, len(self._groups), of_stage(progress, "tfi"))

    def differentiable(self) -> PreparedTFI:
        """The same, as it is linear to round-off."""
        return self

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`fill`: pass gradients (n_nodes, 3) from inside sub-blocks on to their faces, in place."""
        # A rank passes on the gradients of all sub-blocks with nodes of its own, on their faces, too.
        method = self._touching
        Nodes.of(gradient).widen(*method.rows)
        values = Nodes.of(gradient).rows
        for number in range(len(method._groups)):
            group, curved = method.group(number)
            if curved:
                curved.pull(values)
            group.pull(values)

    def group(self, number: int) -> tuple[Group, CurvedLines | None]:
        """A group of sub-blocks, and the deviations of those grid lines that TFI would not generate."""
        first, last = self._groups[number]
        group = Group.of(self._points, self._subs[first:last])
        if self._straight:
            return group, None
        curved = CurvedLines.of(group, self._bent.get(number))
        self._bent[number] = curved.bent
        return group, curved if len(curved.bent.rows) else None


def _subs_within(subs: IntArray, low: int, high: int, inside: bool) -> tuple[IntArray, tuple[int, int]]:
    """The sub-blocks with nodes ``inside`` them, or any nodes, among the rows low <= n < high, and the rows of all of
    their nodes.

    If the parts of two ranks meet inside a sub-block, both fill it.
    """
    start, plane = subs[:, 0], subs[:, 2] * subs[:, 3]
    thick = inside & (subs[:, 7] > subs[:, 4])
    first, last = start + (subs[:, 4] + thick) * plane, start + (subs[:, 7] + ~thick) * plane
    own = np.flatnonzero((first < high) & (last > low))
    if not own.size:
        return subs[own], (low, high)
    rows = (start + subs[:, 4] * plane)[own].min(), (start + (subs[:, 7] + 1) * plane)[own].max()
    return subs[own], (min(low, int(rows[0])), max(high, int(rows[1])))
