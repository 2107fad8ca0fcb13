"""Derivative of a composite, from those of its two steps and of the constraints between them."""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from ...grid import FloatArray
from ...parallel import alike, for_rows, require_whole, rows_of
from ..base import Mover, PreparedMethod, Problem
from ..composite import PreparedComposite, PreparedFiller, _on_faces, _Scattered
from ..periodic_steps import PreparedPeriodic
from ..scattered.block_rbf import PreparedBlockRBF
from ..scattered.idw import PreparedIDW
from ..scattered.rbf import PreparedRBF
from ..transfinite.edge_graph import PreparedEdgeGraph
from ..transfinite.tfi import PreparedTFI
from .constraints import Constraints, add_to_faces
from .greedy import GreedyDerivative
from .kinks import UNCHOSEN, Kinks
from .radial import BlockRBFDerivative, RBFDerivative
from .transfinite import EdgeGraphDerivative, TFIDerivative
from .weighting import IDWDerivative


class Derivative(Protocol):
    """Derivative of the displacement (n_nodes, 3) of all block nodes with respect to that (n_sources, 3) of the
    sources; ``kinks``: why it is not that of the displacement field, see :mod:`.kinks`.
    """

    kinks: Kinks

    def push(self, change: FloatArray) -> FloatArray:
        """Change (n_nodes, 3) for a ``change`` (n_sources, 3) of the sources."""
        ...

    def pull(self, gradient: FloatArray) -> FloatArray:
        """Gradient (n_sources, 3) from that (n_nodes, 3) of all block nodes, which is overwritten."""
        ...


def derivative_of_composite(method: PreparedMethod, displacement: FloatArray) -> Derivative:
    """The derivative of a prepared composite at one displacement (n_sources, 3); see :func:`.derivative_of`."""
    if isinstance(method, PreparedPeriodic):
        return _Periodic(method, displacement)
    assert isinstance(method, PreparedComposite)
    return _Composite(method, displacement)


class _Composite:
    def __init__(self, method: PreparedComposite, displacement: FloatArray) -> None:
        problem = method._problem
        self._problem, self._left_out = problem, method._left_out
        self._mover = _first_step(method._mover, problem, displacement)
        self._filler = _filling(method._filler, problem) if method._filler else None
        out = _blank(problem)
        face = method._mover.move(displacement, out)
        self._first = Constraints(problem, face.copy())
        self.kinks = self._mover.kinks + self._first.kinks
        if self._left_out and self._filler:
            method._constrain(face, out)
            self._filler.push(out)
            self._second = Constraints(problem, _on_faces(out, problem))
            self.kinks += self._second.kinks

    def push(self, change: FloatArray) -> FloatArray:
        problem = self._problem
        out = _blank(problem) if self._left_out else alike(problem.grid.points)
        face = self._mover.push(change, out)
        self._first.impose(face, out)
        if self._filler:
            self._filler.push(out)
            if self._left_out:
                self._second.impose(_on_faces(out, problem), out)
        return out

    def pull(self, gradient: FloatArray) -> FloatArray:
        if self._filler:
            if self._left_out:
                face = self._second.gathered(gradient)
                add_to_faces(face, self._problem.topology, gradient)
            self._filler.pull(gradient)
        return self._mover.pull(self._first.gathered(gradient), gradient)


class _Periodic:
    """Derivative of a method that moves periodic nodes first, and all others with these as additional sources."""

    def __init__(self, method: PreparedPeriodic, displacement: FloatArray) -> None:
        problem = method._problem
        self._problem, self._sources = problem, method._guided.source_numbers
        self._mover = _first_step(method._first, problem, displacement)
        face = method._on_faces(displacement, None)
        self._constraints = Constraints(problem, face.copy())
        topology, boundary = problem.topology, problem.boundary
        boundary.slip.constrain(face, problem.grid.points, topology.first)
        boundary.periodic.constrain(face, ~boundary.known)
        self._rest = derivative_of_composite(method._rest, face[self._sources])
        self.kinks = self._mover.kinks + self._constraints.kinks + self._rest.kinks

    def push(self, change: FloatArray) -> FloatArray:
        face = self._mover.push(change, alike(self._problem.grid.points))
        self._constraints.push(face)
        return self._rest.push(face[self._sources])

    def pull(self, gradient: FloatArray) -> FloatArray:
        face = np.zeros((self._problem.topology.n_unique, 3))
        face[self._sources] = self._rest.pull(gradient)
        self._constraints.pull(face)
        for_rows(lambda rows: gradient[rows].fill(0.0), gradient)
        return self._mover.pull(face, gradient)


