"""A grid warped by a distributed solver, which passes and receives the pieces of each rank."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.errors import CaseError, GridError, MotionError
from meshdeform_core.grid import FloatArray, Grid, IntArray
from meshdeform_core.parallel import Ranks, sharing
from meshdeform_core.wording import vector

from ..grid import read, wrapped, write
from ..pieces import gathered, share_of, summed
from ..session import one_at_a_time, ranks_of_comm
from .component import Component, Zones
from .options import Options
from .surface import Definition, match, require_found, rows_of_file, rows_of_freedoms

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


class Warp:
    """The grid of a file, whose groups of zones follow one surface; every rank must make the same calls.

    Every rank holds the whole grid, as the solver may ask for any of its nodes; the first rank deforms it, on all cores
    of its machine.

    Parameters
    ----------
    groups : zones (numbers from 0) that move together, with their options; zones in no group do not move
    """

    def __init__(self, grid: Grid, groups: list[tuple[IntArray, Options]], ranks: Ranks):
        if grid.dimension != 3:
            raise GridError(f"{grid.path}: a plane grid; expected one in space, at least one cell thick")
        self._grid, self._ranks = grid, ranks
        with one_at_a_time(), sharing(Ranks(ranks.cores), None):
            self._zones = [Zones(grid, zones, options) for zones, options in groups]
        self._solver_rows: IntArray | None = None
        self._components: list[Component] = []
        self._surface = self._start = np.empty((0, 3))
        self._still: IntArray = np.empty(0, dtype=np.int64)
        self._gradient = np.empty((0, 3))
        self._points = grid.points

    @property
    def grid(self) -> Grid:
        """The grid as the file has it."""
        return self._grid

    @property
    def defined(self) -> bool:
        """Whether the surface has been defined."""
        return bool(self._components)

    @property
    def own_rows(self) -> IntArray:
        """Rows of ``grid.points`` of this rank's share of the nodes, in the order of the file."""
        own = share_of(self._grid.n_nodes, self._ranks)
        return rows_of_file(self._grid, np.arange(own.start, own.stop))

    @property
    def knows_solver_nodes(self) -> bool:
        """Whether :attr:`solver_rows` are known."""
        return self._solver_rows is not None

    def by_component(self) -> tuple[list[FloatArray], int]:
        """Deformed coordinates (3 n,) of this rank's share of each component, and the number of coordinates of all."""
        found, total = [], 0
        for zones in self._zones:
            ends = self._grid.offsets[zones.zones], self._grid.offsets[zones.zones + 1]
            numbers = np.concatenate([np.arange(low, high) for low, high in zip(*ends, strict=True)])
            own = numbers[share_of(len(numbers), self._ranks)]
            found.append(self.coordinates(rows_of_file(self._grid, own)))
            total += 3 * len(numbers)
        return found, total

    @property
    def solver_rows(self) -> IntArray:
        """Rows of ``grid.points`` of the nodes that the solver holds on this rank.

        Raises
        ------
        CaseError
            Before they are set.
        """
        if self._solver_rows is None:
            raise CaseError("the solver's nodes are not known; expected a call of setExternalMeshIndices first")
        return self._solver_rows

    def set_solver_nodes(self, indices: ArrayLike) -> None:
        """The degrees of freedom that the solver holds on this rank."""
        self._solver_rows = rows_of_freedoms(self._grid, indices)

    def define(self, definition: Definition) -> None:
        """Define the surface by this rank's points and faces, which are located on the undeformed grid."""
        first = sum(self._ranks.gather([len(definition.points)])[: self._ranks.number])
        own = definition.moved_by(first)
        whole = Definition(*(gathered(self._ranks, part) for part in (own.points, own.faces, own.zone)))
        times, matches = np.zeros(len(whole.faces), dtype=np.int64), []
        for zones in self._zones:
            asked = np.flatnonzero((whole.zone < 0) | np.isin(whole.zone, zones.zones))
            matches.append(match(zones.grid, zones.topology, whole, asked))
            times += matches[-1].found
        moving = np.concatenate([zones.zones for zones in self._zones])
        require_found(whole, np.where((whole.zone < 0) | np.isin(whole.zone, moving), times, 1))
        self._surface = self._start = own.points
        self._begin([(m.quads, (m.point, m.node)) for m in matches])

    def define_from_file(self) -> None:
        """Define the surface by the families that the options select; its nodes are divided among the ranks."""
        found, points, count = [], [], 0
        for zones in self._zones:
            quads = zones.wall_quads()
            nodes = np.unique(zones.topology.quads.corners[quads])
            found.append((quads, (count + np.arange(len(nodes)), nodes)))
            points.append(zones.grid.points[zones.topology.first[nodes]])
            count += len(nodes)
        self._surface = self._start = np.concatenate(points)[share_of(count, self._ranks)]
        self._begin(found)

    def _begin(self, found: list[tuple[IntArray, tuple[IntArray, IntArray]]]) -> None:
        pairs = list(zip(self._zones, found, strict=True))
        if not all(len(quads) for quads, _ in found):
            empty_zones = next(zones for zones, (quads, _) in pairs if not len(quads))
            raise CaseError(
                f"no face of the surface lies on {', '.join(empty_zones.grid.names[:4])}; expected a surface for every "
                f"component with options"
            )
        self._components = [Component(zones, *each) for zones, each in pairs]
        count = sum(self._ranks.gather([len(self._surface)]))
        used = np.concatenate([component.point for component in self._components])
        self._still = np.setdiff1d(np.arange(count), used)
        self._points = self._grid.points
        self._gradient = np.zeros_like(self._surface)

    @property
    def surface(self) -> FloatArray:
        """This rank's points of the surface (n, 3), as they were set."""
        if not self._components:
            self.define_from_file()
        return self._surface.copy()

    def set_surface(self, points: ArrayLike) -> None:
        """New positions of this rank's points."""
        expected = self.surface.shape
        values = np.array(points, dtype=np.float64)
        if values.shape != expected and values.size != expected[0] * 3:
            raise MotionError(f"surface coordinates have the shape {values.shape}; expected {expected}")
        if not np.isfinite(values).all():
            raise MotionError("surface coordinates contain values that are not finite; expected numbers")
        self._surface = values.reshape(-1, 3)

    def warp(self) -> None:
        """Deform the grid to the surface's new position; an invalid grid causes a warning on every rank."""
        self.surface  # noqa: B018  (the surface of the file, if none was defined)
        whole = gathered(self._ranks, self._surface)
        self._require_still(whole)

        def warped() -> tuple[FloatArray, list[str]]:
            points, found = self._grid.points.copy(), []
            for number, component in enumerate(self._components, 1):
                step, apart = component.warp(whole)
                where = f" of component {number}" if len(self._components) > 1 else ""
                if apart:
                    found.append(f"copies of surface points are up to {apart:.3g} edges apart; they get their mean")
                if not step.valid:
                    first = step.invalid_cells[0] if step.invalid_cells else None
                    found.append(f"the warped grid{where} is invalid: {step!r}; first {first}")
                component.put(points)
            return points, found

        self._points, found = self._ranks.on_first(warped)
        for text in found:
            warnings.warn(text, stacklevel=3)

    def _require_still(self, whole: FloatArray) -> None:
        if not self._still.size:
            return
        moved = np.any(whole[self._still] != gathered(self._ranks, self._start)[self._still], axis=1)
        if moved.any():
            raise MotionError(
                f"{moved.sum():,} surface points moved that lie on zones without options, the first to "
                f"{vector(whole[self._still[np.argmax(moved)]])}; expected points that stay, or options for the zones"
            )

    def coordinates(self, rows: IntArray) -> FloatArray:
        """Deformed coordinates (3 n,) of some rows of ``grid.points``."""
        return self._points[rows].ravel()

    def forward(self, change: ArrayLike, rows: IntArray) -> FloatArray:
        """Change (3 n,) of the nodes ``rows`` for a ``change``, (n, 3) or flat, of this rank's points."""
        own = np.asarray(change, dtype=np.float64).reshape(-1, 3)
        if own.shape != self.surface.shape:
            raise MotionError(f"dXs has {own.size} values; expected {self._surface.size}")
        whole = gathered(self._ranks, own)

        def forward() -> tuple[FloatArray, list[str]]:
            moved = np.zeros_like(self._grid.points)
            for component in self._components:
                moved[component.rows] = component.forward(whole)
            return moved, self._reasons()

        moved, reasons = self._ranks.on_first(forward)
        _tell_of(reasons)
        return np.asarray(moved[rows]).ravel()

    def reverse(self, gradient: ArrayLike, rows: IntArray) -> FloatArray:
        """Gradient (n, 3) of this rank's points from that (3 n,) of the nodes ``rows``, which may repeat."""
        own = np.asarray(gradient, dtype=np.float64).reshape(-1, 3)
        if len(own) != len(rows):
            raise GridError(f"dXv has {own.size} values; expected {3 * len(rows)}")
        count = len(self.surface)
        total = summed(self._ranks, self._grid.n_nodes, rows, own)
        sizes = self._ranks.gather([count])

        def reverse() -> tuple[FloatArray, list[str]]:
            whole = np.zeros((sum(sizes), 3))
            for component in self._components:
                component.reverse(total, whole)
            return whole, self._reasons()

        whole, reasons = self._ranks.on_first(reverse)
        _tell_of(reasons)
        first = sum(sizes[: self._ranks.number])
        self._gradient = whole[first : first + count]
        return self._gradient

    @property
    def gradient(self) -> FloatArray:
        """The gradient (n, 3) computed by the last :meth:`reverse`."""
        return self._gradient.copy()

    def _reasons(self) -> list[str]:
        """Why the derivatives of components are not those of the warped grid."""
        return [reason for component in self._components if (reason := component.derivative().reason)]

    def write(self, name: str) -> None:
        """The deformed grid as a copy of the file, made by the first rank."""
        moved = wrapped(self._grid.moved(self._points))
        self._ranks.on_first(lambda: write(moved, name, force=True))


def _tell_of(reasons: list[str]) -> None:
    for reason in reasons:
        warnings.warn(f"the derivative is not that of the warped grid: {reason}", stacklevel=4)


def grid_of(name: str, file_type: str, ranks: Ranks) -> Grid:
    """The structured grid of a file.

    Raises
    ------
    CaseError
        When the file is of another type than ``file_type``.
    """
    with one_at_a_time(), sharing(Ranks(ranks.cores), None):
        grid = read(name).core
    found = grid.format.name if grid.format else ""
    if found != file_type.lower():
        raise CaseError(f"{name}: found a file of type {found}; fileType is {file_type!r}")
    return grid


def ranks_of(comm: Comm | None) -> tuple[Comm | None, Ranks]:
    """The communicator, by default that of all ranks, and its ranks; a process alone needs no mpi4py."""
    from importlib.util import find_spec

    if comm is None and find_spec("mpi4py"):
        from mpi4py import MPI

        comm = MPI.COMM_WORLD
    if comm is None or comm.size == 1:
        return None, Ranks()
    return comm, ranks_of_comm(comm)
