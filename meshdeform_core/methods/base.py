"""The interface of deformation methods: their input and the protocols they implement.

A method is a frozen dataclass of the user's options. ``prepare(problem)`` does everything that depends on the
undeformed grid only; ``apply(displacement)`` of the prepared method is the cost of every time step.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any, Protocol

import numpy as np

from ..boundary import Boundary, Kind
from ..boundary.constraints import Layer
from ..grid import FloatArray, Grid, IntArray, Side
from ..grid.planes import plane_normal
from ..grid.topology import Topology, side_nodes
from ..grid.windows import end_planes, side_numbers
from ..memory import UNLIMITED, MemoryLimit
from ..numerics.arrays import distinct_pairs, places_among, total
from ..numerics.geometry.coincidence import distinct, integers
from ..numerics.geometry.vectors import face_sizes
from ..numerics.rotation import SurfaceRotations
from ..wording import Notice

_FACES = 250_000
"""Faces whose areas are computed at a time, which bounds the memory."""

Progress = Callable[[str, int, int], None]
"""``progress(stage, done, total)``; called only by the thread that started the computation."""


def of_stage(progress: Progress | None, stage: str) -> Callable[[int, int], None] | None:
    """A callback ``(done, total)`` that reports the progress of one stage."""
    return None if progress is None else partial(progress, stage)


@dataclass(frozen=True)
class Surface:
    """Faces between sources, from which nodal areas and rotations are computed; indices refer to sources.

    ``area`` (n_sources,) has a quarter of each face beside a source (half of each edge in 2-D), ``corners`` (c, 3)
    node, next and previous node of each corner of a moving face (in 2-D (c, 2) edge ends), ``edges`` (e, 2) node and
    neighbour along moving faces, each pair once.
    """

    area: FloatArray
    corners: IntArray
    edges: IntArray


@dataclass(frozen=True, eq=False, repr=False)
class Problem:
    """One undeformed grid with its classified boundary: the input of ``prepare``.

    The sources are the unique nodes with known displacement (moving and fixed), N_s in the paper. ``memory`` limits
    what methods may allocate; nodes that follow others in a ``layer`` of cells are not sought.
    """

    grid: Grid
    topology: Topology
    boundary: Boundary
    memory: MemoryLimit = UNLIMITED
    layer: Layer | None = None

    def __repr__(self) -> str:
        return f"Problem({self.grid!r})"

    @cached_property
    def source_numbers(self) -> IntArray:
        """Unique node numbers of the sources, ascending."""
        return np.flatnonzero(self.boundary.known).astype(np.int64)

    @cached_property
    def source_flat(self) -> IntArray:
        """Flat indices of the sources."""
        return self.topology.first[self.source_numbers]

    @cached_property
    def source_points(self) -> FloatArray:
        """Coordinates (n_sources, 3)."""
        return np.asarray(self.grid.nodes.at(self.source_flat))

    @cached_property
    def plane_normal(self) -> FloatArray | None:
        """Unit normal of a 2-D grid, ``None`` in 3-D."""
        return plane_normal(self.grid)

    @cached_property
    def plane(self) -> bool:
        """Whether the grid is 2-D or a single layer of cells, so that its sources lie along curves."""
        return self.grid.dimension == 2 or bool(end_planes(self.grid, self.topology))

    @cached_property
    def surface(self) -> Surface:
        """Faces between the sources."""
        count, corners, kind = self.topology.n_unique, self.topology.quads.corners, self.boundary.quad_kind
        # Corners of faces; indices refer to sources, -1 to other nodes.
        local = places_among(self.source_numbers, count).astype(integers(count))
        every, quads = local[corners[kind >= Kind.FIXED]], local[corners[kind == Kind.MOVING]]
        every = every[(every >= 0).all(axis=1)]
        area, sides = np.zeros(len(self.source_points)), every.shape[1]
        for lo in range(0, len(every), _FACES):
            some = every[lo : lo + _FACES]
            share = np.repeat(face_sizes(self.source_points[some]) / sides, sides)
            area = area + np.bincount(some.ravel(), share, minlength=len(area))
        if quads.shape[1] == 2:
            return Surface(area, quads, np.empty((0, 2), dtype=np.int64))
        around = [np.roll(quads, shift, axis=1) for shift in (0, -1, 1)]
        corners = np.stack([a.ravel() for a in around], axis=1)
        pairs = np.concatenate([corners[:, :2], corners[:, ::2]])
        return Surface(area, corners, distinct_pairs(pairs[pairs[:, 0] != pairs[:, 1]]))

    @cached_property
    def rotations(self) -> SurfaceRotations:
        """Rotations of the moving walls; zero at the other sources."""
        return SurfaceRotations(self.source_points, self.surface.corners, self.surface.edges, self.plane_normal)

    def forget(self) -> None:
        """Free the arrays of sources and their surface, which are computed again when asked for; for a problem of which
        no method is prepared any more."""
        for name in ("source_flat", "source_points", "surface", "rotations", "first_cell_height"):
            self.__dict__.pop(name, None)

    @cached_property
    def first_cell_height(self) -> FloatArray:
        """Smallest distance (n_sources,) from each source to the next node off the wall, over its faces."""
        topology, grid = self.topology, self.grid
        height = np.full(topology.n_unique, np.inf)
        known = self.boundary.quad_kind >= Kind.FIXED
        for block_side in distinct(topology.quads.block_side[known], 6 * grid.n_blocks):
            block, side = int(block_side) // 6, Side(int(block_side) % 6)
            flat = side_nodes(grid, block, side).ravel()
            wall, off = grid.nodes.at(np.stack([flat, flat + grid.sides.inward[block_side]]))
            gap = np.linalg.norm(off - wall, axis=1)
            np.minimum.at(height, side_numbers(grid, topology, block, side).ravel(), np.where(gap > 0, gap, np.inf))
        own = height[self.source_numbers]
        return np.where(np.isfinite(own), own, topology.edge[self.source_numbers])

    @cached_property
    def n_unique_nodes(self) -> int:
        """Number of nodes with coincident ones counted once (N_s + N_v)."""
        return self.grid.n_nodes - len(self.topology.face_nodes) + self.topology.n_unique

    @cached_property
    def centroid(self) -> FloatArray:
        """Mean of all unique nodes (eq. 17)."""
        t = self.topology
        whole = self.grid.total_of(self.grid.points) - total(self.grid.nodes.at(t.face_nodes))
        return np.asarray((whole + total(self.grid.nodes.at(t.first))) / self.n_unique_nodes)


@dataclass(frozen=True)
class Setting:
    """A parameter as used: its value and, if the program chose it, the reason."""

    value: Any
    reason: str = ""


@dataclass
class Account:
    """The report of a prepared method: parameters with reasons, counts, and the last warning of each kind."""

    settings: dict[str, Setting] = field(default_factory=dict)
    notices: dict[str, str] = field(default_factory=dict)

    def note(self, kind: str, warning: str | None) -> None:
        """Set the warning of a kind; ``None`` withdraws that of an earlier displacement."""
        self.notices.pop(kind, None)
        if warning:
            self.notices[kind] = Notice(warning, kind)

    @property
    def warnings(self) -> list[str]:
        return list(self.notices.values())

    def include(self, other: Account) -> None:
        """Add the report of another part of the method."""
        self.settings |= other.settings
        self.notices |= other.notices


Kinks = Counter[str]
"""Numbers of places by kind, one of the texts in :mod:`.limits`, in which ``{}`` stands for the number."""


@dataclass(frozen=True)
class Linearised:
    """Derivative of the displacement of all block nodes with respect to that of the sources: ``push`` gives the change
    (n_nodes, 3) for a change (n_sources, 3) of the sources, ``pull`` the gradient (n_sources, 3) from that (n_nodes, 3)
    of all block nodes, which is overwritten; ``kinks`` why it is not the derivative of the displacement field."""

    push: Callable[..., Any]
    pull: Callable[..., FloatArray]
    kinks: Kinks = field(default_factory=Kinks)


class PreparedMethod(Protocol):
    """A method prepared on one undeformed grid."""

    @property
    def account(self) -> Account:
        """Parameters as used, with reasons, and warnings."""
        ...

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]:
        """Warnings for a displacement (n_sources, 3) before it is applied; ``step`` is the first increment."""
        ...

    def apply(self, displacement: FloatArray, progress: Progress | None = None) -> FloatArray:
        """Displacement (n_nodes, 3) of all block nodes from that of the sources (n_sources, 3).

        A new array from :func:`meshdeform_core.parallel.empty`, owned by the caller.
        """
        ...

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative at a displacement (n_sources, 3)."""
        ...


