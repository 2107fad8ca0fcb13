"""The invariants of the methods (spec section 10): contract tests over all of them."""

import dataclasses
import functools

import numpy as np
import pytest
from cases import ALL_METHODS, FRAME_DEPENDENT, STILL, apply, body_specs, every, problem_of, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.methods import IDW, Options, Problem, make_method
from meshdeform_core.parallel import sharing

EVERY = every(ALL_METHODS)
ROTATION = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
ROTATION *= np.sign(np.linalg.det(ROTATION))

RBF_ALONE = {name for name in ALL_METHODS if name.startswith("rbf-")}
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


@functools.cache
def bar() -> Problem:
    """The bar of a grid moves, the outside stays, the span slides."""
    return problem_of(frame(), body_specs(turning(10)))


@EVERY
def test_no_motion_moves_nothing_and_each_displacement_is_computed_alone(name):
    problem = bar()
    told, prepared = bend(problem.source_points), make_method(ALL_METHODS[name]).prepare(problem)
    first = prepared.apply(told)
    kept = first.copy()
    assert np.all(prepared.apply(np.zeros_like(told)) == 0.0)
    second = prepared.apply(2 * told)
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(second, apply(ALL_METHODS[name], problem, 2 * told))
    assert not np.shares_memory(first, problem.grid.points)


@EVERY
def test_boundary_nodes_land_where_told_coincident_ones_stay_together_slip_planes_stay_planes(name):
    problem = bar()
    told, t, z = bend(problem.source_points), problem.topology, problem.grid.points[:, 2]
    # Between the planes the bar also moves across them.
    told[:, 2] = told[:, 1] * problem.source_points[:, 2] * (1.0 - problem.source_points[:, 2])
    moved = apply(ALL_METHODS[name], problem, told)
    np.testing.assert_array_equal(moved[problem.source_flat], told)
    np.testing.assert_array_equal(moved[t.face_nodes], moved[t.first][t.number])
    assert np.all(moved[(z == 0.0) | (z == 1.0), 2] == 0.0)
    assert np.abs(moved[(z == 0.0), :2]).max() > 1e-3


def _rotated_specs() -> list[BoundarySpec]:
    """The same entries for a rotated grid: the filter on coordinates is replaced by the inner faces."""
    faces = ("block2.imax", "block4.jmax", "block5.jmin", "block7.imin")
    return [
        BoundarySpec("body", faces, Kind.MOVING, None, turning(10)),
        BoundarySpec("span", ("*.kmin", "*.kmax"), Kind.SLIP),
    ]


@functools.cache
def body(factor: float = 1.0, mirrored: bool = False) -> Problem:
    """The bar as in :func:`bar`, selected by faces, in a grid of another size, or mirrored."""
    grid = frame()
    return problem_of(grid.moved(grid.points * factor * [-1.0 if mirrored else 1.0, 1.0, 1.0]), _rotated_specs())


@functools.cache
def oblique(shift: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Problem:
    grid = frame()
    return problem_of(grid.moved(grid.points @ ROTATION.T + shift), _rotated_specs())


@EVERY
def test_frame_rotation_and_shift_do_not_matter(name):
    here, there = body(), oblique((0.7, -1.3, 0.4))
    told = solid_turn_of_body(here)
    moved = apply(ALL_METHODS[name], here, told)
    other = apply(ALL_METHODS[name], there, told @ ROTATION.T) @ ROTATION
    difference = np.abs(moved - other).max()
    assert difference > 1e-6 if name in FRAME_DEPENDENT else difference < tolerance(name)


WITHOUT_THE_MEAN = Options("idw", idw=IDW(rotation="division", divisions=8, remove_mean=True))


@every([*ALL_METHODS, "without the mean"])
def test_superposed_translation(name):
    problem = problem_of(frame(), body_specs(turning(10), Kind.FREE))
    shift, options = np.array([0.5, 0.25, -0.125]), ALL_METHODS.get(name, WITHOUT_THE_MEAN)
    moved, more = (apply(options, problem, solid_turn_of_body(problem) + by) for by in (0.0, shift))
    error = np.abs(more - moved - shift).max()
    # As in the paper each part of the motion turns the translation of those before.
    assert error > 1e-4 if name == "idw-division" else error < tolerance(name)


def solid_turn_of_body(problem):
    moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
    return solid_turn(problem.source_points) * moving[:, None]


@EVERY
@pytest.mark.parametrize("factor", [1e-12, 1e6])
def test_scale_does_not_matter(name, factor):
    told, options = solid_turn_of_body(body()), ALL_METHODS[name]
    moved = apply(options, body(), told)
    if options.rbf.radius != "auto":
        # A radius is a length: it grows with the grid.
        options = dataclasses.replace(options, rbf=dataclasses.replace(options.rbf, radius=options.rbf.radius * factor))
    assert np.abs(moved - apply(options, body(factor), told * factor) / factor).max() < 1e-10


@EVERY
def test_mirror_image(name):
    mirror, told = np.array([-1.0, 1.0, 1.0]), solid_turn_of_body(body())
    moved, other = apply(ALL_METHODS[name], body(), told), apply(ALL_METHODS[name], body(1.0, True), told * mirror)
    assert np.abs(moved - other * mirror).max() < 1e-10


@pytest.mark.parametrize("name", sorted({"tfi", "idw-lie", "idw-tfi", "idw-tfi-cut"} | RBF_ALONE))
def test_linear_map_is_exact(name):
    grid = frame()
    matrix = np.array([[0.1, 0.2, 0.0], [-0.1, 0.05, 0.3], [0.0, 0.1, -0.2]])
    moved = apply(ALL_METHODS[name], problem_of(grid), lambda x: x @ matrix.T)
    assert np.abs(moved - grid.points @ matrix.T).max() < (1e-14 if name == "tfi" else 1e-10)


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
    with sharing(scratch=Unset()):
        assert np.isfinite(prepared.apply(bend(problem.source_points))).all()


@pytest.mark.parametrize("name", ["tfi", "idw-lie", "rbf-tfi"])
def test_free_periodic_nodes_take_the_mean_of_their_images_and_are_sources_then(name):
    bar, span = body_specs(turning(10))
    told = problem_of(frame(), [bar, dataclasses.replace(span, kind=Kind.MOVING, motion=STILL)])
    alone, pairs = (problem_of(frame(), body_specs(turning(10), kind)) for kind in (Kind.FREE, Kind.PERIODIC))
    given = 0.1 * np.sin(pairs.source_points @ [[1.0, 2.0, 0.5], [0.3, 0.7, 1.0], [2.0, 0.5, 3.0]])
    moved = apply(ALL_METHODS[name], alone, given)
    for number in range(8):
        block = alone.grid.block(number, moved)
        block[:, :, [0, -1]] = block[:, :, [0, -1]].mean(axis=2, keepdims=True)
    every = moved[told.source_flat]
    every[np.isin(told.source_numbers, pairs.source_numbers)] = given
    expected = apply(ALL_METHODS[name], told, every)
    np.testing.assert_allclose(apply(ALL_METHODS[name], pairs, given), expected, rtol=0, atol=1e-12)
