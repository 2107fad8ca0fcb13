"""The composite of two methods: one moves block interfaces, the other block interiors (Sen et al. section 4).

Every method of the program is a composite, including those with a single name: ``tfi`` is tfi-tfi, and a scattered-data
method alone moves all nodes in the first step and has no second one.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from ..errors import MotionError
from ..grid import FloatArray, IntArray
from ..memory import release_freed
from ..numerics.rows import put_rows, spread_rows, take_rows
from ..parallel import Part, alike, for_chunks, for_rows, of_all, own_rows, rows_of
from ..wording import vector
from .base import Account, Interpolation, Mover, PreparedMethod, Problem, Progress
from .beside_slip import BesideSlip
from .periodic_steps import PreparedPeriodic, free_periodic, with_known_periodic
from .transfinite.edge_graph import PreparedEdgeGraph
from .transfinite.skeleton import Skeleton

# Face nodes per chunk: large enough to outweigh the cost of starting a thread.
_NODES = 100_000


class PreparedFiller(Protocol):
    """The second step of a method, bound to its blocks."""

    account: Account

    def fill(self, displacement: FloatArray, progress: Progress | None = None) -> None:
        """Fill block interiors, in place, from the nodes that the first step moved."""
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
        nodes, (low, high) = np.sort(problem.topology.first[periodic]), own_rows(problem.grid.points)
        first = _mover(self.mover, problem, nodes[(nodes >= low) & (nodes < high)])
        guided = with_known_periodic(problem)
        return PreparedPeriodic(problem, first, PreparedComposite(self, guided), guided)


def _mover(interpolation: Interpolation | None, problem: Problem, flat: IntArray) -> Mover:
    """An interpolation for the nodes ``flat``, or TFI on the edge graph, which moves all face nodes."""
    if interpolation is None:
        return PreparedEdgeGraph(problem)
    return _Scattered(interpolation, problem, flat)


@dataclass
class _Scattered:
    """An interpolation as the first step, which moves the nodes of the skeleton that are not sources."""

    interpolation: Interpolation
    problem: Problem
    flat: IntArray
    account: Account = field(init=False)

    def __post_init__(self) -> None:
        self._bound = self.interpolation.bind(self.problem)
        self._evaluator = self._bound.at(self.flat)
        self.beside_slip = BesideSlip(self.problem, self.flat)
        self.account = self._bound.account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        return self._bound.warnings_for(motion, step)

    def move(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> FloatArray:
        self.interpolate(displacement, out, progress)
        release_freed()
        self.beside_slip.apply(out, progress)
        face = _on_faces(out, self.problem)
        put_rows(displacement, self.problem.source_numbers, face)
        return face

    def interpolate(self, displacement: FloatArray, out: FloatArray, progress: Progress | None = None) -> None:
        """Write the interpolated displacement into the rows of ``out`` (n_nodes, 3) of the target nodes."""
        values = self._bound.fit(displacement, progress)
        release_freed()
        self._evaluator.evaluate(values, out, progress)


class PreparedComposite:
    """Two prepared steps and the constraints between them."""

    def __init__(self, method: Composite, problem: Problem):
        self._problem = problem
        skeleton = method.filler.skeleton(problem) if method.filler else None
        nodes = first_step_nodes(problem, skeleton)
        self._mover = _mover(method.mover, problem, nodes)
        self._filler = method.filler.prepare(problem, skeleton) if method.filler and skeleton else None
        self._left_out = skeleton is not None and bool(skeleton.left_out)

    @property
    def account(self) -> Account:
        """Settings and warnings of both steps."""
        parts = [self._mover.account] + ([self._filler.account] if self._filler else [])
        merged = Account()
        for part in parts:
            merged.include(part)
        return merged

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        return self._mover.warnings_for(motion, step)

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3)."""
        problem = self._problem
        check_displacement(displacement, len(problem.source_numbers))
        # Every row is set: each node lies on a block face, in the skeleton, or inside a block or sub-block.
        out = alike(problem.grid.points)
        if self._left_out:
            # Read the face values before the second step overwrites them.
            for_rows(lambda rows: out[rows].fill(np.nan), out)
        self._constrain(self._mover.move(displacement, out, progress), out)
        if self._filler:
            self._filler.fill(out, progress)
            if self._left_out:
                self._constrain(_on_faces(out, problem), out)
        return out

    def constrain_again(self, out: FloatArray) -> None:
        """Impose the constraints again, in place, on displacements (n_nodes, 3) that were changed since."""
        self._constrain(_on_faces(out, self._problem), out)

    def _constrain(self, face: FloatArray, out: FloatArray) -> None:
        """Impose slip and periodicity on ``face`` (n_unique, 3) and copy it to all coincident nodes of ``out``."""
        problem, boundary = self._problem, self._problem.boundary
        if problem.layer:
            problem.layer.follow(face)
        boundary.slip.constrain(face, problem.grid.points, problem.topology.first)
        boundary.periodic.constrain(face, ~boundary.known)
        put_on_faces(face, out, problem)


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


def _on_faces(displacement: FloatArray, problem: Problem) -> FloatArray:
    """The rows (n_unique, 3) of ``displacement`` (n_nodes, 3) at nodes on block faces."""
    if isinstance(displacement, Part):
        return np.asarray(displacement[problem.topology.first])
    face, first = np.empty((problem.topology.n_unique, 3)), problem.topology.first
    for_chunks(lambda lo, hi: take_rows(displacement, first[lo:hi], face[lo:hi]), len(first), _NODES)
    return face


def put_on_faces(face: FloatArray, out: FloatArray, problem: Problem) -> None:
    """Copy displacements (n_unique, 3) to all coincident nodes in the rows of ``out`` (n_nodes, 3)."""
    topology = problem.topology
    begin, end = np.searchsorted(topology.face_nodes, own_rows(out)).tolist()
    number, nodes, rows = topology.number[begin:end], topology.face_nodes[begin:end], rows_of(out)

    def work(lo: int, hi: int) -> None:
        spread_rows(face, number[lo:hi], nodes[lo:hi], rows)

    for_chunks(work, end - begin, _NODES)


def first_step_nodes(problem: Problem, skeleton: Skeleton | None) -> IntArray:
    """Flat indices, ascending, of the nodes that the first step moves: sources left out, coincident nodes once.

    If the grid is in parts, only the nodes of this rank.
    """
    topology = problem.topology
    low, high = own_rows(problem.grid.points)
    chosen = np.full(high - low, skeleton is None)
    if skeleton is not None:
        chosen[skeleton.nodes() - low] = True
    begin, end = np.searchsorted(topology.face_nodes, [low, high])
    faces = topology.face_nodes[begin:end] - low
    # A node belongs to the skeleton if any coincident node does: all nodes on block faces, except on omitted sides.
    wanted = np.full(topology.n_unique, skeleton is None or not skeleton.left_out)
    if not wanted.all():
        for numbers in of_all(problem.grid.points, np.unique(topology.number[begin:end][chosen[faces]])):
            wanted[numbers] = True
    wanted[problem.source_numbers] = False
    if problem.layer:
        wanted[problem.layer.followers] = False
    chosen[faces] = False
    first = topology.first[wanted]
    chosen[first[(first >= low) & (first < high)] - low] = True
    return low + np.flatnonzero(chosen)
