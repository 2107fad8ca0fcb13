"""The composite of two methods: one moves block interfaces, the other block interiors (Sen et al. section 4).

Every method of the program is a composite, including those with a single name: ``tfi`` is tfi-tfi, and a scattered-data
method alone moves all nodes in the first step and has no second one.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..boundary import Kind
from ..errors import MotionError
from ..grid import FloatArray, IntArray
from ..memory import release_freed
from ..parallel import Nodes
from ..wording import vector
from .base import Account, Interpolation, Mover, PreparedMethod, Problem, Progress
from .beside_slip import BesideSlip
from .constraints import Constraints, add_to_faces, impose
from .transfinite.edge_graph import PreparedEdgeGraph
from .transfinite.skeleton import Skeleton

# Face nodes per chunk: large enough to outweigh the cost of starting a thread.
_NODES = 100_000


class PreparedFiller(Protocol):
    """The second step of a method, bound to its blocks."""

    account: Account

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Fill block interiors, in place, from the nodes that the first step moved; linear in their displacement."""
        ...

    def differentiable(self) -> PreparedFiller:
        """The same, accurate enough for :meth:`fill` and :meth:`pull` to be transposes of each other."""
        ...

    def pull(self, gradient: FloatArray) -> None:
        """Transpose of :meth:`fill`: pass gradients (n_nodes, 3) from inside blocks on to their faces, in place."""
        ...


class Filler(Protocol):
    """A method that fills blocks."""

    def skeleton(self, problem: Problem) -> Skeleton:
        """The nodes that the first step has to move."""
        ...

    def prepare(self, problem: Problem, skeleton: Skeleton) -> PreparedFiller:
        """Bind to the undeformed grid."""
        ...


@dataclass(frozen=True)
class Composite:
    """``mover`` for the interfaces (``None``: TFI on the edge graph), then ``filler`` for the interiors.

    Without a filler the mover moves every node.
    """

    mover: Interpolation | None
    filler: Filler | None

    def prepare(self, problem: Problem) -> PreparedMethod:
        """Bind both steps to the undeformed grid."""
        periodic = free_periodic(problem)
        if periodic.size == 0:
            return PreparedComposite(self, problem)
        nodes, (low, high) = np.sort(problem.topology.first[periodic]), problem.grid.nodes.ends
        first = _mover(self.mover, problem, nodes[(nodes >= low) & (nodes < high)])
        guided = with_known_periodic(problem)
        return PreparedPeriodic(problem, first, PreparedComposite(self, guided), guided)


def _mover(interpolation: Interpolation | None, problem: Problem, flat: IntArray) -> Mover:
    """An interpolation for the nodes ``flat``, or TFI on the edge graph, which moves all face nodes."""
    if interpolation is None:
        return PreparedEdgeGraph(problem)
    return Scattered(interpolation, problem, flat)


@dataclass
class Scattered:
    """An interpolation as the first step, which moves the nodes of the skeleton that are not sources."""

    interpolation: Interpolation
    problem: Problem
    flat: IntArray
    account: Account = field(init=False)

    def __post_init__(self) -> None:
        self.bound = self.interpolation.bind(self.problem)
        self.evaluator = self.bound.at(self.flat)
        self.beside_slip = BesideSlip(self.problem, self.flat)
        self.account = self.bound.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self.bound.warnings_for(motion, step)

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> FloatArray:
        values = self.bound.fit(displacement, progress)
        release_freed()
        self.evaluator.evaluate(values, out, progress)
        release_freed()
        self.beside_slip.apply(out, progress)
        face = on_faces(out, self.problem)
        face[self.problem.source_numbers] = displacement
        return face

    def linearised(self, displacement: FloatArray) -> _LinearScattered:
        return _LinearScattered(self, displacement)


