"""A grid prepared for any number of deformations."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.motion import SMALLEST
from meshdeform_core.boundary.prescribed import given_displacement
from meshdeform_core.deform import BoundaryMotion, Setup, Start, Timing, impose
from meshdeform_core.errors import CaseError, GridError, MotionError
from meshdeform_core.grid import BoolArray, FloatArray, IntArray
from meshdeform_core.methods import PreparedMethod, Progress
from meshdeform_core.numerics.arrays import places_among
from meshdeform_core.parallel import Part, Ranks, dividing, sharing
from meshdeform_core.repair.options import Mode
from meshdeform_core.wording import vector

from ..gate import checked_array, checked_time, in_parts, require_arguments, whole
from ..grids.grid import Grid
from ..notebook import html_table
from .linearisation import Linearisation, Moving
from .step import Step
from .turns import one_at_a_time

Displacement = ArrayLike | Mapping[str, ArrayLike] | Callable[[FloatArray, float], ArrayLike]


class Mesh:
    """A grid, its classified boundary and a prepared method; made by :func:`meshdeform.prepare`.

    Every :meth:`deform` starts from the undeformed grid: the same displacement gives the same step to the last bit,
    with the same warnings, whatever was called before. Calls from several threads run one at a time, as each uses all
    cores; a mesh with ``parts=True`` works in the thread that prepared it only.
    """

    def __init__(self, setup: Setup, plane: bool, ranks: Ranks, threads: int | None):
        self._setup, self._plane, self._ranks, self._threads = setup, plane, ranks, threads
        self._prepared: PreparedMethod | None = None
        self._thread = threading.get_ident()

    @property
    def grid(self) -> Grid:
        """The undeformed grid."""
        return Grid._of(self._setup.grid, self._plane)

    @property
    def method(self) -> str:
        """Name of the method."""
        return self._setup.case.method.name

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the grid and its boundary."""
        return self._setup.warnings

    @cached_property
    def points(self) -> FloatArray:
        """Undeformed positions (n_moving, 3) of the nodes that move: coincident nodes once; read-only.

        All of them on every rank, also where the ranks hold parts of the grid.
        """
        points: FloatArray = self._setup.grid.points[self._setup.topology.first[self._numbers]]
        points.flags.writeable = False
        return points

    @cached_property
    def nodes(self) -> IntArray:
        """Grid index of each row of :attr:`points`, (n_moving, 4): block, i, j, k of one copy of the node, from 0."""
        grid, first = self._setup.grid, self._setup.topology.first[self._numbers]
        block = np.searchsorted(grid.offsets, first, side="right") - 1
        nodes = np.empty((len(first), 4), dtype=np.int64)
        for b in np.unique(block):
            rows = block == b
            nodes[rows, 0] = b
            nodes[rows, 1:] = np.stack(np.unravel_index(first[rows] - grid.offsets[b], grid.shapes[b]), axis=1)
        return nodes

    @property
    def patches(self) -> Mapping[str, IntArray]:
        """Rows of :attr:`points` of each moving patch; nodes shared by two patches belong to both."""
        return MappingProxyType(self._patches)

    @cached_property
    def _patches(self) -> dict[str, IntArray]:
        row_of = places_among(self._numbers, self._setup.topology.n_unique)
        moving = [patch for patch in self._setup.boundary.patches if patch.kind is Kind.MOVING]
        return {patch.name: rows[rows >= 0] for patch in moving for rows in [row_of[patch.nodes]]}

    def mask(self, patch: str) -> BoolArray:
        """Mask (n_moving,) bool of the rows of :attr:`points` that belong to a moving patch."""
        if patch not in self.patches:
            raise MotionError(f"no moving patch {patch!r}; expected one of {', '.join(map(repr, self.patches))}")
        mask = np.zeros(len(self._numbers), dtype=bool)
        mask[self.patches[patch]] = True
        return mask

    def rows(self, block: int) -> IntArray:
        """For every node (ni, nj, nk) of a block, its row in :attr:`points`, or -1 if it is not a moving node."""
        grid, topology = self._setup.grid, self._setup.topology
        if not 0 <= block < grid.n_blocks:
            raise MotionError(f"block {block}; expected 0 to {grid.n_blocks - 1}")
        row_of = places_among(self._numbers, topology.n_unique)
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
        moment, steps = checked_time(time, MotionError), whole(steps)
        if steps is True:
            raise CaseError('steps = True; expected a whole number >= 1 or "auto"')
        with self._at_work():
            motion = self._motion(displacement, moment)
            timing = Timing()
            setup = self._setup if repair is None else self._setup.with_repair(repair)
            start = Start(setup.grid.points, self._method(timing))
            result = impose(setup, motion, steps, setup.grid.precision, timing, progress, start)
            setup.undeformed.expect_more()
        return Step(result, self._plane)

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
        at = np.zeros((len(self.points), 3)) if displacement is None else displacement
        step = self.deform(at, steps=steps, repair=repair)
        with self._at_work():
            total = self._motion(at, 0.0)(1.0)[self._setup.problem.source_numbers]
            moving = Moving(self._numbers, self._checked, self._at_work)
            return Linearisation(moving, self._method(Timing()), step, total)

    @contextmanager
    def _at_work(self) -> Iterator[None]:
        """Context of a call: one at a time, with the threads and ranks of this mesh."""
        with in_parts(), one_at_a_time(), sharing(self._ranks, self._threads), self._dividing():
            yield

    def _dividing(self) -> AbstractContextManager[None]:
        if not isinstance(self._setup.grid.points, Part):
            return nullcontext()
        if threading.get_ident() != self._thread:
            raise GridError(
                "a mesh prepared with parts=True is used in another thread; expected the one that prepared it"
            )
        return dividing()

    @cached_property
    def _numbers(self) -> IntArray:
        """Unique numbers of the independently moving nodes, ascending; their periodic partners follow them."""
        movers = self._setup.boundary.movers
        return np.unique(np.concatenate([nodes for nodes, _ in movers])).astype(np.int64)

    def _method(self, timing: Timing) -> PreparedMethod:
        if self._prepared is None:
            with timing.stage("prepare"):
                self._prepared = self._setup.prepare()
        return self._prepared

    def _motion(self, displacement: Displacement | None, time: float) -> BoundaryMotion:
        if displacement is None:
            if not any(motion.steps for _, motion in self._setup.boundary.movers):
                raise MotionError("no displacement is given, and no case prescribes one; expected deform(displacement)")
            return self._setup.motion(time)
        if isinstance(displacement, Mapping):
            values = self._from_patches(displacement)
        elif callable(displacement):
            require_arguments(displacement, "displacement", "points", "time")
            values = self._checked(displacement(self.points, time), "displacement(points, time)", len(self.points))
        else:
            values = self._checked(displacement, "displacement", len(self.points))
        setup = self._setup
        values = np.where(np.abs(values) < SMALLEST, 0.0, values)
        total = given_displacement(setup.grid, setup.topology, setup.boundary, self._numbers, values)
        return lambda fraction: total if fraction == 1.0 else fraction * total

    def _checked(self, values: Any, what: str, rows: int) -> FloatArray:
        """An array (rows, 3); (rows, 2) is accepted for a grid given in the plane."""
        meaning = "one row per node of mesh.points" if rows == len(self.points) else "one row per node of the patch"
        if self._plane and np.ndim(values) == 2 and np.shape(values)[1] == 2:
            plane = checked_array(values, (rows, 2), what, meaning, MotionError)
            return np.concatenate([plane, np.zeros((rows, 1))], axis=1)
        return checked_array(values, (rows, 3), what, meaning, MotionError)

    def _from_patches(self, displacement: Mapping[str, ArrayLike]) -> FloatArray:
        if set(displacement) != set(self.patches):
            names = [", ".join(map(repr, names)) or "none" for names in (displacement, self.patches)]
            raise MotionError(f"displacement is given for the patches {names[0]}; expected all moving ones: {names[1]}")
        total = np.full((len(self.points), 3), np.nan)
        for name, rows in self.patches.items():
            values = self._checked(displacement[name], f"displacement[{name!r}]", len(rows))
            known = np.isfinite(total[rows, 0])
            self._require_agreement(name, rows[known], total[rows[known]], values[known])
            total[rows] = values
        return total

    def _require_agreement(self, name: str, rows: IntArray, before: FloatArray, values: FloatArray) -> None:
        edge = self._setup.topology.edge[self._numbers[rows]]
        gap = np.linalg.norm(values - before, axis=1)
        if gap.size and (gap > 1e-6 * edge).any():
            worst = int(np.argmax(gap / edge))
            raise MotionError(
                f"patch {name!r} gives its shared node {vector(self.points[rows[worst]])} the displacement "
                f"{vector(values[worst])}, another patch {vector(before[worst])}; expected the same"
            )

    def __getstate__(self) -> dict[str, Any]:
        """The state of a copy, without the prepared method: the copy prepares it again."""
        if self._ranks.count > 1:
            raise TypeError("a Mesh of several MPI ranks cannot be copied or pickled; prepare it where it is needed")
        return {**self.__dict__, "_prepared": None}

    def __repr__(self) -> str:
        patches = ", ".join(self.patches)
        return f"Mesh({self.method}, {len(self.points):,} moving nodes of {patches}; {self.grid!r})"

    def _repr_html_(self) -> str:
        patches = self._setup.boundary.patches
        rows = [(patch.name, patch.kind.label, f"{len(patch.nodes):,}") for patch in patches]
        return html_table(repr(self), rows, ("boundary", "kind", "nodes"))
