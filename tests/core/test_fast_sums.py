"""Fast IDW sums against exact ones: every rotation kind and weight, the tolerance kept, nothing common disturbed;
sums in single and double precision beside plain numpy, for distances of all sizes."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from cases import apply, body_specs, constant, everything_moves, problem_of, sphere, told, turning
from grids import frame, frame_2d
from reference.rbf import COMPACT

from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import IDW, Options, make_method
from meshdeform_core.methods.scattered import idw_sums
from meshdeform_core.methods.scattered.summation import doubtful
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.direct import sum_groups
from meshdeform_core.numerics.exact.radial import radial_sums
from meshdeform_core.numerics.fastsum.clusters import build_tree
from meshdeform_core.numerics.fastsum.plan import sum_single
from meshdeform_core.numerics.fastsum.radial import FastRadial, make_radial_targets
from meshdeform_core.numerics.fastsum.targets import make_targets, node_sizes, shape_table
from meshdeform_core.numerics.fastsum.weighted import Accuracy, FastSums

VARIANTS = {
    "none": {"rotation": "none"},
    "quaternion": {"rotation": "quaternion"},
    "division": {"rotation": "division", "divisions": 4},
    "blend": {"rotation": "blend"},
    "lie": {},
    "other exponents": {"a": 2.5, "b": 4.0, "alpha": 0.3},
    "shepard": {"weights": "shepard"},
    "shepard, two exponents": {"weights": "shepard", "p_moving": 4.0, "p_fixed": 3.0},
}


@pytest.fixture(scope="module")
def problem():
    return problem_of(frame(9, 6), body_specs(turning(20, center=(0.3, 0.1, 0.0))))


def cell_sizes(problem):
    grid = problem.grid
    return node_sizes(grid.points, shape_table(grid.shapes), grid.offsets, np.arange(grid.n_nodes))


@pytest.mark.parametrize(
    ("name", "tolerance"),
    [*((name, 1e-4) for name in VARIANTS), ("lie", 1e-2), ("lie", 1e-8), ("shepard", 1e-2), ("shepard", 1e-8)],
)
def test_error_stays_below_the_tolerance(name, tolerance, problem):
    exact = apply(Options("idw", idw=IDW(summation="exact", **VARIANTS[name])), problem, told(problem))
    fast = IDW(summation="fast", summation_tolerance=tolerance, **VARIANTS[name])
    prepared = make_method(Options("idw", idw=fast)).prepare(problem)
    error = np.linalg.norm(prepared.apply(told(problem)) - exact, axis=1) / cell_sizes(problem)
    assert error.max() <= tolerance
    # Exact sums would pass too: they must not have been what ran.
    assert tolerance < 1e-4 or error.max() > 1e-13
    assert prepared.account.settings["sampled_error"].value <= tolerance
    assert prepared.account.warnings == []


@pytest.mark.parametrize(
    ("name", "room"),
    [
        *((name, None) for name in ("quaternion", "blend", "lie", "shepard, two exponents")),
        ("lie", 0), ("shepard", 0),
    ],
)  # fmt: skip
def test_further_displacements_are_as_accurate_and_checked_alike(name, room, problem):
    """With and without memory for lists and weights; the exact check sums only what moves once weights are known."""
    if room is not None:
        problem = dataclasses.replace(problem, memory=MemoryLimit(room, "none"))
    first, further = told(problem), 0.6 * told(problem) * np.cos(3 * problem.source_points)
    options = Options("idw", idw=IDW(summation="exact", **VARIANTS[name]))
    prepared = make_method(Options("idw", idw=IDW(summation="fast", **VARIANTS[name]))).prepare(problem)
    exact = [apply(options, problem, displacement) for displacement in (first, further)]
    for number in (0, 1, 0):
        found = prepared.apply((first, further)[number])
        error = (np.linalg.norm(found - exact[number], axis=1) / cell_sizes(problem)).max()
        sampled = prepared.account.settings["sampled_error"].value
        assert 1e-13 < error <= 1e-2
        assert 0.0 < sampled <= error * (1.0 + 1e-6) + 1e-12


@pytest.mark.parametrize("rotation", ["none", "quaternion", "blend", "lie"])
def test_common_translation_is_exact(rotation):
    problem = problem_of(frame(10, 6), everything_moves(constant(0.3, -0.2, 0.5)))
    moved = apply(Options("idw", idw=IDW(rotation=rotation, summation="fast")), problem, told(problem))
    np.testing.assert_allclose(moved, np.tile([0.3, -0.2, 0.5], (len(moved), 1)), atol=1e-13)


def test_two_dimensional_grid():
    problem = problem_of(frame_2d(40), body_specs(turning(20))[:1])
    exact, fast = (
        apply(Options("idw", idw=IDW(summation=kind, summation_tolerance=1e-3)), problem, told(problem))
        for kind in ("exact", "fast")
    )
    gap = np.linalg.norm(fast - exact, axis=1) / cell_sizes(problem)
    assert 0 < gap.max() <= 1e-3
    np.testing.assert_array_equal(fast[:, 2], 0.0)


def test_error_that_is_too_large_is_found_and_mended(problem, monkeypatch):
    assert make_method(Options("idw")).prepare(problem).account.settings["summation"].value == "exact"
    options = Options("idw", idw=IDW(summation="fast", summation_tolerance=1e-3))
    exact = apply(Options("idw", idw=IDW(summation="exact")), problem, told(problem))
    monkeypatch.setattr(idw_sums, "SHARE", 1e6)
    prepared = make_method(options).prepare(problem)
    error = np.linalg.norm(prepared.apply(told(problem)) - exact, axis=1) / cell_sizes(problem)
    assert prepared.account.settings["sampled_error"].value <= 1e-3
    assert error.max() <= 2e-3
    monkeypatch.setattr("meshdeform_core.methods.scattered.summation.MAX_RETRIES", 0)
    prepared = make_method(options).prepare(problem)
    prepared.apply(told(problem))
    assert "fast sums" in prepared.account.warnings[0]


def test_errors_are_searched_where_their_bounds_are_largest():
    """At the samples of 64 of 200 bricks, and at random nodes."""
    risk, samples = np.random.default_rng(0).random(200), np.arange(1800).reshape(200, 9)
    found = doubtful(np.zeros((2000, 3)), SimpleNamespace(samples=samples, every=np.array([1900])), risk)
    assert set(found) == {*samples[np.argsort(-risk)[:64]].ravel(), 1900}


def radial_sums_at(fast, coefficients, targets, tolerance):
    """Fast sums (n, 3) at all nodes."""
    out = np.full((len(targets.points), 3), np.nan)

    def use(flat, sums):
        out[flat] = sums

    fast.apply(coefficients, targets, tolerance, use)
    return out


@pytest.mark.parametrize(("basis", "tolerance"), [("tps", 1e-1), ("tps", 1e-6), *((name, 1e-3) for name in COMPACT)])
def test_radial_sums_are_exact_to_the_tolerance_of_local_cells(basis, tolerance):
    """The coefficients are no solution of a smooth motion, and the trial aims at a quarter of the tolerance."""
    grid, kind = frame(8, 6), BASES[basis]
    points, centres = grid.points / 3, np.concatenate([sphere(1000) * 0.3, 1.1 * sphere(600) + 0.2]) / 3
    targets = make_radial_targets(points, grid.shapes, grid.offsets, np.arange(grid.n_nodes))
    coefficients, fast = np.random.default_rng(0).standard_normal((len(centres), 3)), FastRadial(kind, centres)
    out = radial_sums_at(fast, coefficients, targets, tolerance)
    error = np.linalg.norm(out - radial_sums(kind, points, centres, coefficients), axis=1)
    assert (error[targets.samples] / targets.sizes).max() <= tolerance
    # The same again, whatever was found out.
    share = fast.share
    np.testing.assert_array_equal(out, radial_sums_at(fast, coefficients, targets, tolerance))
    assert fast.share == share


@pytest.mark.parametrize(("length", "largest"), [(0.0, 0.1), (0.3, 1e-3)])
def test_compact_sums_reach_every_target_of_a_region(length, largest):
    """Sources at the rim of the support of the outermost nodes only, which lie outside all interpolation points."""
    axis = np.linspace(0.0, 0.5, 9)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    sources = -0.98 / np.sqrt(3) + 1e-4 * np.random.default_rng(0).standard_normal((400, 3))
    sources -= np.linspace(0.0, length, 400)[:, None]
    kind, coefficients = BASES["wendland-c0"], np.ones((400, 3))
    targets = make_radial_targets(points, [(9, 9, 9)], np.array([0, 729]), np.arange(729))
    out = radial_sums_at(FastRadial(kind, sources), coefficients, targets, 1e-6)
    np.testing.assert_allclose(out, radial_sums(kind, points, sources, coefficients), atol=1e-6)
    assert out.max() > largest


def _sums(targets, sources, charges, a, kappa, every=True, single=True):
    out = np.zeros((len(targets), 8))
    half = len(sources) // 2
    pieces, span = np.array([[0, half], [half, len(sources)]]), np.array([[0, len(targets)]])
    groups = targets, span, sources, charges, pieces, np.array([[0, 2]])
    if single:
        sum_single(*groups, a, kappa, every, out)
    else:
        sum_groups(*groups, a, 5.0, kappa, every, out)
    return out


def _exact(targets, sources, charges, a, kappa):
    r = np.linalg.norm(targets[:, None] - sources, axis=2)
    weights = r**-a + kappa * r**-5.0
    return weights @ charges, weights @ np.abs(charges)


def test_what_acts_on_whole_regions_only_reaches_their_nodes():
    """All sources are far: none acts on the bricks of a region or on their nodes."""
    axis, random = np.linspace(0.0, 1.0, 21), np.random.default_rng(2)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    sources, values = 9.0 + random.random((900, 3)), random.standard_normal((2, 900))
    targets = make_targets(points, [(21, 21, 21)], np.array([0, 9261]), np.arange(9261), 3)
    fast = FastSums(np.ones(900), [np.arange(900)], [build_tree(sources, 3)], targets, 0)
    fast.prepare([(3.0, 5.0, 0.3)], np.ones(900), np.zeros(900), np.ones(900, dtype=bool), Accuracy(1e-3, False, False))
    found = np.empty((9261, 3))
    fast.apply(values, lambda _, flat, sums: found.__setitem__(flat, sums))
    wanted, size = _exact(points, sources, np.vstack([np.ones(900), values]).T, 3.0, 0.3)
    assert np.abs((found - wanted) / size).max() < 1e-3


@pytest.mark.parametrize("a", [3.0, 4.0])
@pytest.mark.parametrize("kappa", [0.3, 1e12])
@pytest.mark.parametrize(("single", "error"), [(True, 2e-5), (False, 1e-14)])
@pytest.mark.parametrize("n_sources", [7, 1300])
def test_as_plain_numpy(a, kappa, n_sources, single, error):
    random = np.random.default_rng(0)
    targets, sources = 50.0 + random.random((33, 3)), 50.7 + random.random((n_sources, 3))
    charges = random.standard_normal((n_sources, 8))
    wanted, size = _exact(targets, sources, charges, a, kappa)
    assert np.abs((_sums(targets, sources, charges, a, kappa, True, single) - wanted) / size).max() < error
    some = _sums(targets, sources, charges, a, kappa, False, single)
    assert not some[:, [0, 7]].any()
    assert np.abs((some - wanted)[:, 1:7] / size[:, 1:7]).max() < error


@pytest.mark.parametrize("a", [3.0, 4.0])
@pytest.mark.parametrize("distance", [1e-6, 1e-7, 1e-9, 1e-11])
def test_targets_almost_at_a_source(a, distance):
    """First cells may be that much thinner than the brick of nodes to which their nodes belong is long."""
    random = np.random.default_rng(1)
    sources = random.random((900, 3)) * [1.0, 1.0, 0.0]
    targets = np.concatenate([sources[:20], sources[890:]]) + [0.0, 0.0, distance]
    targets[::2, 0] += 0.5 * distance
    charges = random.standard_normal((900, 8))
    # One of them is between two sources, whose weights differ little.
    sources[1] = sources[0] + [2.0 * distance, 0.0, 0.0]
    wanted, size = _exact(targets, sources, charges, a, 0.3)
    found = _sums(targets, sources, charges, a, 0.3)
    assert np.isfinite(found).all()
    assert np.abs((found - wanted) / size).max() < 1e-4
