"""The invariants of the methods (spec section 10): contract tests over all of them."""

import dataclasses

import numpy as np
import pytest
from cases import ALL_METHODS, apply, body_specs, every, problem_of, turning
from grids import back, frame, frame_2d, permuted, polar

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.prescribed import prescribed_displacement
from meshdeform_core.grid import Grid
from meshdeform_core.methods import make_method
from meshdeform_core.parallel.scratch import scratch_in

EVERY = every(ALL_METHODS)
ROTATION = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
ROTATION *= np.sign(np.linalg.det(ROTATION))

NO_ROTATION = {"idw-none"}
# These turn about the origin of coordinates; all others are frame independent (spec section 10).
RBF_ALONE = {name for name in ALL_METHODS if name.startswith("rbf-")}
FRAME_DEPENDENT = {"idw-quaternion", "idw-division"}
# Solutions of linear systems carry the round-off of their condition.
SOLVED = RBF_ALONE | {"idw-rbf"}


def tolerance(name: str) -> float:
    return 1e-10 if name in SOLVED else 1e-12


def bend(x: np.ndarray) -> np.ndarray:
    """A smooth motion of the inner bar that dies out at the outside."""
    near = np.exp(-(x[:, :1] ** 2 + x[:, 1:2] ** 2))
    wave = np.stack([0.1 * np.sin(x[:, 1]), 0.15 * np.cos(x[:, 0]), 0 * x[:, 0]], axis=1)
    return near * wave


def solid_turn(x: np.ndarray, degrees: float = 25.0) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    turned = np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1)
    return turned - x


@EVERY
@pytest.mark.parametrize("grid", [frame(), frame_2d(), polar()], ids=["frame", "frame-2d", "o-grid"])
def test_translation_of_everything_is_exact(name, grid):
    problem = problem_of(grid)
    shift = np.array([0.3, -0.2, 0.0])
    moved = apply(ALL_METHODS[name], problem, lambda x: np.tile(shift, (len(x), 1)))
    assert np.abs(moved - shift).max() < tolerance(name)


@EVERY
@pytest.mark.parametrize("grid", [frame(), frame_2d()], ids=["frame", "frame-2d"])
def test_rigid_rotation_of_everything_is_exact(name, grid):
    problem = problem_of(grid)
    moved = apply(ALL_METHODS[name], problem, solid_turn)
    error = np.abs(moved - solid_turn(grid.points)).max()
    if name in NO_ROTATION:
        assert error > 1e-3
    else:
        assert error < tolerance(name)


@EVERY
def test_no_motion_moves_nothing(name):
    problem = problem_of(frame(), body_specs(turning(10)))
    assert np.all(apply(ALL_METHODS[name], problem, np.zeros((len(problem.source_points), 3))) == 0.0)


@EVERY
def test_boundary_nodes_land_where_told(name):
    problem = problem_of(frame(), body_specs(turning(10)))
    told = bend(problem.source_points)
    moved = apply(ALL_METHODS[name], problem, told)
    np.testing.assert_array_equal(moved[problem.source_flat], told)


@EVERY
def test_coincident_nodes_stay_together_bit_for_bit(name):
    problem = problem_of(frame(), body_specs(turning(10)))
    moved = problem.grid.points + apply(ALL_METHODS[name], problem, bend)
    t = problem.topology
    np.testing.assert_array_equal(moved[t.face_nodes], moved[t.first][t.number])


@EVERY
def test_slip_planes_stay_planes_exactly(name):
    problem = problem_of(frame(), body_specs(turning(10)))
    moved = apply(ALL_METHODS[name], problem, bend)
    z = problem.grid.points[:, 2]
    assert np.all(moved[(z == 0.0) | (z == 1.0), 2] == 0.0)
    assert np.abs(moved[(z == 0.0), :2]).max() > 1e-3


@EVERY
def test_oblique_slip_planes_stay_planes(name):
    grid = frame()
    turned = grid.moved(grid.points @ ROTATION.T)
    problem = problem_of(turned, _rotated_specs(grid))
    moved = apply(ALL_METHODS[name], problem, lambda x: bend(x @ ROTATION) @ ROTATION.T)
    span = (grid.points[:, 2] == 0.0) | (grid.points[:, 2] == 1.0)
    assert np.abs(moved[span] @ ROTATION[:, 2]).max() < 1e-13


