"""Transfinite interpolation: block interiors from block faces, and faces from edges (Sen et al. section 2.1); and the
skeleton that the first step of a hybrid moves: block faces and the faces of virtual sub-blocks.

TFI, as an operator T, reproduces a linear map, such as a rotation, only where it would also generate the grid: T x = x.
Elsewhere, for example around leading edges, the image of the deviation x - T x is missing. With the gradient G of the
displacement of the sub-block, fitted to its corners, T d + G (x - T x) reproduces every linear map
(:class:`CurvedLines`). In grids that TFI generated there are no deviations, and no cost.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from ...grid import BoolArray, FloatArray, Grid, IntArray, Side
from ...numerics.arrays import batches, portions, spans
from ...numerics.pieces import even_cuts
from ...numerics.transfinite.arcs import (
    TILE,
    apart,
    arc_coordinates,
    arc_numbers,
    arc_parts,
    box_nodes,
    box_numbers,
    inner_numbers,
)
from ...numerics.transfinite.blend import blend_slabs
from ...numerics.transfinite.faces import blend_faces, face_coordinates
from ...parallel import Nodes, for_chunks
from ..base import Account, Problem, Progress, Setting, of_stage
from ..options import MethodOptions, option

Cuts = tuple[IntArray, IntArray, IntArray]


@dataclass(frozen=True)
class Skeleton:
    """The index planes at which blocks are cut: ``cuts`` are for every block the node indices of the planes along i, j,
    k, including both ends. Of sides ``left_out``, which the second step moves itself, only the edges belong to it."""

    grid: Grid
    cuts: tuple[Cuts, ...]
    left_out: frozenset[tuple[int, Side]] = frozenset()

    def sub_blocks(self) -> IntArray:
        """All sub-blocks (n, 11) of all blocks, see :mod:`...numerics.transfinite.arcs`; the last column is not set."""
        counts = np.array([[max(len(cut) - 1, 1) for cut in cuts] for cuts in self.cuts])
        block, place = spans(counts.prod(axis=1))
        # The single plane of a 2-D block is both ends of a sub-block.
        number = np.stack([place // counts[block, 1:].prod(axis=1), place // counts[block, 2], place]) % counts[block].T
        ends = np.empty((2, len(block), 3), dtype=np.int64)
        for axis, along in enumerate(zip(*self.cuts, strict=True)):
            sizes = np.array([len(cut) for cut in along])
            first = (np.cumsum(sizes) - sizes)[block]
            last = first + sizes[block] - 1
            for end in range(2):
                ends[end, :, axis] = np.concatenate(along)[np.minimum(first + number[axis] + end, last)]
        unset = np.zeros(len(block), dtype=np.int64)
        shapes = np.array(self.grid.shapes, dtype=np.int64)[block]
        return np.column_stack([self.grid.offsets[block], shapes, *ends, unset])

    def nodes(self) -> IntArray:
        """Flat indices, ascending, of all nodes that the first step moves, including coincident ones; if the grid is in
        parts, those of this rank."""
        found = list[IntArray]()
        for block, shape in enumerate(self.grid.shapes):
            own, on = self.grid.planes(block), [np.zeros(n, dtype=bool) for n in shape]
            for axis, cut in enumerate(self.cuts[block]):
                # The single plane of a 2-D block is not a cut: it contains the interior.
                on[axis][cut if shape[axis] > 1 else []] = True
            on[0] = on[0][own]
            mask = on[0][:, None, None] | on[1][:, None] | on[2]
            for side in (side for side in Side if (block, side) in self.left_out):
                a, b = side.tangential
                layer = side.layer(shape) - (own.start if side.axis == 0 else 0)
                if 0 <= layer < mask.shape[side.axis]:
                    plane: list[slice | int] = [slice(None)] * 3
                    plane[side.axis] = layer
                    mask[tuple(plane)] = on[a][:, None] | on[b]
            start = self.grid.offsets[block] + own.start * shape[1] * shape[2]
            found.append(np.asarray(start + np.flatnonzero(mask), dtype=np.int64))
        return np.concatenate(found)


_TURNING = np.deg2rad(50.0)
"""Directions whose grid lines turn by more than this within a sub-block are cut twice as often, as TFI does not move
such lines rigidly."""
_LINES = 12
"""Number of grid lines per direction that are sampled for their turning angle."""


def make_skeleton(problem: Problem, max_cells: int) -> Skeleton:
    """Cut every block into sub-blocks of at most ``max_cells`` cells per direction; 0 cuts nothing.

    A direction with more than ``max_cells / 2`` cells is cut at least once; one whose grid lines turn by more than 50
    degrees within ``max_cells`` cells is cut every ``max_cells / 2`` cells.
    """
    grid = problem.grid

    def along(block: int, axis: int) -> IntArray:
        nodes, most = grid.shapes[block][axis], max_cells
        # Coarse blocks turn around a body as much as fine ones do, so only the number of cells decides whether a block
        # remains uncut.
        long = max_cells > 0 and 2 * (nodes - 1) > max_cells
        if long and max_cells > 1 and _turning(grid, block, axis, max_cells) > _TURNING:
            most = -(-max_cells // 2)
        return even_cuts(nodes, most, 2 if long else 1)

    return Skeleton(grid, tuple((along(b, 0), along(b, 1), along(b, 2)) for b in range(grid.n_blocks)))


def _turning(grid: Grid, block: int, axis: int, cells: int) -> float:
    """Largest angle (radians) by which any of the sampled grid lines along ``axis`` turns within ``cells`` cells."""
    shape = grid.shapes[block]
    chosen = [np.unique(np.linspace(0, n - 1, min(n, _LINES)).astype(int)) for n in shape]
    chosen[axis] = np.arange(shape[axis])
    flat = grid.offsets[block] + np.ravel_multi_index(np.ix_(*chosen), shape)
    some = np.moveaxis(grid.points[flat], axis, 0)
    edge = np.diff(some, axis=0)
    cosine = (edge[1:] * edge[:-1]).sum(axis=-1)
    sine = np.linalg.norm(np.cross(edge[1:], edge[:-1]), axis=-1)
    # An edge of zero length has no direction: sine and cosine are zero, and so is the angle.
    total = np.concatenate([np.zeros((1, *some.shape[1:3])), np.cumsum(np.arctan2(sine, cosine), axis=0)])
    window = min(cells, len(total)) - 1
    return float((total[window:] - total[: len(total) - window]).max(initial=0.0))


FEW_PAIRS = (5e7, 4), (2e8, 8), (np.inf, 16)
"""Automatic ``max_cells``: largest number of pairs of nodes and sources, and cells per direction up to that number.

