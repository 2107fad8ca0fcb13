"""How the automatic support radius of compact basis functions follows the grid."""

from __future__ import annotations

import numpy as np

from ....boundary import Kind
from ....grid import FloatArray, IntArray
from ....numerics.tape import Tape, Tracked, largest
from ...base import Problem
from ...scattered.rbf import RBF, covering_radius
from ..kinks import FARTHEST, Kinks, kinks_of

_WHAT = FARTHEST.replace("{what}", "the support radius")


class Radius:
    """Relative change of a radius whose derivative with respect to the nodes ``flat`` (m,) is ``slope`` (m, 3)."""

    def __init__(self, flat: IntArray, slope: FloatArray, tied: int) -> None:
        self._flat, self._slope = flat, slope
        self.kinks: Kinks = kinks_of([(_WHAT, tied if tied > 1 else 0)])

    def push(self, dx: FloatArray) -> float:
        """Relative change of the radius for a change (n_nodes, 3) of the grid."""
        return float((self._slope * dx[self._flat]).sum())

    def pull(self, gradient: float, of_grid: FloatArray) -> None:
        """Transpose of :meth:`push`: add the gradient of the grid."""
        of_grid[self._flat] += gradient * self._slope


def _given(options: RBF) -> bool:
    return options.basis == "tps" or options.radius != "auto"


def of_sources(options: RBF, problem: Problem) -> Radius | None:
    """The growth of the radius between all sources; ``None`` where the radius does not depend on the grid."""
    if _given(options):
        return None
    rows = problem.source_numbers[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
    first, tape = problem.topology.first, Tape()
    face = tape.variable(problem.grid.points[first])
    found: Tracked = covering_radius(face[rows], face)  # type: ignore[assignment, arg-type]
    (slope,) = tape.pull({found.number: np.array(1.0 / float(found.value))}, [face.number])
    x = face.value
    center = x[rows].mean(axis=0)
    counts = (len(largest(np.linalg.norm(x[some] - center, axis=1))) for some in (rows, slice(None)))
    return Radius(first, slope, max(counts))


def of_block(options: RBF, problem: Problem, known: IntArray) -> Radius | None:
    """The growth of the radius of a block with nodes ``known`` on its faces, the diagonal of their extent."""
    if _given(options):
        return None
    x = problem.grid.points[known]
    size, slope, tied = np.ptp(x, axis=0), np.zeros_like(x), 0
    for axis in range(3):
        for sign, far in ((1.0, x[:, axis] - x[:, axis].min()), (-1.0, x[:, axis].max() - x[:, axis])):
            rows = largest(far)
            slope[rows, axis] += sign * size[axis] / len(rows)
            tied = max(tied, len(rows) if size[axis] > 0.0 else 0)
    return Radius(known, slope / (size @ size), tied)
