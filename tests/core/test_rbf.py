"""RBF against scipy and a slow twin; its solvers, its greedy reduction, its centres."""

import dataclasses
import itertools

import numpy as np
import pytest
from cases import SETS, apply, bend, body_specs, everything_moves, inner_nodes, problem_of, sphere, told, turning
from grids import frame, frame_2d, polar
from reference.rbf import COMPACT, distances, slow_greedy, slow_rbf

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid, Side
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import RBF, Options, Problem, make_method
from meshdeform_core.methods.base import Account, Setting
from meshdeform_core.methods.scattered.block_rbf import BlockRBF
from meshdeform_core.methods.scattered.prepared_rbf import Centres, RadialSystem
from meshdeform_core.methods.scattered.summation import fast_pays
from meshdeform_core.numerics import krylov
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.radial import radial_matrix, radial_sums
from meshdeform_core.numerics.fastsum.nested import NestedSums
from meshdeform_core.numerics.krylov import ExactProduct, KrylovSolver, NestedProduct
from meshdeform_core.numerics.saddle import DirectSolver


def moved_by(options: RBF, problem: Problem) -> np.ndarray:
    return apply(Options("rbf", rbf=options), problem, told(problem))


def bent(problem: Problem) -> np.ndarray:
    """A smooth displacement of the sources that is not linear."""
    x = problem.source_points
    return np.stack([0.1 * np.sin(2 * x[:, 1]), 0.15 * np.cos(2 * x[:, 0]), 0.05 * x[:, 0] * x[:, 1]], axis=1)


