"""Derivative of a motion imposed in several steps, each prepared on the grid that the previous one has reached."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from ...grid import FloatArray
from .. import Options, PreparedMethod, prepare_method
from ..base import Problem
from .choice import derivative_of
from .grid.choice import grid_derivative_of
from .grid.composite import GridDerivative


class Correction(Protocol):
    """Derivative of a grid (n_nodes, 3) after its repair with respect to that before it."""

    def push(self, change: FloatArray) -> FloatArray:
        """Change of the repaired grid."""
        ...

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Transpose of :meth:`push`."""
        ...


Mend = Callable[[FloatArray], tuple[FloatArray, Correction | None]]


class StepsDerivative:
    """Derivative of several steps by the chain rule; later steps also depend on the grid that they start from.

    Parameters
    ----------
    first, options, problem : the method prepared on the undeformed grid, its options, and that grid
    displacement : (n_sources, 3) at the end of the motion
    fractions : fraction of the motion at the end of each step
    mend : called in each step with the grid (n_nodes, 3) that the method reaches; returns the repaired one and the
        derivative of the repair, or the same grid and ``None``

    Attributes
    ----------
    points : (n_nodes, 3) the grid reached
    kinks : see :mod:`.kinks`

    Raises
    ------
    MethodError
        Where a method has no derivative with respect to the grid.
    """

    def __init__(
        self,
        first: PreparedMethod,
        options: Options,
        problem: Problem,
        displacement: FloatArray,
        fractions: Sequence[float],
        mend: Mend = lambda plain: (plain, None),
    ) -> None:
        self._parts = np.diff(fractions, prepend=0.0)
        imposed = fractions[0] * displacement
        self._first = derivative_of(first, imposed)
        points, repair = mend(problem.grid.points + first.apply(imposed))
        self._later, self._repairs = list[GridDerivative](), [repair]
        for fraction in fractions[1:]:
            method = prepare_method(options, dataclasses.replace(problem, grid=problem.grid.moved(points)))
            target = fraction * displacement
            self._later.append(grid_derivative_of(method, target - imposed))
            imposed, (points, repair) = target, mend(points + self._later[-1].moved)
            self._repairs.append(repair)
        self.points = points
        self.kinks = sum((step.kinks for step in self._later), self._first.kinks)

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for a ``change`` (n_sources, 3) of the sources."""
        moved = self._first.push(self._parts[0] * change)
        if self._repairs[0]:
            moved = self._repairs[0].push(moved)
        for part, step, repair in zip(self._parts[1:], self._later, self._repairs[1:], strict=True):
            moved += step.push(part * change, moved)
            if repair:
                moved = repair.push(moved)
        return moved

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that (n_nodes, 3) of all block nodes, which is overwritten."""
        found = np.zeros_like(gradient[:1])
        for part, step, repair in zip(self._parts[:0:-1], self._later[::-1], self._repairs[:0:-1], strict=True):
            if repair:
                gradient = repair.pull(gradient)
            own, of_grid = step.pull(gradient)
            found = found + part * own
            gradient += of_grid
        if self._repairs[0]:
            gradient = self._repairs[0].pull(gradient)
        return np.asarray(found + self._parts[0] * self._first.pull(gradient))
