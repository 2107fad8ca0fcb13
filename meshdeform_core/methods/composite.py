"""The composite of two methods: one moves block interfaces, the other block interiors (Sen et al. section 4).

Every method of the program is a composite, including those with a single name: ``tfi`` is tfi-tfi, and a scattered-data
method alone moves all nodes in the first step and has no second one.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from ..boundary import Kind
from ..boundary.constraints import Layer
from ..grid import FloatArray, IntArray
from ..memory import release_freed
from ..parallel import Nodes
from .base import Account, Linearised, Mover, PreparedInterpolation, PreparedMethod, Problem, Progress
from .constraints import BesideSlip, Constraints, add_to_faces, impose, put_on_faces
from .transfinite.edge_graph import PreparedEdgeGraph
from .transfinite.tfi import TFI, Skeleton

if TYPE_CHECKING:
    from .scattered.block_rbf import BlockRBF


@dataclass(frozen=True)
class Composite:
    """``mover`` for the interfaces (``None``: TFI on the edge graph), then ``filler`` for the interiors.

    Without a filler the mover moves every node. ``kind`` of the prepared method, if it is not a plain composite.
    """

    mover: Mover | None
    filler: TFI | BlockRBF | None
    kind: Callable[[Composite, Problem], PreparedComposite] | None = None

    def prepare(self, problem: Problem) -> PreparedMethod:
        """Bind both steps to the undeformed grid."""
        # Those that no boundary of higher precedence moves or fixes.
        periodic = problem.boundary.periodic.nodes
        periodic = np.asarray(periodic[~problem.boundary.known[periodic]])
        if periodic.size == 0:
            return (self.kind or PreparedComposite)(self, problem)
        nodes, (low, high) = np.sort(problem.topology.first[periodic]), problem.grid.nodes.ends
        first = _mover(self.mover, problem, nodes[(nodes >= low) & (nodes < high)])
        guided = with_known_periodic(problem, periodic)
        return PreparedPeriodic(problem, first, PreparedComposite(self, guided), guided)


def _mover(mover: Mover | None, problem: Problem, flat: IntArray) -> PreparedEdgeGraph | Scattered:
    """An interpolation for the nodes ``flat``, or TFI on the edge graph, which moves all face nodes."""
    return PreparedEdgeGraph(problem) if mover is None else Scattered(mover.bind(problem, flat), problem, flat)


class Scattered:
    """An interpolation as the first step, which moves the nodes ``flat`` of the skeleton that are not sources.

    Interface as :class:`.transfinite.edge_graph.PreparedEdgeGraph`.
    """

    def __init__(self, bound: PreparedInterpolation, problem: Problem, flat: IntArray) -> None:
        self.problem, self.bound = problem, bound
        self.beside_slip = BesideSlip(problem, flat)
        self.account, self.warnings_for = self.bound.account, self.bound.warnings_for

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_unique, 3) of nodes on block faces from that of the sources (n_sources, 3); that of nodes
        inside blocks is written into ``out`` (n_nodes, 3)."""
        values = self.bound.fit(displacement, progress)
        release_freed()
        self.bound.evaluate(values, out, progress)
        release_freed()
        self.beside_slip.apply(out, progress)
        face = on_faces(out, self.problem)
        face[self.problem.source_numbers] = displacement
        return face

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative at a displacement (n_sources, 3).

        ``push(change, out)`` is as :meth:`move` for a ``change`` of the displacement; ``pull(face, gradient)`` returns
        the gradient (n_sources, 3) from those of the nodes on block faces (n_unique, 3) and, rows of ``gradient``
        (n_nodes, 3), inside blocks, and overwrites both.
        """
        problem, inside = self.problem, self.bound.linearised(displacement)

        def push(change: FloatArray, out: FloatArray) -> FloatArray:
            inside.push(change, out)
            self.beside_slip.damp(out)
            face = on_faces(out, problem)
            face[problem.source_numbers] = change
            return face

        def pull(face: FloatArray, gradient: FloatArray) -> FloatArray:
            # Sources are no targets: their rows of ``gradient`` have no further effect.
            own = face[problem.source_numbers]
            add_to_faces(face, problem.topology, gradient)
            self.beside_slip.damp(gradient)
            return np.asarray(own + inside.pull(gradient))

        return Linearised(push, pull, inside.kinks)


class PreparedComposite(PreparedMethod):
    """Two prepared steps and the constraints between them."""

    def __init__(self, method: Composite, problem: Problem):
        self.problem = problem
        skeleton = method.filler.skeleton(problem) if method.filler else None
        self.mover = _mover(method.mover, problem, first_step_nodes(problem, skeleton))
        self.filler = method.filler.prepare(problem, skeleton) if method.filler and skeleton else None
        self.left_out = skeleton is not None and bool(skeleton.left_out)

    @property
    def account(self) -> Account:
        merged = Account()
        for part in (self.mover, self.filler):
            if part:
                merged.include(part.account)
        return merged

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self.mover.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        # Every row is set: each node lies on a block face, in the skeleton, or inside a block or sub-block; on sides
        # left out, nodes that no step has reached are no numbers.
        out = filled(self.problem, np.nan) if self.left_out else self.problem.grid.nodes.like(3)
        impose(self.problem, self.mover.move(displacement, out, progress), out)
        if self.filler:
            self.filler.fill(out, progress)
            if self.left_out:
                impose(self.problem, on_faces(out, self.problem), out)
        return out

    def linearised(self, displacement: FloatArray) -> Linearised:
        problem, mover = self.problem, self.mover.linearised(displacement)
        filler = self.filler.differentiable() if self.filler else None
        out = filled(problem, np.nan)
        face = self.mover.move(displacement, out)
        first, second = Constraints(problem, face.copy()), None
        if self.left_out and filler:
            # Constraints on the sides that the second step fills.
            impose(problem, face, out)
            filler.fill(out)
            second = Constraints(problem, on_faces(out, problem))
        del out, face

        def push(change: FloatArray) -> FloatArray:
            out = filled(problem, np.nan) if second else problem.grid.nodes.like(3)
            first.impose(mover.push(change, out), out)
            if filler:
                filler.fill(out)
            if second:
                second.impose(on_faces(out, problem), out)
            return out

        def pull(gradient: FloatArray) -> FloatArray:
            if second:
                add_to_faces(second.gathered(gradient), problem.topology, gradient)
            if filler:
                filler.pull(gradient)
            return mover.pull(first.gathered(gradient), gradient)

        # The second ones count the nodes of the first ones, too.
        return Linearised(push, pull, mover.kinks + (second or first).kinks)


def with_known_periodic(problem: Problem, periodic: IntArray) -> Problem:
    """The problem with its free ``periodic`` nodes as sources."""
    boundary = problem.boundary
    kind, quad_kind = boundary.kind.copy(), boundary.quad_kind.copy()
    kind[periodic] = Kind.MOVING
    quad_kind[quad_kind == Kind.PERIODIC] = Kind.MOVING
    # Images on curved surfaces, whose facets may differ, slide before their mean is taken, not after.
    curved = tuple(
        dataclasses.replace(surface, nodes=np.setdiff1d(surface.nodes, periodic)) for surface in boundary.slip.curved
    )
    slip = dataclasses.replace(boundary.slip, curved=curved)
    boundary = dataclasses.replace(boundary, kind=kind, quad_kind=quad_kind, slip=slip)
    return dataclasses.replace(problem, boundary=boundary)


@dataclass(frozen=True)
class PreparedPeriodic(PreparedMethod):
    """A method that moves free periodic nodes before all others, in pairs; then these are sources, too.

    Averaging the pairs afterwards would leave a jump next to the boundary, because the interpolation ignores the
    periodic images of the body.
    """

    problem: Problem
    first: PreparedEdgeGraph | Scattered
    rest: PreparedMethod
    guided: Problem

    @property
    def account(self) -> Account:
        return self.rest.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self.first.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        face = self.first.move(displacement, filled(self.problem, 0.0), progress)
        impose(self.problem, face)
        return self.rest.apply(face[self.guided.source_numbers], progress)

    def linearised(self, displacement: FloatArray) -> Linearised:
        problem, sources = self.problem, self.guided.source_numbers
        mover, face = self.first.linearised(displacement), self.first.move(displacement, filled(problem, 0.0))
        constraints = Constraints(problem, face.copy())
        impose(problem, face)
        rest = self.rest.linearised(face[sources])

        def push(change: FloatArray) -> FloatArray:
            face = mover.push(change, problem.grid.nodes.like(3))
            constraints.push(face)
            return rest.push(face[sources])

        def pull(gradient: FloatArray) -> FloatArray:
            face = np.zeros((problem.topology.n_unique, 3))
            face[sources] = rest.pull(gradient)
            constraints.pull(face)
            Nodes.of(gradient).each(lambda rows: gradient[rows].fill(0.0))
            return mover.pull(face, gradient)

        return Linearised(push, pull, mover.kinks + constraints.kinks + rest.kinks)


class PreparedLayer(PreparedMethod):
    """A method on a grid of one layer of cells between two planes that mirror each other (:class:`.Layer`): prepared on
    one of them; for motions that are no mirror images, on both."""

    def __init__(self, method: Composite, problem: Problem, layer: Layer):
        self._method, self._problem, self._layer = method, problem, layer
        self._half = method.prepare(dataclasses.replace(problem, layer=layer))

    @cached_property
    def whole(self) -> PreparedMethod:
        """The method prepared on both planes, when it is needed for the first time."""
        return self._method.prepare(self._problem)

    @property
    def account(self) -> Account:
        return self._half.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self._half.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        problem = self._problem
        known = np.zeros((problem.topology.n_unique, 3))
        if displacement.shape == (len(problem.source_numbers), 3):
            known[problem.source_numbers] = displacement
        if not self._layer.mirrors(known):
            return self.whole.apply(displacement, progress)
        out = self._half.apply(displacement, progress)
        face = on_faces(out, problem)
        self._layer.follow(face)
        put_on_faces(face, out, problem)
        return out

    def linearised(self, displacement: FloatArray) -> Linearised:
        # On both planes, as changes of single sources are not mirrored.
        return self.whole.linearised(displacement)


def filled(problem: Problem, value: float) -> FloatArray:
    """An array (n_nodes, 3) of equal numbers."""
    out = problem.grid.nodes.like(3)
    Nodes.of(out).each(lambda rows: out[rows].fill(value))
    return out


def on_faces(displacement: FloatArray, problem: Problem) -> FloatArray:
    """The rows (n_unique, 3) of ``displacement`` (n_nodes, 3) at nodes on block faces."""
    return np.asarray(Nodes.of(displacement).at(problem.topology.first))


def first_step_nodes(problem: Problem, skeleton: Skeleton | None) -> IntArray:
    """Flat indices, ascending, of the nodes that the first step moves: sources left out, coincident nodes once.

    If the grid is in parts, only the nodes of this rank.
    """
    topology = problem.topology
    low, high = problem.grid.nodes.ends
    chosen = np.full(high - low, skeleton is None)
    if skeleton is not None:
        chosen[skeleton.nodes() - low] = True
    begin, end = np.searchsorted(topology.face_nodes, [low, high])
    faces = topology.face_nodes[begin:end] - low
    # A node belongs to the skeleton if any coincident node does: all nodes on block faces, except on omitted sides.
    wanted = np.full(topology.n_unique, skeleton is None or not skeleton.left_out)
    if not wanted.all():
        for numbers in problem.grid.nodes.gather(np.unique(topology.number[begin:end][chosen[faces]])):
            wanted[numbers] = True
    wanted[problem.source_numbers] = False
    if problem.layer:
        wanted[problem.layer.followers] = False
    chosen[faces] = False
    first = topology.first[wanted]
    chosen[first[(first >= low) & (first < high)] - low] = True
    return low + np.flatnonzero(chosen)
