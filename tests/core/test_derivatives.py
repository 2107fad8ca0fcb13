"""Derivatives of methods: central differences fall as h^2, and the two modes are transposes of each other."""

import dataclasses
import tracemalloc

import numpy as np
import pytest
from cases import ALL_METHODS, FEW, body_specs, every, everything_moves, problem_of, told, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.methods import IDW, RBF, Options, make_method
from meshdeform_core.methods.limits import CHOSEN, EDGES, FOLDED, HALF_TURNS, LARGEST
from meshdeform_core.methods.scattered import idw_sums, linear_idw, prepared_rbf
from meshdeform_core.methods.scattered.summation import DERIVATIVE_TOLERANCE
from meshdeform_core.numerics.rigid import Frame
from meshdeform_core.numerics.tape import Tape
from meshdeform_core.parallel import sharing

# With weights computed anew in every part of a rotation there is no exact derivative.
METHODS = ALL_METHODS | {
    "idw-alpha": Options("idw", idw=IDW(alpha="auto", eta=4.0)),
    "idw-alpha-capped": Options("idw", idw=IDW(alpha="auto", eta=40.0)),
    "idw-alpha-none": Options("idw", idw=IDW(rotation="none", alpha="auto", eta=4.0)),
    "idw-smoothed": Options("idw", idw=IDW(rotation="blend", smoothing=3)),
    "idw-two-exponents": Options("idw", idw=IDW(weights="shepard", p_moving=4.0)),
    "idw-no-transition": Options("idw", idw=IDW(transition=0, remove_mean=False)),
}


@pytest.fixture(autouse=True)
def _several_portions(monkeypatch):
    for module in (idw_sums, prepared_rbf):
        monkeypatch.setattr(module, "_CHUNK", 32)
        monkeypatch.setattr(module, "_ROWS", 128)


def bulged():
    grid = frame()
    x = grid.points.copy()
    x[:, 2] += 0.15 * np.sin(1.1 * x[:, 0]) * np.cos(0.8 * x[:, 1])
    return grid.moved(x)


KINDS = {
    "slip": lambda: problem_of(frame(), body_specs(turning(10))),
    "symmetry": lambda: problem_of(frame(), body_specs(turning(10), Kind.SYMMETRY)),
    "periodic": lambda: problem_of(frame(), body_specs(turning(10), Kind.PERIODIC)),
    "free": lambda: problem_of(frame(), body_specs(turning(10), Kind.FREE)),
    "curved slip": lambda: problem_of(bulged(), body_specs(turning(10))),
    "all moving": lambda: problem_of(frame(), everything_moves()),
    "plane": lambda: problem_of(frame_2d(6), body_specs(turning(20))[:1]),
    "plane, all moving": lambda: problem_of(frame_2d(4), [BoundarySpec("all", ("*",), Kind.MOVING, None, turning(5))]),
}


def directions(where):
    """Displacement of the moving sources: smooth, and rough changes of it."""
    moving = (where.boundary.kind[where.source_numbers] == Kind.MOVING)[:, None]
    inside = moving * (1.0 if where.plane_normal is None else 1.0 - np.abs(where.plane_normal))
    x = where.source_points
    smooth = 0.1 * np.sin(1.3 * x[:, [1, 0, 2]] + np.arange(3)) * inside
    rough = np.random.default_rng(5).standard_normal(x.shape) * inside
    return smooth, rough


def check(method, at, change):
    derivative = method.linearised(at)
    found = derivative.push(change)
    size = np.abs(found).max()
    assert np.isfinite(found).all()
    errors = []
    for h in (1e-4, 2.5e-5):
        difference = (method.apply(at + h * change) - method.apply(at - h * change)) / (2 * h)
        errors.append(np.abs(difference - found).max() / size)
    assert errors[1] < 1e-6
    # A sixteenth, or the round-off of the differences.
    assert errors[1] < errors[0] / 12 or errors[1] < 1e-8
    weight = np.random.default_rng(6).standard_normal(found.shape)
    product = (derivative.pull(weight.copy()) * change).sum()
    assert abs((weight * found).sum() - product) < 1e-12 * np.linalg.norm(weight) * np.linalg.norm(found)


@every(METHODS)
def test_central_differences_and_transposes(name):
    where = KINDS["slip"]()
    smooth, rough = directions(where)
    method = make_method(METHODS[name]).prepare(where)
    if name in FEW:
        check(method, np.zeros_like(smooth), rough)
    at = smooth
    if name.startswith("idw-alpha"):
        # Eq. 18 takes the largest displacement: there is no derivative where two nodes have it.
        at = at * (1.0 + 0.2 * where.source_points @ [[1.0], [0.5], [0.3]])
    check(method, at, rough)


@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (kind, name)
        for n, kind in enumerate(kind for kind in KINDS if kind not in ("slip", "curved slip"))
        for name in FEW[n % 3 :: 3]
    ],
)
def test_every_kind_of_boundary(name, kind):
    where = KINDS[kind]()
    smooth, rough = directions(where)
    check(make_method(METHODS[name]).prepare(where), smooth, rough)


