"""Fast IDW sums against exact ones: every rotation kind and weight, the tolerance kept, nothing common disturbed."""

import dataclasses
import types

import numpy as np
import pytest
from cases import apply, body_specs, constant, everything_moves, problem_of, turning
from forked_ranks import on_ranks
from grids import frame, frame_2d
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.boundary.prescribed import prescribed_displacement
from meshdeform_core.errors import MethodError
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import IDW, RBF, Account, Options, make_method
from meshdeform_core.methods.scattered import fast_idw_sums
from meshdeform_core.methods.scattered.summation import doubtful, sum_accurately
from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.elementary import exp, log
from meshdeform_core.numerics.exact.radial import radial_sums
from meshdeform_core.numerics.fastsum.clusters.boxes import fit_boxes, interpolate, make_boxes
from meshdeform_core.numerics.fastsum.clusters.targets import build_bricks, make_regions, node_sizes, shape_table
from meshdeform_core.numerics.fastsum.clusters.tree import build_tree, interpolation_points
from meshdeform_core.numerics.fastsum.radial.sums import FastRadial
from meshdeform_core.numerics.fastsum.radial.targets import make_radial_targets
from meshdeform_core.numerics.fastsum.weighted.plan import Charges, gather
from meshdeform_core.parallel import alone

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
    return problem_of(frame(12, 8), body_specs(turning(20, center=(0.3, 0.1, 0.0))))


def told(problem):
    return prescribed_displacement(problem.grid, problem.topology, problem.boundary)[problem.source_numbers]


def cell_sizes(problem):
    grid = problem.grid
    return node_sizes(grid.points, shape_table(grid.shapes), grid.offsets, np.arange(grid.n_nodes))


@pytest.mark.parametrize("tolerance", [1e-2, 1e-4, 1e-8])
@pytest.mark.parametrize("name", VARIANTS)
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
        *((name, None) for name in VARIANTS),
        *(pytest.param(name, 0, marks=() if name in ("lie", "shepard") else pytest.mark.slow)
          for name in VARIANTS),
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
    options = Options("idw", idw=IDW(summation="fast", summation_tolerance=1e-3))
    exact = apply(Options("idw", idw=IDW(summation="exact")), problem, told(problem))
    monkeypatch.setattr(fast_idw_sums, "SHARE", 3e4)
    prepared = make_method(options).prepare(problem)
    error = np.linalg.norm(prepared.apply(told(problem)) - exact, axis=1) / cell_sizes(problem)
    assert prepared.account.settings["sampled_error"].value <= 1e-3
    assert error.max() <= 2e-3
    monkeypatch.setattr("meshdeform_core.methods.scattered.summation.MAX_RETRIES", 0)
    prepared = make_method(options).prepare(problem)
    prepared.apply(told(problem))
    assert "fast sums" in prepared.account.warnings[0]


def test_small_cases_are_summed_exactly(problem):
    prepared = make_method(Options("idw")).prepare(problem)
    assert prepared.account.settings["summation"].value == "exact"
    with pytest.raises(MethodError, match="1e-08 up to"):
        IDW(summation_tolerance=1e-9)
    with pytest.raises(MethodError, match=r"idw\.summation"):
        IDW(summation="quick")


def test_bricks_hold_every_target_once():
    grid = frame(9, 7)
    shapes = shape_table(grid.shapes)
    wanted = np.random.default_rng(0).random(grid.n_nodes) < 0.6
    bricks, first = build_bricks(grid.points, shapes, grid.offsets, np.flatnonzero(wanted), 4, 100)
    np.testing.assert_array_equal(np.sort(bricks.targets), np.flatnonzero(wanted))
    for b in range(len(bricks.start) - 1):
        x = grid.points[bricks.targets[bricks.start[b] : bricks.start[b + 1]]]
        inside = np.abs((x - bricks.boxes.center[b]) @ bricks.boxes.axes[b].T)
        assert np.all(inside <= bricks.boxes.half[b] + 1e-12)
    assert first[0] == 0
    assert first[-1] == len(bricks.start) - 1
    assert np.all(np.diff(first) > 0)
    regions = make_regions(grid.points, bricks, first, 4)
    for g in range(len(first) - 1):
        x = np.concatenate(
            [
                bricks.boxes.proxies[bricks.boxes.proxy[first[g]] : bricks.boxes.proxy[first[g + 1]]],
                grid.points[bricks.targets[bricks.start[first[g]] : bricks.start[first[g + 1]]]],
            ]
        )
        inside = np.abs((x - regions.boxes.center[g]) @ regions.boxes.axes[g].T)
        assert np.all(inside <= regions.boxes.half[g] + 1e-12)