Sums over 5e7 pairs take less than a tenth of a second. Small grids are coarse, and a motion may change within a few of
their cells; smaller sub-blocks follow it better.
"""
# Nodes in a group of sub-blocks, whose coordinates stay in the cache until they are used; of grids that keep them all.
_TOGETHER, _KEEPING = 1 << 17, 1 << 19


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


# Planes and nodes per chunk, and chunks per group: enough chunks to balance the load at negligible cost.
_PLANES, _NODES, _CHUNKS = (8, 32), 65536, 64
# Deviations below this fraction of the size of a sub-block are round-off.
_ROUND_OFF = 1e-8
_THINNEST = 1e-7
"""In sub-blocks thinner than this fraction of their length, the gradient across them is not determined."""


class Faces:
    """Rectangles and lines of nodes with their arc coordinates: ``start`` (n + 1,) is the index at which each begins in
    ``nodes``, C-ordered node numbers, ``width`` (n,) that of nodes along its second index, 1 for a line, and ``wanted``
    tells which interior nodes are to be moved."""

    def __init__(self, points: FloatArray, start: IntArray, width: IntArray, nodes: IntArray, wanted: BoolArray):
        s, t = np.empty(len(nodes)), np.empty(len(nodes))
        face_coordinates(points, start, width, nodes, s, t)
        self._arrays = start, width, nodes, wanted, s, t

    def blend(self, displacement: FloatArray) -> None:
        """Compute the displacement inside the rectangles from that of their edges, in place, one by one."""
        blend_faces(displacement, *self._arrays, False)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend`: pass gradients on from inside the rectangles to their edges, in place."""
        blend_faces(gradient, *self._arrays, True)