def test_a_boundary_that_follows_its_mean_affine_motion_in_part():
    """Between the rigid frame, that of a wave, and the affine one, that of a stretch: the derivative of the share."""
    where = problem_of(frame(), everything_moves())
    smooth, rough = directions(where)
    x, area = where.source_points, np.ones(len(where.source_points))
    stretch = x @ np.diag([0.1, -0.05, 0.02])
    turns = [Frame.fitted(x, at, area, None, True).turn for at in (smooth, stretch + 0.1 * smooth, stretch)]
    np.testing.assert_array_equal(turns[0], Frame.fitted(x, smooth, area, None, False).turn)
    np.testing.assert_allclose(turns[2], np.diag([1.1, 0.95, 1.02]), atol=1e-15)
    # Turned inside out, the boundary has a rigid frame alone.
    assert np.linalg.det(Frame.fitted(x, x @ np.diag([-1.8, 0.1, 0.0]), area, None, True).turn) == pytest.approx(1.0)
    affine = np.linalg.norm(turns[1] - np.eye(3)) / np.linalg.norm(turns[2] - np.eye(3))
    assert 0.3 < affine < 0.95
    check(make_method(METHODS["idw-lie"]).prepare(where), stretch + 0.1 * smooth, rough)


@pytest.mark.parametrize("name", ["tfi", "idw-lie", "idw-tfi", "idw-rbf", "rbf-tfi"])
def test_sliding_on_a_curved_surface(name):
    where = KINDS["curved slip"]()
    (surface,) = where.boundary.slip.curved
    smooth, rough = directions(where)
    # No node may come to the edge of a flat face within the step.
    method = make_method(METHODS[name]).prepare(where)
    check(method, 0.3 * smooth, 1e-2 * rough)
    assert method.linearised(0.3 * smooth).kinks == {}
    # Undeformed, they all are at corners of these faces.
    assert method.linearised(0.0 * smooth).kinks == {EDGES: len(surface.nodes)}


def test_where_grid_lines_are_curved_inside_blocks():
    """Sub-blocks that TFI alone would straighten share corners, whose gradients are sums."""
    grid = frame(4, 4)
    x, y, z = grid.points.T
    bump = z * (1.0 - z) * (np.maximum(abs(x), abs(y)) - 0.5) * np.sin(2.0 * x + 1.0) * np.cos(2.0 * y)
    where = problem_of(grid.moved(grid.points + np.stack([bump, -bump, 0 * z], axis=1)), body_specs(turning(10)))
    method = make_method(METHODS["idw-tfi-cut"]).prepare(where)
    assert len(method.filler.group(0)[1].bent[0]) > grid.n_blocks
    check(method, *directions(where))


def test_sliding_where_a_gap_closes():
    """What is blended there slides on the surface once more."""
    where = KINDS["curved slip"]()
    moving = (where.boundary.kind[where.source_numbers] == Kind.MOVING)[:, None]
    _, rough = directions(where)
    method = make_method(Options("idw-tfi")).prepare(where)
    at = moving * np.array([0.9, 0.13, 0.0])
    assert method.closing(at) is not None
    check(method, at, 1e-3 * rough)


@pytest.mark.parametrize(
    ("name", "angle"), [("idw-lie", 179.0), ("idw-quaternion", 130.0), ("idw-blend", 179.0), ("idw-division", 130.0)]
)
def test_large_rotations(name, angle):
    where = problem_of(frame(), body_specs(turning(angle)))
    at = told(where)
    _, rough = directions(where)
    check(make_method(METHODS[name]).prepare(where), at, 0.05 * rough)


FAST = {
    "lie": IDW(),
    "no transition": IDW(transition=0, rotation="quaternion"),
    "twelve values": IDW(rotation="blend"),
    "two exponents": IDW(weights="shepard", p_moving=4.0),
    "alpha": IDW(rotation="none", alpha="auto", eta=4.0),
}


@every(FAST, {"no transition", "alpha"})
def test_fast_sums_are_differentiated_within_their_tolerance(name):
    where = problem_of(frame(7, 5), body_specs(turning(20)))
    smooth, rough = directions(where)
    at = smooth * (1.0 + 0.2 * where.source_points @ [[1.0], [0.5], [0.3]])
    exact, fast = (
        make_method(Options("idw", idw=dataclasses.replace(FAST[name], summation=kind))).prepare(where).linearised(at)
        for kind in ("exact", "fast")
    )
    weight = np.random.default_rng(6).standard_normal((where.grid.n_nodes, 3))
    for change in (rough, smooth):
        one, two = exact.push(change), fast.push(change)
        gap = np.abs(one - two).max()
        assert 0.0 < gap < DERIVATIVE_TOLERANCE * np.abs(one).max()
        product, size = (fast.pull(weight.copy()) * change).sum(), np.linalg.norm(weight) * np.linalg.norm(two)
        assert abs((weight * two).sum() - product) < 1e-12 * size
    # The gradient of sources that no case moves is not defined with fast sums.
    moving = where.boundary.kind[where.source_numbers] == Kind.MOVING
    one, two = exact.pull(weight.copy())[moving], fast.pull(weight.copy())[moving]
    assert np.abs(one - two).max() < DERIVATIVE_TOLERANCE * np.abs(one).max()