@pytest.mark.parametrize(
    ("name", "radius", "solver"),
    [
        *((name, radius, "auto") for name in COMPACT for radius in (1.5, 6.0)),
        ("tps", 1, "direct"),
        ("tps", 1, "krylov"),
    ],
)
def test_slow_twin(name, radius, solver):
    problem = problem_of(frame(), body_specs(turning(25)))
    inside = inner_nodes(problem)
    moved = moved_by(RBF(basis=name, radius=radius, solver=solver, tolerance=1e-13), problem)[inside]
    expected = slow_rbf(name, radius, problem.source_points, told(problem), problem.grid.points[inside])
    np.testing.assert_allclose(moved, expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize("specs", [None, [BoundarySpec("top", ("block3.kmin",), Kind.MOVING, None, turning(5)),
                                          BoundarySpec("rest", ("*",), Kind.FREE)]], ids=["all", "planar"])  # fmt: skip
@pytest.mark.parametrize("options", [RBF(), RBF(basis="wendland-c2", radius=3.0)], ids=["tps", "compact"])
def test_planar_centres_have_a_solution(specs, options):
    """All centres in the plane z = 0, in two and in three dimensions: no polynomial term across it."""
    problem = problem_of(frame_2d() if specs is None else frame(), specs or everything_moves(turning(5)))
    assert np.all(problem.source_points[:, 2] == 0.0)
    prepared = make_method(Options("rbf", rbf=options)).prepare(problem)
    told = Setting("linear in 2 directions", "the centres lie in a plane or on a line")
    assert prepared.account.settings["polynomial"] == told
    values = bent(problem) * [1, 1, 0]
    targets = inner_nodes(problem)
    expected = slow_rbf(options.basis, 3.0, problem.source_points, values, problem.grid.points[targets], (0, 1))
    np.testing.assert_allclose(prepared.apply(values)[targets], expected, rtol=0, atol=1e-9)


def test_every_node_is_within_the_radius_of_every_moving_source():
    problem = problem_of(frame(), body_specs(turning(10)))
    method = make_method(Options("rbf", rbf=RBF(basis="wendland-c2"))).prepare(problem)
    moving = problem.source_points[problem.boundary.kind[problem.source_numbers] == Kind.MOVING]
    farthest = np.linalg.norm(moving[:, None] - problem.grid.points, axis=2).max()
    assert farthest <= method.account.settings["radius"].value <= 1.5 * farthest


def test_seams_and_poles_are_one_centre_each():
    """An O-grid whose inner circle is collapsed to its axis: hundreds of block nodes share centres."""
    pole = polar()
    blocks = [pole.block(0).copy()]
    blocks[0][:, -1, :, :2] = 0.0
    problem = problem_of(Grid.from_blocks(blocks), everything_moves())
    assert len(np.unique(problem.source_points, axis=0)) == len(problem.source_points)
    values = bent(problem)
    moved = apply(Options("rbf"), problem, values)
    inside = inner_nodes(problem)
    expected = slow_rbf("tps", 1.0, problem.source_points, values, problem.grid.points[inside])
    np.testing.assert_allclose(moved[inside], expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("name", "updates"), [*((name, 50) for name in COMPACT), ("wendland-c2", 0), ("wendland-c0", 3)]
)
@pytest.mark.parametrize("measure", ["absolute", "first-cell"])
def test_greedy_reduction_has_a_slow_twin(name, updates, measure):
    """No two nodes have equal errors, whose order round-off would decide."""
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    values = told(problem) * (1.0 + 0.2 * np.sin(problem.source_points @ [[2.0], [1.0], [1.5]]))
    options = RBF(basis=name, radius=6.0, greedy="hybrid", greedy_error=measure, greedy_tolerance=0.02,
                  greedy_updates=updates)  # fmt: skip
    bound = options.bind(problem, inner_nodes(problem))
    fit, settings = bound.fit(values), bound.account.settings
    x = (problem.source_points - problem.source_points.mean(axis=0)) / 6.0
    scale = np.ones((len(x), 1)) if measure == "absolute" else problem.first_cell_height[:, None]
    chosen, error, rounds = slow_greedy(name, x, values, scale, 0.02, updates or len(x))
    np.testing.assert_allclose(fit.centres, x[chosen], atol=1e-14)
    np.testing.assert_allclose(fit.residual, error, atol=1e-9)
    assert fit.reach == pytest.approx(20.0 * np.linalg.norm(error, axis=1).max())
    unit = "length unit" if measure == "absolute" else "first-cell heights"
    assert settings["greedy_points"] == Setting(len(chosen), f"of {len(x)} centres")
    assert settings["greedy_rounds"].value == rounds
    assert settings["greedy_updates_done"].value == rounds * (updates or len(x))
    assert settings["greedy_tolerance"] == Setting(0.02, unit)
    assert settings["greedy_error_reached"].value == pytest.approx(np.abs(error / scale).max())
    assert bound.account.warnings == []


@pytest.mark.parametrize("error", ["first-cell", "absolute"])
def test_greedy_correction_carries_nodes_with_what_is_left_at_the_nearest_source(error):
    """It fades out with the distance, so that first cells keep their shape."""
    problem = problem_of(frame(3, 2), body_specs(turning(25)))
    options = RBF(basis="wendland-c2", radius=6.0, greedy="hybrid", greedy_error=error, greedy_tolerance=0.05)
    moved, inside = moved_by(options, problem), inner_nodes(problem)
    np.testing.assert_array_equal(moved[problem.source_flat], told(problem))
    plain = moved_by(dataclasses.replace(options, greedy_correct=False), problem)
    fit = options.bind(problem, inside).fit(told(problem))
    away = distances(problem.grid.points[inside], problem.source_points)
    r = np.minimum(away.min(axis=1) / fit.reach, 1.0)[:, None]
    expected = (1.0 - r) ** 4 * (4.0 * r + 1.0) * fit.residual[away.argmin(axis=1)]
    # But for a node that is equally far from two.
    own = np.abs((moved - plain)[inside] - expected).max(axis=1) < 1e-14
    assert own.sum() == len(inside) - 1
    assert 0.0 < np.abs(expected).max() <= 0.05 * (problem.first_cell_height.max() if error == "first-cell" else 1.0)


def test_first_cells_are_as_high_as_the_nearest_node_off_each_face():
    """Of a sector whose axis is no face; there, faces beside it have no height, and in its middle edges are taken."""
    r, a, z = np.meshgrid([0.0, 0.1, 0.4, 1.0], np.linspace(0.0, 1.0, 5), [0.0, 0.2, 1.0], indexing="ij")
    x = np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)
    problem = problem_of(Grid.from_blocks([x]), everything_moves())
    lowest = np.full(len(problem.source_points), np.inf)
    for axis, end in list(itertools.product(range(3), (0, -1)))[1:]:
        wall, off = (np.take(x, n, axis).reshape(-1, 3) for n in (end, 1 if end == 0 else -2))
        height = np.linalg.norm(off - wall, axis=1)
        for at, own in zip(wall[height > 0], height[height > 0], strict=True):
            same = (problem.source_points == at).all(axis=1)
            lowest[same] = np.minimum(lowest[same], own)
    np.testing.assert_allclose(problem.first_cell_height, np.where(np.isinf(lowest), 0.1, lowest))


