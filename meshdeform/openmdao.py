"""Grid deformation in OpenMDAO models and MPhys scenarios; needs the extra ``openmdao``.

    import openmdao.api as om
    from meshdeform.openmdao import MeshDeformComp

    problem.model.add_subsystem("deform", MeshDeformComp(mesh=md.prepare("wing.cgns", moving=["wing"])))

Surface and volume coordinates are flat vectors, distributed if there are several ranks. Rank r of P holds the rows
int(n r / P) to int(n (r + 1) / P) of ``mesh.points``, and the nodes of its ``mesh.grid.part``, in C order within a
block.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import openmdao.api as om
from mphys.core import Builder, MPhysGroup, MPhysVariables

from meshdeform_core.boundary import Kind
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.parallel import Nodes
from meshdeform_core.quality.gradients import quality_gradient

from .grid import Grid
from .mesh import Mesh, Repeated
from .step import unusable
from .tasks import prepare

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

__all__ = ["MeshCoordinates", "MeshDeformBuilder", "MeshDeformComp", "MeshQualityComp"]

SURFACE = MPhysVariables.Aerodynamics.Surface
VOLUME = "x_aero_volume"
"""Name of the volume coordinates unless options say otherwise."""


class _OnMesh(om.ExplicitComponent):
    """A component whose vectors are divided among the ranks of a mesh."""

    def initialize(self) -> None:
        self.options.declare("mesh", types=Mesh, recordable=False, desc="prepared grid")

    def setup(self) -> None:
        mesh = self.options["mesh"]
        self.mesh, self.ranks = mesh, mesh.ranks
        if self.comm.size != self.ranks.count:
            raise CaseError(
                f"the mesh was prepared for {self.ranks.count} ranks, the component runs on {self.comm.size}; expected "
                f"prepare(..., comm=comm) with the communicator of the component"
            )
        # With a single process, vectors are serial, as distributed ones require PETSc.
        self.divided = self.ranks.count > 1
        self.own_points = self.ranks.share(len(mesh.points))
        self.own_nodes = slice(*mesh.setup.grid.nodes.ends)

    def whole(self, values: Any) -> FloatArray:
        """The rows (n, 3) of all ranks from this rank's, flat."""
        return np.array(self.ranks.collect(_real(values)))


def _real(values: Any) -> FloatArray:
    """Rows (n, 3) of a flat vector."""
    if np.iscomplexobj(values):
        raise MethodError("complex steps through the grid are not offered; expected differences (fd)")
    return np.asarray(values, dtype=np.float64).reshape(-1, 3)


