"""All methods on random multi-block grids: blocks of any order and orientation, curvilinear, with holes."""

from collections.abc import Callable

import numpy as np
from cases import ALL_METHODS, apply, every, everything_moves, problem_of
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from random_grids import BlockGrid, block_grids
from scipy.spatial.transform import Rotation

from meshdeform_core.methods import Problem

EVERY = every(ALL_METHODS)
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
# Blending along curved lines reproduces translations only: its error is that with which it would make the grid itself.
STRAIGHT = block_grids(straight=True)
BLENDED = [name for name in ALL_METHODS if name.startswith("tfi") or "-tfi" in name]
RIGID = [name for name in ALL_METHODS if name != "idw-none"]
LINEAR = [name for name in ALL_METHODS if name == "tfi" or name.startswith("rbf-")]


def wave(x: np.ndarray) -> np.ndarray:
    return 0.05 * np.stack([np.sin(3 * x[:, 1]), np.cos(2 * x[:, 0] + x[:, 2]), x[:, 0] * x[:, 1]], axis=1)


def affine(matrix: np.ndarray, shift: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    return lambda x: x @ matrix.T + shift


def moved_everywhere(
    name: str, drawn: BlockGrid, motion: Callable[[np.ndarray], np.ndarray]
) -> tuple[Problem, np.ndarray]:
    problem = problem_of(drawn.shuffled, everything_moves())
    return problem, apply(ALL_METHODS[name], problem, motion)


@EVERY
@FEW
@given(drawn=GRIDS)
def test_nodes_at_one_point_stay_at_one_point(name, drawn):
    """Judged by the coordinates alone, not by the program's own topology."""
    problem, moved = moved_everywhere(name, drawn, wave)
    _, first, group = np.unique(problem.grid.points, axis=0, return_index=True, return_inverse=True)
    np.testing.assert_array_equal(moved, moved[first][group.ravel()])
    assert np.isfinite(moved).all()


@EVERY
@FEW
@given(drawn=GRIDS, shift=st.tuples(*[st.floats(-2, 2)] * 3))
def test_translations_are_reproduced(name, drawn, shift):
    _, moved = moved_everywhere(name, drawn, lambda x: np.tile(shift, (len(x), 1)))
    assert np.abs(moved - shift).max() < 1e-10


@every(RIGID)
@FEW
@given(data=st.data(), axis=st.tuples(*[st.floats(-1, 1)] * 3), shift=st.tuples(*[st.floats(-2, 2)] * 3))
def test_rigid_motions_are_reproduced(name, data, axis, shift):
    motion = affine(Rotation.from_rotvec(axis).as_matrix() - np.eye(3), np.array(shift))
    problem, moved = moved_everywhere(name, data.draw(STRAIGHT if name in BLENDED else GRIDS), motion)
    assert np.abs(moved - motion(problem.grid.points)).max() < 1e-9


@every(LINEAR)
@FEW
@given(data=st.data(), entries=st.lists(st.floats(-0.5, 0.5), min_size=9, max_size=9))
def test_linear_motions_are_reproduced(name, data, entries):
    motion = affine(np.reshape(entries, (3, 3)), np.array([0.1, 0.2, 0.3]))
    problem, moved = moved_everywhere(name, data.draw(STRAIGHT if name in BLENDED else GRIDS), motion)
    assert np.abs(moved - motion(problem.grid.points)).max() < 1e-9


@EVERY
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
