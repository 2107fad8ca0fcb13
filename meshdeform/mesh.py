"""A grid prepared for any number of deformations."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from functools import cached_property
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.motion import SMALLEST
from meshdeform_core.deform import BoundaryMotion, Timing, impose
from meshdeform_core.errors import CaseError, MotionError
from meshdeform_core.grid import BoolArray, FloatArray, IntArray
from meshdeform_core.methods import PreparedMethod, Progress
from meshdeform_core.numerics.arrays import places_among
from meshdeform_core.repair.options import Mode
from meshdeform_core.wording import vector

from .grid import Grid, checked_time, require_arguments, whole_number, wrapped
from .session import Session
from .step import Linearisation, Step

_SAME = 1e-6
"""Displacements that patches give a shared node may differ by this fraction of the shortest edge there."""
Displacement = ArrayLike | Mapping[str, ArrayLike] | Callable[[FloatArray, float], ArrayLike]


class Mesh:
    """A grid, its classified boundary and a prepared method; made by :func:`meshdeform.prepare`.

    Every :meth:`deform` starts from the undeformed grid: the same displacement gives the same step to the last bit,
    with the same warnings, whatever was called before. Calls from several threads run one at a time, as each uses all
    cores; a mesh with ``comm=`` works in the thread that prepared it only.
    """

    def __init__(self, session: Session):
        self.session = session
        self._prepared: PreparedMethod | None = None
        self._last: tuple[FloatArray, int | str | None, Mode | None, weakref.ref[Step]] | None = None

    @property
    def grid(self) -> Grid:
        """The undeformed grid."""
        return wrapped(self.session.setup.grid, self.session.plane)

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.session.setup.case.method.name

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the grid and its boundary."""
        return self.session.setup.warnings

    @property
    def points(self) -> FloatArray:
        """Undeformed positions (n_moving, 3) of the nodes that move: coincident nodes once; read-only.

        All of them on every rank, also where the ranks hold parts of the grid.
        """
        return self.session.points

    @cached_property
    def nodes(self) -> IntArray:
        """Grid index of each row of :attr:`points`, (n_moving, 4): block, i, j, k of one copy of the node, from 0."""
        grid, first = self.session.setup.grid, self.session.setup.topology.first[self.session.numbers]
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
        row_of = places_among(self.session.numbers, self.session.setup.topology.n_unique)
        moving = [patch for patch in self.session.setup.boundary.patches if patch.kind is Kind.MOVING]
        return MappingProxyType({each.name: rows[rows >= 0] for each in moving for rows in [row_of[each.nodes]]})

    def mask(self, patch: str) -> BoolArray:
        """Mask (n_moving,) bool of the rows of :attr:`points` that belong to a moving patch."""
        if patch not in self.patches:
            raise MotionError(f"no moving patch {patch!r}; expected one of {', '.join(map(repr, self.patches))}")
        mask = np.zeros(len(self.session.numbers), dtype=bool)
        mask[self.patches[patch]] = True
        return mask

    def rows(self, block: int) -> IntArray:
        """For every node (ni, nj, nk) of a block, its row in :attr:`points`, or -1 if it is not a moving node."""
        grid, topology = self.session.setup.grid, self.session.setup.topology
        if not 0 <= block < grid.n_blocks:
            raise MotionError(f"block {block}; expected 0 to {grid.n_blocks - 1}")
        row_of = places_among(self.session.numbers, topology.n_unique)
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
        with self.session.at_work():
            if displacement is not None:
                return self._deformed(self._displacement_values(displacement, moment), steps, repair, progress)
            setup = self.session.setup
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
        with self.session.at_work():
            at = np.zeros_like(self.points) if displacement is None else self._displacement_values(displacement, 0.0)
            steps, last = whole_number(steps), self._last
            step = last[3]() if last and last[1:3] == (steps, repair) and np.array_equal(last[0], at) else None
            step = step or self._deformed(at, steps, repair, None)
            of_sources = self.session.of_boundary(at)[self.session.setup.problem.source_numbers]
            return Linearisation(self.session, self._method(Timing()), step, of_sources)

    def _deformed(
        self, values: FloatArray, steps: int | str | None, repair: Mode | None, progress: Progress | None
    ) -> Step:
        """The step for a displacement (n_moving, 3); as long as it is in use, :meth:`linearise` finds it again."""
        total = self.session.of_boundary(values)
        step = self._imposed(lambda part: total if part == 1.0 else part * total, steps, repair, progress)
        self._last = values, steps, repair, weakref.ref(step)
        return step

    def _imposed(
        self, motion: BoundaryMotion, steps: int | str | None, repair: Mode | None, progress: Progress | None
    ) -> Step:
        timing, setup = Timing(), self.session.setup
        setup = setup if repair is None else setup.with_repair(repair)
        result = impose(setup, motion, steps, setup.grid.precision, timing, progress, self._method(timing))
        return Step(result, self.session.plane)

    def _method(self, timing: Timing) -> PreparedMethod:
        if self._prepared is None:
            with timing.stage("prepare"):
                self._prepared = self.session.setup.prepare()
        return self._prepared

    def _displacement_values(self, displacement: Displacement, time: float) -> FloatArray:
        """The displacement (n_moving, 3) of the moving nodes."""
        if isinstance(displacement, Mapping):
            if set(displacement) != set(self.patches):
                given, known = (", ".join(map(repr, names)) or "none" for names in (displacement, self.patches))
                raise MotionError(f"displacement is given for the patches {given}; expected all moving ones: {known}")
            values = np.full((len(self.points), 3), np.nan)
            for name, rows in self.patches.items():
                part = self.session.checked(displacement[name], f"displacement[{name!r}]", len(rows))
                twice = np.isfinite(values[rows, 0])
                shared, first, second = rows[twice], values[rows[twice]], part[twice]
                edges = self.session.setup.topology.edge[self.session.numbers[shared]]
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
            values = self.session.checked(own, what, len(self.points))
        else:
            values = self.session.checked(displacement, "displacement", len(self.points))
        return np.where(np.abs(values) < SMALLEST, 0.0, values)

    def __getstate__(self) -> dict[str, Any]:
        """The state of a copy, without the prepared method: the copy prepares it again."""
        if self.session.ranks.count > 1:
            raise TypeError("a Mesh of several MPI ranks cannot be copied or pickled; prepare it where it is needed")
        lasting = {name: value for name, value in self.__dict__.items() if name != "patches"}
        return {**lasting, "_prepared": None, "_last": None}

    def __repr__(self) -> str:
        patches = ", ".join(self.patches)
        return f"Mesh({self.method}, {len(self.points):,} moving nodes of {patches}; {self.grid!r})"


class Repeated:
    """Steps of a mesh that are all imposed in one way; the last one is kept, and so is its derivative."""

    def __init__(self, mesh: Mesh, steps: int | Literal["auto"], repair: Mode):
        self.mesh, self._steps, self._repair = mesh, steps, repair
        self._step: Step | None = None
        self._at: FloatArray = np.empty((0, 3))
        self._derivative: Linearisation | None = None

    def step(self, displacement: FloatArray) -> Step:
        """The step for a displacement (n_moving, 3)."""
        # As long as it is kept, its derivative does not deform the grid again.
        self._step = self.mesh.deform(displacement, steps=self._steps, repair=self._repair)
        return self._step

    def derivative(self, displacement: FloatArray, warn: Callable[[str], object]) -> Linearisation:
        """The derivative there; ``warn`` is called once if it is not that of the step."""
        if self._derivative is None or not np.array_equal(displacement, self._at):
            found = self.mesh.linearise(displacement, steps=self._steps, repair=self._repair)
            self._at, self._derivative = displacement.copy(), found
            if not found.exact:
                warn(f"the derivative is not that of the grid: {found.reason}")
        return self._derivative
