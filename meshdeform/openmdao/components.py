"""Components of OpenMDAO models: the deformed grid, measures of it, the undeformed surface."""

from __future__ import annotations

from typing import Any

import numpy as np
import openmdao.api as om
from mphys.core import MPhysVariables

from meshdeform_core.boundary import Kind
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.grid import FloatArray
from meshdeform_core.quality.measures.gradients import quality_gradient

from ..pieces import gathered, share_of
from ..prepared.linearisation import Linearisation
from ..prepared.mesh import Mesh

SURFACE = MPhysVariables.Aerodynamics.Surface
VOLUME = "x_aero_volume"
"""Name of the volume coordinates unless options say otherwise."""


class _OnMesh(om.ExplicitComponent):
    """A component whose vectors are divided among the ranks of a mesh."""

    def initialize(self) -> None:
        self.options.declare("mesh", types=Mesh, recordable=False, desc="prepared grid")

    def setup(self) -> None:
        mesh = self.options["mesh"]
        self.mesh, self.ranks = mesh, mesh._ranks
        if self.comm.size != self.ranks.count:
            raise CaseError(
                f"the mesh was prepared for {self.ranks.count} ranks, the component runs on {self.comm.size}; expected "
                f"prepare(..., comm=comm) with the communicator of the component"
            )
        # With a single process, vectors are serial, as distributed ones require PETSc.
        self.divided = self.ranks.count > 1
        self.own_points = share_of(len(mesh.points), self.ranks)
        self.own_nodes = share_of(mesh.grid.n_nodes, self.ranks)

    def whole(self, values: Any) -> FloatArray:
        """The rows (n, 3) of all ranks from this rank's, flat."""
        if np.iscomplexobj(values):
            raise MethodError("complex steps through the grid are not offered; expected differences (fd)")
        return gathered(self.ranks, np.asarray(values, dtype=np.float64).reshape(-1, 3))


class MeshDeformComp(_OnMesh):
    """Volume coordinates from surface coordinates, with matrix-free derivatives in both directions.

    Options
    -------
    mesh : made by :func:`meshdeform.prepare`, with the communicator of the component if that has several ranks
    surface, volume : names of the input and the output
    initial : name of a further input without effect: MPhys scenarios connect the undeformed surface
    steps, repair : as of :meth:`Mesh.deform`, by default one step without repair, which has an exact derivative

    Raises
    ------
    openmdao.api.AnalysisError
        When the grid is invalid, so that drivers back up.
    """

    def initialize(self) -> None:
        super().initialize()
        self.options.declare("surface", default=SURFACE.COORDINATES, desc="name of the surface coordinates")
        self.options.declare("volume", default=VOLUME, desc="name of the volume coordinates")
        self.options.declare("initial", default="", desc="name of the undeformed surface, an input without effect")
        self.options.declare("steps", default=1, desc="as of Mesh.deform")
        self.options.declare("repair", default="off", values=["off", "auto", "polish"], desc="as of Mesh.deform")
        self._derivative: Linearisation | None = None
        self._at: FloatArray = np.empty((0, 3))

    def setup(self) -> None:
        super().setup()
        o, mesh = self.options, self.mesh
        points, nodes = mesh.points[self.own_points], mesh._setup.grid.points[self.own_nodes]
        for name in filter(None, (o["surface"], o["initial"])):
            self.add_input(name, points.ravel(), distributed=self.divided, tags=["mphys_coordinates"])
        self.add_output(o["volume"], nodes.ravel(), distributed=self.divided, tags=["mphys_coupling"])

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Deform the grid; all ranks reach the same verdict."""
        displacement = self.whole(inputs[self.options["surface"]]) - self.mesh.points
        step = self.mesh.deform(displacement, steps=self.options["steps"], repair=self.options["repair"])
        if not step.valid:
            first = step.invalid_cells[0] if step.invalid_cells else "none is invalid"
            raise om.AnalysisError(f"{self.pathname}: the deformed grid cannot be used: {step!r}; first cell: {first}")
        outputs[self.options["volume"]] = step._result.grid.points[self.own_nodes].ravel()

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        """Products with the derivative at ``inputs``, which is computed once per set of inputs."""
        surface, volume = self.options["surface"], self.options["volume"]
        if surface not in d_inputs or volume not in d_outputs:
            return
        operator = self._linearised(inputs).operator
        if mode == "fwd":
            moved = operator.matvec(self.whole(d_inputs[surface]).ravel()).reshape(-1, 3)
            d_outputs[volume] += moved[self.own_nodes].ravel()
        else:
            found = operator.rmatvec(self.whole(d_outputs[volume]).ravel()).reshape(-1, 3)
            d_inputs[surface] += found[self.own_points].ravel()

    def _linearised(self, inputs: Any) -> Linearisation:
        at = self.whole(inputs[self.options["surface"]]) - self.mesh.points
        if self._derivative is None or not np.array_equal(at, self._at):
            self._at = at
            self._derivative = self.mesh.linearise(at, steps=self.options["steps"], repair=self.options["repair"])
            if not self._derivative.exact:
                om.issue_warning(
                    f"the derivative is not that of the grid: {self._derivative.reason}",
                    prefix=self.pathname,
                    category=om.DerivativesWarning,
                )
        return self._derivative


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
        nodes = self.mesh._setup.grid.points[self.own_nodes]
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
        setup, points = self.mesh._setup, self.whole(inputs[self.options["volume"]])
        with self.mesh._at_work():
            return quality_gradient(setup.grid, points, setup.topology, measure, self.options["sharpness"])


class MeshCoordinates(_OnMesh):
    """The undeformed surface as the output ``x_aero0_mesh`` that MPhys expects.

    After :meth:`mphys_add_coordinate_input` it passes on the coordinates of a geometry component.
    """

    _GIVEN = "x_aero0_points"

    def initialize(self) -> None:
        super().initialize()
        self._given = False

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
        setup, names = self.mesh._setup, self.mesh.patches if groupName is None else [groupName]
        patches = [p for p in setup.boundary.patches if p.kind is Kind.MOVING and p.name in names]
        if not patches:
            raise CaseError(f"no moving patch {groupName!r}; expected one of {', '.join(self.mesh.patches)}")
        corners = setup.topology.quads.corners[np.unique(np.concatenate([patch.quads for patch in patches]))]
        if corners.shape[1] != 4:
            raise CaseError("a plane grid has edges, not faces; expected a grid in space")
        at = setup.grid.points[setup.topology.first[np.concatenate([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])]]
        return [at[:, 0], at[:, 1] - at[:, 0], at[:, 2] - at[:, 0]]

    def compute(self, inputs: Any, outputs: Any) -> None:
        """Pass on the coordinates of the geometry component, if there is one."""
        if self._given:
            outputs[SURFACE.Mesh.COORDINATES] = inputs[self._GIVEN]

    def compute_jacvec_product(self, inputs: Any, d_inputs: Any, d_outputs: Any, mode: str) -> None:
        """Products with the identity."""
        if self._GIVEN in d_inputs and SURFACE.Mesh.COORDINATES in d_outputs:
            if mode == "fwd":
                d_outputs[SURFACE.Mesh.COORDINATES] += d_inputs[self._GIVEN]
            else:
                d_inputs[self._GIVEN] += d_outputs[SURFACE.Mesh.COORDINATES]
