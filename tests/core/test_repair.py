"""Repair of deformed grids: the energy against differences, constraints to the last bit, motions that need it."""

import dataclasses

import numpy as np
import pytest
import scipy
from cases import body_specs, formulas, turning
from grids import frame, frame_2d, permuted
from scipy.spatial.transform import Rotation

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import Case, Timing, deform, impose, set_up
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.quality.validity import judge
from meshdeform_core.repair import RepairOptions, energy, newton
from meshdeform_core.repair.constraints import Constraints, find_extrusion
from meshdeform_core.repair.energy import Penalty
from meshdeform_core.repair.newton import NewtonSystem
from meshdeform_core.repair.outcome import Judged, unhealthy_cells
from meshdeform_core.repair.region import Basis
from meshdeform_core.repair.repair import Repairer
from meshdeform_core.repair.untangle import PATIENT, QUICK, Untangler
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample


def cube(n, dimension=3):
    axes = [np.linspace(0.0, 1.0, n) ** 1.3 for _ in range(dimension)] + [np.zeros(1)] * (3 - dimension)
    return Grid.from_blocks([np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)])


def fixed_setup(grid, *more):
    moving = BoundarySpec("all", ("*",), Kind.MOVING, None, formulas("0", "0", "0"))
    return set_up(grid, Case((moving, *more)))


def repaired(setup, points, **options):
    """The verdict on coordinates, and their repair."""
    verdict = judge(setup.original, points)
    return verdict, Repairer(Basis(setup.original, setup.boundary), **options).repair(Judged(points, verdict))


def dense(system):
    """The scaled Hessian as a matrix (d n, d n), from both of its halves, whose blocks are transposed."""
    found = [scipy.sparse.bsr_array((b.transpose(0, 2, 1) * 1.0, at, n)) for b, n, at in (system._upper, system._lower)]
    return np.triu(found[0].toarray()) + np.tril(found[1].toarray(), -1)


PENALTIES = [Penalty(1.0), Penalty(0.05), Penalty(0.0, 0.3, 2.0, 0.7), Penalty(0.0, 0.3, 2.0, 0.7, 1.0)]


@pytest.mark.parametrize("dimension", [2, 3])
@pytest.mark.parametrize("penalty", PENALTIES)
def test_gradient_is_that_of_differences_and_matrix_is_symmetric(dimension, penalty):
    setup = fixed_setup(cube(5, dimension))
    plot, random = Basis(setup.original, setup.boundary).whole, np.random.default_rng(3)
    if dimension == 3:
        # A share of its own for the samples between corners of every cell.
        energy = plot.region.energy
        energy = energy.with_between(random.uniform(0.1, 1.0, len(energy.weight)))
        plot = dataclasses.replace(plot, region=dataclasses.replace(plot.region, energy=energy))
    region, system, start = plot.region, plot.system, plot.inside(setup.grid.points)
    x = start + 0.03 * random.standard_normal(start.shape)
    untangler, step = Untangler(plot, start), random.standard_normal((region.n_unknowns, dimension))
    moved = [region.moved(x, region.unknowns, step, h) for h in (-1e-6, 1e-6)]
    ends = [untangler.state(at, penalty).energy for at in moved]
    system.fill(region, x, start, penalty)
    assert (ends[1] - ends[0]) / 2e-6 == pytest.approx(np.vdot(system.gradient, step), rel=1e-4)
    matrix = dense(system)
    np.testing.assert_allclose(matrix, matrix.T, atol=2e-6)
    if not penalty.exact:
        assert np.linalg.eigvalsh(matrix).min() > 1e-6
        return
    found, gradients = [], []
    for share in (0.0, 0.25, 1.0):
        system.fill(region, x, start, penalty._replace(exact=share))
        # The matrix is scaled from both sides.
        scaling = scipy.linalg.block_diag(*np.linalg.inv(system._factor))
        found.append(scaling @ dense(system) @ scaling.T)
    convex, mixed, exact = found
    assert np.linalg.eigvalsh(convex).min() > 0.0 > np.linalg.eigvalsh(exact - convex).min()
    np.testing.assert_allclose(mixed, 0.75 * convex + 0.25 * exact, atol=1e-5 * np.abs(exact).max())
    for at in moved:
        system.fill(region, at, start, penalty)
        gradients.append(system.gradient.ravel().copy())
    expected = (gradients[1] - gradients[0]) / 2e-6
    np.testing.assert_allclose(exact @ step.ravel(), expected, atol=2e-5 * np.abs(expected).max())
    if dimension == 3:
        # Of the shares the gradient is a linear function.
        gradients, free = [], region.unknowns.number >= 0
        for factor in (1.0, 1.5):
            more = dataclasses.replace(region, energy=energy.with_between(factor * energy.between))
            system.fill(more, x, start, penalty)
            gradients.append(system.gradient[region.unknowns.number[free]])
        change, _, _ = energy.products(x, penalty, 0.0 * x, 0.0, 0.5 * energy.between)
        np.testing.assert_allclose(change[free], gradients[1] - gradients[0], atol=1e-12)