class _LinearScattered:
    """Derivative of an interpolation as the first step; sources on faces take the change prescribed for them."""

    def __init__(self, mover: Scattered, displacement: FloatArray) -> None:
        self._problem, self._beside_slip = mover.problem, mover.beside_slip
        self.inside = mover.bound.linearised(mover.evaluator, displacement)
        self.kinks = self.inside.kinks

    def push(self, change: FloatArray, out: FloatArray) -> FloatArray:
        self.inside.push(change, out)
        self._beside_slip.damp(Nodes.of(out).rows)
        face = on_faces(out, self._problem)
        face[self._problem.source_numbers] = change
        return face

    def pull(self, face: FloatArray, gradient: FloatArray) -> FloatArray:
        own = face[self._problem.source_numbers].copy()
        face[self._problem.source_numbers] = 0.0
        add_to_faces(face, self._problem.topology, gradient)
        self._beside_slip.damp(Nodes.of(gradient).rows)
        return np.asarray(own + self.inside.pull(gradient))


class PreparedComposite:
    """Two prepared steps and the constraints between them."""

    def __init__(self, method: Composite, problem: Problem):
        self.problem = problem
        skeleton = method.filler.skeleton(problem) if method.filler else None
        self.mover = _mover(method.mover, problem, first_step_nodes(problem, skeleton))
        self.filler = method.filler.prepare(problem, skeleton) if method.filler and skeleton else None
        self.left_out = skeleton is not None and bool(skeleton.left_out)

    @property
    def account(self) -> Account:
        """Settings and warnings of both steps."""
        merged = Account()
        for part in (self.mover, self.filler):
            if part:
                merged.include(part.account)
        return merged

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self.mover.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        problem = self.problem
        check_displacement(displacement, len(problem.source_numbers))
        # Every row is set: each node lies on a block face, in the skeleton, or inside a block or sub-block.
        out = _blank(problem) if self.left_out else problem.grid.nodes.like(3)
        impose(problem, self.mover.move(displacement, out, progress), out)
        if self.filler:
            self.filler.fill(out, progress)
            if self.left_out:
                self.constrain_again(out)
        return out

    def constrain_again(self, out: FloatArray) -> None:
        """Impose the constraints again, in place, on displacements (n_nodes, 3) that were changed since."""
        impose(self.problem, on_faces(out, self.problem), out)

    def linearised(self, displacement: FloatArray) -> _LinearComposite:
        """The derivative at a displacement (n_sources, 3)."""
        return _LinearComposite(self, displacement)


class _LinearComposite:
    """Derivative of a composite, from those of its two steps and of the constraints between them."""

    def __init__(self, method: PreparedComposite, displacement: FloatArray) -> None:
        problem = self._problem = method.problem
        self.mover = method.mover.linearised(displacement)
        self._filler = method.filler.differentiable() if method.filler else None
        out = _blank(problem)
        face = method.mover.move(displacement, out)
        self._first = Constraints(problem, face.copy())
        self.kinks = self.mover.kinks + self._first.kinks
        # Constraints on the sides that the second step fills.
        self._second = None
        if method.left_out and self._filler:
            impose(problem, face, out)
            self._filler.fill(out)
            self._second = Constraints(problem, on_faces(out, problem))
            self.kinks += self._second.kinks

    def push(self, change: FloatArray) -> FloatArray:
        problem = self._problem
        out = _blank(problem) if self._second else problem.grid.nodes.like(3)
        self._first.impose(self.mover.push(change, out), out)
        if self._filler:
            self._filler.fill(out)
        if self._second:
            self._second.impose(on_faces(out, problem), out)
        return out

    def pull(self, gradient: FloatArray) -> FloatArray:
        if self._second:
            add_to_faces(self._second.gathered(gradient), self._problem.topology, gradient)
        if self._filler:
            self._filler.pull(gradient)
        return self.mover.pull(self._first.gathered(gradient), gradient)