def _rotated_specs(grid: Grid):
    """The same entries for a rotated grid: the filter on coordinates is replaced by windows of the inner faces."""
    from meshdeform_core.boundary import BoundarySpec

    inner = ("block4.imin", "block2.imax", "block5.imin", "block7.imin", "block4.jmax", "block5.jmin")
    sides = {"block2.imax": 0, "block4.jmax": 0, "block5.jmin": 0, "block7.imin": 0}
    faces = tuple(name for name in inner if name in sides)
    return [
        BoundarySpec("body", faces, Kind.MOVING, None, turning(10)),
        BoundarySpec("span", ("*.kmin", "*.kmax"), Kind.SLIP),
    ]


@EVERY
def test_frame_rotation_and_shift_do_not_matter(name):
    grid = frame()
    shift = np.array([0.7, -1.3, 0.4])
    turned = grid.moved(grid.points @ ROTATION.T + shift)
    specs = _rotated_specs(grid)
    here, there = problem_of(grid, specs), problem_of(turned, specs)
    told = solid_turn(here.source_points) * (here.boundary.kind[here.source_numbers] == Kind.MOVING)[:, None]
    moved = apply(ALL_METHODS[name], here, told)
    other = apply(ALL_METHODS[name], there, told @ ROTATION.T) @ ROTATION
    difference = np.abs(moved - other).max()
    if name in FRAME_DEPENDENT:
        assert difference > 1e-6
    else:
        assert difference < tolerance(name)


@EVERY
def test_superposed_translation(name):
    problem = problem_of(frame(), body_specs(turning(10), Kind.FREE))
    shift = np.array([0.5, 0.25, -0.125])
    moved = apply(ALL_METHODS[name], problem, solid_turn_of_body(problem))
    more = apply(ALL_METHODS[name], problem, solid_turn_of_body(problem) + shift)
    error = np.abs(more - moved - shift).max()
    if name == "idw-division":
        # Without remove_mean, as in the paper: each part of the motion turns the translation of those before.
        assert error > 1e-4
    else:
        assert error < tolerance(name)


def test_superposed_translation_without_the_mean():
    name = "idw-division"
    problem = problem_of(frame(), body_specs(turning(10), Kind.FREE))
    options = ALL_METHODS[name]
    free = dataclasses.replace(options, idw=dataclasses.replace(options.idw, remove_mean=True))
    shift = np.array([0.5, 0.25, -0.125])
    moved, more = (apply(free, problem, solid_turn_of_body(problem) + by) for by in (0.0, shift))
    assert np.abs(more - moved - shift).max() < tolerance(name)


def solid_turn_of_body(problem):
    moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
    return solid_turn(problem.source_points) * moving[:, None]


@EVERY
@pytest.mark.parametrize("factor", [1e-12, *(pytest.param(f, marks=pytest.mark.slow) for f in (1e-3, 1e3)), 1e6])
def test_scale_does_not_matter(name, factor):
    grid = frame()
    specs = _rotated_specs(grid)
    big = problem_of(grid.moved(grid.points * factor), specs)
    told = solid_turn_of_body(problem_of(grid, specs))
    moved = apply(ALL_METHODS[name], problem_of(grid, specs), told)
    options = ALL_METHODS[name]
    if options.rbf.radius != "auto":
        # A radius is a length: it grows with the grid.
        options = dataclasses.replace(options, rbf=dataclasses.replace(options.rbf, radius=options.rbf.radius * factor))
    other = apply(options, big, told * factor) / factor
    assert np.abs(moved - other).max() < 1e-10


@EVERY
def test_mirror_image(name):
    grid = frame()
    mirror = np.array([-1.0, 1.0, 1.0])
    specs = _rotated_specs(grid)
    told = solid_turn_of_body(problem_of(grid, specs))
    moved = apply(ALL_METHODS[name], problem_of(grid, specs), told)
    other = apply(ALL_METHODS[name], problem_of(grid.moved(grid.points * mirror), specs), told * mirror)
    assert np.abs(moved - other * mirror).max() < 1e-10


