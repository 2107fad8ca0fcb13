"""OpenMDAO components: derivatives, invalid grids; what MPhys asks of a solver's builder, asked of ours."""

import numpy as np
import pytest
from grids import frame

import meshdeform as md
from meshdeform.grid import wrapped

om = pytest.importorskip("openmdao.api")
pytest.importorskip("mphys")

from mphys.core import Builder, MPhysVariables  # noqa: E402
from mphys.scenarios.aerodynamic import ScenarioAerodynamic  # noqa: E402

from meshdeform.openmdao import (  # noqa: E402
    MeshCoordinates,
    MeshDeformBuilder,
    MeshDeformComp,
    MeshQualityComp,
)

pytestmark = pytest.mark.usefixtures("openmdao_folder")

BODY = {"body": ["block2.imax", "block4.jmax", "block5.jmin", "block7.imin"]}


def prepared(comm=None, size=(2, 1)):
    blocks = [np.array(block) for block in wrapped(frame(*size)).blocks]
    return md.prepare(md.Grid(blocks), moving=BODY, slip={"span": ["*.kmin", "*.kmax"]}, comm=comm)


def bent(points):
    return points + 0.05 * np.sin(points[:, [1, 0, 2]] + 1.0) * [1.0, 1.0, 0.0]


@pytest.fixture(scope="module")
def mesh():
    return prepared()


def model_of(mesh, **options):
    """Surface coordinates as the design, their grid and its worst corner."""
    problem = om.Problem()
    add = problem.model.add_subsystem
    add("deform", MeshDeformComp(mesh=mesh, **options), promotes=["*"])
    add("quality", MeshQualityComp(mesh=mesh, measures=("scaled_jacobian_min", "volume")), promotes=["*"])
    for part in (problem.model.deform, problem.model.quality):
        # One random direction in place of every coordinate.
        part.set_check_partial_options("*", directional=True, form="central", step=1e-6)
    problem.setup()
    problem.set_val("x_aero", bent(mesh.points).ravel())
    return problem


def test_partial_derivatives(mesh):
    problem = model_of(mesh)
    problem.run_model()
    found = problem.check_partials(out_stream=None)
    assert sum(len(component) for component in found.values()) == 3
    for component in found.values():
        for pair in component.values():
            assert_exact(pair)


def assert_exact(pair):
    """Both directions of a directional check, and one against the other."""
    scale = np.abs(pair["J_fd"]).max()
    assert scale > 0
    if "J_fwd" in pair:
        assert np.abs(pair["J_fwd"] - pair["J_fd"]).max() < 1e-6 * scale
    for key in ("directional_fd_rev", "directional_fwd_rev"):
        if key in pair:
            one, two = pair[key]
            assert np.abs(one - two).max() < 1e-6 * np.abs(two).max()


def test_total_derivatives_of_quality(mesh):
    problem = model_of(mesh)
    problem.run_model()
    step = mesh.deform(bent(mesh.points) - mesh.points, repair="off")
    assert problem.get_val("quality_volume")[0] == pytest.approx(step.quality_gradient("volume").value)
    names = ["quality_scaled_jacobian_min", "quality_volume"]
    found = problem.compute_totals(of=names, wrt=["x_aero"])
    for name in names:
        expected = mesh.linearise(bent(mesh.points) - mesh.points, repair="off").vjp(
            step.quality_gradient(name.removeprefix("quality_")).blocks
        )
        np.testing.assert_allclose(found[name, "x_aero"].reshape(-1, 3), expected, atol=1e-12)


def test_an_invalid_grid_is_an_analysis_error(mesh):
    problem = model_of(mesh)
    problem.set_val("x_aero", (mesh.points * [-1.0, 1.0, 1.0]).ravel())
    with pytest.raises(om.AnalysisError, match=r"INVALID.*first cell"):
        problem.run_model()
    # Drivers back up: the same problem goes on.
    problem.set_val("x_aero", bent(mesh.points).ravel())
    problem.run_model()


