"""``USMesh`` and ``MultiUSMesh`` with the interface of IDWarp (mdolab), for solvers and scripts that call it.

    from meshdeform.compat.idwarp import USMesh

    mesh = USMesh(options={"gridFile": "wing.cgns"}, comm=MPI.COMM_WORLD)

Written from the documented behaviour and from the use that callers make of it; docs/guides/idwarp.md says which options
are honoured, mapped or refused. Nothing is fixed: outside nodes on neither surface nor symmetry plane move freely.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from importlib.util import find_spec
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.errors import CaseError, GridError, MotionError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.parallel import Ranks, sharing
from meshdeform_core.wording import vector

from ..grid import read, wrapped, write
from ..mesh import one_at_a_time
from ..tasks import ranks_of_comm
from .component import Component, Definition, defined, require_found, rows_of_freedoms
from .options import NOTES, Options, known_name

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

__all__ = ["MultiUSMesh", "USMesh"]


class _Interface:
    """Interface common to both kinds of mesh. All calls are collective.

    Every rank holds the whole grid, as the solver may ask for any of its nodes; the first rank deforms it, on all cores
    of its machine.

    Parameters
    ----------
    options : those of each component, by the part of its zones' names before the dot; of all zones by an empty name
    """

    def __init__(self, file: str, kind: str, comm: Comm | None, options: Mapping[str, Options]):
        if comm is None and find_spec("mpi4py"):
            from mpi4py import MPI

            comm = MPI.COMM_WORLD
        # A process alone needs no mpi4py.
        self._ranks: Ranks = ranks_of_comm(None if comm is None or comm.size == 1 else comm)
        self._file = file
        with one_at_a_time(), sharing(threads=self._ranks.cores):
            grid = read(file).core
            found = grid.format.name if grid.format else ""
            if found != kind.lower():
                raise CaseError(f"{file}: found a file of type {found}; fileType is {kind!r}")
            if grid.dimension != 3:
                raise GridError(f"{file}: a plane grid; expected one in space, at least one cell thick")
            member = np.array([name.split(".")[0].lower() for name in grid.names])
            groups = {
                name: np.flatnonzero(member == name.lower()) if name else np.arange(grid.n_blocks) for name in options
            }
            for name, zones in groups.items():
                if not zones.size:
                    known = ", ".join(dict.fromkeys(member.tolist()))
                    raise CaseError(f"no zone of component {name!r}; expected some of {known}")
            # In the order of the file, as IDWarp has its instances.
            ordered = sorted(groups.items(), key=lambda group: int(group[1][0]))
            self._components = [Component(grid, zones, options[name]) for name, zones in ordered]
        self._grid, self._points = grid, grid.points
        # Rows of the grid's points in the order of the file, i fastest in each zone, and those of this rank's share.
        every = np.split(np.arange(grid.n_nodes), grid.offsets[1:-1])
        self._in_file = np.concatenate([
            rows.reshape(shape).ravel(order="F") for rows, shape in zip(every, grid.shapes, strict=True)
        ])  # fmt: skip
        self._own_rows = self._in_file[self._ranks.share(grid.n_nodes)]
        self._freedoms: IntArray | None = None
        self._begun = False
        self._surface = self._start = self._gradient = np.empty((0, 3))
        self._still: IntArray = np.empty(0, dtype=np.int64)

    def setExternalMeshIndices(self, ind: ArrayLike) -> None:
        """The degrees of freedom (3 n,) that the solver holds on this rank.

        The number of a node is zone offset + (k - 1) ni nj + (j - 1) ni + (i - 1), with zones in the order of the file;
        its x, y, z have three times that number plus 0, 1, 2. Nodes may repeat.
        """
        self._freedoms = rows_of_freedoms(self._in_file, ind)

    def setSurfaceDefinitionFromFile(self, surfFile: str) -> None:
        """The surface from a Plot3D file with a block for each patch; the first rank holds its points."""
        points, faces = _surface_file(surfFile)
        own = slice(None) if self._ranks.number == 0 else slice(0)
        self._define(defined(points[own], faces[own], np.full(len(faces[own]), 4), None))

    def setSurfaceFromFile(self, surfFile: str) -> None:
        """New surface coordinates from a file like that of :meth:`setSurfaceDefinitionFromFile`."""
        points = _surface_file(surfFile)[0]
        self.setSurfaceCoordinates(points if self._ranks.number == 0 else points[:0])

    def getSurfaceCoordinates(self) -> FloatArray:
        """This rank's points (n, 3), exactly as they were set."""
        if not self._begun:
            # The families that the options select; their nodes are divided among the ranks.
            found, points, count = [], [], 0
            for component in self._components:
                quads = component.wall_quads()
                nodes = np.unique(component.topology.quads.corners[quads])
                found.append((quads, (count + np.arange(len(nodes)), nodes)))
                points.append(component.grid.points[component.topology.first[nodes]])
                count += len(nodes)
            self._begin(np.concatenate(points)[self._ranks.share(count)], found)
        return self._surface.copy()

    def setSurfaceCoordinates(self, coordinates: ArrayLike) -> None:
        """Set the new positions (n, 3) of this rank's points; :meth:`warpMesh` then moves the grid."""
        expected, values = self.getSurfaceCoordinates().shape, np.array(coordinates, dtype=np.float64)
        if values.shape != expected and values.size != expected[0] * 3:
            raise MotionError(f"surface coordinates have the shape {values.shape}; expected {expected}")
        if not np.isfinite(values).all():
            raise MotionError("surface coordinates contain values that are not finite; expected numbers")
        self._surface = values.reshape(-1, 3)

    def warpMesh(self) -> None:
        """Move the grid. An invalid grid causes a warning only, as solvers have checks of their own."""
        whole = self._ranks.collect(self.getSurfaceCoordinates())
        moved = np.any(whole[self._still] != self._ranks.collect(self._start)[self._still], axis=1)
        if moved.any():
            raise MotionError(
                f"{moved.sum():,} surface points moved that lie on zones without options, the first to "
                f"{vector(whole[self._still[np.argmax(moved)]])}; expected points that stay, or options for the zones"
            )

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
            warnings.warn(text, stacklevel=2)

    def getSolverGrid(self) -> FloatArray:
        """The solver's nodes (3 n,) on this rank; wall nodes are exactly where they were set."""
        return self._points[self._rows(True)].ravel()

    def getCommonGrid(self) -> FloatArray:
        """This rank's share (3 n,) of all nodes, which are divided evenly in the order of the file."""
        return self._points[self._own_rows].ravel()

    def getdXs(self) -> FloatArray:
        """The gradient (n, 3) of this rank's points computed by the last :meth:`warpDeriv`."""
        return self._gradient.copy()

    def warpDerivFwd(self, dXs: ArrayLike, solverVec: bool = True) -> FloatArray:
        """Change (3 n,) of the solver's nodes, or of those of :meth:`getCommonGrid`, for a change of the points.

        ``dXs`` is (n, 3) or flat.
        """
        rows, own = self._rows(solverVec), np.asarray(dXs, dtype=np.float64).reshape(-1, 3)
        if own.shape != self.getSurfaceCoordinates().shape:
            raise MotionError(f"dXs has {own.size} values; expected {self._surface.size}")
        whole = self._ranks.collect(own)

        def forward() -> FloatArray:
            moved = np.zeros_like(self._grid.points)
            for component in self._components:
                moved[component.rows] = component.forward(whole)
            return moved

        return np.asarray(self._differentiated(forward)[rows]).ravel()

    def _reverse(self, gradient: ArrayLike, rows: IntArray) -> FloatArray:
        """Gradient (n, 3) of this rank's points from that (3 n,) of the nodes ``rows``, which may repeat."""
        own = np.asarray(gradient, dtype=np.float64).reshape(-1, 3)
        if len(own) != len(rows):
            raise GridError(f"dXv has {own.size} values; expected {3 * len(rows)}")
        count = len(self.getSurfaceCoordinates())
        sizes, total = self._ranks.gather([count]), np.zeros_like(self._grid.points)
        np.add.at(total, self._ranks.collect(rows), self._ranks.collect(own))

        def reverse() -> FloatArray:
            whole = np.zeros((sum(sizes), 3))
            for component in self._components:
                component.reverse(total, whole)
            return whole

        first = sum(sizes[: self._ranks.number])
        self._gradient = self._differentiated(reverse)[first : first + count]
        return self._gradient

    def _differentiated(self, product: Callable[[], FloatArray]) -> FloatArray:
        """A product with the derivative, taken by the first rank; where it is not that of the grid, all say so."""

        def product_and_reasons() -> tuple[FloatArray, list[str]]:
            return product(), [reason for each in self._components if (reason := each.derivative().reason)]

        found, reasons = self._ranks.on_first(product_and_reasons)
        for reason in reasons:
            warnings.warn(f"the derivative is not that of the warped grid: {reason}", stacklevel=4)
        return found

    def writeGrid(self, fileName: str | None = None) -> None:
        """The grid as a copy of its file, by default beside it with ``_warped`` in its name."""
        source, moved = Path(self._file), wrapped(self._grid.moved(self._points))
        target = fileName or str(source.with_name(f"{source.stem}_warped{source.suffix}"))
        self._ranks.on_first(lambda: write(moved, target, force=True))

    @property
    def warp(self) -> SimpleNamespace:
        """Sizes as callers ask for them: ``warp.griddata.warpmeshdof``, ``solvermeshdof``, ``commonmeshdof``."""
        own, solver = 3 * len(self._own_rows), 0 if self._freedoms is None else 3 * len(self._freedoms)
        return SimpleNamespace(griddata=SimpleNamespace(warpmeshdof=own, commonmeshdof=own, solvermeshdof=solver))

    def _rows(self, solver: bool) -> IntArray:
        """Rows of the grid's points of the nodes that the solver holds on this rank, or of this rank's share of all."""
        if solver and self._freedoms is None:
            raise CaseError("the solver's nodes are not known; expected a call of setExternalMeshIndices first")
        return self._freedoms if solver and self._freedoms is not None else self._own_rows

    def _define(self, definition: Definition) -> None:
        """Define the surface by this rank's points and faces, which are located on the undeformed grid."""
        first = sum(self._ranks.gather([len(definition.points)])[: self._ranks.number])
        parts = definition.points, definition.faces + first, definition.zone
        whole = Definition(*(self._ranks.collect(part) for part in parts))
        times, found = np.zeros(len(whole.faces), dtype=np.int64), []
        for component in self._components:
            faces, quads, pairs = component.match(whole)
            times += faces
            found.append((quads, pairs))
        moving = np.concatenate([component.zones for component in self._components])
        require_found(whole, np.where((whole.zone < 0) | np.isin(whole.zone, moving), times, 1))
        self._begin(definition.points, found)

    def _begin(self, surface: FloatArray, found: list[tuple[IntArray, tuple[IntArray, IntArray]]]) -> None:
        """Take this rank's points; ``found`` are face quads, and points with their nodes, of every component."""
        for component, (quads, pairs) in zip(self._components, found, strict=True):
            if not len(quads):
                raise CaseError(
                    f"no face of the surface lies on {', '.join(component.grid.names[:4])}; expected a surface for "
                    f"every component with options"
                )
            component.begin(quads, *pairs)
        used = np.concatenate([component.point for component in self._components])
        self._still = np.setdiff1d(np.arange(sum(self._ranks.gather([len(surface)]))), used)
        self._surface = self._start = surface
        self._points, self._gradient, self._begun = self._grid.points, np.zeros_like(surface), True


