"""A grid prepared for any number of deformations, and their derivatives by the displacement of the moving nodes."""

from __future__ import annotations

import os
import threading
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from functools import cached_property
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.classification import given_displacement, given_gradient
from meshdeform_core.boundary.motions.motion import SMALLEST
from meshdeform_core.deform import BoundaryMotion, Setup, Timing, impose
from meshdeform_core.errors import CaseError, GridError, MotionError
from meshdeform_core.grid import BoolArray, FloatArray, IntArray
from meshdeform_core.methods import PreparedMethod, Progress
from meshdeform_core.methods.limits import reason_of
from meshdeform_core.numerics.arrays import places_among
from meshdeform_core.parallel import Nodes, Ranks, sharing
from meshdeform_core.repair.options import Mode
from meshdeform_core.wording import vector

from .grid import (
    Grid,
    by_part,
    checked_array,
    checked_time,
    in_parts,
    read_only,
    require_arguments,
    rows_of_block,
    whole_number,
    wrapped,
)  # fmt: skip
from .step import Step, differentiated

if TYPE_CHECKING:
    from scipy.sparse.linalg import LinearOperator

_SAME = 1e-6
"""Displacements that patches give a shared node may differ by this fraction of the shortest edge there."""
Displacement = ArrayLike | Mapping[str, ArrayLike] | Callable[[FloatArray, float], ArrayLike]

# Re-entrant, as a thread may call again, for example from a function that returns displacements.
_lock = threading.RLock()


@contextmanager
def one_at_a_time() -> Iterator[None]:
    """Wait for calls of other threads to end: each sets the threads of its loops."""
    with _lock:
        yield


def _renew() -> None:
    """Make a new lock in a forked process, where the thread that held the old one does not exist."""
    global _lock
    _lock = threading.RLock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_renew)


