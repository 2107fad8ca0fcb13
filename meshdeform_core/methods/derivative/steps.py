"""Derivative of a motion imposed in several steps, each prepared on the grid that the previous one has reached."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from ...grid import FloatArray
from ...grid.connectivity.components import assembled
from .. import Options, PreparedMethod, prepare_method
from ..base import Problem
from ..components import PreparedComponents
from .choice import ComponentsDerivative, derivative_of
from .grid.composite import GridDerivative, grid_derivative_of


def derivative_of_steps(
    first: PreparedMethod, options: Options, problem: Problem, displacement: FloatArray, fractions: Sequence[float]
) -> StepsDerivative | ComponentsInSteps:
    """The derivative of a motion in several steps, separately for each component; see :class:`StepsDerivative`."""
    if not isinstance(first, PreparedComponents):
        return StepsDerivative(first, options, problem, displacement, fractions)
    own = [
        StepsDerivative(method, options, part, displacement[rows], fractions) if method else None
        for (_, part), method, rows in first.parts
    ]
    return ComponentsInSteps(first, own)


class StepsDerivative:
    """Derivative of several steps by the chain rule; later steps also depend on the grid that they start from.

    Parameters
    ----------
    first, options, problem : the method prepared on the undeformed grid, its options, and that grid
    displacement : (n_sources, 3) at the end of the motion
    fractions : fraction of the motion at the end of each step

    Attributes
    ----------
    points : (n_nodes, 3) the grid reached, without repairs
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
    ) -> None:
        self._parts = np.diff(fractions, prepend=0.0)
        imposed = fractions[0] * displacement
        self._first, points = derivative_of(first, imposed), problem.grid.points + first.apply(imposed)
        self._later: list[GridDerivative] = []
        for fraction in fractions[1:]:
            method = prepare_method(options, dataclasses.replace(problem, grid=problem.grid.moved(points)))
            target = fraction * displacement
            self._later.append(grid_derivative_of(method, target - imposed))
            imposed, points = target, points + self._later[-1].moved
        self.points = points
        self.kinks = sum((step.kinks for step in self._later), self._first.kinks)

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for a ``change`` (n_sources, 3) of the sources."""
        moved = self._first.push(self._parts[0] * change)
        for part, step in zip(self._parts[1:], self._later, strict=True):
            moved += step.push(part * change, moved)
        return moved

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that (n_nodes, 3) of all block nodes, which is overwritten."""
        found = np.zeros_like(gradient[:1])
        for part, step in zip(self._parts[:0:-1], self._later[::-1], strict=True):
            own, of_grid = step.pull(gradient)
            found = found + part * own
            gradient += of_grid
        return np.asarray(found + self._parts[0] * self._first.pull(gradient))


class ComponentsInSteps(ComponentsDerivative):
    """Derivative of components that take the same steps; ``points`` (n_nodes, 3): the grid reached, without repairs."""

    def __init__(self, method: PreparedComponents, own: Sequence[StepsDerivative | None]) -> None:
        super().__init__(method, own)
        reached = [
            (component, each.points if each else component.grid.points)
            for ((component, _), _, _), each in zip(method.parts, own, strict=True)
        ]
        self.points = assembled(method.problem.grid, reached)
