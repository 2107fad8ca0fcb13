"""The same grid elsewhere or in other blocks gives the same result; axes, scales, block order: ``test_invariants``."""

from collections.abc import Callable

import numpy as np
import pytest
from cases import ALL_METHODS, INNER, apply, every, everything_moves, formulas, problem_of, turning
from grids import block_around, frame, stretched
from hypothesis import HealthCheck, Phase, given, settings
from random_grids import BlockGrid, block_grids

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion
from meshdeform_core.deform import Case, deform
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.methods import Problem, make_method
from meshdeform_core.repair import RepairOptions

XYZ = {"x", "y", "z"}
SPAN = BoundarySpec("span", ("*.kmin", "*.kmax"), Kind.SLIP)
WALL = ("block2.imax", "block4.jmax", "block5.jmin", "block7.imin")
AWAY = np.array([1.0, -0.7, 0.3])
# Methods that blend between the faces of blocks: other blocks, other results.
BY_BLOCKS = {name for name, each in ALL_METHODS.items() if make_method(each).filler}


def displaced(grid: Grid, name: str, motion: Motion, wall: tuple[str, ...] = WALL) -> np.ndarray:
    """Displacement (n_nodes, 3) by the whole program, which must find the result valid and have nothing to add."""
    specs = (BoundarySpec("body", wall, Kind.MOVING, None, motion), SPAN)
    result = deform(grid, Case(specs, {}, ALL_METHODS[name], repair=RepairOptions("off")))
    assert result.valid
    assert [text for text in result.warnings if "selected" not in text and "MINRES" not in text] == []
    return result.grid.points - grid.points


@pytest.mark.parametrize(
    ("name", "turns"),
    [
        *((name, False) for name in ("tfi", "rbf-krylov", "idw-quaternion", "idw-tfi")),
        *((name, True) for name in ("rbf-tps", "idw-lie")),
    ],
)
def test_offset_costs_the_round_off_of_the_coordinates(name, turns):
    """A grid far from the origin: the result is that of the grid at the origin, rounded to its coordinates once; of a
    rotating body the position of its axis is rounded, too, and the angle is found from rounded nodes."""
    grid = frame()

    def moved(distance):
        motion = turning(10, center=tuple(distance * AWAY)) if turns else formulas("0.1", "0.05", "0")
        return displaced(grid.moved(grid.points + distance * AWAY), name, motion)

    here = moved(0.0)
    for distance in (1e3, 1e12):
        assert np.abs(moved(distance) - here).max() < (20 if turns else 1) * np.spacing(distance)


@pytest.mark.parametrize(("precision", "distance"), [("float64", 1e13), ("float64", 1e14), ("float32", 1e5)])
def test_motion_near_the_round_off_is_told(precision, distance):
    grid = frame()
    body = BoundarySpec("body", WALL, Kind.MOVING, None, formulas("0.1", "0.05", "0"))
    case = Case((body, SPAN), {}, repair=RepairOptions("off"))

    def rounding(distance: float) -> list[str]:
        away = grid.moved(grid.points + distance * AWAY)
        result = deform(away, case, precision=precision)
        assert result.valid
        return [text for text in result.warnings if "are multiples of" in text]

    (text,) = rounding(distance)
    assert f"{precision} are multiples of {np.spacing(np.dtype(precision).type(distance)):.2g}" in text
    assert "to which the motion of at most 0.112 is rounded" in text
    assert ("--variant precision=float64" in text) == (precision == "float32")
    assert rounding(1e-3 * distance) == []


def test_cells_below_the_round_off_are_refused():
    """At 1e15 coordinates are multiples of 0.125: nodes 0.2 apart coincide or not by chance."""
    grid = frame()
    away = grid.moved(grid.points + 1e15 * AWAY)
    case = Case((BoundarySpec("body", WALL, Kind.MOVING, None, formulas("0.1", "0", "0")),), {})
    with pytest.raises(CaseError, match=r"touch, but their nodes do not match"):
        deform(away, case)


def split(grid: Grid, block: int, axis: int, at: int) -> Grid:
    """The grid with a block cut in two at a layer of nodes; the second part is the last block."""
    blocks = [grid.block(b) for b in range(grid.n_blocks)]
    one, two = np.split(blocks[block], [at + 1], axis=axis)
    two = np.concatenate([one.take([-1], axis=axis), two], axis=axis)
    blocks[block] = np.ascontiguousarray(one)
    return Grid.from_blocks([*blocks, np.ascontiguousarray(two)])


