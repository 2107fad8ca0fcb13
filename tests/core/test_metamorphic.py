"""The same grid elsewhere or in other blocks gives the same result; axes, scales, block order: ``test_invariants``."""

import numpy as np
import pytest
from cases import ALL_METHODS, apply, everything_moves, formulas, problem_of, turning
from grids import frame
from hypothesis import Phase, given, settings
from random_grids import block_grids

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, deform
from meshdeform_core.repair import RepairOptions

AWAY = np.array([1.0, -0.7, 0.3])


def moved(distance, motion, method="idw-tfi", **options):
    """The result of a motion of the bar, by faces, in a grid so far from the origin."""
    wall = ("block2.imax", "block4.jmax", "block5.jmin", "block7.imin")
    specs = (BoundarySpec("bar", wall, Kind.MOVING, None, motion), BoundarySpec("span", ("*.k*",), Kind.SLIP))
    case = Case(specs, {}, ALL_METHODS[method], repair=RepairOptions("off"))
    result = deform(frame().moved(frame().points + distance * AWAY), case, **options)
    assert result.valid
    return result


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

    def change(distance):
        turn = turning(10, center=tuple(distance * AWAY))
        result = moved(distance, turn if turns else formulas("0.1", "0.05", "0"), name)
        assert [text for text in result.warnings if "selected" not in text and "MINRES" not in text] == []
        return result.grid.points - result.setup.grid.points

    here = change(0.0)
    for distance in (1e3, 1e12):
        assert np.abs(change(distance) - here).max() < (20 if turns else 1) * np.spacing(distance)


@pytest.mark.parametrize(("precision", "distance"), [("float64", 1e13), ("float64", 1e14), ("float32", 1e5)])
def test_motion_near_the_round_off_is_told(precision, distance):
    def rounding(distance):
        result = moved(distance, formulas("0.1", "0.05", "0"), precision=precision)
        return [text for text in result.warnings if "are multiples of" in text]

    (text,) = rounding(distance)
    assert f"{precision} are multiples of {np.spacing(np.dtype(precision).type(distance)):.2g}" in text
    assert "to which the motion of at most 0.112 is rounded" in text
    assert ("--variant precision=float64" in text) == (precision == "float32")
    assert rounding(1e-3 * distance) == []


def wave(x: np.ndarray) -> np.ndarray:
    return 0.05 * np.stack([np.sin(3 * x[:, 1]), np.cos(2 * x[:, 0] + x[:, 2]), x[:, 0] * x[:, 1]], axis=1)


@pytest.mark.parametrize("name", ["tfi", "rbf-tps", "rbf-krylov", "rbf-tfi", "idw-rbf", "idw-blend", "idw-tfi-cut"])
# No search for smaller examples: bounded in time also when it fails.
@settings(max_examples=6, database=None, phases=[Phase.generate])
@given(drawn=block_grids())
def test_order_and_orientation_of_blocks_do_not_matter_and_nodes_at_one_point_stay_there(name, drawn):
    """The latter by the coordinates alone, not by the program's own topology."""
    one, moved = (
        apply(ALL_METHODS[name], problem_of(grid, everything_moves()), wave) for grid in (drawn.plain, drawn.shuffled)
    )
    assert np.abs(drawn.in_first_order(drawn.shuffled, moved) - one).max() < 1e-10
    _, first, group = np.unique(drawn.shuffled.points, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(moved, moved[first][group.ravel()])