@pytest.mark.parametrize("rows", [7, 1 << 15])
@pytest.mark.parametrize("dimension", [2, 3])
def test_a_direction_solves_the_linear_system_in_ranges_of_any_size(dimension, rows, monkeypatch):
    monkeypatch.setattr(newton, "_SWEPT", rows)
    setup = fixed_setup(cube(6, dimension))
    plot, random = Basis(setup.original, setup.boundary).whole, np.random.default_rng(2)
    start = plot.inside(setup.grid.points)
    system = NewtonSystem(plot.region)
    system.fill(plot.region, start + 0.02 * random.standard_normal(start.shape), start, Penalty(0.0, 1.0, 2.0, 1.0))
    step, convex = system.direction(1e-9, 1000)
    right = -np.einsum("nij,nj->ni", system._factor, system.gradient)
    solved = np.linalg.solve(dense(system), right.ravel()).reshape(right.shape)
    expected = np.einsum("nji,nj->ni", system._factor, solved)
    assert convex
    np.testing.assert_allclose(step, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("refused", [0, 10, 20])
def test_where_steps_are_shortened_or_refused_the_minimum_is_not_called_reached(refused, monkeypatch):
    """So many trials of every step are made to look bad: then 2^-10 of it is taken, or, of 14 trials, none."""
    setup = fixed_setup(cube(5, 2))
    plot = Basis(setup.original, setup.boundary).whole
    start = plot.inside(setup.grid.points)
    untangler = Untangler(plot, start)
    untangler.x = start.copy()
    untangler.x[plot.region.unknowns.number >= 0] += 1e-5
    true, trials = Untangler.state, []

    def state(self, x, penalty):
        found = true(self, x, penalty)
        trials.append(x)
        bad = (len(trials) - 1) % (refused + 1) > 0
        return dataclasses.replace(found, energy=found.energy + bad)

    monkeypatch.setattr(Untangler, "state", state)
    assert untangler.minimise(1.0, 5) == (refused == 0)


@pytest.mark.parametrize("dimension", [2, 3])
def test_a_node_thrown_out_of_its_cells_comes_back(dimension):
    setup = fixed_setup(cube(7, dimension))
    points = setup.grid.points.copy()
    points[setup.grid.n_nodes // 2, :dimension] += 0.6
    verdict, outcome = repaired(setup, points)
    assert not verdict.valid
    assert outcome.verdict.valid
    assert not judge(setup.original, outcome.points).invalid.size
    weak = np.setdiff1d(unhealthy_cells(setup.original, points), verdict.invalid)
    assert (outcome.repair.invalid, outcome.repair.weak) == (verdict.invalid.size, weak.size)
    assert outcome.repair.converged
    assert 0 < outcome.repair.nodes < setup.grid.n_nodes
    assert outcome.repair.max_movement > 0.1
    held = setup.topology.first[setup.boundary.known]
    np.testing.assert_array_equal(outcome.points[held], points[held])


def test_a_grid_in_an_inclined_plane_stays_in_it():
    grid, a = frame_2d(6), 0.6
    turn = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    tilted = grid.moved(np.ascontiguousarray(grid.points @ turn.T))
    axis = turn @ [0.0, 0.0, 1.0]
    near = expression("abs(x) < 0.51 and sqrt(y*y + z*z) < 0.51", {"x", "y", "z"})
    spec = BoundarySpec("body", ("*",), Kind.MOVING, near, turning("110", axis=tuple(axis)))
    result = deform(tilted, Case((spec,)), steps=1)
    assert result.repair is not None
    assert result.valid
    assert np.abs(result.grid.points @ axis).max() < 1e-12


def test_periodic_sides_move_alike():
    grid = cube(9)
    specs = (
        BoundarySpec("floor", ("*.kmin",), Kind.MOVING, None, formulas("0", "0", "0.9*exp(-40*(y-0.4)**2)")),
        BoundarySpec("sides", ("*.imin", "*.imax"), Kind.PERIODIC),
        BoundarySpec("rest", ("*.jmin", "*.jmax"), Kind.SLIP),
    )
    setup = set_up(grid, Case(specs))
    points = grid.points.copy()
    block = grid.block(0, points)
    # A cell on each side of the period is turned over.
    block[0, 4, 4, 2] += 0.5
    block[-1, 4, 4, 2] += 0.5
    verdict, outcome = repaired(setup, points)
    assert not verdict.valid
    assert outcome.verdict.valid
    moved = grid.block(0, outcome.points - grid.points)
    np.testing.assert_allclose(moved[0], moved[-1], rtol=0, atol=1e-15)
    assert np.abs(moved[0]).max() > 0.01
    # Distances, in cells, from the first of a row of cells reach it from both sides.
    layers = grid.block(0, Basis(setup.original, setup.boundary).near(np.array([4 * 8 + 4]), 9))
    np.testing.assert_array_equal(layers[:, 4, 4], [0, 0, 1, 2, 3, 3, 2, 1, 0])


def test_planes_at_an_image_count_as_seen_from_its_root():
    """A casing of three planes; those at the periodic sides are normal to the radius: one turns into the other."""

    def block(degrees):
        a, s, z = np.meshgrid(np.radians(degrees), [0.5, 0.75, 1.0], [0.0, 0.5, 1.0], indexing="ij")
        r = 2.0 * s / np.cos(a - np.pi / 6 * np.rint(a * 6 / np.pi))
        return np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)

    specs = (
        BoundarySpec("hub", ("*.jmin",), Kind.MOVING, None, formulas("0", "0", "0")),
        BoundarySpec("casing", ("*.jmax",), Kind.SLIP),
        BoundarySpec("pitch", ("block1.imin", "block3.imax"), Kind.PERIODIC),
    )
    grid = Grid.from_blocks([block(degrees) for degrees in ([0, 8, 15], [15, 30, 45], [45, 52, 60])])
    setup = set_up(grid, Case((*specs, BoundarySpec("span", ("*.k*",), Kind.SLIP))))
    found, turn = Constraints.of(setup.original, setup.boundary), Rotation.from_euler("z", 60, degrees=True).as_matrix()
    root, image = (setup.topology.numbers_of(np.array([n]))[0] for n in (7, 2 * 27 + 18 + 7))
    assert found.root[image] == root
    np.testing.assert_allclose(found.frame[root], np.diag([0.0, 1.0, 1.0]), atol=1e-12)
    np.testing.assert_allclose(found.frame[image], turn @ np.diag([0.0, 1.0, 1.0]), atol=1e-12)


def test_when_nothing_helps_the_boundary_is_where_it_was_told():
    """The bar is pushed through the outer boundary: no valid grid exists."""
    result = deform(frame(4, 1), Case(tuple(body_specs(formulas("0", "6", "0")))))
    assert not result.valid
    assert result.reached == 1.0
    setup = result.setup
    wall = setup.topology.first[setup.boundary.known]
    told = setup.grid.points[wall] + setup.displacement(0.0)[setup.boundary.known]
    np.testing.assert_array_equal(result.grid.points[wall], told)
    # What was reached before the walls meet is told; both repairs are short.
    assert ["'body'" in result.warnings[-2], "only for 2" in result.warnings[-1]] == [True, True]
    assert 0 < result.repair.newton_steps <= 60
    assert result.attempts[1].invalid_cells < result.attempts[0].invalid_cells


@pytest.mark.parametrize("wrong", [{"mode": "no"}, {"min_jacobian": -0.1}, {"min_jacobian": 1.0}, {"time_limit": 0.0}])
def test_options_are_checked(wrong):
    with pytest.raises(CaseError):
        RepairOptions(**wrong)


def test_extruded_grids_are_repaired_as_plane_ones_whatever_their_indices():
    grid = frame(6, 3)
    ends = expression("z < 0.01 or z > 0.99", {"x", "y", "z"})
    body, _ = body_specs(turning("110"))
    specs = (dataclasses.replace(body, select=("*",)), BoundarySpec("span", ("*",), Kind.SLIP, ends))
    results = [deform(g, Case(specs), steps=1) for g in (grid, permuted(grid, (2, 0, 1), (False, True, False)))]
    plain, mixed = (np.unique(np.round(np.hstack([r.setup.grid.points, r.grid.points]), 7), axis=0) for r in results)
    assert all(result.valid for result in results)
    np.testing.assert_allclose(plain, mixed, atol=1e-5)
    for b in range(grid.n_blocks):
        inner = grid.block(b, results[0].grid.points)[1:-1, 1:-1]
        np.testing.assert_allclose(np.ptp(inner[..., :2], axis=2), 0.0, atol=1e-12)


def test_what_differs_along_lines_fades_out_smoothly():
    shares = np.linspace(0.0, 1.2 * energy.ALONG, 13)
    kept, slope = np.transpose([energy.kept_along_lines(share) for share in shares])
    assert (kept[0], slope[0], *kept[10:], *slope[10:]) == (1.0, *np.zeros(7))
    h = 1e-6 * energy.ALONG
    ends = [[energy.kept_along_lines(share + sign * h)[0] for share in shares[1:]] for sign in (1, -1)]
    np.testing.assert_allclose(np.subtract(*ends) / (2 * h), slope[1:], atol=1e-5 / energy.ALONG)


@pytest.mark.parametrize("common", [0.0, 0.3, 0.4])
def test_what_differs_along_lines_is_dropped_where_it_would_make_cells_invalid(common):
    """With a common shift of the line, a repair of the plane grid that would keep nearly all of the differences."""
    grid = frame(4, 3)
    setup = set_up(grid, Case(tuple(body_specs(turning("20")))))
    repairer = Repairer(Basis(setup.original, setup.boundary))
    extrusion, _ = repairer.basis.extrusion
    points = grid.points.copy()
    block = grid.block(0, points)
    block[2, 2] += common * (block[2, 3] - block[2, 2])
    block[2, 2, 1] += block[3, 2, 1] - block[1, 2, 1]
    mean, verdict = extrusion.flattened(points - grid.points), judge(setup.original, points)
    assert not verdict.valid
    found = repairer.repair(Judged(points, verdict))
    assert found.verdict.valid
    change = extrusion.flattened(found.points - grid.points)
    np.testing.assert_allclose(found.points - grid.points, change[extrusion.line], atol=1e-12)
    assert (np.abs(change - mean).max() > 1e-12) == (common > 0.0)
    # A line near the next one has four weak cells in each of three layers.
    block[2, 2] = 0.2 * grid.block(0)[2, 2] + 0.8 * grid.block(0)[2, 3]
    assert repairer.repair(Judged(points, judge(setup.original, points))).repair.weak == 4 * 3


def test_a_repair_is_bounded_and_undone_far_from_cells_that_stay_invalid(monkeypatch):
    """A corner whose nodes are all prescribed stays inverted; a node near it is moved back."""
    grid = cube(41, 2)
    setup = fixed_setup(grid)
    points = grid.points.copy()
    block = grid.block(0, points)
    block[0, 0] = 1.2 * block[1, 1]
    block[4, 4] += 1.2 * (block[5, 5] - block[4, 4])
    verdict, outcome = repaired(setup, points, farthest=0.01)
    assert not verdict.valid
    assert not outcome.verdict.valid
    moved = np.linalg.norm(outcome.points - points, axis=1)
    assert 0.009 < moved.max() <= 0.01 * (1 + 1e-12)
    # In full within 8 cells of those that are or were invalid, beyond 16 not at all.
    with monkeypatch.context() as whole:
        whole.setattr(Repairer, "_undone", lambda _, start, end: end)
        _, entire = repaired(setup, points, farthest=0.01)
    cells = np.union1d(verdict.invalid, outcome.verdict.invalid)
    ends = np.array(np.divmod(cells, 40)).T[:, None] + [[0, 0], [0, 1], [1, 0], [1, 1]]
    away = np.abs(np.indices((41, 41)).reshape(2, -1, 1) - ends.reshape(-1, 2).T[:, None]).max(axis=0).min(axis=1)
    part = np.clip(2.0 - away / 8.0, 0.0, 1.0)[:, None]
    np.testing.assert_allclose(outcome.points, points + part * (entire.points - points), atol=1e-15)


def test_nodes_at_the_rim_of_a_region_are_held():
    """The energy has the cells around the nodes that move, whose outer nodes stay."""
    setup = fixed_setup(cube(9))
    basis = Basis(setup.original, setup.boundary)
    plot = basis.plot(basis.near(np.array([setup.grid.n_cells // 2]), 1), 1)
    np.testing.assert_array_equal(np.flatnonzero(plot.region.unknowns.number >= 0), np.sort(plot.at))
    assert 0 < len(plot.at) < len(plot.nodes) < basis.n_unknowns


@pytest.mark.parametrize("large", [0, 10**9])
def test_the_minimum_over_a_neighbourhood_is_not_called_that_over_all_nodes(large, monkeypatch):
    monkeypatch.setattr("meshdeform_core.repair.repair.LARGE", large)
    setup = fixed_setup(cube(41, 2))
    points = setup.grid.points.copy()
    block = setup.grid.block(0, points)
    block[20, 20] += 1.2 * (block[21, 21] - block[20, 20])
    _, outcome = repaired(setup, points)
    assert outcome.verdict.valid
    assert outcome.repair.converged == (large > 0)


def test_a_repair_that_does_not_fit_is_left_out_with_the_reason():
    grid, limit = frame_2d(6), MemoryLimit(1000, "--max-memory allows")
    body = body_specs(turning("75"))[0]
    setup = set_up(grid, Case((body,)), memory=MemoryLimit(2**20, "--max-memory allows"))
    result = impose(setup, setup.motion(0.0), None, "float64", Timing())
    plain = impose(setup.with_repair("off"), setup.motion(0.0), None, "float64", Timing())
    assert plain.valid
    _, outcome = repaired(setup, plain.grid.points, memory=limit)
    assert "--max-memory allows 1000 B" in outcome.repair.left_out
    np.testing.assert_array_equal(outcome.points, plain.grid.points)
    assert result.valid


def test_a_grid_turned_about_its_middle_is_still_an_extrusion():
    """Round-off of its heights is relative to its extent, not to its distance from the origin."""
    grid = frame(3, 2)
    middle = grid.points - (grid.points.min(axis=0) + grid.points.max(axis=0)) / 2
    turned = middle @ Rotation.from_rotvec([0.3, 0.5, 0.7]).as_matrix().T
    for bent in (0.0, 0.01 * np.sin(grid.points + 1.0).prod(axis=1)[:, None]):
        setup = set_up(grid.moved(turned + bent), Case(tuple(body_specs(turning("20")))[:1]))
        constraints = Constraints.of(setup.original, setup.boundary)
        free = dataclasses.replace(constraints, held=np.zeros(setup.topology.n_unique, bool))
        assert (find_extrusion(free) is None) == np.any(bent)


def test_only_plane_motions_of_extruded_grids_are_taken_for_plane():
    grid = frame(5, 3)
    setup = set_up(grid, Case(tuple(body_specs(turning("20"), Kind.SLIP))))
    constraints = Constraints.of(setup.original, setup.boundary)
    extrusion = find_extrusion(constraints)
    assert extrusion is not None
    # One node of a line differs from the others in what holds it: one of the body, one of an interface.
    body, interface = np.flatnonzero(constraints.walls)[1], np.flatnonzero(~constraints.held)[1]
    tilted = np.diag([0.0, 1.0, 1.0])
    for name, node, value in (
        ("held", body, False), ("held", interface, True), ("walls", body, False), ("walls", interface, True),
        ("frame", interface, tilted), ("frame", body, tilted), ("root", interface, body),
    ):  # fmt: skip
        other = getattr(constraints, name).copy()
        other[node] = value
        assert find_extrusion(dataclasses.replace(constraints, **{name: other})) is None
    assert extrusion.plane.n_nodes * 4 == grid.n_nodes
    change = np.tile([0.1, 0.2, 0.0], (grid.n_nodes, 1))
    np.testing.assert_allclose(extrusion.flattened(change), np.tile([0.1, 0.2, 0.0], (extrusion.plane.n_nodes, 1)))
    wall = setup.topology.first[setup.boundary.known][:1]
    for direction in ([0.0, 0.0, 1e-3], [1e-3, 0.0, 0.0]):
        other = change.copy()
        other[wall] += direction
        assert extrusion.flattened(other) is None
    # Fixed ends hold lines whose middles are free.
    fixed = set_up(grid, Case(tuple(body_specs(turning("20"), Kind.FIXED))))
    assert find_extrusion(Constraints.of(fixed.original, fixed.boundary)) is None


@pytest.mark.parametrize("dimension", [2, 3])
def test_nodes_slide_on_curved_surfaces_and_stay_on_them(dimension):
    """A quarter of a ring or shell; its outer side slides on the polygon of its undeformed edges."""
    angle, radius, z = np.linspace(0.0, np.pi / 2, 13), np.linspace(1.0, 2.0, 9), np.linspace(0.0, 0.6, 5)
    a, r, h = np.meshgrid(angle, radius, z if dimension == 3 else np.zeros(1), indexing="ij")
    # Not an extrusion, which would be repaired as a plane grid.
    grid = Grid.from_blocks([np.stack([(1 + 0.2 * h**2) * r * np.cos(a), r * np.sin(a), h], axis=-1)])
    outer = BoundarySpec("outer", ("*.jmax",), Kind.SLIP)
    inner = BoundarySpec("inner", ("*.jmin",), Kind.MOVING, None, formulas("0", "0", "0"))
    setup = set_up(grid, Case((outer, inner)))
    constraints = Constraints.of(setup.original, setup.boundary)
    (sliding,) = constraints.sliding
    assert sliding.nodes.size == 11 * (3 if dimension == 3 else 1)
    points = setup.grid.points.copy()
    block = setup.grid.block(0, points)
    # Nodes crowd on the surface, in the middle of the segments.
    for i in range(1, 6):
        block[i, -1] = 0.5 * (setup.grid.block(0)[0, -1] + setup.grid.block(0)[1, -1])
        block[i, -2] += 0.8 * (setup.grid.block(0)[i + 3, -2] - setup.grid.block(0)[i, -2])
    if dimension == 3:
        block[:, :, [0, -1]] = setup.grid.block(0)[:, :, [0, -1]]
    verdict, outcome = repaired(setup, points)
    assert verdict.failed.any()
    assert outcome.verdict.valid
    after = outcome.points[setup.topology.first[sliding.nodes]]
    before = points[setup.topology.first[sliding.nodes]]
    assert np.abs(after - before).max() > 0.05
    _, _, distance = sliding.closest(after)
    assert distance.max() < 1e-12
    held = setup.topology.first[constraints.held]
    np.testing.assert_array_equal(outcome.points[held], points[held])


@pytest.mark.parametrize(("amount", "full"), [(0.6, False), (0.8, True)])
def test_a_patient_search_reaches_the_minimum_only_if_the_share_is_full_at_the_start(amount, full):
    setup = fixed_setup(cube(7, 2))
    plot, points = Basis(setup.original, setup.boundary).whole, setup.grid.points.copy()
    assert Untangler(plot, plot.inside(points)).search(QUICK, False) is None
    block = setup.grid.block(0, points)
    block[3, 3] += amount * (block[4, 4] - block[3, 3])
    quick, patient, polished = (
        Untangler(plot, plot.inside(points)).search(*how) for how in ((QUICK, False), (PATIENT, False), (PATIENT, True))
    )
    assert [each.converged for each in (quick, patient, polished)] == [True, full, True]
    assert [each.sound for each in (quick, patient, polished)] == [True] * 3
    assert (quick.share >= 1.0) == full


@pytest.mark.slow
@pytest.mark.parametrize(("angle", "skew", "height", "wall"), [(60.0, 0.35, 0.5, 10.0), (90.0, 0.18, 0.2, 14.0)])
def test_the_splitter_plate_turns_far_and_keeps_its_first_cells(angle, skew, height, wall):
    """One repair of one step; without weights at walls first cells lost nine tenths of their height. With the convex
    part of the second derivatives alone, 60 steps do not suffice: each is 7 % shorter than the one before."""
    setup = prepare_sample(Sample("splitter-plate", 8, constants=(("angle", angle),)))
    result = impose(setup, setup.motion(0.0), 1, "float64", Timing())
    after = result.assessment.after
    assert result.valid
    assert result.repair.converged
    assert result.repair.newton_steps < 60
    assert after.f_skew.min > skew
    assert after.first_cell_height_ratio is not None
    assert after.first_cell_height_ratio.min > height
    assert after.first_cell_height_ratio.max < 1.3
    assert after.wall_normal_deviation_deg is not None
    assert after.wall_normal_deviation_deg.rms < wall