def test_sides_are_left_out_of_the_skeleton_if_all_of_them_slides():
    lower = BoundarySpec("lower", ("*.kmin",), Kind.SLIP, expression("x < 1", {"x"}))
    problem = problem_of(frame(), [lower, BoundarySpec("upper", ("*.kmax",), Kind.SYMMETRY)])
    found = BlockRBF(RBF()).skeleton(problem).left_out
    assert found == {(block, Side.KMAX) for block in range(8)} | {(block, Side.KMIN) for block in range(5)}


def test_thin_plate_splines_cannot_be_reduced():
    with pytest.raises(MethodError, match=r"thin plate spline.*wendland-c2"):
        RBF(basis="tps", greedy="hybrid")


def system(points: np.ndarray, basis: str, radius: float | None) -> tuple[KrylovSolver, Centres, int]:
    centres, kind = Centres.of(points, radius), BASES[basis]
    x = centres.points
    return KrylovSolver(kind, x, centres.polynomial(x), ExactProduct(kind, x)), centres, kind


@pytest.mark.parametrize(
    ("name", "basis", "reach"),
    [
        *((name, "tps", None) for name in SETS),
        *((name, "wendland-c2", 2.0) for name in ("graded-plane", "two-scales")),
        *((name, "wendland-c0", 0.2) for name in ("graded-plane", "two-scales")),
    ],
)
def test_solution_is_that_of_the_factorised_system(name, basis, reach):
    points = SETS[name]
    extent = np.linalg.norm(points - points.mean(axis=0), axis=1).max()
    solver, centres, kind = system(points, basis, None if reach is None else reach * extent)
    told = bend(points / extent)
    found = solver.solve(told, 1e-6, 60)
    assert found.iterations <= 25
    assert found.residual.max() <= 1e-6
    x, terms = centres.points, centres.polynomial(centres.points)
    matrix = radial_matrix(kind, x, x)
    rest = told - matrix @ found.coefficients - terms @ found.polynomial
    assert (np.linalg.norm(rest, axis=0) <= 1.1e-6 * np.linalg.norm(told, axis=0)).all()
    np.testing.assert_allclose(terms.T @ found.coefficients, 0, atol=1e-9 * np.abs(found.coefficients).sum())
    # Between the centres, where coefficients that differ may mean the same, both interpolate alike.
    between = centres.normalised(0.5 * (points[:-1] + points[1:])[::7])
    known = DirectSolver(lambda: matrix, terms).solve(told)
    one, two = (radial_sums(kind, between, x, c) + centres.polynomial(between) @ p
                for c, p in [(found.coefficients, found.polynomial), known])  # fmt: skip
    assert np.abs(one - two).max() < 2e-5 * np.abs(told).max()


def test_dependent_and_empty_columns():
    solver, centres, _ = system(SETS["sphere"], "tps", None)
    told = bend(centres.points)
    told[:, 1], told[:, 2] = 2 * told[:, 0], 0.0
    found = solver.solve(told, 1e-6, 40)
    assert found.residual.max() <= 1e-6
    assert np.all(found.coefficients[:, 2] == 0)
    assert np.all(found.polynomial[:, 2] == 0)
    nothing = solver.solve(np.zeros_like(told), 1e-6, 40)
    assert nothing.iterations == 0
    assert np.all(nothing.coefficients == 0)


