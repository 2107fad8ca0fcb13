"""IDW against a slow twin, the limits it must have, and its options."""

import dataclasses

import numpy as np
import pytest
from cases import apply, body_specs, everything_moves, formulas, inner_nodes, problem_of, told, turning
from grids import block_around, frame, frame_2d, polar
from reference.idw import nodal_areas, slow_idw

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.errors import MethodError
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, Options, make_method
from meshdeform_core.numerics.rotation import continuous
from meshdeform_core.wording import literal
from meshdeform_samples.reproduce.paper_methods import ReweightedIDW

VARIANTS = {
    "none": IDW(rotation="none"),
    "quaternion": IDW(rotation="quaternion"),
    "quaternion without mean": IDW(rotation="quaternion", remove_mean=True),
    "division reweighted": ReweightedIDW(rotation="division", divisions=5),
    "division": IDW(rotation="division", divisions=5),
    "blend": IDW(rotation="blend"),
    "lie": IDW(),
    "lie with mean": IDW(remove_mean=False),
    "lie as in the paper": IDW(a=3.0, smoothing=0, transition=0),
    "lie by weights": IDW(transition=0),
    "smooth transition": IDW(transition=0.5),
    "short ends": IDW(transition=0.1, a=3.5),
    "one round": IDW(smoothing=1),
    "quaternion smoothed": IDW(rotation="quaternion", smoothing=3),
    "other exponents": IDW(a=2.0, b=4.5, alpha=0.3),
    "auto alpha": IDW(alpha="auto"),
    "length": IDW(length=2.0),
    "shepard": IDW(weights="shepard", p_moving=4.0, p_fixed=2.0),
}


# Others are in space as in the plane.
IN_SPACE = ("none", "quaternion", "division", "blend", "lie")


SIDES = [BoundarySpec(face, (face,), Kind.MOVING, None, turning(25)) for face in ("block2.imax", "block7.imin")]


