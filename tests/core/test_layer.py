"""Grids one cell thick: planes that mirror each other stay equal to the last bit, with half the sums."""

import numpy as np
import pytest
from cases import ALL_METHODS, STILL, constant, formulas, inner_nodes, problem_of, turning
from grids import frame, polar

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.constraints import find_layer
from meshdeform_core.deform import Case, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, RBF, Options, make_method
from meshdeform_core.methods.composite import PreparedLayer, first_step_nodes
from meshdeform_core.methods.constraints import WIDTH, BesideSlip

FAST = (
    Options("idw-tfi", idw=IDW(summation="fast")),
    Options("idw", idw=IDW(summation="fast")),
    Options("rbf-tfi", rbf=RBF(solver="krylov", summation="fast")),
)
OUTER = BoundarySpec("far", ("*.jmax",), Kind.FIXED)


def ring(thickness: float = 0.3) -> Grid:
    """One layer of cells around a cylinder; the planes of one half of the blocks are in the opposite order."""
    x = polar(24, 6, 1).block(0) * [1.0, 1.0, thickness]
    return Grid.from_blocks([x[:13], x[12:, :, ::-1]])


def wedge() -> Grid:
    """A wedge of 5 degrees about the x axis with a bump on its axis and a collapsed edge."""
    x, r = np.meshgrid(np.linspace(0.0, 3.0, 13), np.linspace(0.0, 1.0, 9), indexing="ij")
    angle = np.radians([-2.5, 2.5])
    points = [x[..., None] + 0.0 * angle, r[..., None] * np.cos(angle), r[..., None] * np.sin(angle)]
    return Grid.from_blocks([np.stack(points, axis=-1)])


def prepared(grid: Grid, method: Options, *specs: BoundarySpec):
    setup = set_up(grid, Case(specs, method=method))
    return setup, setup.prepare(), setup.displacement(0.0)[setup.problem.source_numbers]


def in_ring(motion) -> tuple[BoundarySpec, BoundarySpec]:
    return BoundarySpec("wall", ("*.jmin",), Kind.MOVING, None, motion), OUTER


@pytest.mark.parametrize("method", FAST, ids=lambda method: method.name)
def test_planes_of_an_extrusion_stay_equal(method):
    setup, found, moved = prepared(ring(), method, *in_ring(turning(20.0)))
    both = make_method(method).prepare(setup.problem).apply(moved)
    out = found.apply(moved)
    for block in (0, 1):
        front, back = np.moveaxis(setup.grid.block(block, out), 2, 0)
        np.testing.assert_array_equal(front[..., :2], back[..., :2])
        assert not out[:, 2].any()
    np.testing.assert_allclose(out, both, atol=1e-4)
    layer = find_layer(setup.grid, setup.topology, setup.boundary.kind, setup.boundary.known)
    assert layer is not None
    assert (layer.normal == [0, 0, 1]).all()
    assert len(first_step_nodes(found._half.problem, None)) * 2 == len(first_step_nodes(setup.problem, None))


@pytest.mark.parametrize("method", FAST, ids=lambda method: method.name)
def test_radii_of_a_wedge_stay_equal(method):
    specs = (
        BoundarySpec("wall", ("*.jmax",), Kind.MOVING, None, formulas("0", "-0.2*y*sin(pi*x/3)", "-0.2*z*sin(pi*x/3)")),
        BoundarySpec("ends", ("*.i*",), Kind.FREE),
        BoundarySpec("planes", ("*.k*",), Kind.SLIP),
    )
    setup, found, moved = prepared(wedge(), method, *specs)
    front, back = np.moveaxis(setup.grid.block(0, setup.grid.points + found.apply(moved)), 2, 0)
    np.testing.assert_array_equal(front, back * [1.0, 1.0, -1.0])


@pytest.mark.parametrize("name", ALL_METHODS)
def test_the_layer_changes_nothing_but_rounding(name):
    setup, found, moved = prepared(ring(), ALL_METHODS[name], *in_ring(constant(0.2, -0.1, 0.0)))
    assert isinstance(found, PreparedLayer)
    whole = make_method(ALL_METHODS[name]).prepare(setup.problem)
    np.testing.assert_allclose(found.apply(moved), whole.apply(moved), atol=1e-7 if "krylov" in name else 1e-12)