@pytest.mark.parametrize("n", [1, 2, 3, 5, 61, 400])
def test_few_and_duplicate_centres(n):
    points = np.random.default_rng(n).uniform(size=(n, 3))
    for centres in (points, np.concatenate([points, points[: n // 5 + 1]])):
        solver, _, _ = system(centres, "tps", None)
        found = solver.solve(bend(centres), 1e-10, 20)
        assert found.residual.max() <= 1e-10


@pytest.mark.parametrize(("stalled", "room"), [(False, 2**40), (False, 12 * 2**20), (True, 2**40)])
def test_not_converging_is_a_warning_until_the_next_displacement(stalled, room, monkeypatch):
    """The matrix of 1,444 centres takes 16 MiB."""
    account, centres = Account(), Centres.of(SETS["graded-plane"], 2.0)
    options = RBF(basis="wendland-c2", radius=2.0, solver="krylov", max_iterations=1, tolerance=1e-12)
    system = RadialSystem(options, centres, MemoryLimit(room, "the machine has"))
    solve = KrylovSolver.solve
    monkeypatch.setattr(KrylovSolver, "solve", lambda *given: dataclasses.replace(solve(*given), stalled=stalled))
    system.solve(bend(centres.points), account, None)
    worst = max(account.settings["residual"].value)
    more = "the limit of round-off; " if stalled else "raise method.rbf.max_iterations, "
    other = "" if stalled or room < 2**24 else " or solver = direct"
    told = (
        f"GMRES stopped after 1 iterations with a residual of {worst:.2e} (asked for 1e-12); {more}loosen tolerance, "
    )
    assert account.warnings == [f"{told}use a smaller radius{other}"]
    system.solve(np.zeros_like(centres.points), account, None)
    assert account.warnings == []


def test_short_support_multiplies_by_its_nonzeros_only():
    points = np.concatenate([sphere(4000), 1.5 * sphere(2000)])
    centres = Centres.of(points, 0.18)
    told, account = bend(points), Account()
    options = RBF(basis="wendland-c2", radius=0.18)
    coefficients, polynomial = RadialSystem(options, centres).solve(told, account, None)
    assert account.settings["products"].value.startswith("sparse matrix of ")
    assert account.warnings == []
    x = centres.points
    rest = told - radial_sums(BASES["wendland-c2"], x, x, coefficients) - centres.polynomial(x) @ polynomial
    assert (np.linalg.norm(rest, axis=0) <= 1.1e-6 * np.linalg.norm(told, axis=0)).all()


def test_automatic_choice_by_size_alone():
    sizes = ("auto", 10**6, 2000), ("auto", 10**5, 2001), ("auto", 10**4, 2001), ("fast", 1, 1), ("fast", 0, 1)
    assert [fast_pays(*each)[0] for each in sizes] == [False, True, False, True, False]
    assert fast_pays("exact", 10**5, 2001)[1] == Setting("exact")
    assert fast_pays("auto", 10**5, 2001)[1] == Setting("fast", "100,000 nodes with 2,001 sources")
    few, many = Centres.of(SETS["curve"], None), Centres.of(sphere(5000), None)
    assert RadialSystem(RBF(), few).solver == "direct"
    assert RadialSystem(RBF(), many).solver == "krylov"
    tight = MemoryLimit(40 * 2**20, "--max-memory allows")
    assert RadialSystem(RBF(), many, tight).solver == "krylov"
    told = r"of 1,200 centres needs about 11 MiB, --max-memory allows 1000 B; use solver = krylov, greedy reduction"
    with pytest.raises(MethodError, match=told):
        RadialSystem(RBF(), few, MemoryLimit(1000, "--max-memory allows"))
    with pytest.raises(MethodError, match="solver = krylov"):
        RadialSystem(RBF(solver="direct"), many, tight)


CLOUDS = SETS | {
    "volume": np.random.default_rng(1).uniform(size=(3000, 3)),
    "duplicates": np.repeat(sphere(700), 3, axis=0),
    "one point": np.zeros((300, 3)),
    "few": sphere(7),
}
RADIUS = {"tps": None, "wendland-c0": 5.0, "wendland-c2": 0.7, "ctps-c1": 2.0, "ctps-c2a": 5.0, "ctps-c2b": 1.0}


def normalised(name, basis):
    points = CLOUDS[name]
    extent = np.linalg.norm(points - points.mean(axis=0), axis=1).max() or 1.0
    radius = RADIUS[basis]
    return Centres.of(points, None if radius is None else radius * extent).points


def charges(n):
    """Coefficients of random signs: what a cluster does nearly cancels, as with coefficients of an interpolation."""
    return np.random.default_rng(n).standard_normal((n, 3))


@pytest.mark.parametrize(
    ("name", "basis"), [*((name, "tps") for name in CLOUDS), *(("volume", basis) for basis in RADIUS if basis != "tps")]
)
def test_sums_are_the_exact_ones_to_the_tolerance(name, basis):
    points, kind = normalised(name, basis), BASES[basis]
    c = charges(len(points))
    exact = radial_sums(kind, points, points, c)
    size = np.abs(radial_matrix(kind, points[:50], points)).max() * np.sqrt(len(points))
    for tolerance in (1e-4, 1e-8):
        found = NestedSums(kind, points, tolerance)(c)
        # The singular part is up to 60 r^3 log r (see decompose), and a sum has a hundred clusters or so.
        assert np.abs(found - exact).max() <= 100 * tolerance * size + 1e-12 * size


def test_far_clusters_are_not_summed_centre_by_centre():
    points = Centres.of(sphere(20000), None).points
    sums = NestedSums(0, points, 1e-8)
    assert sums.pairs < 0.2 * len(points) ** 2
    c = charges(len(points))
    rows = np.arange(0, len(points), 97)
    np.testing.assert_allclose(sums(c)[rows], radial_sums(0, points[rows], points, c), atol=1e-5)


@pytest.fixture
def nested(monkeypatch):
    monkeypatch.setattr(krylov, "_NESTED_FROM", 100)
    monkeypatch.setattr(krylov, "_LARGEST_PART", 10.0)


def solved(points, basis="tps", radius=None, tolerance=1e-6, limit=2**40):
    system = RadialSystem(RBF(solver="krylov", basis=basis, tolerance=tolerance), Centres.of(points, radius),
                          MemoryLimit(limit, "the machine has"))  # fmt: skip
    account, told = Account(), bend(points)
    coefficients, polynomial = system.solve(told, account, None)
    x = system.centres.points
    rest = told - radial_sums(system.kind, x, x, coefficients) - system.terms @ polynomial
    size = np.linalg.norm(told, axis=0)
    return system, np.linalg.norm(rest, axis=0) / np.where(size > 0, size, 1.0), account


@pytest.mark.parametrize(("basis", "radius"), [("tps", None), ("wendland-c0", 4.0), ("ctps-c1", 3.0)])
@pytest.mark.parametrize("name", ["sphere", "graded-plane", "two-scales"])
def test_solutions_have_the_residual_that_is_reported(nested, name, basis, radius):
    points = SETS[name] / np.abs(SETS[name]).max()
    system, residual, account = solved(points, basis, radius)
    assert isinstance(system._krylov.product, NestedProduct)
    assert residual.max() <= 1e-6
    # Reported is the residual by nested sums and the norm of their error: an upper bound, not far off.
    reported = np.array(account.settings["residual"].value)
    assert (residual <= 1.1 * reported).all()
    assert (reported <= 2 * residual + 3e-7).all()


def test_sums_that_are_too_coarse_are_refined(nested, monkeypatch):
    monkeypatch.setattr(krylov, "_FINER", 1e3)
    system, residual, account = solved(sphere(3000))
    assert residual.max() <= 1e-6
    assert system._krylov.product._tolerance < 1e-4
    assert "nested" in account.settings["products"].value


def test_errors_of_sums_are_part_of_the_residual(monkeypatch):
    """Errors of a thousandth, which no refinement makes smaller."""
    solver, centres, kind = system(sphere(300), "tps", None)
    x, given, rough = centres.points, bend(centres.points), 1.0 + 1e-3 * np.sin(np.arange(300))[:, None]
    monkeypatch.setattr(ExactProduct, "__call__", lambda _, c: rough * radial_sums(kind, x, x, c))
    monkeypatch.setattr(ExactProduct, "error", lambda _, c, found: np.linalg.norm(found - found / rough, axis=0))
    found = solver.solve(given, 1e-6, 100)
    rest = given - radial_sums(kind, x, x, found.coefficients) - centres.polynomial(x) @ found.polynomial
    assert (np.linalg.norm(rest, axis=0) <= 1.01 * found.residual * np.linalg.norm(given, axis=0)).all()


def test_little_memory_is_refused_and_changes_no_sums(nested):
    points = sphere(3000)
    with pytest.raises(MethodError, match=r"3,000 centres needs about .*the machine has"):
        solved(points, limit=KrylovSolver.memory(3000) + 10_000)
    with pytest.raises(MethodError, match=r"3,000 centres needs about .*the machine has"):
        solved(100 * points, "wendland-c2", 5.0, limit=KrylovSolver.memory(3000) + 10_000)