@dataclass(frozen=True, eq=False)
class Group:
    """Neighbouring sub-blocks ``subs`` (n, 11) among ``points`` (n_nodes, 3) and the coordinates ``arc`` of the nodes
    inside them, see :mod:`...numerics.transfinite.arcs`; in 2-D, sub-blocks are ``faces``."""

    points: FloatArray
    subs: IntArray
    arc: FloatArray
    faces: Faces | None = None

    @classmethod
    def of(cls, points: FloatArray, rows: IntArray) -> Group:
        """The sub-blocks ``rows`` (n, 11), whose last column is not used, of a grid with these coordinates."""
        subs = rows.copy()
        if (subs[:1, 1:4] == 1).any():
            return cls(points, subs, np.empty(0), _faces(points, subs))
        numbers = arc_numbers(subs)
        subs[:, 10] = np.cumsum(numbers) - numbers
        # Vectors extend beyond the last coordinates.
        arc, parts = np.empty(int(numbers.sum()) + TILE), arc_parts(subs)

        def work(lo: int, hi: int) -> None:
            arc_coordinates(points, subs, parts[lo:hi], arc)

        for_chunks(work, len(parts), 1 + len(parts) // _CHUNKS)
        return cls(points, subs, arc)

    def apart(self, rows: IntArray) -> Group:
        """Some of the sub-blocks, copied to separate arrays."""
        copies, table = apart(self.points, self.subs[rows])
        return Group(copies, table, self.arc, self.faces and _faces(copies, table))

    def blend(self, values: FloatArray, slabs: IntArray | None = None) -> None:
        """Compute ``values`` (n_nodes, 3) inside the sub-blocks from those on their faces, in place.

        ``slabs`` (m, 3): only these planes, given as row of ``subs``, first plane, end; ignored in 2-D grids.
        """
        if self.faces:
            self.faces.blend(values)
            return
        chosen = self.slabs if slabs is None else slabs

        def work(lo: int, hi: int) -> None:
            blend_slabs(values, self.arc, self.subs, chosen[lo:hi])

        for_chunks(work, len(chosen), 1 + len(chosen) // _CHUNKS)

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`blend` of all planes: pass gradients (n_nodes, 3) from inside the sub-blocks on to their
        faces, in place."""
        if self.faces:
            self.faces.pull(gradient)
        else:
            from ...numerics.transfinite.transposed import blend_transposed

            blend_transposed(gradient, self.arc, self.subs)

    @property
    def slabs(self) -> IntArray:
        """All interior planes, a few per row, so that threads can share the work."""
        low, high = self.subs[:, 4:7], self.subs[:, 7:10]
        planes = np.clip(_NODES // np.prod(high[:, 1:] - low[:, 1:], axis=1), *_PLANES)
        found = portions(np.maximum(high[:, 0] - low[:, 0] - 1, 0), planes)
        return np.asarray(found + low[found[:, 0], :1] * [0, 1, 1] + [0, 1, 1])


def _faces(points: FloatArray, subs: IntArray) -> Faces:
    """Sub-blocks of a 2-D grid as rectangles."""
    shapes = subs[:, 7:10] - subs[:, 4:7] + 1
    width = np.where(subs[:, 3] > 1, shapes[:, 2], shapes[:, 1])
    start, nodes = np.append(0, np.cumsum(box_numbers(subs))), box_nodes(subs)
    return Faces(points, start, width, nodes, np.ones(len(nodes), dtype=bool))


class CurvedLines:
    """Deviations of the nodes inside the sub-blocks of a group from where TFI would place them.

    ``bent``: rows (m,) in the group of the sub-blocks with deviations, and matrices (m, 3, 8) that map values at their
    corners to the least-squares gradient; sought unless it is given, as it is the same for all displacements.
    """

    def __init__(self, group: Group, bent: tuple[IntArray, FloatArray] | None = None) -> None:
        ends = np.stack([group.subs[:, 4:7], group.subs[:, 7:10]], axis=1)
        i, j, k = (ends[:, n, axis] for axis, n in enumerate(np.indices((2, 2, 2)).reshape(3, 8)))
        shape = group.subs[:, 1:4, None]
        corners = group.subs[:, :1] + (i * shape[:, 1] + j) * shape[:, 2] + k
        if bent is None:
            rows = np.flatnonzero(inner_numbers(group.subs))
            arms = group.points[corners] - group.points[corners].mean(axis=1, keepdims=True)
            size = np.abs(arms).max(axis=(1, 2))
            # One plane of each sub-block excludes most of those without deviations; measuring all planes costs twice
            # that.
            for one_plane in (True, False):
                sub, deviation = _measured(group, rows, one_plane)
                # Of each sub-block, all of which have nodes inside.
                start = np.flatnonzero(np.diff(sub, prepend=-1))
                largest = np.maximum.reduceat(np.abs(deviation).max(axis=1), start) if len(start) else np.empty(0)
                rows = rows[largest > _ROUND_OFF * size[rows]]
            bent = rows, np.asarray(np.linalg.pinv(arms[rows], rcond=_THINNEST), dtype=np.float64)
        self.bent = bent
        rows, self._inverse = bent
        self._corners, self._nodes = corners[rows], box_nodes(group.subs[rows], inside=True)
        # Row of ``bent`` to which each node inside belongs, and its deviation (n, 3).
        self._sub, self._deviation = _measured(group, rows)

    def add(self, displacement: FloatArray) -> None:
        """Add the missing linear part to the displacement (n_nodes, 3) of inner nodes, in place."""
        gradient = self._inverse @ displacement[self._corners]
        displacement[self._nodes] += np.einsum("na,nac->nc", self._deviation, gradient[self._sub])

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`add`: add to the gradients (n_nodes, 3) of the corners, in place."""
        given, found = gradient[self._nodes], np.empty((len(self._inverse), 3, 3))
        for a, c in np.ndindex(3, 3):
            found[:, a, c] = np.bincount(self._sub, self._deviation[:, a] * given[:, c], len(found))
        np.add.at(gradient, self._corners, np.einsum("nac,nak->nkc", found, self._inverse))


def _measured(group: Group, rows: IntArray, one_plane: bool = False) -> tuple[IntArray, FloatArray]:
    """Deviations of the nodes inside some sub-blocks, or in one plane of each, from where TFI would place them: the
    position of their sub-block in ``rows`` (n,), and the deviations (n, 3)."""
    part = group.apart(rows)
    blended, subs = part.points.copy(), part.subs
    if one_plane:
        # At a third, not the middle, where S-shaped lines have no deviation.
        low, high = subs[:, 4], subs[:, 7]
        plane, subs = low + np.maximum((high - low) // 3, 1), subs.copy()
        subs[:, 4], subs[:, 7] = np.where(high > low, [plane - 1, plane + 1], [low, high])
    part.blend(blended, np.column_stack([np.arange(len(rows)), subs[:, 4] + 1, subs[:, 7]]) if one_plane else None)
    nodes = box_nodes(subs, inside=True)
    return np.repeat(np.arange(len(rows)), inner_numbers(subs)), part.points[nodes] - blended[nodes]


class PreparedTFI:
    """The sub-blocks of one undeformed grid, filled group by group.

    Arc coordinates of large grids exist only while their group is filled: recomputing them takes less time than the
    blending, and for all nodes they would take as much memory as the grid.
    """

    def __init__(self, options: TFI, problem: Problem, skeleton: Skeleton):
        self.problem, self._skeleton = problem, skeleton
        self._points, self._subs = problem.grid.nodes.rows, skeleton.sub_blocks()
        self.account = Account()
        cells = options.cells(problem)
        reason = options.used("max_cells")["max_cells"].reason
        if options.max_cells == "auto":
            cheap = "sub-blocks as small as this cost little and follow a motion that changes within a few cells"
            usual = f"smaller sub-blocks would take longer, and this {reason.removeprefix('default: ')}"
            reason = f"{_pairs(problem):.1e} pairs of nodes and sources: {cheap if cells < FEW_PAIRS[-1][1] else usual}"
        self.account.settings["max_cells"] = Setting(cells, reason)
        self.account.settings["sub_blocks"] = Setting(len(self._subs), "follows from max_cells")
        # Rows of the nodes that this rank holds.
        self.rows = problem.grid.nodes.ends
        self._straight = cells == 0
        self._choose(inside=True)

    def _choose(self, inside: bool) -> None:
        """Keep the sub-blocks with nodes of this rank ``inside`` them or anywhere, if the grid is in parts."""
        nodes = self.problem.grid.nodes
        if nodes.divided:
            # If the parts of two ranks meet inside a sub-block, both fill it.
            (low, high), subs = nodes.ends, self._subs
            start, plane = subs[:, 0], subs[:, 2] * subs[:, 3]
            thick = inside & (subs[:, 7] > subs[:, 4])
            first, last = start + (subs[:, 4] + thick) * plane, start + (subs[:, 7] + ~thick) * plane
            own = np.flatnonzero((first < high) & (last > low))
            # The rows of all nodes of the sub-blocks.
            low = int((start + subs[:, 4] * plane)[own].min(initial=low))
            high = int((start + (subs[:, 7] + 1) * plane)[own].max(initial=high))
            self._subs, self.rows = subs[own], (low, high)
            nodes.widen(low, high)
        self._groups = batches(box_numbers(self._subs), _TOGETHER)
        # The bent sub-blocks of each group that has been examined, and the groups of a small grid.
        self._bent, self._kept = dict[int, tuple[IntArray, FloatArray]](), dict[int, Group]()

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

        def work(number: int, _: int) -> None:
            group, curved = self.group(number)
            group.blend(values)
            if curved:
                curved.add(values)

        for_chunks(work, len(self._groups), 1, of_stage(progress, "tfi"), threads=1)

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
        group = self._kept.get(number) or Group.of(self._points, self._subs[first:last])
        if self.problem.grid.n_nodes <= _KEEPING:
            self._kept[number] = group
        if self._straight:
            return group, None
        curved = CurvedLines(group, self._bent.get(number))
        self._bent[number] = curved.bent
        return group, curved if len(curved.bent[0]) else None
