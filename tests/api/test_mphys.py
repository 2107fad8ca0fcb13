"""What MPhys asks of a solver's builder, asked of ours: scenarios with a geometry, groups, converters."""

import numpy as np
import pytest
from api.test_openmdao import PLACE, AeroBuilder, StructBuilder, TransferBuilder, X, bent, prepared

om = pytest.importorskip("openmdao.api")
pytest.importorskip("mphys")
from mphys.core import (  # noqa: E402
    Builder,
    DistributedConverter,
    DistributedVariableDescription,
    MaskedConverter,
    MaskedVariableDescription,
    MPhysGroup,
    UnmaskedConverter,
)
from mphys.scenarios.aerodynamic import ScenarioAerodynamic  # noqa: E402
from mphys.scenarios.aerostructural import ScenarioAeroStructural  # noqa: E402

from meshdeform.openmdao import MeshCoordinates, MeshDeformBuilder, MeshDeformComp  # noqa: E402

pytestmark = pytest.mark.usefixtures("openmdao_folder")


@pytest.fixture(scope="module")
def mesh():
    return prepared()


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


def test_an_aerostructural_scenario(mesh):
    size = mesh.points.size
    builder = MeshDeformBuilder(lambda comm: mesh, solver=AeroBuilder(size))
    others = {"struct_builder": StructBuilder(size), "ldxfer_builder": TransferBuilder(size)}
    scenario = ScenarioAeroStructural(aero_builder=builder, in_MultipointParallel=True, **others)
    problem = run(scenario)
    assert isinstance(scenario.aero_mesh, MeshCoordinates)
    assert not any("auto_ivc" in source for source in problem.model._conn_global_abs_in2out.values())
    points = problem.get_val(f"scenario.{X.COORDINATES}")
    assert np.abs(points - mesh.points.ravel()).max() > 0.0
    np.testing.assert_allclose(problem.get_val("scenario.x_aero_volume"), grid_at(mesh, points), atol=1e-12)


@pytest.mark.parametrize("promotes", [False, True])
def test_a_group_promotes_what_is_tagged(mesh, promotes):
    problem = om.Problem()
    group = problem.model.add_subsystem("group", MPhysGroup())
    add = group.mphys_add_subsystem if promotes else group.add_subsystem
    add("deform", MeshDeformComp(mesh=mesh))
    problem.setup()
    problem.run_model()
    places = "inputs", "outputs"
    names = {name: data["prom_name"] for way in places for name, data in group.get_io_metadata(way[:-1]).items()}
    assert set(names) == {"deform.x_aero", "deform.x_aero_volume"}
    for name, promoted in names.items():
        assert promoted == (name.removeprefix("deform.") if promotes else name)


def test_converters_around_the_deformation(mesh):
    """Some nodes of the surface are masked out and put back, and the grid goes to a solver that is not distributed."""
    builder = MeshDeformBuilder(lambda comm: mesh)
    builder.initialize(None)
    chosen = np.zeros(len(mesh.points), dtype=bool)
    chosen[builder.get_tagged_indices(["body"])[::2]] = True
    mask = np.repeat(chosen, 3)
    size, some, nodes = mask.size, int(mask.sum()), 3 * mesh.grid.n_nodes

    def of(name, count, tag=PLACE):
        return MaskedVariableDescription(name, shape=count, tags=[tag])

    problem = om.Problem()
    add = problem.model.add_subsystem
    add("masker", MaskedConverter(input=of("given", size), output=of("some", some), mask=mask), promotes=["*"])
    whole = UnmaskedConverter(
        input=of("some", some), output=of("x_aero", size), mask=mask, default_values=mesh.points.ravel()
    )
    add("unmasker", whole, promotes=["*"])
    add("deform", MeshDeformComp(mesh=mesh), promotes=["*"])
    grid = DistributedVariableDescription("x_aero_volume", shape=nodes, tags=["mphys_coupling"])
    add("serial", DistributedConverter(distributed_inputs=[grid]), promotes=["*"])
    problem.setup()
    problem.set_val("given", bent(mesh.points).ravel())
    problem.run_model()
    points = np.where(chosen[:, None], bent(mesh.points), mesh.points)
    np.testing.assert_allclose(problem.get_val("x_aero_volume_serial"), grid_at(mesh, points), atol=1e-12)
    found = problem.check_totals(
        of=["x_aero_volume_serial"], wrt=["given"], form="central", step=1e-6, directional=True, out_stream=None
    )
    (pair,) = found.values()
    assert pair["abs error"].forward < 1e-6 * np.linalg.norm(pair["J_fd"])