class USMesh(_Interface):
    """A grid that moves with its surface.

    Parameters
    ----------
    options : see docs/guides/idwarp.md; names are not case-sensitive
    comm : communicator of the ranks that share it; all ranks by default
    debug : ignored

    Raises
    ------
    CaseError
        Without options, and for unknown or refused ones.
    """

    def __init__(self, options: Mapping[str, Any] | None = None, comm: Comm | None = None, debug: bool = False) -> None:
        own = self._options = Options.of(options)
        super().__init__(own.gridFile, own.fileType, comm, {"": own})

    def setSurfaceDefinition(
        self, pts: ArrayLike, conn: ArrayLike, faceSizes: ArrayLike, cgnsBlockID: ArrayLike | None = None
    ) -> None:
        """The solver's surface on this rank: undeformed points (n, 3), corners of the faces from 0, 3 or 4 each.

        Points may repeat; a rank may have none. ``cgnsBlockID``: the zone of each face, from 1.
        """
        self._define(defined(pts, conn, faceSizes, cgnsBlockID))

    def getWarpGrid(self) -> FloatArray:
        """As :meth:`getCommonGrid`, as the order of the file is the only one."""
        return self.getCommonGrid()

    def getOption(self, name: str) -> Any:
        """Value of an option."""
        return getattr(self._options, known_name(name))

    def setOption(self, name: str, value: Any) -> None:
        """Change an option before the surface is defined."""
        if self._begun:
            raise CaseError(f"setOption({name!r}) after the surface was defined; expected options before that")
        self._options.set(name, value)

    def printOptions(self) -> None:
        """Print every option with its value, and its meaning here where that differs from IDWarp's."""
        if self._ranks.number == 0:
            for name in self._options.__struct_fields__:
                note = f"  ({NOTES[name]})" if name in NOTES else ""
                print(f"{name:20} {getattr(self._options, name)!r}{note}")

    def warpDeriv(self, dXv: ArrayLike, solverVec: bool = True) -> None:
        """Apply the transposed derivative to the gradient (3 n,) of the nodes; :meth:`getdXs` returns the result.

        Gradients of solver nodes that repeat are added.
        """
        self._reverse(dXv, self._rows(solverVec))