class MeshDeformComp(_OnMesh):
    """Volume coordinates from surface coordinates, with matrix-free derivatives in both directions.

    Options
    -------
    mesh : made by :func:`meshdeform.prepare`, with the communicator of the component if that has several ranks
    surface, volume : names of the input and the output
    initial : name of a further input without effect: MPhys scenarios connect the undeformed surface
    steps, repair : as of :meth:`Mesh.deform`, by default one step without repair, which has an exact derivative
    on_invalid : ``"raise"``, or ``"keep"``: an invalid grid is an output like any other. Drivers of scipy, which
        cannot back up after an error, then turn back at a constraint of :class:`MeshQualityComp`

    Raises
    ------
    openmdao.api.AnalysisError
        When the grid is invalid and ``on_invalid = "raise"``, so that drivers back up.
    """

    def initialize(self) -> None:
        super().initialize()
        self.options.declare("surface", default=SURFACE.COORDINATES, desc="name of the surface coordinates")
        self.options.declare("volume", default=VOLUME, desc="name of the volume coordinates")
        self.options.declare("initial", default="", desc="name of the undeformed surface, an input without effect")
        self.options.declare("steps", default=1, desc="as of Mesh.deform")
        self.options.declare("repair", default="off", values=["off", "auto", "polish"], desc="as of Mesh.deform")
        self.options.declare("on_invalid", default="raise", values=["raise", "keep"], desc="what an invalid grid is")

    def setup(self) -> None:
        super().setup()
        o, mesh = self.options, self.mesh
        self._repeated = Repeated(mesh, o["steps"], o["repair"])
        points, nodes = mesh.points[self.own_points], mesh.setup.grid.points[self.own_nodes]
        for name in filter(None, (o["surface"], o["initial"])):
            self.add_input(name, points.ravel(), distributed=self.divided, tags=["mphys_coordinates"])
        self.add_output(o["volume"], nodes.ravel(), distributed=self.divided, tags=["mphys_coupling"])

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Deform the grid; all ranks reach the same verdict."""
        step = self._repeated.step(self.whole(inputs[self.options["surface"]]) - self.mesh.points)
        if not step.valid and self.options["on_invalid"] == "raise":
            raise om.AnalysisError(f"{self.pathname}: {unusable(step)}")
        outputs[self.options["volume"]] = step.result.grid.points[self.own_nodes].ravel()

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        """Products with the derivative at ``inputs``, which is computed once per set of inputs."""
        surface, volume = self.options["surface"], self.options["volume"]
        if surface not in d_inputs or volume not in d_outputs:
            return
        warn = partial(om.issue_warning, prefix=self.pathname, category=om.DerivativesWarning)
        operator = self._repeated.derivative(self.whole(inputs[surface]) - self.mesh.points, warn).operator
        if mode == "fwd":
            d_outputs[volume] += operator.matvec(self.whole(d_inputs[surface]).ravel())
        else:
            found = operator.rmatvec(d_outputs[volume]).reshape(-1, 3)
            d_inputs[surface] += found[self.own_points].ravel()


class MeshQualityComp(_OnMesh):
    """Measures of the deformed grid with their derivatives, for constraints.

    Options
    -------
    mesh : as of :class:`MeshDeformComp`
    measures : of :meth:`Step.quality_gradient`; each is an output ``quality_MEASURE``
    sharpness : of the smooth minima, as in :meth:`Step.quality_gradient`
    volume : name of the volume coordinates, the input
    """

    def initialize(self) -> None:
        super().initialize()
        self.options.declare("measures", default=("scaled_jacobian_min",), desc="measures of Step.quality_gradient")
        self.options.declare("sharpness", default=100.0, desc="of smooth minima")
        self.options.declare("volume", default=VOLUME, desc="name of the volume coordinates")

    def setup(self) -> None:
        super().setup()
        nodes = self.mesh.setup.grid.points[self.own_nodes]
        self.add_input(self.options["volume"], nodes.ravel(), distributed=self.divided, tags=["mphys_coupling"])
        for measure in self.options["measures"]:
            self.add_output(f"quality_{measure}", 0.0, tags=["mphys_result"])

    def compute(self, inputs: Any, outputs: Any) -> None:
        """The measures of the whole grid, the same on every rank."""
        for measure in self.options["measures"]:
            outputs[f"quality_{measure}"] = self._measured(inputs, measure)[0]

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        """Products with the gradients."""
        volume = self.options["volume"]
        for measure in self.options["measures"]:
            name = f"quality_{measure}"
            if volume not in d_inputs or name not in d_outputs:
                continue
            own = self._measured(inputs, measure)[1][self.own_nodes].ravel()
            if mode == "fwd":
                d_outputs[name] += sum(self.ranks.gather([float(own @ d_inputs[volume])]))
            else:
                # A serial output is the same on every rank; OpenMDAO divides its seed among them.
                d_inputs[volume] += sum(self.ranks.gather([float(d_outputs[name][0])])) * own

    def _measured(self, inputs: Any, measure: str) -> tuple[float, FloatArray]:
        setup = self.mesh.setup
        points = setup.grid.nodes.like(3)
        Nodes.of(points).rows[self.own_nodes] = _real(inputs[self.options["volume"]])
        with self.mesh.at_work():
            return quality_gradient(setup.grid, points, setup.topology, measure, self.options["sharpness"])


class MeshCoordinates(_OnMesh):
    """The undeformed surface as the output ``x_aero0_mesh`` that MPhys expects.

    After :meth:`mphys_add_coordinate_input` it passes on the coordinates of a geometry component.
    """

    _GIVEN = "x_aero0_points"
    _given = False

    def setup(self) -> None:
        super().setup()
        tags = ["mphys_coordinates"]
        self.add_output(SURFACE.Mesh.COORDINATES, self.mphys_get_surface_mesh(), distributed=self.divided, tags=tags)

    def mphys_add_coordinate_input(self) -> tuple[str, FloatArray]:
        """Add an input of surface coordinates; its name and undeformed value."""
        self._given = True
        points = self.mphys_get_surface_mesh()
        self.add_input(self._GIVEN, points, distributed=self.divided)
        return self._GIVEN, points

    def mphys_get_surface_mesh(self) -> FloatArray:
        """This rank's undeformed surface nodes, flat."""
        return self.mesh.points[self.own_points].ravel()

    def mphys_get_triangulated_surface(self, groupName: str | None = None) -> list[FloatArray]:
        """All triangles of the surface on every rank: a corner (n, 3), and the edges (n, 3) to the other two.

        Parameters
        ----------
        groupName : a moving patch; all by default
        """
        setup, names = self.mesh.setup, self.mesh.patches if groupName is None else [groupName]
        patches = [p for p in setup.boundary.patches if p.kind is Kind.MOVING and p.name in names]
        if not patches:
            raise CaseError(f"no moving patch {groupName!r}; expected one of {', '.join(self.mesh.patches)}")
        corners = setup.topology.quads.corners[np.unique(np.concatenate([patch.quads for patch in patches]))]
        if corners.shape[1] != 4:
            raise CaseError("a plane grid has edges, not faces; expected a grid in space")
        with self.mesh.at_work():
            at = setup.grid.points[setup.topology.first[np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])]]
        return [at[:, 0], at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]]

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Pass on the coordinates of the geometry component, if there is one."""
        if self._given:
            outputs[SURFACE.Mesh.COORDINATES] = inputs[self._GIVEN]

    def setup_partials(self) -> None:
        """The derivative is the identity."""
        if self._given:
            every = np.arange(self.mphys_get_surface_mesh().size)
            self.declare_partials(SURFACE.Mesh.COORDINATES, self._GIVEN, rows=every, cols=every, val=1.0)


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
    steps, repair, on_invalid : as of :class:`MeshDeformComp`
    prepare_options : arguments of :func:`meshdeform.prepare`
    """

    def __init__(
        self, grid: Grid | str | Path | Callable[[Comm | None], Mesh], *, solver: Any = None,
        measures: Sequence[str] = (), steps: int | str = 1, repair: str = "off", on_invalid: str = "raise",
        **prepare_options: Any,
    ) -> None:  # fmt: skip
        self._grid, self._solver, self._measures = grid, solver, tuple(measures)
        self._options, self._prepare = {"steps": steps, "repair": repair, "on_invalid": on_invalid}, prepare_options
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
        chosen = np.full(len(self.mesh.points), names is None)
        for name in names or ():
            chosen |= self.mesh.mask(name)
        return np.flatnonzero(chosen[self.mesh.ranks.share(len(chosen))])