@every(sorted(ALL_METHODS.keys() - BY_BLOCKS))
def test_split_blocks_do_not_matter(name):
    grid = frame()
    specs = [
        BoundarySpec("body", ("*.i*", "*.j*"), Kind.MOVING, expression(INNER, XYZ), turning(10)),
        BoundarySpec("span", ("*.kmin", "*.kmax"), Kind.SLIP),
    ]

    def bend(x):
        return np.exp(-(x[:, :1] ** 2)) * np.stack([0.1 * np.sin(x[:, 1]), 0.1 * np.cos(x[:, 0]), 0 * x[:, 0]], axis=1)

    whole = apply(ALL_METHODS[name], problem_of(grid, specs), bend)
    cut = split(split(grid, 3, 1, 2), 0, 2, 1)
    parts = apply(ALL_METHODS[name], problem_of(cut, specs), bend)
    known = {tuple(x): d for x, d in zip(grid.points, whole, strict=True)}
    error = max(np.abs(known[tuple(x)] - d).max() for x, d in zip(cut.points, parts, strict=True))
    assert error < 1e-9


@pytest.mark.parametrize("name", ["tfi", "idw-lie", "idw-tfi", "rbf-tps", "rbf-tfi", "idw-rbf"])
def test_thin_wall_cells_far_away(name):
    """A boundary layer of 1e-8 of its distance to the origin keeps its first cells."""
    ratio = 1e5
    z = np.linspace(0.0, 1.0, 3)
    height = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 12)])
    block = block_around(stretched((0.0, 2.0), 6), height, z) + ratio * AWAY
    grid = Grid.from_blocks([block])
    specs = (
        BoundarySpec("wall", ("block1.jmin",), Kind.MOVING, None, formulas("0", f"0.05*sin(pi*(x-{ratio})/2)", "0")),
        BoundarySpec("sides", ("block1.imin", "block1.imax", "block1.kmin", "block1.kmax"), Kind.SLIP),
    )
    result = deform(grid, Case(specs, {}, ALL_METHODS[name], repair=RepairOptions("off")))
    assert result.valid
    first = np.linalg.norm(np.diff(result.grid.block(0)[:, :2], axis=1)[:, 0], axis=-1)
    assert first.min() > 0.5e-3
    assert first.max() < 2e-3


SOME = pytest.mark.parametrize(
    "name", ["tfi", "rbf-tps", "rbf-krylov", "rbf-tfi", "idw-rbf", "idw-blend", "idw-tfi-cut"]
)
# Few and always the same examples, no search for smaller ones: bounded in time also when it fails.
FEW = settings(
    max_examples=6,
    deadline=None,
    derandomize=True,
    database=None,
    phases=[Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
GRIDS = block_grids()


def wave(x: np.ndarray) -> np.ndarray:
    return 0.05 * np.stack([np.sin(3 * x[:, 1]), np.cos(2 * x[:, 0] + x[:, 2]), x[:, 0] * x[:, 1]], axis=1)


def moved_everywhere(
    name: str, drawn: BlockGrid, motion: Callable[[np.ndarray], np.ndarray]
) -> tuple[Problem, np.ndarray]:
    problem = problem_of(drawn.shuffled, everything_moves())
    return problem, apply(ALL_METHODS[name], problem, motion)


@SOME
@FEW
@given(drawn=GRIDS)
def test_nodes_at_one_point_stay_at_one_point(name, drawn):
    """Judged by the coordinates alone, not by the program's own topology."""
    problem, moved = moved_everywhere(name, drawn, wave)
    _, first, group = np.unique(problem.grid.points, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(moved, moved[first][group.ravel()])
    assert np.isfinite(moved).all()


@SOME
@FEW
@given(drawn=GRIDS)
def test_order_and_orientation_of_blocks_do_not_matter(name, drawn):
    one = apply(ALL_METHODS[name], problem_of(drawn.plain, everything_moves()), wave)
    problem, other = moved_everywhere(name, drawn, wave)
    assert np.abs(drawn.in_first_order(problem.grid, other) - one).max() < 1e-10


@FEW
@given(drawn=GRIDS)
def test_drawn_grids_are_what_they_claim(drawn):
    np.testing.assert_array_equal(drawn.in_first_order(drawn.shuffled, drawn.shuffled.points), drawn.plain.points)