def test_node_sizes():
    grid = frame_2d(4)
    sizes = cell_sizes(problem_of(grid, body_specs(turning(1))[:1]))
    for block in range(grid.n_blocks):
        x = grid.block(block)
        shortest = np.full(x.shape[:3], np.inf)
        for axis in (0, 1):
            edge = np.linalg.norm(np.diff(x, axis=axis), axis=3)
            low, high = [slice(None)] * 3, [slice(None)] * 3
            low[axis], high[axis] = slice(None, -1), slice(1, None)
            shortest[tuple(low)] = np.minimum(shortest[tuple(low)], edge)
            shortest[tuple(high)] = np.minimum(shortest[tuple(high)], edge)
        here = sizes[grid.offsets[block] : grid.offsets[block + 1]]
        np.testing.assert_allclose(here, shortest.ravel(), rtol=1e-14)


@settings(max_examples=20)
@given(st.integers(2, 900), st.integers(0, 2), st.integers(0, 10**6))
def test_clusters_hold_their_sources_and_keep_their_charges(n, flat, seed):
    """Boxes contain their sources, and interpolation keeps the total and the first moment of the charges."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, 3))
    points[:, :flat] = 1.0
    charges = rng.random((n, 8))
    tree = build_tree(points, 3)
    np.testing.assert_array_equal(np.sort(tree.order), np.arange(n))
    values = np.concatenate([charges[tree.order], np.zeros((tree.boxes.proxy[-1], 8))])
    proxy = gather(tree, tree.boxes.proxy, values).values[n:]
    for c, (lo, hi) in enumerate(tree.span):
        members = tree.order[lo:hi]
        inside = np.abs((points[members] - tree.boxes.center[c]) @ tree.boxes.axes[c].T)
        assert np.all(inside <= tree.boxes.half[c] + 1e-12)
        mine = slice(tree.boxes.proxy[c], tree.boxes.proxy[c + 1])
        if mine.stop > mine.start:
            np.testing.assert_allclose(proxy[mine].sum(axis=0), charges[members].sum(axis=0), rtol=1e-11)
            moments = points[members].T @ charges[members]
            if np.all(tree.boxes.per_side[c] >= 2 - (tree.boxes.half[c] < 1e-12)):
                points_of = interpolation_points(tree, tree.boxes.proxy)[mine]
                np.testing.assert_allclose(points_of.T @ proxy[mine], moments, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3, 5, 8])
def test_interpolation_reproduces_polynomials_and_its_transpose_is_one(order):
    """In a box that is no cube, from its interpolation points to more points than are interpolated together."""
    rng = np.random.default_rng(order)
    x = rng.uniform(-1.0, 1.0, (300, 3)) * [3.0, 1.0, 0.4] @ np.linalg.qr(rng.standard_normal((3, 3)))[0]
    box = make_boxes(*fit_boxes(x, np.arange(300), np.array([[0, 300]])), order)
    points, task = np.concatenate([x, box.proxies]), np.array([[0, 300, 0, 300]])
    powers = (points @ rng.standard_normal((3, 8))) ** ((box.per_side.min() - 1) * np.arange(8) // 7)
    values = np.where(np.arange(len(points))[:, None] < 300, 0.0, powers)
    interpolate(box, task, points, values, 0, 8, False)
    np.testing.assert_allclose(values[:300], powers[:300], atol=1e-11 * np.abs(powers).max())
    weight = np.concatenate([rng.standard_normal((300, 8)), np.zeros((len(box.proxies), 8))])
    back = weight.copy()
    interpolate(box, task, points, back, 0, 8, True)
    assert (weight * values)[:300].sum() == pytest.approx((back * powers)[300:].sum(), rel=1e-10)


def test_logarithm_and_exponential():
    x = np.linspace(-690, 690, 4001)
    np.testing.assert_allclose([exp(v) for v in x], np.exp(x), rtol=1e-15)
    y = np.exp(np.linspace(-600, 600, 4001))
    np.testing.assert_allclose([log(v) for v in y], np.log(y), rtol=1e-15, atol=1e-15)


# The radius of tps is of no effect; both kinds of compact bases are summed with a large and with a small one.
@pytest.mark.parametrize(
    ("basis", "radius"),
    [
        ("tps", 12.0), ("wendland-c0", 2.5), ("wendland-c2", 12.0), ("ctps-c1", 12.0), ("ctps-c2a", 12.0),
        ("ctps-c2b", 2.5),
        *(pytest.param(basis, 14.5 - radius, marks=pytest.mark.slow)
          for basis, radius in (("wendland-c0", 2.5), ("wendland-c2", 12.0), ("ctps-c1", 12.0), ("ctps-c2b", 2.5))),
    ],
)  # fmt: skip
def test_radial_sums(basis, radius, problem):
    """The same coefficients, once exactly and once fast, at nodes and at the centres themselves."""
    exact, fast = (
        apply(
            Options("rbf", rbf=RBF(basis=basis, radius=radius, summation=kind, summation_tolerance=1e-3)),
            problem,
            told(problem),
        )
        for kind in ("exact", "fast")
    )
    assert 0 < (np.linalg.norm(fast - exact, axis=1) / cell_sizes(problem)).max() <= 1e-3


def test_compact_sums_reach_every_target_of_a_region():
    """Sources at the rim of the support of the outermost nodes only, which lie outside all interpolation points."""
    axis = np.linspace(0.0, 0.5, 9)
    points = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    rng = np.random.default_rng(0)
    sources = -0.98 / np.sqrt(3) + 1e-4 * rng.standard_normal((400, 3))
    kind, coefficients = BASES["wendland-c0"], np.ones((400, 3))
    targets = make_radial_targets(points, [(9, 9, 9)], np.array([0, 729]), np.arange(729))
    out = np.zeros((729, 3))

    def use(flat, sums):
        out[flat] = sums

    fast = FastRadial(kind, sources)
    fast.prepare(coefficients, targets, 1e-6)
    fast.apply(use)
    np.testing.assert_allclose(out, radial_sums(kind, points, sources, coefficients), atol=1e-6)
    assert out.max() > 0.01


def test_errors_are_sought_where_their_bounds_are_largest():
    samples, risk = np.arange(1800).reshape(200, 9), np.random.default_rng(2).permutation(200)
    targets = types.SimpleNamespace(samples=samples, every=np.arange(1800))
    found = doubtful(np.zeros((1800, 3)), targets, risk.astype(np.float64))
    assert len(found) == 64 * 9 + 256
    assert set(found[: 64 * 9]) == set(samples[risk >= 200 - 64].ravel())


def test_an_error_that_is_no_number_is_told_and_spoils_nothing():
    account, refined = Account(), []
    sums = types.SimpleNamespace(restart=refined.clear, refine=refined.append)
    sum_accurately("idw", sums, lambda: float("nan"), 1e-2, account)
    assert refined == []
    assert "fast sums" in account.warnings[0]
    sum_accurately("idw", sums, lambda: 1e-3, 1e-2, account)
    assert account.warnings == []


def test_charges_of_used_clusters_are_the_same_without_the_others():
    rng = np.random.default_rng(3)
    tree = build_tree(rng.standard_normal((900, 3)), 3)
    used, charges = rng.random(len(tree.child)) < 0.4, rng.random((900, 8))
    every, some = (
        gather(tree, start, np.concatenate([charges, np.zeros((start[-1], 8))]))
        for start in (tree.boxes.proxy, np.append(0, np.cumsum(np.where(used, np.diff(tree.boxes.proxy), 0))))
    )
    assert len(some.values) == 900 + np.diff(tree.boxes.proxy)[used].sum() < len(every.values)
    for cluster in np.flatnonzero(used):
        one, other = (each.values[each.start[cluster] : each.start[cluster + 1]] for each in (every, some))
        np.testing.assert_array_equal(one, other)


def test_what_ranks_know_of_clusters_does_not_serve_one_of_them_alone(problem):
    """Each rank lists the clusters of its own bricks; alone it needs those of all."""
    options, displacement = Options("idw", idw=IDW(summation="fast")), told(problem)
    expected = apply(options, problem, displacement)

    def differ(_):
        prepared = make_method(options).prepare(problem)
        together = prepared.apply(displacement)
        with alone():
            return abs(together - expected).max(), abs(prepared.apply(displacement) - expected).max()

    np.testing.assert_allclose(on_ranks(2, differ), 0.0, atol=1e-13)


def test_sources_that_act_through_clusters_only_are_left_out():
    rng = np.random.default_rng(3)
    tree = build_tree(rng.random((1000, 3)), 4)
    n, leaves = 1000, np.flatnonzero(tree.child < 0)
    rows, start = rng.random((n + 7, 8)), np.minimum(n + np.arange(len(tree.child) + 1), n + 7)
    direct = np.zeros(len(tree.child), dtype=bool)
    direct[leaves[[1, 4, 5]]] = True
    found = Charges(rows[:, :3], rows, start, tree.span, True).of_sources(tree, direct)
    assert np.array_equal(found.points, found.values[:, :3])
    assert len(found.values) == 7 + np.diff(tree.span[direct], axis=1).sum()
    for cluster in np.flatnonzero(direct):
        assert np.array_equal(found.values[slice(*found.span[cluster])], rows[slice(*tree.span[cluster])])
    for cluster in range(len(tree.child)):
        assert np.array_equal(
            found.values[slice(*found.start[cluster : cluster + 2])], rows[slice(*start[cluster : cluster + 2])]
        )