@EVERY
@pytest.mark.parametrize("axes", [(1, 2, 0), (2, 1, 0)])
@pytest.mark.parametrize("flips", [(True, False, False), (True, True, True)])
def test_index_order_does_not_matter(name, axes, flips):
    grid = frame()
    other = permuted(grid, axes, flips)
    motion = turning(10)
    from meshdeform_core.boundary import BoundarySpec
    from meshdeform_core.boundary.motions.expression import expression

    xyz = {"x", "y", "z"}
    specs = [
        BoundarySpec("body", ("*",), Kind.MOVING, expression("abs(x)<0.51 and abs(y)<0.51", xyz), motion),
        BoundarySpec("low", ("*",), Kind.SLIP, expression("z<0.001", xyz)),
        BoundarySpec("high", ("*",), Kind.SLIP, expression("z>0.999", xyz)),
    ]
    results = []
    for g in (grid, other):
        problem = problem_of(g, specs)
        results.append(apply(ALL_METHODS[name], problem, bend))
    for b in range(grid.n_blocks):
        again = back(other.block(b, results[1]), axes, flips)
        assert np.abs(again - grid.block(b, results[0])).max() < 1e-10


@EVERY
def test_block_order_does_not_matter(name):
    grid = frame()
    order = [5, 2, 7, 0, 3, 6, 1, 4]
    shuffled = Grid.from_blocks([grid.block(b) for b in order], [grid.names[b] for b in order])
    one = apply(ALL_METHODS[name], problem_of(grid, body_specs(turning(10))), bend)
    two = apply(ALL_METHODS[name], problem_of(shuffled, body_specs(turning(10))), bend)
    for new, old in enumerate(order):
        assert np.abs(shuffled.block(new, two) - grid.block(old, one)).max() < 1e-10


@EVERY
def test_prepared_once_and_applied_twice_is_prepared_twice(name):
    problem = problem_of(frame(), body_specs(turning(10)))
    prepared = make_method(ALL_METHODS[name]).prepare(problem)
    first = prepared.apply(bend(problem.source_points))
    kept = first.copy()
    second = prepared.apply(2 * bend(problem.source_points))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(second, apply(ALL_METHODS[name], problem, 2 * bend(problem.source_points)))
    assert not np.shares_memory(first, problem.grid.points)


def test_extrema_are_kept_without_rotation():
    problem = problem_of(frame(), body_specs(turning(10)))
    told = bend(problem.source_points)
    moved = apply(ALL_METHODS["idw-none"], problem, told)
    assert np.all(moved <= told.max(axis=0) + 1e-14)
    assert np.all(moved >= told.min(axis=0) - 1e-14)


@pytest.mark.parametrize("name", sorted({"tfi"} | RBF_ALONE))
def test_linear_map_is_exact(name):
    grid = frame()
    matrix = np.array([[0.1, 0.2, 0.0], [-0.1, 0.05, 0.3], [0.0, 0.1, -0.2]])
    moved = apply(ALL_METHODS[name], problem_of(grid), lambda x: x @ matrix.T)
    assert np.abs(moved - grid.points @ matrix.T).max() < (1e-14 if name == "tfi" else 1e-10)


def test_fixed_outside_and_moving_body_are_told_by_the_boundary():
    problem = problem_of(frame(), body_specs(turning(30)))
    told = prescribed_displacement(problem.grid, problem.topology, problem.boundary)
    moving = problem.boundary.kind == Kind.MOVING
    points = problem.grid.points[problem.topology.first]
    np.testing.assert_allclose(told[moving], solid_turn(points[moving], 30.0), atol=1e-15)
    assert np.all(told[~moving] == 0.0)


class Unset:
    """In place of a folder for arrays: those that are not initialised hold not-a-number."""

    def takes(self, size):
        return True

    def empty(self, shape, dtype):
        return np.full(shape, np.nan, dtype) if np.dtype(dtype).kind == "f" else np.zeros(shape, dtype)

    def look(self, maps=None):
        """Nothing is in files."""


REACHED = {
    "3-D": lambda: problem_of(frame(), body_specs(turning(10))),
    "2-D": lambda: problem_of(frame_2d(), body_specs(turning(10))[:1]),
    "periodic": lambda: problem_of(frame(3, 4), body_specs(turning(10), Kind.PERIODIC)),
}


@EVERY
@pytest.mark.parametrize("which", REACHED)
def test_every_node_is_reached(name, which):
    problem = REACHED[which]()
    prepared = make_method(ALL_METHODS[name]).prepare(problem)
    with scratch_in(Unset()):
        assert np.isfinite(prepared.apply(bend(problem.source_points))).all()
