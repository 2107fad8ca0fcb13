"""The builder of MPhys scenarios that deform a grid."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mphys.core import Builder, MPhysGroup

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import IntArray

from ..grids.grid import Grid
from ..pieces import share_of
from ..prepared.mesh import Mesh
from ..prepared.preparation import prepare
from .components import SURFACE, MeshCoordinates, MeshDeformComp, MeshQualityComp

if TYPE_CHECKING:
    from mpi4py.MPI import Comm


class DeformationGroup(MPhysGroup):
    """The deformation, then the solver that takes the volume coordinates."""

    def initialize(self) -> None:
        self.options.declare("parts", recordable=False, desc="subsystems by name, in their order")

    def setup(self) -> None:
        for name, part in self.options["parts"].items():
            self.mphys_add_subsystem(name, part)


class MeshDeformBuilder(Builder):
    """An MPhys builder: the surface of a grid, its deformation in the coupling group, a solver on the volume.

    Parameters
    ----------
    grid : a grid, the name of its file, or a function that prepares a mesh for a communicator
    solver : builder of a solver whose coupling subsystem has an input ``x_aero_volume`` (distributed, see
        :mod:`meshdeform.openmdao`); its subsystems before and after the coupling are added, too
    measures : of :class:`MeshQualityComp`, added after the coupling
    steps, repair : as of :class:`MeshDeformComp`
    prepare_options : arguments of :func:`meshdeform.prepare`
    """

    def __init__(
        self, grid: Grid | str | Path | Callable[[Comm | None], Mesh], *, solver: Any = None,
        measures: Sequence[str] = (), steps: int | str = 1, repair: str = "off", **prepare_options: Any,
    ) -> None:  # fmt: skip
        self._grid, self._solver, self._measures = grid, solver, tuple(measures)
        self._options, self._prepare = {"steps": steps, "repair": repair}, prepare_options
        self._mesh: Mesh | None = None

    def initialize(self, comm: Any) -> None:
        """Prepare the mesh, and the solver, for the ranks of a communicator."""
        shared = comm if comm is not None and comm.size > 1 else None
        if callable(self._grid):
            self._mesh = self._grid(shared)
        else:
            self._mesh = prepare(self._grid, comm=shared, **self._prepare)
        if self._solver is not None:
            self._solver.initialize(comm)

    @property
    def mesh(self) -> Mesh:
        """The prepared mesh.

        Raises
        ------
        CaseError
            Before :meth:`initialize`.
        """
        if self._mesh is None:
            raise CaseError("the builder has no communicator yet; expected a call of initialize(comm)")
        return self._mesh

    def get_mesh_coordinate_subsystem(self, scenario_name: str | None = None) -> MeshCoordinates:
        """The undeformed surface."""
        return MeshCoordinates(mesh=self.mesh)

    def get_pre_coupling_subsystem(self, scenario_name: str | None = None) -> Any:
        """The solver's own subsystem before the coupling."""
        return None if self._solver is None else self._solver.get_pre_coupling_subsystem(scenario_name)

    def get_coupling_group_subsystem(self, scenario_name: str | None = None) -> Any:
        """The deformation, followed by the solver if there is one."""
        deformation = MeshDeformComp(mesh=self.mesh, initial=SURFACE.COORDINATES_INITIAL, **self._options)
        if self._solver is None:
            return deformation
        solver = self._solver.get_coupling_group_subsystem(scenario_name)
        return DeformationGroup(parts={"deformation": deformation, "solver": solver})

    def get_post_coupling_subsystem(self, scenario_name: str | None = None) -> Any:
        """The solver's own subsystem after the coupling, and the measures of the grid."""
        parts: dict[str, Any] = {}
        if self._measures:
            parts["quality"] = MeshQualityComp(mesh=self.mesh, measures=self._measures)
        solver = None if self._solver is None else self._solver.get_post_coupling_subsystem(scenario_name)
        if solver is None or not parts:
            return solver or parts.get("quality")
        return DeformationGroup(parts={**parts, "solver": solver})

    def get_number_of_nodes(self, groupName: str | None = None) -> int:
        """This rank's surface nodes, all or those of a moving patch."""
        return len(self._rows(None if groupName is None else [groupName]))

    def get_ndof(self) -> int:
        """Number of coordinates of a node."""
        return 3

    def get_tagged_indices(self, tags: Any) -> list[int]:
        """Numbers, within this rank's share, of the nodes of moving patches; -1 for all."""
        given: list[Any] = [tags] if isinstance(tags, str | int) else list(tags)
        return [int(row) for row in self._rows(None if -1 in given else given)]

    def _rows(self, names: Sequence[str] | None) -> IntArray:
        mesh = self.mesh
        chosen = np.ones(len(mesh.points), dtype=bool)
        if names is not None:
            chosen[:] = False
            for name in names:
                chosen |= mesh.mask(name)
        return np.flatnonzero(chosen[share_of(len(chosen), mesh._ranks)])