def test_other_motions_are_those_of_both_planes():
    slip = BoundarySpec("planes", ("*.k*",), Kind.FREE)
    setup, found, moved = prepared(ring(), FAST[0], *in_ring(formulas("0.1*z", "0", "0.1*x")), slip)
    assert isinstance(found, PreparedLayer)
    np.testing.assert_array_equal(found.apply(moved), make_method(FAST[0]).prepare(setup.problem).apply(moved))


def test_planes_that_are_no_images_and_thicker_grids_are_no_layer():
    x, specs = ring().points, in_ring(constant(0.1, 0.0, 0.0))
    moved = (x * np.where(x[:, 2:] > 0, [1.1, 1, 1], 1.0), x + [0.0, 0.0, 0.1] * x[:, :1])
    other = (*specs, BoundarySpec("front", ("block1.kmin",), Kind.FREE))
    no_layers = [(polar(24, 6, 2), specs), *((ring().moved(each), specs) for each in moved), (ring(), other)]
    for grid, entries in no_layers:
        setup = set_up(grid, Case(entries))
        assert find_layer(setup.grid, setup.topology, setup.boundary.kind, setup.boundary.known) is None


def corner(grid: Grid):
    """Slip sides in three directions, at right angles no longer; the body between them moves."""
    grid = grid.moved(grid.points @ np.array([[1.0, 0.1, 0.0], [0.0, 1.0, 0.2], [0.3, 0.0, 1.0]]))
    slip = "*.kmin", "*.kmax", "block6.imax", "block7.imax", "block8.imax", "block3.jmax", "block5.jmax", "block8.jmax"
    body = "block2.imax", "block4.jmax", "block5.jmin", "block7.imin"
    return problem_of(
        grid, [BoundarySpec("sides", slip, Kind.SLIP), BoundarySpec("body", body, Kind.MOVING, None, STILL)]
    )


def distances(problem, x, quads):
    """Distances (n,) of points from the nearest of some faces, by looking at a fine sample of each."""
    s, t = (each.ravel() for each in np.meshgrid(*2 * [np.linspace(0.0, 1.0, 41)]))
    weights = np.stack([(1 - s) * (1 - t), s * (1 - t), s * t, (1 - s) * t], axis=1)
    corners = problem.grid.points[problem.topology.first[problem.topology.quads.corners[quads]]]
    samples = (weights @ corners).reshape(-1, 3)
    return np.sqrt(((x[:, None] - samples) ** 2).sum(axis=2).min(axis=1))


def test_it_is_the_solution_of_a_small_system_at_every_node():
    problem = corner(frame())
    assert len(problem.boundary.slip.sides) == 3
    rng = np.random.default_rng(3)
    flat = np.sort(rng.choice(inner_nodes(problem), 12, replace=False))
    given = rng.standard_normal((problem.grid.n_nodes, 3))
    found = given.copy()
    x, boundary, fixed = problem.grid.points[flat], problem.boundary, problem.boundary.kind == Kind.FIXED
    # A moving node of no moving face, as tables may have, near half of the others.
    own = np.linalg.norm(x[:, None] - problem.grid.points[problem.topology.first[fixed]], axis=2)
    alone = np.median(own, axis=0).argmin()
    boundary.kind[np.flatnonzero(fixed)[alone]] = Kind.MOVING
    BesideSlip(problem, flat).apply(found)
    wall = np.minimum(distances(problem, x, np.flatnonzero(boundary.quad_kind == Kind.MOVING)), own[:, alone])
    system = np.tile(np.eye(3), (len(flat), 1, 1))
    for normal, quads in boundary.slip.sides:
        side = distances(problem, x, quads)
        at = side / (side + wall)
        kept = np.where(at < 1 - WIDTH, at / (1 - WIDTH / 2), 1 - (1 - at) ** 2 / (WIDTH * (2 - WIDTH)))
        system += ((1 - kept) / kept)[:, None, None] * np.outer(normal, normal)
    np.testing.assert_allclose(found[flat], np.linalg.solve(system, given[flat][..., None])[..., 0], atol=0.01)
    others = np.setdiff1d(np.arange(problem.grid.n_nodes), flat)
    np.testing.assert_array_equal(found[others], given[others])