def free_periodic(problem: Problem) -> IntArray:
    """Unique numbers of the periodic nodes that no boundary of higher precedence moves or fixes."""
    periodic = problem.boundary.periodic
    nodes = np.unique(np.r_[periodic.one, periodic.two])
    return np.asarray(nodes[~problem.boundary.known[nodes]])


def with_known_periodic(problem: Problem) -> Problem:
    """The problem with its free periodic nodes as sources."""
    boundary = problem.boundary
    kind, quad_kind = boundary.kind.copy(), boundary.quad_kind.copy()
    periodic = free_periodic(problem)
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
class PreparedPeriodic:
    """A method that moves free periodic nodes before all others, in pairs; then these are sources, too.

    Averaging the pairs afterwards would leave a jump next to the boundary, because the interpolation ignores the
    periodic images of the body.
    """

    problem: Problem
    first: Mover
    rest: PreparedMethod
    guided: Problem

    @property
    def account(self) -> Account:
        """Settings and warnings of the method itself."""
        return self.rest.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self.first.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        face = self.first.move(displacement, _filled(self.problem, 0.0), progress)
        impose(self.problem, face)
        return self.rest.apply(face[self.guided.source_numbers], progress)

    def linearised(self, displacement: FloatArray) -> _LinearPeriodic:
        """The derivative at a displacement (n_sources, 3)."""
        return _LinearPeriodic(self, displacement)


class _LinearPeriodic:
    """Derivative of a method that moves periodic nodes first, and all others with these as additional sources."""

    def __init__(self, method: PreparedPeriodic, displacement: FloatArray) -> None:
        problem = self._problem = method.problem
        self._sources, self._mover = method.guided.source_numbers, method.first.linearised(displacement)
        face = method.first.move(displacement, _filled(problem, 0.0))
        self._constraints = Constraints(problem, face.copy())
        impose(problem, face)
        self._rest = method.rest.linearised(face[self._sources])
        self.kinks = self._mover.kinks + self._constraints.kinks + self._rest.kinks

    def push(self, change: FloatArray) -> FloatArray:
        face = self._mover.push(change, self._problem.grid.nodes.like(3))
        self._constraints.push(face)
        return self._rest.push(face[self._sources])

    def pull(self, gradient: FloatArray) -> FloatArray:
        face = np.zeros((self._problem.topology.n_unique, 3))
        face[self._sources] = self._rest.pull(gradient)
        self._constraints.pull(face)
        Nodes.of(gradient).each(lambda rows: gradient[rows].fill(0.0))
        return self._mover.pull(face, gradient)


def _filled(problem: Problem, value: float) -> FloatArray:
    """An array (n_nodes, 3) of equal numbers."""
    out = problem.grid.nodes.like(3)
    Nodes.of(out).each(lambda rows: out[rows].fill(value))
    return out


def _blank(problem: Problem) -> FloatArray:
    """An array (n_nodes, 3) in which nodes that no step has reached are no numbers."""
    return _filled(problem, np.nan)


def check_displacement(displacement: FloatArray, n_sources: int) -> None:
    """Refuse arrays that compiled loops would read out of bounds, and non-finite values.

    Raises
    ------
    MotionError
        Unless it is a finite float64 array (n_sources, 3).
    """
    expected = (
        f"expected a finite float64 array ({n_sources}, 3): one row per source, ascending (problem.source_numbers)"
    )
    if not isinstance(displacement, np.ndarray):
        raise MotionError(f"displacement is a {type(displacement).__name__}; {expected}")
    if displacement.shape != (n_sources, 3) or displacement.dtype != np.float64:
        raise MotionError(f"displacement is {displacement.shape} {displacement.dtype}; {expected}")
    bad = ~np.isfinite(displacement).all(axis=1)
    if bad.any():
        first = int(bad.argmax())
        raise MotionError(
            f"displacement has {int(bad.sum())} rows that are not finite, the first is row {first} = "
            f"{vector(displacement[first])}; {expected}"
        )


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
