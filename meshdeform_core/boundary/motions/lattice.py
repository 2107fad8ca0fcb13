"""Free-form deformation: a box whose control points are moved carries along the nodes inside it.

Source: T. W. Sederberg, S. R. Parry, "Free-form deformation of solid geometric models", SIGGRAPH 1986.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from ...errors import MotionError
from ...grid import FloatArray, IntArray
from ...wording import vector
from .expression import Expression
from .motion import PreparedStep, Step, at_time

_ROWS_AT_ONCE = 20_000


@dataclass(frozen=True)
class ControlMove:
    """A displacement of some control points: three formulas of t and constants, in the unit of the grid.

    ``points`` (m, 3) are indices from 0.
    """

    points: IntArray
    vector: tuple[Expression, Expression, Expression]


@dataclass(frozen=True)
class Lattice(Step, PreparedStep):
    """A box of control points: products of Bernstein polynomials along its three edges.

    Nodes on and inside the box move, others do not. The box refers to positions after the motion's preceding steps.

    Attributes
    ----------
    origin : a corner (3,); edges : (3, 3), a row for each of the three edges from there
    counts : control points along each edge, at least 2
    """

    origin: FloatArray
    edges: FloatArray
    counts: tuple[int, int, int]
    moves: tuple[ControlMove, ...]

    @property
    def names(self) -> frozenset[str]:
        return frozenset().union(*(part.names for move in self.moves for part in move.vector))

    @cached_property
    def _to_box(self) -> FloatArray:
        return np.asarray(np.linalg.inv(self.edges))

    def require(self, time: float, constants: Mapping[str, float]) -> None:
        self._controls(time, constants)

    def _controls(self, time: float, constants: Mapping[str, float]) -> FloatArray:
        """Displacements (counts, 3) of the control points."""
        found = np.zeros((*self.counts, 3))
        for move in self.moves:
            i, j, k = move.points.T
            found[i, j, k] += [at_time(part, time, constants, "displacement of control points") for part in move.vector]
        return found

    def increment(self, current: FloatArray, values: Mapping[str, Any], fraction: float) -> FloatArray:
        place = (current - self.origin) @ self._to_box
        inside = np.flatnonzero(((place >= 0) & (place <= 1)).all(axis=1))
        if inside.size == 0:
            low, high = current.min(axis=0), current.max(axis=0)
            raise MotionError(
                f"no node of the boundary is in the box at {vector(self.origin)} with edges "
                f"{', '.join(map(vector, self.edges))}; the nodes extend from {vector(low)} to {vector(high)}"
            )
        control = self._controls(float(values["t"]), values)
        displacement = np.zeros_like(current)
        for begin in range(0, len(inside), _ROWS_AT_ONCE):
            rows = inside[begin : begin + _ROWS_AT_ONCE]
            a, b, c = (bernstein(count - 1, place[rows, axis]) for axis, count in enumerate(self.counts))
            displacement[rows] = np.einsum("ni,nj,nk,ijkd->nd", a, b, c, control, optimize=True)
        return fraction * displacement


def bernstein(degree: int, place: FloatArray) -> FloatArray:
    """All Bernstein polynomials of a degree at positions (n,) between 0 and 1: (n, degree + 1)."""
    power = np.arange(degree + 1)
    x = place[:, None]
    return np.asarray(scipy.special.comb(degree, power) * x**power * (1.0 - x) ** (degree - power))