class Mesh:
    """A grid, its classified boundary and a prepared method; made by :func:`meshdeform.prepare`.

    Every :meth:`deform` starts from the undeformed grid: the same displacement gives the same step to the last bit,
    with the same warnings, whatever was called before. Calls from several threads run one at a time, as each uses all
    cores; a mesh with ``comm=`` works in the thread that prepared it only.
    """

    def __init__(self, setup: Setup, plane: bool, ranks: Ranks, threads: int | None):
        # ``plane``: whether users give and get two coordinates; ranks and threads share the work of every call.
        self.setup, self.plane, self.ranks, self.threads = setup, plane, ranks, threads
        # Unique numbers of the independently moving nodes, ascending; their periodic partners follow them.
        movers = [nodes for nodes, _ in setup.boundary.movers]
        self.numbers: IntArray = np.unique(np.concatenate(movers)).astype(np.int64)
        self._points: FloatArray = read_only(setup.grid.points[setup.topology.first[self.numbers]])
        self._thread = threading.get_ident()
        self._prepared: PreparedMethod | None = None
        self._last: tuple[FloatArray, int | str | None, Mode | None, weakref.ref[Step]] | None = None

    @property
    def grid(self) -> Grid:
        """The undeformed grid."""
        return wrapped(self.setup.grid, self.plane)

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.setup.case.method.name

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the grid and its boundary."""
        return self.setup.warnings

    @property
    def points(self) -> FloatArray:
        """Undeformed positions (n_moving, 3) of the nodes that move: coincident nodes once; read-only.

        All of them on every rank, also where the ranks hold parts of the grid.
        """
        return self._points

    @cached_property
    def nodes(self) -> IntArray:
        """Grid index of each row of :attr:`points`, (n_moving, 4): block, i, j, k of one copy of the node, from 0."""
        grid, first = self.setup.grid, self.setup.topology.first[self.numbers]
        block = np.searchsorted(grid.offsets, first, side="right") - 1
        nodes = np.empty((len(first), 4), dtype=np.int64)
        for b in np.unique(block):
            rows = block == b
            nodes[rows, 0] = b
            nodes[rows, 1:] = np.stack(np.unravel_index(first[rows] - grid.offsets[b], grid.shapes[b]), axis=1)
        return nodes

    @cached_property
    def patches(self) -> Mapping[str, IntArray]:
        """Rows of :attr:`points` of each moving patch; nodes shared by two patches belong to both."""
        row_of = places_among(self.numbers, self.setup.topology.n_unique)
        moving = [patch for patch in self.setup.boundary.patches if patch.kind is Kind.MOVING]
        return MappingProxyType({each.name: rows[rows >= 0] for each in moving for rows in [row_of[each.nodes]]})

    def mask(self, patch: str) -> BoolArray:
        """Mask (n_moving,) bool of the rows of :attr:`points` that belong to a moving patch."""
        if patch not in self.patches:
            raise MotionError(f"no moving patch {patch!r}; expected one of {', '.join(map(repr, self.patches))}")
        mask = np.zeros(len(self.numbers), dtype=bool)
        mask[self.patches[patch]] = True
        return mask

    def rows(self, block: int) -> IntArray:
        """For every node (ni, nj, nk) of a block, its row in :attr:`points`, or -1 if it is not a moving node."""
        grid, topology = self.setup.grid, self.setup.topology
        if not 0 <= block < grid.n_blocks:
            raise MotionError(f"block {block}; expected 0 to {grid.n_blocks - 1}")
        row_of = places_among(self.numbers, topology.n_unique)
        lo, hi = np.searchsorted(topology.face_nodes, grid.offsets[block : block + 2])
        rows = np.full(grid.shapes[block], -1, dtype=np.int64)
        rows.ravel()[topology.face_nodes[lo:hi] - grid.offsets[block]] = row_of[topology.number[lo:hi]]
        return rows

    def deform(
        self,
        displacement: Displacement | None = None,
        *,
        time: float = 0.0,
        steps: int | Literal["auto"] | None = None,
        repair: Mode | None = None,
        progress: Progress | None = None,
    ) -> Step:
        """Deform the undeformed grid and judge the result.

        Parameters
        ----------
        displacement : of the moving nodes (grid length unit): an array like :attr:`points`; a mapping from the names of
            all moving patches to arrays with one row per node of the patch; or a function of the undeformed points
            (n, 3) and the time. ``None``: the motion prescribed by the case
        time : passed to functions and to the case's motion
        steps : number of increments, or ``"auto"``: as many as a valid grid requires; one by default
        repair : ``"auto"`` repairs invalid and weak cells, ``"polish"`` also the worst cells of a valid
            grid, ``"off"`` nothing; by default the case's setting, ``"auto"`` if it has none
        progress : called as ``progress(stage, done, total)``

        Raises
        ------
        MotionError
            When an array has the wrong shape, carries a unit or contains values that are not finite, or patches
            disagree at shared nodes.
        GridError
            When the grid is in parts, and the method or the repair takes the whole of it.
        """
        moment, steps = checked_time(time, MotionError), whole_number(steps)
        if steps is True:
            raise CaseError('steps = True; expected a whole number >= 1 or "auto"')
        with self.at_work():
            if displacement is not None:
                return self._deformed(self._displacement_values(displacement, moment), steps, repair, progress)
            setup = self.setup
            if not any(motion.steps for _, motion in setup.boundary.movers):
                raise MotionError("no displacement is given, and no case prescribes one; expected deform(displacement)")
            return self._imposed(setup.motion(moment), steps, repair, progress)

    def linearise(
        self,
        displacement: Displacement | None = None,
        *,
        steps: int | Literal["auto"] | None = None,
        repair: Mode | None = None,
    ) -> Linearisation:
        """The derivative of the grid with respect to the displacement of the moving nodes.

        Parameters
        ----------
        displacement : at which it is taken, as for :meth:`deform`; ``None``: the undeformed grid
        steps, repair : as for :meth:`deform`. ``.exact`` is false for a grid repaired without reaching the minimum of
            the repair's energy, where the result has no derivative, and where the ranks hold parts of a grid that was
            repaired or moved in several steps; ``.reason`` says why

        Raises
        ------
        MotionError
            As for :meth:`deform`.
        GridError
            When the grid is in parts, and the derivative of the method takes the whole of it.
        """
        with self.at_work():
            at = np.zeros_like(self.points) if displacement is None else self._displacement_values(displacement, 0.0)
            steps, last = whole_number(steps), self._last
            step = last[3]() if last and last[1:3] == (steps, repair) and np.array_equal(last[0], at) else None
            return Linearisation(self, step or self._deformed(at, steps, repair, None), at)

    def _deformed(
        self, values: FloatArray, steps: int | str | None, repair: Mode | None, progress: Progress | None
    ) -> Step:
        """The step for a displacement (n_moving, 3); as long as it is in use, :meth:`linearise` finds it again."""
        total = self.of_boundary(values)
        step = self._imposed(lambda part: total if part == 1.0 else part * total, steps, repair, progress)
        self._last = values, steps, repair, weakref.ref(step)
        return step

    def _imposed(
        self, motion: BoundaryMotion, steps: int | str | None, repair: Mode | None, progress: Progress | None
    ) -> Step:
        timing, setup = Timing(), self.setup
        setup = setup if repair is None else setup.with_repair(repair)
        result = impose(setup, motion, steps, setup.grid.precision, timing, progress, self.prepared(timing))
        return Step(result, self.plane)

    def prepared(self, timing: Timing) -> PreparedMethod:
        """The method, prepared by the first call that needs it."""
        if self._prepared is None:
            with timing.stage("prepare"):
                self._prepared = self.setup.prepare()
        return self._prepared

    def _displacement_values(self, displacement: Displacement, time: float) -> FloatArray:
        """The displacement (n_moving, 3) of the moving nodes."""
        if isinstance(displacement, Mapping):
            if set(displacement) != set(self.patches):
                given, known = (", ".join(map(repr, names)) or "none" for names in (displacement, self.patches))
                raise MotionError(f"displacement is given for the patches {given}; expected all moving ones: {known}")
            values = np.full((len(self.points), 3), np.nan)
            for name, rows in self.patches.items():
                part = self.checked(displacement[name], f"displacement[{name!r}]", len(rows))
                twice = np.isfinite(values[rows, 0])
                shared, first, second = rows[twice], values[rows[twice]], part[twice]
                edges = self.setup.topology.edge[self.numbers[shared]]
                gap = np.linalg.norm(second - first, axis=1) / edges
                if gap.max(initial=0.0) > _SAME:
                    worst = int(np.argmax(gap))
                    raise MotionError(
                        f"patch {name!r} gives its shared node {vector(self.points[shared[worst]])} the displacement "
                        f"{vector(second[worst])}, another patch {vector(first[worst])}; expected the same"
                    )
                values[rows] = part
        elif callable(displacement):
            require_arguments(displacement, "displacement", "points", "time")
            own, what = displacement(self.points, time), "displacement(points, time)"
            values = self.checked(own, what, len(self.points))
        else:
            values = self.checked(displacement, "displacement", len(self.points))
        return np.where(np.abs(values) < SMALLEST, 0.0, values)

    @contextmanager
    def at_work(self) -> Iterator[None]:
        """Context of a call: one at a time, with threads and ranks of the mesh; a mesh in parts keeps to its thread."""
        if self.ranks.count > 1 and threading.get_ident() != self._thread:
            raise GridError("a mesh prepared with comm= is used in another thread; expected the one that prepared it")
        with in_parts(), one_at_a_time(), sharing(threads=self.threads or self.ranks.cores):
            yield

    def checked(self, values: Any, what: str, rows: int) -> FloatArray:
        """An array (rows, 3); (rows, 2) is accepted for a grid given in the plane, any other array refused."""
        meaning = f"one row per node of {'mesh.points' if rows == len(self.points) else 'the patch'}"
        if self.plane and np.ndim(values) == 2 and np.shape(values)[1] == 2:
            return np.pad(checked_array(values, (rows, 2), what, meaning, MotionError), ((0, 0), (0, 1)))
        return checked_array(values, (rows, 3), what, meaning, MotionError)

    def of_boundary(self, values: FloatArray) -> FloatArray:
        """Displacement (n_unique, 3) of all nodes on faces from that (n_moving, 3) of the moving ones.

        Refused where a 2-D grid would leave its plane, or periodic images would move differently.
        """
        setup = self.setup
        return given_displacement(setup.grid, setup.topology, setup.boundary, self.numbers, values)

    def __getstate__(self) -> dict[str, Any]:
        """The state of a copy, without the prepared method: the copy prepares it again."""
        if self.ranks.count > 1:
            raise TypeError("a Mesh of several MPI ranks cannot be copied or pickled; prepare it where it is needed")
        lasting = {name: value for name, value in self.__dict__.items() if name != "patches"}
        return {**lasting, "_prepared": None, "_last": None}

    def __repr__(self) -> str:
        patches = ", ".join(self.patches)
        return f"Mesh({self.method}, {len(self.points):,} moving nodes of {patches}; {self.grid!r})"


class Linearisation:
    """The derivative of the grid at one displacement; made by :meth:`Mesh.linearise`.

    It is that of the method and of its repair, for a fixed undeformed grid: rotations, their smoothing and mean motions
    are differentiated as they depend on the displacement, the repair as the minimum that it is. Of a motion in several
    steps it is that of the method in one step, and :attr:`exact` is false.

    Attributes
    ----------
    step : the deformed grid at this displacement, as :meth:`Mesh.deform` gives it
    reason : why this is not the derivative of :attr:`step`; empty if it is
    """

    def __init__(self, mesh: Mesh, step: Step, displacement: FloatArray) -> None:
        self._mesh, self._setup, self.step = mesh, step.result.setup, step
        of_sources = mesh.of_boundary(displacement)[self._setup.problem.source_numbers]
        self._derivative, why = differentiated(step.result, mesh.prepared(Timing()), of_sources)
        self.reason = "; ".join(filter(None, (why, reason_of(self._derivative.kinks))))

    @property
    def exact(self) -> bool:
        """Whether this is the derivative of :attr:`step`; else :attr:`reason` says why not."""
        return not self.reason

    def jvp(self, displacement: ArrayLike) -> list[FloatArray]:
        """Change of the blocks' coordinates, arrays like ``mesh.grid.blocks``, for a change of the displacement.

        If every rank holds a part of the grid: arrays like ``mesh.grid.part``; all ranks call this, with the same
        change.

        Parameters
        ----------
        displacement : (n_moving, 3) change of the displacement, rows as in :attr:`Mesh.points`

        Raises
        ------
        MotionError
            For an array of another shape, values that are not finite, or a change out of the plane of a 2-D grid.
        """
        with self._mesh.at_work():
            change = self._mesh.checked(displacement, "displacement", len(self._mesh.numbers))
            return by_part(self.step.grid, self._pushed(change))

    def vjp(self, gradients: Sequence[ArrayLike]) -> FloatArray:
        """Gradient (n_moving, 3) with respect to the displacement from that with respect to the coordinates.

        The transpose of :meth:`jvp`. The contributions of coincident block nodes are added.

        Parameters
        ----------
        gradients : one array per block, like ``mesh.grid.blocks``; if every rank holds a part of the grid, of the nodes
            in its ``mesh.grid.part``. All ranks call this together and get the whole gradient

        Raises
        ------
        GridError
            When their number or shapes are not those of the blocks, or values are not finite.
        """
        parts = self.step.grid.part
        what = f"expected those of the {len(parts)} blocks"

        def fill() -> None:
            found = list(gradients) if isinstance(gradients, Iterable) else [gradients]
            if len(found) != len(parts):
                raise GridError(f"found gradients for {len(found)} blocks; {what}")
            for (block, _, _, points), each in zip(parts, found, strict=True):
                values = checked_array(each, points.shape, f"gradient of block {block + 1}", what, GridError)
                rows_of_block(self.step.grid, block, flat)[...] = values

        with self._mesh.at_work():
            flat = self._setup.grid.nodes.like(3)
            Nodes.of(flat).each(lambda rows: flat[rows].fill(0.0))
            Nodes.of(flat).on_each(fill)
            return self._pulled(flat)

    @property
    def operator(self) -> LinearOperator:
        """The derivative as a scipy ``LinearOperator`` of shape (3 n_nodes, 3 n_moving), with its transpose.

        Rows: nodes of all blocks in block order, C order within a block, x y z last; columns: rows of ``mesh.points``.
        If every rank holds a part of the grid: rows of its nodes; all ranks call this with the same change, or each
        with the gradient of its nodes, and get the whole gradient.
        """
        from scipy.sparse.linalg import LinearOperator

        nodes, moving = self._setup.grid.nodes, len(self._mesh.numbers)
        low, high = nodes.ends

        def push(x: FloatArray) -> FloatArray:
            with self._mesh.at_work():
                return np.asarray(self._pushed(_real(x).reshape(moving, 3))[low:high]).ravel()

        def pull(w: FloatArray) -> FloatArray:
            with self._mesh.at_work():
                gradient = nodes.like(3)
                Nodes.of(gradient).rows[low:high] = _real(w).reshape(high - low, 3)
                return self._pulled(gradient).ravel()

        return LinearOperator((3 * (high - low), 3 * moving), matvec=push, rmatvec=pull, dtype=np.float64)

    def _pushed(self, change: FloatArray) -> FloatArray:
        return self._derivative.push(self._mesh.of_boundary(change)[self._setup.problem.source_numbers])

    def _pulled(self, gradient: FloatArray) -> FloatArray:
        """:meth:`vjp` of a gradient (n_nodes, 3), which is overwritten."""
        setup = self._setup
        total = np.zeros((setup.topology.n_unique, 3))
        total[setup.problem.source_numbers] = self._derivative.pull(gradient)
        return given_gradient(setup.grid, setup.boundary, self._mesh.numbers, total)


def _real(values: Any) -> FloatArray:
    """The argument of a ``LinearOperator`` as a new real array."""
    found = np.array(values)
    if found.dtype.kind == "c":
        raise GridError("found complex numbers; expected real ones: apply the operator to both parts")
    return found.astype(np.float64)


class Repeated:
    """Steps of a mesh that are all imposed in one way; the last one is kept, and so is its derivative."""

    def __init__(self, mesh: Mesh, steps: int | Literal["auto"], repair: Mode):
        self.mesh, self._steps, self._repair = mesh, steps, repair
        self._kept: tuple[FloatArray, Step] | None = None
        self._derivative: Linearisation | None = None

    def step(self, displacement: FloatArray) -> Step:
        """The step for a displacement (n_moving, 3)."""
        if self._kept is None or not np.array_equal(displacement, self._kept[0]):
            step = self.mesh.deform(displacement, steps=self._steps, repair=self._repair)
            self._kept, self._derivative = (displacement.copy(), step), None
        return self._kept[1]

    def derivative(self, displacement: FloatArray, warn: Callable[[str], object]) -> Linearisation:
        """The derivative there; ``warn`` is called once if it is not that of the step."""
        self.step(displacement)
        if self._derivative is None:
            self._derivative = self.mesh.linearise(displacement, steps=self._steps, repair=self._repair)
            if not self._derivative.exact:
                warn(f"the derivative is not that of the grid: {self._derivative.reason}")
        return self._derivative
