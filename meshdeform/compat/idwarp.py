"""``USMesh`` and ``MultiUSMesh`` with the interface of IDWarp (mdolab), for solvers and scripts that call it.

    from meshdeform.compat.idwarp import USMesh

    mesh = USMesh(options={"gridFile": "wing.cgns"}, comm=MPI.COMM_WORLD)

Written from the documented behaviour and from the use that callers make of it; docs/guides/idwarp.md says which options
are honoured, mapped or refused. Nothing is fixed: outside nodes on neither surface nor symmetry plane move freely.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from meshdeform_core.errors import CaseError, MotionError
from meshdeform_core.grid import FloatArray, IntArray

from ..grid import read
from .options import Options
from .surface import Definition
from .warp import Warp, grid_of, ranks_of

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

__all__ = ["MultiUSMesh", "USMesh"]


class _Interface:
    """Interface common to both kinds of mesh. All calls are collective."""

    _warp: Warp
    _comm: Comm | None
    _file: str

    def setExternalMeshIndices(self, ind: ArrayLike) -> None:
        """The degrees of freedom (3 n,) that the solver holds on this rank.

        The number of a node is zone offset + (k - 1) ni nj + (j - 1) ni + (i - 1), with zones in the order of the file;
        its x, y, z have three times that number plus 0, 1, 2. Nodes may repeat.
        """
        self._warp.set_solver_nodes(ind)

    def setSurfaceDefinitionFromFile(self, surfFile: str) -> None:
        """The surface from a Plot3D file with a block for each patch; the first rank holds its points."""
        points, faces = _surface_file(surfFile)
        own = slice(None) if self._rank == 0 else slice(0)
        flat = faces[own]
        self._warp.define(Definition.of(points[own], flat, np.full(len(flat), 4), None))

    def setSurfaceFromFile(self, surfFile: str) -> None:
        """New surface coordinates from a file like that of :meth:`setSurfaceDefinitionFromFile`."""
        points = _surface_file(surfFile)[0]
        self._warp.set_surface(points if self._rank == 0 else points[:0])

    def getSurfaceCoordinates(self) -> FloatArray:
        """This rank's points (n, 3), exactly as they were set."""
        return self._warp.surface

    def setSurfaceCoordinates(self, coordinates: ArrayLike) -> None:
        """Set the new positions (n, 3) of this rank's points; :meth:`warpMesh` then moves the grid."""
        self._warp.set_surface(coordinates)

    def warpMesh(self) -> None:
        """Move the grid. An invalid grid causes a warning only, as solvers have checks of their own."""
        self._warp.warp()

    def getSolverGrid(self) -> FloatArray:
        """The solver's nodes (3 n,) on this rank; wall nodes are exactly where they were set."""
        return self._warp.coordinates(self._warp.solver_rows)

    def getCommonGrid(self) -> FloatArray:
        """This rank's share (3 n,) of all nodes, which are divided evenly in the order of the file."""
        return self._warp.coordinates(self._warp.own_rows)

    def getdXs(self) -> FloatArray:
        """The gradient (n, 3) of this rank's points computed by the last :meth:`warpDeriv`."""
        return self._warp.gradient

    def warpDerivFwd(self, dXs: ArrayLike, solverVec: bool = True) -> FloatArray:
        """Change (3 n,) of the solver's nodes, or of those of :meth:`getCommonGrid`, for a change of the points.

        ``dXs`` is (n, 3) or flat.
        """
        return self._warp.forward(dXs, self._rows(solverVec))

    def verifyWarpDeriv(
        self, dXv: ArrayLike | None = None, solverVec: bool = True, dofStart: int = 0, dofEnd: int = 10,
        h: float = 1e-6, randomSeed: int = 314,
    ) -> None:  # fmt: skip
        """Compare the gradient with central differences of :meth:`warpMesh` for some coordinates of the first rank.

        Parameters
        ----------
        dXv : gradient of the nodes (3 n,); random numbers by default
        dofStart, dofEnd : first coordinate of the surface to compare, and one past the last
        h : step (grid length unit)

        Raises
        ------
        AssertionError
            When any component differs by more than 1e-4 of the largest one.
        """
        rows = self._rows(solverVec)
        if dXv is None:
            dXv = np.random.default_rng(randomSeed).random(3 * len(rows))
        weights, at = np.asarray(dXv, dtype=np.float64).ravel(), self.getSurfaceCoordinates()
        self._warp.warp()
        found = self._warp.reverse(weights, rows).ravel()[dofStart:dofEnd]
        found = found if self._comm is None else self._comm.bcast(found)
        expected = np.zeros_like(found)
        for number in range(len(found)):
            ends = []
            for step in (h, -h):
                moved = at.ravel().copy()
                if self._rank == 0:
                    moved[dofStart + number] += step
                self._warp.set_surface(moved)
                self._warp.warp()
                value = float(weights @ self._warp.coordinates(rows))
                ends.append(value if self._comm is None else self._comm.allreduce(value))
            expected[number] = (ends[0] - ends[1]) / (2 * h)
        self._warp.set_surface(at)
        self._warp.warp()
        error = np.abs(found - expected).max(initial=0.0)
        if error > 1e-4 * np.abs(expected).max(initial=0.0):
            raise AssertionError(f"gradients {found.tolist()}; differences with h = {h:g}: {expected.tolist()}")

    def writeGrid(self, fileName: str | None = None) -> None:
        """The grid as a copy of its file, by default beside it with ``_warped`` in its name."""
        source = Path(self._file)
        self._warp.write(fileName or str(source.with_name(f"{source.stem}_warped{source.suffix}")))

    @property
    def warp(self) -> SimpleNamespace:
        """Sizes as callers ask for them: ``warp.griddata.warpmeshdof``, ``solvermeshdof``, ``commonmeshdof``."""
        own = 3 * len(self._warp.own_rows)
        solver = 3 * len(self._warp.solver_rows) if self._warp.knows_solver_nodes else 0
        return SimpleNamespace(griddata=SimpleNamespace(warpmeshdof=own, commonmeshdof=own, solvermeshdof=solver))

    @property
    def _rank(self) -> int:
        return 0 if self._comm is None else self._comm.rank

    def _rows(self, solver: bool) -> Any:
        return self._warp.solver_rows if solver else self._warp.own_rows


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
        self._options = Options(options)
        self._comm, ranks = ranks_of(comm)
        self._file = self._options["gridFile"]
        grid = grid_of(self._file, self._options["fileType"], ranks)
        self._warp = Warp(grid, [(np.arange(grid.n_blocks), self._options)], ranks)

    def setSurfaceDefinition(
        self, pts: ArrayLike, conn: ArrayLike, faceSizes: ArrayLike, cgnsBlockID: ArrayLike | None = None
    ) -> None:
        """The solver's surface on this rank: undeformed points (n, 3), corners of the faces from 0, 3 or 4 each.

        Points may repeat; a rank may have none. ``cgnsBlockID``: the zone of each face, from 1.
        """
        self._warp.define(Definition.of(pts, conn, faceSizes, cgnsBlockID))

    def getWarpGrid(self) -> FloatArray:
        """As :meth:`getCommonGrid`, as the order of the file is the only one."""
        return self.getCommonGrid()

    def getOption(self, name: str) -> Any:
        """Value of an option."""
        return self._options[name]

    def setOption(self, name: str, value: Any) -> None:
        """Change an option before the surface is defined."""
        if self._warp.defined:
            raise CaseError(f"setOption({name!r}) after the surface was defined; expected options before that")
        self._options.set(name, value)

    def printOptions(self) -> None:
        """Print every option with its value, and its meaning here where that differs from IDWarp's."""
        if self._rank == 0:
            for name, value, note in self._options.items():
                print(f"{name:20} {value!r}" + (f"  ({note})" if note else ""))

    def warpDeriv(self, dXv: ArrayLike, solverVec: bool = True) -> None:
        """Apply the transposed derivative to the gradient (3 n,) of the nodes; :meth:`getdXs` returns the result.

        Gradients of solver nodes that repeat are added.
        """
        self._warp.reverse(dXv, self._rows(solverVec))


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
        self._comm, ranks = ranks_of(comm)
        self._file = str(CGNSFile)
        grid = grid_of(self._file, "CGNS", ranks)
        member = np.array([name.split(".")[0].lower() for name in grid.names])
        groups: list[tuple[IntArray, Options]] = []
        for name, options in optionsDict.items():
            zones = np.flatnonzero(member == name.lower())
            if not zones.size:
                known = ", ".join(dict.fromkeys(member.tolist()))
                raise CaseError(f"no zone of component {name!r}; expected some of {known}")
            groups.append((zones, Options({**options, "gridFile": self._file})))
        if not groups:
            raise CaseError("optionsDict is empty; expected options for at least one component")
        # In the order of the file, as IDWarp has its instances.
        groups.sort(key=lambda group: int(group[0][0]))
        self._warp = Warp(grid, groups, ranks)

    def setSurfaceDefinition(
        self, pts: ArrayLike, conn: ArrayLike, faceSizes: ArrayLike, cgnsBlockIDs: ArrayLike | None = None
    ) -> None:
        """As :meth:`USMesh.setSurfaceDefinition`, after :meth:`setExternalMeshIndices`."""
        self._warp.solver_rows  # noqa: B018  (refuses the wrong order)
        self._warp.define(Definition.of(pts, conn, faceSizes, cgnsBlockIDs))

    def getWarpGrid(self) -> tuple[list[FloatArray], int]:
        """This rank's share (3 n,) of the nodes of each component that moves, and the number of coordinates of all."""
        return self._warp.by_component()

    def warpDeriv(self, dXv: ArrayLike, solverVec: bool = True) -> FloatArray:
        """As :meth:`USMesh.warpDeriv`; returns the gradient (n, 3), too."""
        return self._warp.reverse(dXv, self._rows(solverVec)).copy()


def _surface_file(name: str) -> tuple[FloatArray, np.ndarray[Any, Any]]:
    """Points (n, 3), i fastest in each block, and faces (n_faces, 4) of a Plot3D file of surfaces."""
    blocks, points, faces, first = read(name).core, [], [], 0
    for block in range(blocks.n_blocks):
        patch = blocks.block(block)
        flat = [axis for axis, size in enumerate(patch.shape[:3]) if size == 1]
        if not flat:
            raise MotionError(f"{name}: block {block + 1} has {patch.shape[:3]} nodes; expected a surface")
        sheet = np.take(patch, 0, axis=flat[0])
        nodes = first + np.arange(sheet.shape[0] * sheet.shape[1]).reshape(sheet.shape[1], sheet.shape[0]).T
        corners = [nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]]
        points.append(sheet.transpose(1, 0, 2).reshape(-1, 3))
        faces.append(np.stack(corners, axis=-1).reshape(-1, 4))
        first += len(points[-1])
    return np.concatenate(points), np.concatenate(faces)
