"""Derivative of a composite with respect to displacements and to the grid."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ....grid import FloatArray
from ...base import Mover, PreparedMethod, Problem
from ...composite import PreparedComposite, PreparedFiller, _on_faces
from ...periodic_steps import PreparedPeriodic
from ...scattered.block_rbf import PreparedBlockRBF
from ...scattered.idw import PreparedIDW
from ...transfinite.edge_graph import PreparedEdgeGraph
from ...transfinite.tfi import PreparedTFI
from ..constraints import Constraints
from ..kinks import Kinks
from .beside_slip import BesideSlipGridDerivative
from .radial import BlockRBFGridDerivative, RBFGridDerivative
from .transfinite import EdgeGraphGridDerivative, TFIGridDerivative
from .weighting import IDWGridDerivative


class GridDerivative(Protocol):
    """Derivative of the displacement (n_nodes, 3) of all block nodes with respect to that (n_sources, 3) of the sources
    and to the grid; ``moved`` is the displacement, ``kinks`` as for :class:`..composite.Derivative`."""

    moved: FloatArray
    kinks: Kinks

    def push(self, change: FloatArray, dx: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for changes of the sources (n_sources, 3) and of the grid (n_nodes, 3)."""
        ...

    def pull(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradients (n_sources, 3) of the sources and (n_nodes, 3) of the grid from that (n_nodes, 3) of the result."""
        ...


def grid_derivative_of_composite(method: PreparedMethod, displacement: FloatArray) -> GridDerivative:
    """The derivative of a prepared composite at one displacement (n_sources, 3); see :func:`.grid_derivative_of`."""
    if isinstance(method, PreparedPeriodic):
        return _Periodic(method, displacement)
    assert isinstance(method, PreparedComposite)
    return _Composite(method, displacement)


class _Composite:
    def __init__(self, method: PreparedComposite, displacement: FloatArray) -> None:
        self._problem, mover, filler = method._problem, method._mover, method._filler
        out = np.full((self._problem.grid.n_nodes, 3), np.nan)
        face = mover.move(displacement, out)
        self._first, self._second = Constraints(self._problem, face.copy()), None
        if method._left_out and filler:
            method._constrain(face, out)
            filler.fill(out)
            self._second = Constraints(self._problem, _on_faces(out, self._problem))
        self._mover = _first_step(mover, displacement)
        constraints = (each for each in (self._first, self._second) if each)
        self.kinks = sum((each.kinks for each in constraints), self._mover.kinks)
        self.moved = method.apply(displacement)
        self._filler = _filling(filler, self._problem, self.moved)
        if isinstance(self._filler, BlockRBFGridDerivative):
            self.kinks += self._filler.kinks

    def push(self, change: FloatArray, dx: FloatArray) -> FloatArray:
        out, of_first = np.full((self._problem.grid.n_nodes, 3), np.nan), dx[self._problem.topology.first]
        self._first.impose(self._mover.push(change, dx, out), out, of_first)
        if self._filler:
            self._filler.push(out, dx)
        if self._second:
            self._second.impose(_on_faces(out, self._problem), out, of_first)
        return out

    def pull(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        g, of_grid, first = np.array(gradient), np.zeros_like(gradient), self._problem.topology.first
        of_first = np.zeros((len(first), 3))
        if self._second:
            face = self._second.gathered(g, of_first)
            g[first] += face
        if self._filler:
            self._filler.pull(g, of_grid)
        face = self._first.gathered(g, of_first)
        of_grid[first] += of_first
        return self._mover.pull(face, g, of_grid), of_grid


class _Periodic:
    """Derivative of a method that moves periodic nodes first, and all others with these as additional sources."""

    def __init__(self, method: PreparedPeriodic, displacement: FloatArray) -> None:
        problem = method._problem
        self._problem, self._sources = problem, method._guided.source_numbers
        self._mover = _first_step(method._first, displacement)
        face = method._on_faces(displacement, None)
        self._constraints = Constraints(problem, face.copy())
        boundary = problem.boundary
        boundary.slip.constrain(face, problem.grid.points, problem.topology.first)
        boundary.periodic.constrain(face, ~boundary.known)
        assert isinstance(method._rest, PreparedComposite)
        self._rest = _Composite(method._rest, face[self._sources])
        self.moved = self._rest.moved
        self.kinks = self._mover.kinks + self._constraints.kinks + self._rest.kinks

    def push(self, change: FloatArray, dx: FloatArray) -> FloatArray:
        face = self._mover.push(change, dx, np.zeros_like(dx))
        self._constraints.push(face, dx[self._problem.topology.first])
        return self._rest.push(face[self._sources], dx)

    def pull(self, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        first = self._problem.topology.first
        face, of_first = np.zeros((len(first), 3)), np.zeros((len(first), 3))
        face[self._sources], of_grid = self._rest.pull(gradient)
        self._constraints.pull(face, of_first)
        of_grid[first] += of_first
        return self._mover.pull(face, np.zeros_like(gradient), of_grid), of_grid


def _filling(
    filler: PreparedFiller | None, problem: Problem, moved: FloatArray
) -> TFIGridDerivative | BlockRBFGridDerivative | None:
    if isinstance(filler, PreparedBlockRBF):
        return BlockRBFGridDerivative(filler, problem, moved)
    assert filler is None or isinstance(filler, PreparedTFI)
    return TFIGridDerivative(filler, moved) if filler else None


def _first_step(mover: Mover, displacement: FloatArray) -> EdgeGraphGridDerivative | _Interpolated:
    if isinstance(mover, PreparedEdgeGraph):
        return EdgeGraphGridDerivative(mover, displacement)
    return _Interpolated(mover, displacement)


class _Interpolated:
    """Derivative of an interpolation as the first step; sources on faces take the change prescribed for them."""

    def __init__(self, mover: Any, displacement: FloatArray) -> None:
        self._problem = mover.problem
        self._derivative: IDWGridDerivative | RBFGridDerivative
        if isinstance(mover._bound, PreparedIDW):
            self._derivative = IDWGridDerivative(mover._bound, mover._evaluator.bound, displacement)
        else:
            self._derivative = RBFGridDerivative(mover._bound, self._problem, mover.flat, displacement)
        self.kinks = self._derivative.kinks + self._derivative.of_grid
        self._beside_slip = BesideSlipGridDerivative(mover, displacement)

    def push(self, change: FloatArray, dx: FloatArray, out: FloatArray) -> FloatArray:
        self._derivative.push(change, dx, out)
        self._beside_slip.push(out, dx)
        face = _on_faces(out, self._problem)
        face[self._problem.source_numbers] = change
        return face

    def pull(self, face: FloatArray, g: FloatArray, of_grid: FloatArray) -> FloatArray:
        own = face[self._problem.source_numbers].copy()
        face[self._problem.source_numbers] = 0.0
        g[self._problem.topology.first] += face
        self._beside_slip.pull(g, of_grid)
        return np.asarray(own + self._derivative.pull(g, of_grid))