def test_an_optimiser_turns_back_at_the_quality_of_an_invalid_grid(mesh, monkeypatch):
    """The first step of SLSQP inverts cells, and its constraint leads back."""
    seen, deform = [], type(mesh).deform

    def watched(*given, **more):
        step = deform(*given, **more)
        seen.append(step.valid)
        return step

    monkeypatch.setattr(type(mesh), "deform", watched)
    problem = om.Problem()
    add = problem.model.add_subsystem
    turn = om.ExecComp(
        "x_aero = start + size*along",
        x_aero={"shape": mesh.points.size},
        start={"val": mesh.points.ravel()},
        along={"val": (mesh.points[:, [1, 0, 2]] * [-1.0, 1.0, 0.0]).ravel()},
        size={"val": 0.0},
    )
    add("turn", turn, promotes=["*"])
    add("deform", MeshDeformComp(mesh=mesh, on_invalid="keep"), promotes=["*"])
    add("quality", MeshQualityComp(mesh=mesh, measures=("scaled_jacobian_min",)), promotes=["*"])
    problem.driver = om.ScipyOptimizeDriver(optimizer="SLSQP", disp=False, maxiter=20)
    problem.model.add_design_var("size", lower=0.0, upper=8.0)
    problem.model.add_objective("size", scaler=-6.0)
    problem.model.add_constraint("quality_scaled_jacobian_min", lower=0.5)
    problem.setup()
    problem.run_driver()
    assert not all(seen)
    assert seen[-1]
    assert problem.get_val("quality_scaled_jacobian_min")[0] == pytest.approx(0.5, abs=1e-4)
    assert 0.5 < problem.get_val("size")[0] < 1.5


def test_an_inexact_derivative_is_a_warning(mesh, monkeypatch):
    problem = model_of(mesh)
    problem.run_model()
    monkeypatch.setattr(type(mesh.linearise()), "exact", False)
    with pytest.warns(om.DerivativesWarning, match="not that of the grid"):
        problem.compute_totals(of=["quality_volume"], wrt=["x_aero"])


def test_complex_steps_are_refused(mesh):
    problem = om.Problem()
    problem.model.add_subsystem("deform", MeshDeformComp(mesh=mesh))
    problem.setup(force_alloc_complex=True)
    problem.final_setup()
    problem.set_complex_step_mode(True)
    with pytest.raises(md.MethodError, match="complex"):
        problem.run_model()


def test_other_ranks_than_those_of_the_mesh(mesh, monkeypatch):
    monkeypatch.setattr(type(mesh.ranks), "count", 3)
    problem = om.Problem()
    problem.model.add_subsystem("deform", MeshDeformComp(mesh=mesh))
    with pytest.raises(md.CaseError, match="prepared for 3 ranks"):
        problem.setup()


def test_what_mphys_asks_a_builder(mesh):
    builder = MeshDeformBuilder(lambda comm: mesh)
    with pytest.raises(md.CaseError, match="initialize"):
        builder.get_number_of_nodes()
    builder.initialize(None)
    count = len(mesh.points)
    assert (builder.get_number_of_nodes(), builder.get_number_of_nodes("body"), builder.get_ndof()) == (count, count, 3)
    assert builder.get_tagged_indices(-1) == builder.get_tagged_indices(["body"]) == list(range(count))
    with pytest.raises(md.MotionError, match="no moving patch 'tail'"):
        builder.get_tagged_indices(["tail"])
    assert builder.get_pre_coupling_subsystem() is builder.get_post_coupling_subsystem() is None
    problem = om.Problem()
    coordinates = problem.model.add_subsystem("mesh", builder.get_mesh_coordinate_subsystem("cruise"))
    problem.setup()
    p, u, v = coordinates.mphys_get_triangulated_surface()
    normal = np.cross(u, v)
    # The sides of a bar of 1 x 1 x 1, seen from the grid.
    assert np.linalg.norm(normal, axis=1).sum() / 2 == pytest.approx(4.0)
    assert ((p - [0, 0, p[0, 2]]) * normal)[:, :2].sum(axis=1).max() < 0
    with pytest.raises(md.CaseError, match="no moving patch"):
        coordinates.mphys_get_triangulated_surface("tail")


def test_a_builder_prepares(mesh):
    builder = MeshDeformBuilder(mesh.grid, moving={"body": ["block2.imax"]}, method="tfi")
    builder.initialize(None)
    assert builder.mesh.method == "tfi"
    assert list(builder.mesh.patches) == ["body"]


# scenarios of MPhys

X = MPhysVariables.Aerodynamics.Surface


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
    points = bent(mesh.points) if geometry else mesh.points
    step = mesh.deform(np.reshape(points, (-1, 3)) - mesh.points, repair="off")
    wanted = np.concatenate([block.ravel() for block in step.grid.blocks])
    np.testing.assert_allclose(problem.get_val("scenario.x_aero_volume"), wanted, atol=1e-12)