@pytest.mark.parametrize("tolerance", [1e-7, 1e-15])
def test_fast_sums_that_are_too_wrong_are_made_more_accurate_or_exact(monkeypatch, tolerance):
    where = problem_of(frame(7, 5), body_specs(turning(20)))
    smooth, rough = directions(where)
    derivatives = {}
    for kind in ("exact", "fast"):
        method = make_method(Options("idw", idw=IDW(summation=kind))).prepare(where)
        monkeypatch.setattr(linear_idw, "DERIVATIVE_TOLERANCE", tolerance)
        derivatives[kind] = method.mover.bound.linearised(smooth)
    out = {kind: np.zeros_like(where.grid.points) for kind in derivatives}
    for kind, derivative in derivatives.items():
        derivative.push(rough, out[kind])
    gap = np.abs(out["fast"] - out["exact"]).max() / np.abs(out["exact"]).max()
    assert gap == 0.0 if tolerance == 1e-15 else 0.0 < gap < 1e-6


def test_memory():
    """Coordinate arrays at the peak: three in jvp, its result among them, two in vjp."""
    where = problem_of(frame(36, 24), body_specs(turning(20)))
    smooth, rough = directions(where)
    derivative = make_method(Options("tfi")).prepare(where).linearised(smooth)
    weight, peaks = np.ones((where.grid.n_nodes, 3)), []
    for work in (lambda: derivative.push(rough), lambda: derivative.pull(weight.copy())):
        work()
        tracemalloc.start()
        work()
        peaks.append(tracemalloc.get_traced_memory()[1] / weight.nbytes)
        tracemalloc.stop()
    assert peaks[0] < 3.0
    assert peaks[1] < 2.3


def test_threads_change_no_bit_of_a_derivative():
    where = problem_of(frame(7, 5), body_specs(turning(20)))
    smooth, rough = directions(where)
    weight = np.random.default_rng(6).standard_normal((where.grid.n_nodes, 3))
    found = []
    for options in (Options("idw-tfi", idw=IDW(summation="fast")), Options("rbf", rbf=RBF(summation="fast"))):
        method = make_method(options).prepare(where)
        for threads in (1, 3):
            with sharing(threads=threads):
                derivative = method.linearised(smooth)
                found.append((derivative.push(rough), derivative.pull(weight.copy())))
    for one, two in (found[:2], found[2:]):
        for part in range(2):
            np.testing.assert_array_equal(one[part], two[part])


def test_where_centres_are_chosen_the_derivative_is_that_of_all():
    where = KINDS["slip"]()
    smooth, rough = directions(where)
    options = RBF(basis="wendland-c2", radius=6.0, greedy="hybrid", greedy_tolerance=1.0)
    greedy, whole = (
        make_method(Options("rbf", rbf=each)).prepare(where).linearised(smooth)
        for each in (options, dataclasses.replace(options, greedy="none"))
    )
    assert greedy.kinks == {CHOSEN: 1}
    np.testing.assert_array_equal(greedy.push(rough), whole.push(rough))


def test_of_several_largest_values_the_derivative_is_the_mean():
    tape = Tape()
    variable = tape.variable(np.array([1.0, 3.0, 2.0, 3.0 * (1.0 - 1e-12), 3.0]))
    largest = variable.max()
    assert tape.push({variable.number: np.array([1.0, 2.0, 4.0, 8.0, 5.0])}, [largest.number])[0] == 5.0
    np.testing.assert_allclose(tape.pull({largest.number: np.array(6.0)}, [variable.number])[0], [0, 2, 0, 2, 2])


def test_where_there_is_no_derivative_is_named():
    """Half a turn, two largest displacements, a wall that is folded by half a turn."""
    where = problem_of(frame(), body_specs(turning(180.0)))
    at = told(where)
    moving = int(at.any(axis=1).sum())
    method = make_method(METHODS["idw-lie"]).prepare(where)
    assert method.linearised(at).kinks[HALF_TURNS] == moving
    # Half-way along straight lines the body has no breadth.
    assert set(method.linearised(0.5 * at).kinks) == {FOLDED}
    shift = at.any(axis=1, keepdims=True) * [0.05, 0.02, 0.0]
    for name, kinks in (("idw-lie", {}), ("idw-alpha-none", {LARGEST: moving})):
        assert make_method(METHODS[name]).prepare(where).linearised(shift).kinks == kinks