class MultiUSMesh(_Interface):
    """Components of overset grids in one file, which move independently by their surfaces.

    Parameters
    ----------
    CGNSFile : grid file; the component of a zone is the part of its name before the dot
    optionsDict : options (see :class:`USMesh`) of components by name; components without options do not move
    comm : communicator of the ranks that share it; all ranks by default
    dtype : ``"d"``; complex numbers are refused
    debug : ignored

    Raises
    ------
    CaseError
        For an unknown component, unknown or refused options.
    """

    def __init__(
        self, CGNSFile: str, optionsDict: Mapping[str, Mapping[str, Any]], comm: Comm | None = None,
        dtype: str = "d", debug: bool = False,
    ) -> None:  # fmt: skip
        if dtype != "d":
            raise CaseError(f"dtype = {dtype!r}; expected 'd': derivatives do not need complex numbers")
        if not optionsDict:
            raise CaseError("optionsDict is empty; expected options for at least one component")
        file = str(CGNSFile)
        own = {name: Options.of({**options, "gridFile": file}) for name, options in optionsDict.items()}
        super().__init__(file, "CGNS", comm, own)

    def setSurfaceDefinition(
        self, pts: ArrayLike, conn: ArrayLike, faceSizes: ArrayLike, cgnsBlockIDs: ArrayLike | None = None
    ) -> None:
        """As :meth:`USMesh.setSurfaceDefinition`, after :meth:`setExternalMeshIndices`."""
        # Refuses the wrong order.
        self._rows(True)
        self._define(defined(pts, conn, faceSizes, cgnsBlockIDs))

    def getWarpGrid(self) -> tuple[list[FloatArray], int]:
        """This rank's share (3 n,) of the nodes of each component that moves, and the number of coordinates of all."""
        found, total = [], 0
        for component in self._components:
            ends = [slice(*self._grid.offsets[zone : zone + 2]) for zone in component.zones]
            rows = np.concatenate([self._in_file[each] for each in ends])
            found.append(self._points[rows[self._ranks.share(len(rows))]].ravel())
            total += 3 * len(rows)
        return found, total

    def warpDeriv(self, dXv: ArrayLike, solverVec: bool = True) -> FloatArray:
        """As :meth:`USMesh.warpDeriv`; returns the gradient (n, 3), too."""
        return self._reverse(dXv, self._rows(solverVec)).copy()


def _surface_file(name: str) -> tuple[FloatArray, np.ndarray[Any, Any]]:
    """Points (n, 3), i fastest in each block, and faces (n_faces, 4) of a Plot3D file of surfaces."""
    blocks, points, faces, first = read(name).core, [], [], 0
    for block in range(blocks.n_blocks):
        patch = blocks.block(block)
        if 1 not in patch.shape[:3]:
            raise MotionError(f"{name}: block {block + 1} has {patch.shape[:3]} nodes; expected a surface")
        sheet = np.take(patch, 0, axis=patch.shape.index(1))
        nodes = first + np.arange(sheet[..., 0].size).reshape(sheet.shape[:2], order="F")
        corners = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
        points.append(sheet.transpose(1, 0, 2).reshape(-1, 3))
        faces.append(np.stack(corners, axis=-1).reshape(-1, 4))
        first += len(points[-1])
    return np.concatenate(points), np.concatenate(faces)
