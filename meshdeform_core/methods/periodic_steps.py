"""Periodic boundaries in two steps: first the periodic nodes, in pairs; then all others, with these as sources.

Averaging the pairs afterwards would leave a jump next to the boundary, because the interpolation ignores the periodic
images of the body.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from ..boundary import Kind
from ..grid import FloatArray, IntArray
from ..parallel import alike, for_rows
from .base import Account, Mover, PreparedMethod, Problem, Progress


def free_periodic(problem: Problem) -> IntArray:
    """Unique numbers of the periodic nodes that no boundary of higher precedence moves or fixes."""
    periodic = problem.boundary.periodic
    nodes = np.unique(np.r_[periodic.one, periodic.two])
    return np.asarray(nodes[~problem.boundary.known[nodes]])


def with_known_periodic(problem: Problem) -> Problem:
    """The problem with its free periodic nodes as sources."""
    boundary = problem.boundary
    kind, quad_kind = boundary.kind.copy(), boundary.quad_kind.copy()
    kind[free_periodic(problem)] = Kind.MOVING
    quad_kind[quad_kind == Kind.PERIODIC] = Kind.MOVING
    return dataclasses.replace(problem, boundary=dataclasses.replace(boundary, kind=kind, quad_kind=quad_kind))


class PreparedPeriodic:
    """A method that moves free periodic nodes before all others."""

    def __init__(self, problem: Problem, first: Mover, rest: PreparedMethod, guided: Problem):
        self._problem, self._first, self._rest, self._guided = problem, first, rest, guided

    @property
    def account(self) -> Account:
        """Settings and warnings of the method itself."""
        return self._rest.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self._first.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        problem, face = self._problem, self._on_faces(displacement, progress)
        topology, boundary = problem.topology, problem.boundary
        boundary.slip.constrain(face, problem.grid.points, topology.first)
        boundary.periodic.constrain(face, ~boundary.known)
        return self._rest.apply(face[self._guided.source_numbers], progress)

    def _on_faces(self, displacement: FloatArray, progress: Progress | None) -> FloatArray:
        """Displacement (n_unique, 3) of the periodic nodes; zero at other face nodes that are not sources."""
        out = alike(self._problem.grid.points)
        for_rows(lambda rows: out[rows].fill(0.0), out)
        return self._first.move(displacement, out, progress)
