"""Cell measures of a grid, slab by slab."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..numerics.arrays import batches
from ..numerics.cell.measures import CellMeasures, cell_corners, corner_steps, measure_cells
from ..numerics.geometry.vectors import cross, dot
from ..parallel import Nodes, empty, for_chunks

_SLAB_CELLS = 131072
_TOGETHER = 1 << 14
"""Cells measured at a time in double precision, which bounds the memory."""


def measure_block(x: FloatArray, sign: float, plane_normal: FloatArray | None) -> CellMeasures:
    """Measures (ci, cj, ck) of the cells of a block ``x`` (ni, nj, nk, 3) of handedness ``sign``, in 2-D with the
    normal of the plane; ``jacobian`` is the smallest of each cell."""
    shape, side = [max(n - 1, 1) for n in x.shape[:3]], positive_side(x.shape[1] == 1, sign, plane_normal)
    found = CellMeasures(*np.empty((len(CellMeasures._fields), *shape)))
    step = max(1, _TOGETHER // (shape[1] * shape[2]))
    for lo in range(0, shape[0], step):
        measured = measure_cells(cell_corners(x[lo : lo + step + 1]), side)
        for values, part in zip(found, measured, strict=True):
            some = values[lo : lo + step]
            some[...] = (part.min(axis=1) if part.ndim == 2 else part).reshape(some.shape)
    return found


def positive_side(flat_j: Any, sign: Any, plane_normal: FloatArray | None) -> Any:
    """The side, as in :mod:`..numerics.cell.measures`, of cells in blocks of handedness ``sign`` (...); ``flat_j``
    (...): whether j is the axis along which a 2-D block is one node thick."""
    if plane_normal is None:
        return sign
    # Handedness refers to the normal whose largest component is positive. In (i, j) and (j, k) index planes the index
    # order gives the positive normal, in (i, k) the negative one.
    upward = plane_normal * np.sign(plane_normal[int(np.argmax(np.abs(plane_normal)))])
    return np.where(flat_j, -1.0, 1.0)[..., None] * np.asarray(sign)[..., None] * upward


@dataclass(frozen=True)
class Slab:
    """The layers first <= i < last of a block's cells: cells ``start`` to ``stop`` of the grid.

    Cells are numbered block after block, C-ordered within each block.
    """

    block: int
    first: int
    last: int
    start: int
    stop: int

    @property
    def cells(self) -> slice:
        """Its cells in an array with one row per cell."""
        return slice(self.start, self.stop)


def slabs(grid: Grid) -> list[Slab]:
    """All cells of a grid in slabs of about 130,000, which bounds the memory required for their measures."""
    found, start = [], 0
    for block, (ci, cj, ck) in enumerate(grid.cell_shapes):
        step = max(1, _SLAB_CELLS // (cj * ck))
        for first in range(0, ci, step):
            last = min(first + step, ci)
            stop = start + (last - first) * cj * ck
            found.append(Slab(block, first, last, start, stop))
            start = stop
    return found


def for_slabs(grid: Grid, work: Callable[[int, Slab], None], per_slab: Sequence[np.ndarray] = ()) -> None:
    """Call ``work(number, slab)`` for every slab, on several threads; if the grid is in parts, for those of this rank.

    It may fill the slab's cells in arrays from :func:`cells_alike`, and its row in ``per_slab`` (n_slabs, ...), which
    all ranks get.
    """
    parts, ranks = slabs(grid), grid.nodes.ranks
    ends = _first_slabs(grid, parts)
    first, last = ends[[ranks.number, ranks.number + 1]].tolist()

    def one(lo: int, _: int) -> None:
        work(first + lo, parts[first + lo])

    grid.nodes.on_each(lambda: for_chunks(one, last - first, 1))
    counts = np.diff(ends).tolist()
    for array in per_slab:
        array[...] = ranks.collect(array[first:last], counts)


def _first_slabs(grid: Grid, parts: Sequence[Slab]) -> IntArray:
    """First slab (n_ranks + 1,) of every rank: slabs belong to the rank that holds their first plane."""
    blocks, planes = np.array([(slab.block, slab.first) for slab in parts]).T
    shapes = np.array(grid.shapes)
    rows = grid.offsets[blocks] + planes * (shapes[:, 1] * shapes[:, 2])[blocks]
    return np.asarray(np.searchsorted(rows, grid.nodes.bounds))


def cells_alike(grid: Grid, dtype: Any) -> Any:
    """A new array (n_cells,) for :func:`for_slabs`, in parts if the grid is."""
    if not grid.nodes.divided:
        return empty([grid.n_cells], dtype)
    parts = slabs(grid)
    starts = np.array([*(slab.start for slab in parts), grid.n_cells])
    return Nodes.new(grid.nodes.ranks, starts[_first_slabs(grid, parts)], [grid.n_cells], dtype)


def hold_cells(grid: Grid, *arrays: FloatArray) -> None:
    """Hold all corners of the cells of this rank in arrays (n_nodes, 3), if they are in parts."""
    nodes = grid.nodes
    if not nodes.divided:
        return
    parts = slabs(grid)
    first, last = _first_slabs(grid, parts)[[nodes.ranks.number, nodes.ranks.number + 1]]
    low, end = nodes.ends
    if last > first:
        final = parts[last - 1]
        ni, nj, nk = grid.shapes[final.block]
        end = int(grid.offsets[final.block] + min(final.last + 1, ni) * nj * nk)
    for array in dict.fromkeys(arrays):
        Nodes.of(array).widen(low, end)


def places(grid: Grid, cells: IntArray) -> tuple[IntArray, IntArray]:
    """Block (n,) and 0-based i, j, k (n, 3) of cells, by number."""
    block = np.searchsorted(grid.cell_offsets, cells, side="right") - 1
    shapes = np.array(grid.cell_shapes)[block]
    local = cells - grid.cell_offsets[block]
    i, rest = np.divmod(local, shapes[:, 1] * shapes[:, 2])
    j, k = np.divmod(rest, shapes[:, 2])
    return block, np.stack([i, j, k], axis=1)


def corner_nodes(grid: Grid, block: IntArray, ijk: IntArray) -> IntArray:
    """Flat node indices (n, 8), in a 2-D grid (n, 4), of cells, in the order of :mod:`..numerics.cell.measures`."""
    shapes = np.array(grid.shapes)[block]
    first = grid.offsets[block] + (ijk[:, 0] * shapes[:, 1] + ijk[:, 1]) * shapes[:, 2] + ijk[:, 2]
    return np.asarray(first[:, None] + corner_steps(shapes, grid.dimension))


def corners_of(grid: Grid, points: FloatArray, cells: IntArray) -> FloatArray:
    """Corners (n, 8, 3), in a 2-D grid (n, 4, 3), of cells, by number, with coordinates ``points`` (n_nodes, 3)."""
    return np.asarray(Nodes.of(points).at(corner_nodes(grid, *places(grid, cells))))


def block_volumes(grid: Grid, points: FloatArray, sign: IntArray) -> FloatArray:
    """Volumes (n_blocks,) of blocks of trilinear cells with coordinates ``points`` (n_nodes, 3), from their surfaces.

    The flux of a third of the position through a bilinear face with diagonals p and q is its mean corner . p x q / 6.

    Parameters
    ----------
    sign : (n_blocks,) handedness of each
    """
    center = 0.5 * Nodes.of(points).at(np.stack([grid.offsets[:-1], grid.offsets[1:] - 1])).sum(axis=0)
    flux = np.empty(6 * grid.n_blocks)
    # Sides with equal numbers of nodes together.
    shapes = grid.sides.nodes
    order = np.lexsort(shapes.T)
    new = np.append(True, (shapes[order[1:]] != shapes[order[:-1]]).any(axis=1))
    for alike in np.split(order, np.flatnonzero(new)[1:]):
        for lo, hi in batches(grid.sides.nodes[alike].prod(axis=1), _SLAB_CELLS):
            some = alike[lo:hi]
            na, nb = grid.sides.nodes[some[0]]
            nodes = grid.sides.at(some[:, None, None], np.arange(na)[:, None], np.arange(nb))
            # Component by component, as numpy is slow on axes of length 3.
            face = Nodes.of(points).at(nodes) - center[some // 6, None, None]
            face = np.ascontiguousarray(np.moveaxis(face, -1, 0))
            low, high, right, left = face[..., :-1, :-1], face[..., 1:, 1:], face[..., 1:, :-1], face[..., :-1, 1:]
            through = dot(low + high + left + right, cross(high - low, left - right))
            flux[some] = through.reshape(len(some), -1).sum(axis=1)
    # With the other two axes in ascending order, i and k form a right-handed frame, j a left-handed one.
    total: FloatArray = np.zeros(grid.n_blocks)
    for side, outward in enumerate((-1, 1, 1, -1, -1, 1)):
        total = total + outward * flux[side::6]
    return np.asarray(sign * total / 24.0)
