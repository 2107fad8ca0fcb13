"""What MPhys asks of a solver's builder, asked of ours: scenarios with a geometry, groups, converters."""

import numpy as np
import pytest
from api.test_openmdao import bent, prepared

om = pytest.importorskip("openmdao.api")
pytest.importorskip("mphys")
from mphys.core import (  # noqa: E402
    Builder,
    MPhysVariables,
)
from mphys.scenarios.aerodynamic import ScenarioAerodynamic  # noqa: E402

from meshdeform.openmdao import MeshCoordinates, MeshDeformBuilder, MeshDeformComp  # noqa: E402

pytestmark = pytest.mark.usefixtures("openmdao_folder")

X = MPhysVariables.Aerodynamics.Surface


@pytest.fixture(scope="module")
def mesh():
    return prepared()


class Stand(om.ExplicitComponent):
    """A part of a scenario: outputs of given sizes and tags from inputs with given tags."""

    def initialize(self):
        self.options.declare("takes")
        self.options.declare("gives")

    def setup(self):
        for name, tag in self.options["takes"].items():
            self.add_input(name, shape_by_conn=True, tags=[tag])
        for name, (size, tag) in self.options["gives"].items():
            self.add_output(name, shape=size, tags=[tag])

    def compute(self, inputs, outputs):
        total = sum(np.sin(values).sum() for values in inputs.values())
        for name, (size, _) in self.options["gives"].items():
            outputs[name] = 1e-3 * total * np.sin(np.arange(size)) * np.tile([1.0, 1.0, 0.0], size // 3 or 1)[:size]


PLACE, BOTH = "mphys_coordinates", "mphys_coupling"


class AeroBuilder(Builder):
    """The solver: loads from surface and volume coordinates."""

    def __init__(self, size):
        self.size = size

    def get_pre_coupling_subsystem(self, scenario_name=None):
        return Stand(takes={X.COORDINATES_INITIAL: PLACE}, gives={"prestate_aero": (1, BOTH)})

    def get_coupling_group_subsystem(self, scenario_name=None):
        takes = {X.COORDINATES: PLACE, "prestate_aero": BOTH, "x_aero_volume": BOTH}
        return Stand(takes=takes, gives={X.LOADS: (self.size, BOTH)})

    def get_post_coupling_subsystem(self, scenario_name=None):
        return Stand(takes={X.LOADS: BOTH}, gives={"func_aero": (1, "mphys_result")})


class Bend(om.ExplicitComponent):
    """The geometry: moves the surface."""

    def setup(self):
        self.add_input(X.Geometry.COORDINATES_INPUT, shape_by_conn=True, tags=[PLACE])
        self.add_output(X.Geometry.COORDINATES_OUTPUT, copy_shape=X.Geometry.COORDINATES_INPUT, tags=[PLACE])

    def compute(self, inputs, outputs):
        points = np.reshape(inputs[X.Geometry.COORDINATES_INPUT], (-1, 3))
        outputs[X.Geometry.COORDINATES_OUTPUT] = bent(points).ravel()


class BendBuilder(Builder):
    def get_mesh_coordinate_subsystem(self, scenario_name=None):
        return Bend()


def run(scenario):
    problem = om.Problem()
    problem.model.add_subsystem("scenario", scenario)
    problem.setup()
    problem.set_solver_print(-1)
    problem.run_model()
    return problem


def grid_at(mesh, points):
    step = mesh.deform(np.reshape(points, (-1, 3)) - mesh.points, repair="off")
    return np.concatenate([block.ravel() for block in step.grid.blocks])


@pytest.mark.parametrize("geometry", [False, True])
def test_an_aerodynamic_scenario(mesh, geometry):
    builder = MeshDeformBuilder(lambda comm: mesh, solver=AeroBuilder(mesh.points.size))
    given = {"geometry_builder": BendBuilder()} if geometry else {}
    scenario = ScenarioAerodynamic(aero_builder=builder, in_MultipointParallel=True, **given)
    problem = run(scenario)
    order = [part.name for part in scenario.system_iter(recurse=False)]
    assert order == ["mesh", *(["geometry"] if geometry else []), "aero_pre", "coupling", "aero_post"]
    assert isinstance(scenario.mesh, MeshCoordinates)
    sources = problem.model._conn_global_abs_in2out
    assert not any("auto_ivc" in source for source in sources.values())
    deformer = next(part for part in scenario.system_iter(typ=MeshDeformComp))
    given = f"geometry.{X.Geometry.COORDINATES_OUTPUT}" if geometry else f"mesh.{X.Mesh.COORDINATES}"
    assert sources[f"{deformer.pathname}.{X.COORDINATES}"] == f"scenario.{given}"
    wanted = grid_at(mesh, bent(mesh.points) if geometry else mesh.points)
    np.testing.assert_allclose(problem.get_val("scenario.x_aero_volume"), wanted, atol=1e-12)
