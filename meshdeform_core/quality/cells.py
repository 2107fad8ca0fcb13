"""Cell measures of a grid, slab by slab."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..grid import FloatArray, Grid, IntArray
from ..grid.planes import plane_normal
from ..grid.topology import Topology
from ..numerics.cell.measures import measure_hexahedra, measure_quads
from ..parallel import Shared, for_chunks

_SLAB_CELLS = 16384


@dataclass(frozen=True)
class CellMeasures:
    """Measures of cells, arrays (ci, cj, ck).

    ``skew`` f_skew; ``scaled`` smallest scaled corner Jacobian; ``jacobian`` smallest corner Jacobian; ``volume``
    (2-D: area); ``bad`` bit mask of the corners with Jacobian <= 0.
    """

    skew: FloatArray
    scaled: FloatArray
    jacobian: FloatArray
    volume: FloatArray
    bad: np.ndarray


def measure_block(
    x: FloatArray, sign: float, plane_normal: FloatArray | None, first: int = 0, last: int | None = None
) -> CellMeasures:
    """Measures of one block ``x`` (ni, nj, nk, 3) of handedness ``sign``; in 2-D with the normal of the plane.

    ``first`` and ``last`` choose the layers first <= i < last of its cells; a block with one node along i has one.
    """
    ni, nj, nk = (max(n - 1, 1) for n in x.shape[:3])
    last = ni if last is None else last
    shape = (last - first, nj, nk)
    skew, scaled, jacobian, volume = (np.empty(shape) for _ in range(4))
    measures = CellMeasures(skew, scaled, jacobian, volume, np.empty(shape, dtype=np.uint8))
    arrays = list(vars(measures).values())
    if plane_normal is None:
        measure_hexahedra(x, sign, first, last, *arrays)
        return measures
    flat = x.shape.index(1)
    normal = side_of_good_quads(flat, sign, plane_normal)
    plane = np.ascontiguousarray(x.squeeze(axis=flat))
    rows = (0, plane.shape[0] - 1) if flat == 0 else (first, last)
    measure_quads(plane, normal, *rows, *(a.squeeze(axis=flat) for a in arrays))
    return measures


def side_of_good_quads(flat: int, sign: float, plane_normal: FloatArray) -> FloatArray:
    """The unit normal to which the good cells of a 2-D block look, one node thick along ``flat``, in index order."""
    # Handedness is judged from the side of a positive largest component. The positive normal of (i, j) and (j, k)
    # index planes follows their order, that of (i, k) is opposite.
    side = plane_normal * np.sign(plane_normal[int(np.argmax(np.abs(plane_normal)))])
    return np.asarray(sign * (-1.0 if flat == 1 else 1.0) * side)


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
    """All cells of a grid in slabs of about 16,000, which bound the memory that the measures take."""
    found, start = [], 0
    for block, (ci, cj, ck) in enumerate(grid.cell_shapes):
        step = max(1, _SLAB_CELLS // (cj * ck))
        for first in range(0, ci, step):
            last = min(first + step, ci)
            stop = start + (last - first) * cj * ck
            found.append(Slab(block, first, last, start, stop))
            start = stop
    return found


def measure_cells(
    grid: Grid,
    topology: Topology,
    points: FloatArray,
    use: Callable[[int, Slab, CellMeasures], None],
    per_cell: Sequence[np.ndarray],
    per_slab: Sequence[np.ndarray] = (),
) -> None:
    """Hand the measures of every slab with coordinates ``points`` (n_nodes, 3) to ``use``.

    Parameters
    ----------
    use : called from several threads with the number of the slab, the slab and its measures; fills its cells of the
        arrays ``per_cell`` (n_cells, ...) and its row of the arrays ``per_slab`` (n_slabs, ...)
    """
    normal = plane_normal(grid)

    def measure(number: int, slab: Slab) -> None:
        x, sign = grid.block(slab.block, points), float(topology.handedness[slab.block])
        use(number, slab, measure_block(x, sign, normal, slab.first, slab.last))

    for_slabs(grid, measure, per_cell, per_slab)


def for_slabs(
    grid: Grid,
    work: Callable[[int, Slab], None],
    per_cell: Sequence[np.ndarray],
    per_slab: Sequence[np.ndarray] = (),
) -> None:
    """Call ``work`` for every slab and its number, from several threads; it fills as in :func:`measure_cells`."""
    parts = slabs(grid)

    def some(lo: int, hi: int) -> None:
        for number, slab in enumerate(parts[lo:hi], lo):
            work(number, slab)

    def cells(lo: int, hi: int) -> IntArray:
        return np.arange(parts[lo].start, parts[hi - 1].stop)

    for_chunks(some, len(parts), 1, shared=[*(Shared(a, cells) for a in per_cell), *map(Shared, per_slab)])