@pytest.mark.parametrize(
    ("name", "grid", "moving"),
    [
        *((name, frame_2d(4), body_specs(turning(25))[:1]) for name in VARIANTS),
        *((name, frame(3, 2), body_specs(turning(25))[:1]) for name in IN_SPACE),
        # Moving faces that touch fixed ones, one body or two; a single layer of cells.
        *(("lie", grid, SIDES[:count]) for grid in (frame_2d(4), frame(3, 2)) for count in (1, 2)),
        ("lie", frame(3, 1), body_specs(turning(25))[:1]), ("lie by weights", frame(3, 1), SIDES),
        # A flat side that turns within its plane.
        ("quaternion", frame(3, 2), [dataclasses.replace(SIDES[0], motion=turning(130, (1, 0, 0)))]),
    ],
)  # fmt: skip
def test_slow_twin(name, grid, moving):
    span = BoundarySpec("span", ("*.k*",), Kind.SLIP)
    problem = problem_of(grid, [*moving, span] if grid.dimension == 3 else moving)
    # The body is also bent and twisted: every node of it turns by another angle.
    at = told(problem) * (1.0 + 0.2 * np.sin(problem.source_points @ [[2.0], [1.0], [1.5]]))
    moved = apply(Options("idw", idw=VARIANTS[name]), problem, at)
    free = np.union1d(inner_nodes(problem), np.setdiff1d(problem.topology.first, problem.source_flat))
    targets = free[:: max(1, len(free) // 12)]
    expected = slow_idw(problem, at, grid.points[targets], VARIANTS[name])
    # Beside slip planes the displacement across them is less.
    np.testing.assert_allclose(moved[targets, :2], expected[:, :2], atol=1e-12)


@pytest.mark.parametrize(
    ("angles", "expected"),
    [
        # Two surfaces of three nodes: one that passes half a turn, two that turn by about as much, alike or apart.
        ([100, 179, -178, 20, 10, 0], [100, 179, 182, 20, 10, 0]), ([-120, 179, 170] * 2, [-120, -181, -190] * 2),
        ([175, 176, 177, -179, -178, -178], [175, 176, 177, 181, 182, 182]), ([160, 160, 160, -165, -165, -165], None),
        ([-178, 179, -179, 60, 60, 60], [-178, -181, -179, 60, 60, 60]), ([80, 70, -80, 5, 5, 5], None),
        # One surface that turns up to 320 degrees, and one that passes 324 degrees, beyond which none is followed.
        ([5, 95, 179, -95, -40], [5, 95, 179, 265, 320]), ([5, 95, 179, -95, -30], None),
    ],
)  # fmt: skip
def test_surfaces_turn_continuously_and_alike(angles, expected):
    vectors, chain = np.radians(np.outer(angles, [0.6, 0.0, 0.8])), [(0, 1), (1, 2), (3, 4), (4, 5)]
    chain = chain if len(angles) == 6 else [(0, 1), (1, 2), (2, 3), (3, 4)]
    found = continuous(vectors, np.array([*chain, *(pair[::-1] for pair in chain)]))
    np.testing.assert_allclose(np.degrees(found @ [0.6, 0.0, 0.8]), expected or angles)


@pytest.mark.parametrize("name", ["idw", "idw-tfi"])
@pytest.mark.parametrize(
    "grid", [polar(), Grid.from_blocks([block_around(np.linspace(0, 9, 19), *[np.linspace(0, 1, 5)] * 2)])]
)
def test_a_boundary_that_stretches_and_shears_carries_its_grid_along(name, grid):
    """Not where it encloses no grid: a body that is stretched among slip planes stretches nothing far away."""
    affine = np.array([[0.3, 0.4, 0.0], [-0.2, 0.1, 0.1], [0.0, 0.1, -0.3]])
    moved = apply(Options(name), problem_of(grid), lambda x: x @ affine.T + [0.1, 0.2, 0.0])
    np.testing.assert_allclose(moved, grid.points @ affine.T + [0.1, 0.2, 0.0], atol=1e-13)
    alone = problem_of(frame(), [body_specs(turning(0))[0], BoundarySpec("rest", ("*",), Kind.SLIP)])
    far = apply(Options(name), alone, lambda x: x * [0.5, -0.3, 0.0])
    assert np.abs(far).max() < 0.3


def test_a_symmetry_line_is_the_middle_of_a_mirrored_plane_grid():
    """Round-off puts half of its nodes beside it."""
    whole = polar(24, 6, 0)
    half = Grid.from_blocks([whole.block(0)[:13]])
    wall = BoundarySpec("wall", ("*.jmin",), Kind.MOVING, None, formulas("0.2*x*x", "0.3*x*y", "0"))
    problems = problem_of(whole, [wall]), problem_of(half, [wall, BoundarySpec("middle", ("*.i*",), Kind.SYMMETRY)])
    one, two = (apply(Options("idw", idw=IDW(length=3.0)), problem, told(problem)) for problem in problems)
    np.testing.assert_allclose(whole.block(0, one)[:13], half.block(0, two), atol=1e-12)


def test_options_without_effect_and_numbers_too_large_are_told():
    only = "it is only used with method.idw."
    shepard = f'{only}weights = "shepard"'
    assert IDW().idle == {"eta": f'{only}alpha = "auto"', "p_moving": shepard, "p_fixed": shepard,
                          "divisions": f'{only}rotation = "division"'}  # fmt: skip
    with pytest.raises(MethodError, match=r"'tfi' does not use the options IDW\(.*\); it takes no options\. Leave"):
        Options("tfi", idw=IDW(a=2.0))
    problem = problem_of(frame_2d(), SIDES)
    with pytest.raises(MethodError, match=r"with alpha = 0\.1, L = 1e\+200, a = 2\.5, b = 5 is too large a number"):
        apply(Options("idw", idw=IDW(length=1e200)), problem, told(problem))


@pytest.mark.parametrize(
    ("size", "alpha", "reason"),
    [(1e-6, 1e-3, "{:.3g}"), (0.1, None, "{:.3g}"), (1.0, 0.3, "{:.3g}, capped at 0.3 (crossed cells)")],
)
def test_auto_alpha_is_eq_18_within_limits_and_says_so(size, alpha, reason):
    problem = problem_of(frame(), body_specs(formulas("0.3*y", "0.2*x", "0")))
    at = size * told(problem)
    prepared = make_method(Options("idw", idw=IDW(alpha="auto"))).prepare(problem)
    prepared.apply(at)
    area, settings = nodal_areas(problem), prepared.account.settings
    full = 5.0 / settings["length"].value * np.linalg.norm(at - area @ at / area.sum(), axis=1).max()
    assert settings["alpha"].reason == "eq. 18 gives " + reason.format(full)
    assert settings["alpha"].value == pytest.approx(alpha or full)


ONLY, NEAR = "only for lie between moving and fixed boundaries", "0 nodes are close to sharp edges"


@pytest.mark.parametrize(
    ("problem", "options", "expected"),
    [
        (problem_of(frame(), body_specs(turning(1), Kind.SYMMETRY)), IDW(),
         # Of 80 nodes in each of four planes, those off the first one have an image, then those off the last one.
         {"a": (4.0, "one moving body"), "mirrored_sources": (320 + 240 + 480, "images at symmetry planes take part")}),
        (problem_of(frame(), SIDES), IDW(), {"a": (3.0, "Luke et al.: the far field"), "transition": (0.5, "lie")}),
        (problem_of(frame_2d(), SIDES), IDW(), {"a": (2.5, "lie in a plane grid"), "transition": (0.3, "lie")}),
        (problem_of(frame_2d(), SIDES), IDW(a=3.5, transition=0.1, smoothing=2, remove_mean=True),
         {"a": (3.5, "given"), "transition": (0.1, "given"), "smoothing": (2, f"given; {NEAR}"),
          "remove_mean": (True, "given"), "summation": ("exact", "240 nodes with 96 sources")}),
        (problem_of(frame_2d(), SIDES), IDW(rotation="blend"),
         {"transition": (0.0, ONLY), "smoothing": (0, f'auto: only for rotation = "lie"; {NEAR}'),
          "remove_mean": (False, 'auto: only rotation = "lie" does')}),
        (problem_of(frame_2d(), everything_moves()), IDW(), {"transition": (0.0, ONLY)}),
    ],
)  # fmt: skip
def test_what_was_chosen_is_told_with_the_reason(problem, options, expected):
    settings = make_method(Options("idw", idw=options)).prepare(problem).account.settings
    assert {name: (settings[name].value, settings[name].reason) for name in expected} == expected


EXPECTED = {
    "rotation": "; did you mean 'quaternion'?", "alpha": '; expected a positive number up to 10000 or "auto"',
    "length": '; expected a positive number or "auto"', "divisions": "; expected a positive whole number",
    "summation_tolerance": "; expected a number >= 1e-08 up to 0.1",
}  # fmt: skip


@pytest.mark.parametrize(
    "options",
    [
        {"rotation": "quaternions"}, {"weights": "luk"}, {"alpha": 0}, {"alpha": -1.0}, {"alpha": "automatic"},
        {"alpha": float("nan")}, {"a": True}, {"p_moving": "3"}, {"eta": "5"}, {"divisions": 0}, {"divisions": 2.5},
        {"remove_mean": "yes"}, {"length": 0}, {"p_fixed": None}, {"divisions": True}, {"summation": "quick"},
        {"summation_tolerance": 1e-9},
    ],
)  # fmt: skip
def test_bad_options(options):
    ((name, value),) = options.items()
    with pytest.raises(MethodError) as caught:
        IDW(**options)
    told = str(caught.value)
    assert told.startswith(f"method.idw.{name} = {literal(value)}")
    assert told.endswith(EXPECTED.get(name, ""))
