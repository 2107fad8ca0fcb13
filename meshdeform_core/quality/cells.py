"""Cell measures of a grid, before and after, block by block."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..grid import FloatArray, Grid
from ..numerics.cells import measure_hexahedra, measure_quads
from ..numerics.parallel import for_chunks, thread_count


@dataclass(frozen=True)
class CellMeasures:
    """Measures of the cells of one block, arrays of the block's cell shape.

    ``skew`` f_skew; ``scaled`` smallest scaled corner Jacobian; ``jacobian`` smallest corner Jacobian; ``volume``
    (2-D: area); ``bad`` bit mask of the corners with Jacobian <= 0.
    """

    skew: FloatArray
    scaled: FloatArray
    jacobian: FloatArray
    volume: FloatArray
    bad: np.ndarray


def measure_block(x: FloatArray, sign: float, plane_normal: FloatArray | None) -> CellMeasures:
    """Measures of one block ``x`` (ni, nj, nk, 3) of handedness ``sign``; in 2-D with the normal of the plane."""
    ni, nj, nk = (max(n - 1, 1) for n in x.shape[:3])
    skew, scaled, jacobian, volume = (np.empty((ni, nj, nk)) for _ in range(4))
    measures = CellMeasures(skew, scaled, jacobian, volume, np.empty((ni, nj, nk), dtype=np.uint8))
    arrays = list(vars(measures).values())
    if plane_normal is None:
        _measure(measure_hexahedra, x, sign, ni, arrays)
        return measures
    flat = x.shape.index(1)
    # The positive normal of (i, j) and (j, k) index planes follows their order, that of (i, k) is opposite.
    normal = sign * (-1.0 if flat == 1 else 1.0) * _positive(plane_normal)
    plane = np.ascontiguousarray(x.squeeze(axis=flat))
    _measure(measure_quads, plane, normal, plane.shape[0] - 1, [a.squeeze(axis=flat) for a in arrays])
    return measures


def _measure(kernel: Callable[..., None], x: FloatArray, sign: Any, rows: int, arrays: list[np.ndarray]) -> None:
    def work(lo: int, hi: int) -> None:
        kernel(x, sign, lo, hi, *(a[lo:hi] for a in arrays))

    for_chunks(work, rows, -(-rows // (4 * thread_count())))


def _positive(normal: FloatArray) -> FloatArray:
    """The normal with a positive largest component: the side from which handedness is judged."""
    return np.asarray(normal * np.sign(normal[int(np.argmax(np.abs(normal)))]))


def measure_grid(
    grid: Grid, points: FloatArray, signs: np.ndarray, normal: FloatArray | None
) -> Iterator[CellMeasures]:
    """Measures of every block of ``grid`` with other coordinates ``points`` (n_nodes, 3), one block at a time."""
    for block in range(grid.n_blocks):
        yield measure_block(grid.block(block, points), float(signs[block]), normal)