def _blank(problem: Problem) -> FloatArray:
    """An array (n_nodes, 3) in which nodes that no step has reached are no numbers."""
    out = alike(problem.grid.points)
    for_rows(lambda rows: out[rows].fill(np.nan), out)
    return out


class _FirstStep(Protocol):
    kinks: Kinks

    def push(self, change: FloatArray, out: FloatArray) -> FloatArray: ...

    def pull(self, face: FloatArray, g: FloatArray) -> FloatArray: ...


class _Filling(Protocol):
    def push(self, change: FloatArray) -> None: ...

    def pull(self, gradient: FloatArray) -> None: ...


def _first_step(mover: Mover, problem: Problem, displacement: FloatArray) -> _FirstStep:
    if isinstance(mover, PreparedEdgeGraph):
        return _Edges(mover)
    assert isinstance(mover, _Scattered)
    return _Interpolated(mover, problem, displacement)


def _filling(filler: PreparedFiller, problem: Problem) -> _Filling:
    if isinstance(filler, PreparedBlockRBF):
        require_whole(problem.grid.points, "a derivative with radial basis functions inside blocks")
        return BlockRBFDerivative(filler, problem)
    assert isinstance(filler, PreparedTFI)
    return TFIDerivative(filler)


class _Edges:
    def __init__(self, mover: PreparedEdgeGraph) -> None:
        self._derivative, self.kinks = EdgeGraphDerivative(mover), Kinks()

    def push(self, change: FloatArray, out: FloatArray) -> FloatArray:
        return self._derivative.push(change, out)

    def pull(self, face: FloatArray, g: FloatArray) -> FloatArray:
        return self._derivative.pull(face)


class _Interpolated:
    """Derivative of an interpolation as the first step; sources on faces take the change prescribed for them."""

    def __init__(self, mover: _Scattered, problem: Problem, displacement: FloatArray) -> None:
        self._problem, self._beside_slip = problem, mover.beside_slip
        self._derivative = _interpolated(mover, problem, displacement)
        self.kinks = self._derivative.kinks

    def push(self, change: FloatArray, out: FloatArray) -> FloatArray:
        self._derivative.push(change, out)
        self._beside_slip.damp(rows_of(out))
        face = _on_faces(out, self._problem)
        face[self._problem.source_numbers] = change
        return face

    def pull(self, face: FloatArray, g: FloatArray) -> FloatArray:
        own = face[self._problem.source_numbers].copy()
        face[self._problem.source_numbers] = 0.0
        add_to_faces(face, self._problem.topology, g)
        del face
        self._beside_slip.damp(rows_of(g))
        return np.asarray(own + self._derivative.pull(g))


def _interpolated(
    mover: Any, problem: Problem, displacement: FloatArray
) -> IDWDerivative | RBFDerivative | GreedyDerivative:
    bound, evaluator = mover._bound, mover._evaluator
    if isinstance(bound, PreparedIDW):
        return IDWDerivative(bound, evaluator, displacement)
    assert isinstance(bound, PreparedRBF)
    if bound.options.greedy == "none":
        return RBFDerivative(bound, problem, evaluator)
    if not displacement.any():
        # Few centres chosen for nothing would be those of no direction.
        return RBFDerivative(bound, problem, evaluator, Kinks({UNCHOSEN: 1}))
    return GreedyDerivative(bound, problem, evaluator, displacement)