class PreparedInterpolation(Protocol):
    """A scattered-data method (IDW, RBF) bound to the sources of a problem and its target nodes ``flat`` of this rank:
    coordinates ``problem.grid.nodes.rows[flat]``, rows ``Nodes.of(out).rows[flat]`` of an array ``out`` (n_nodes, 3).

    No target is a source, as :mod:`.composite` sets these. A result that depends on the order of nodes, as of the first
    of equals, is an error. ``account`` and ``warnings_for`` as of :class:`PreparedMethod`.
    """

    account: Account

    def warnings_for(self, motion: FloatArray, step: FloatArray) -> list[str]: ...

    def fit(self, displacement: FloatArray, progress: Progress | None = None) -> Any:
        """Fit the displacement (n_sources, 3) of the sources; returns the coefficients for the evaluation."""
        ...

    def evaluate(self, fit: Any, out: FloatArray, progress: Progress | None = None) -> None:
        """Write the displacement of the targets into their rows of ``out`` (n_nodes, 3)."""
        ...

    def linearised(self, displacement: FloatArray) -> Linearised:
        """The derivative of the displacement of the targets at a displacement (n_sources, 3).

        ``push(change, out)`` writes the change of the nodes into their rows of ``out`` (n_nodes, 3), and
        ``pull(gradient)`` returns the gradient (n_sources, 3) from these rows: ``problem.grid.nodes.total`` of what
        each rank finds from its own.
        """
        ...


class Mover(Protocol):
    """Options of a scattered-data method, which bind it to a problem and its target nodes ``flat``."""

    def bind(self, problem: Problem, flat: IntArray) -> PreparedInterpolation: ...
