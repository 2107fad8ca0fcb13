"""Methods on random multi-block grids: blocks of any order and orientation, curvilinear, with holes."""

from collections.abc import Callable

import numpy as np
import pytest
from cases import ALL_METHODS, apply, everything_moves, problem_of
from hypothesis import HealthCheck, Phase, given, settings
from random_grids import BlockGrid, block_grids

from meshdeform_core.methods import Problem

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
