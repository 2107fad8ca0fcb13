"""A repaired grid depends on the displacement only; where the repair has several solutions, the result says so."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion, Rotate
from meshdeform_core.deform import Case, Timing, impose, set_up
from meshdeform_core.errors import MethodError
from meshdeform_core.memory import MemoryLimit
from meshdeform_core.methods import Options
from meshdeform_core.repair import RepairOptions
from meshdeform_core.repair.limit import Limit
from meshdeform_core.series import Schedule, deform_series
from meshdeform_core.setup import Start
from meshdeform_core.smoothness import Moment, smoothness
from meshdeform_core.stepping.course import Course
from meshdeform_core.stepping.steps import beginning, plain_step, repaired, settled


def bar(size, method="idw-tfi", mode="auto"):
    """A plane bar that turns by t degrees; the coarser the grid, the sooner the repair has several solutions."""
    turn = Motion((Rotate(expression("t", {"t"}), (0, 0, 1), (expression(0.0, ()),) * 3),), {})
    body, _ = body_specs(turning("0"), Kind.SLIP)
    spec = dataclasses.replace(body, select=("*",), motion=turn)
    return set_up(frame_2d(size), Case((spec,), method=Options(method), repair=RepairOptions(mode)))


def single(setup, angle):
    return impose(setup, setup.motion(angle), None, "float64", Timing())


def several(result):
    return any("several solutions" in text for text in result.warnings)


@pytest.mark.parametrize(("angle", "unique"), [(72.0, None), (78.0, True), (144.0, True), (168.0, False)])
def test_a_single_run_from_a_folded_grid_is_compared_with_the_motion_followed(angle, unique):
    result = single(bar(3), angle)
    assert result.valid
    assert result.repair.converged
    assert result.repair.unique is unique
    assert several(result) == (unique is False)


def test_levels_say_where_a_single_run_would_give_another_grid():
    """Every sixteenth level is compared; from the first difference on, all are."""
    setup = bar(3)
    times = tuple(np.arange(132.0, 158.0, 1.5))
    levels = list(deform_series(setup, Schedule(times), "float64"))
    assert all(level.result.repair.converged for level in levels)
    told = [level.result.repair.unique for level in levels]
    assert told[16:] == [False, False]
    assert None in told[:16]
    assert False not in told[:16]
    for level in levels[13:]:
        alone = single(setup, level.time).grid.points
        differs = np.abs(alone - level.result.grid.points).max() > 1e-3
        assert differs == (level.time > 155.0)
        assert several(level.result) == (level.result.repair.unique is False)


def test_another_way_of_making_levels_is_told_with_the_jump():
    levels = list(deform_series(bar(6, "tfi", "off"), Schedule((48.0, 56.0, 64.0), steps="auto"), "float64"))
    assert [level.result.way for level in levels] == ["tfi in one step"] * 2 + ["tfi with a part of the motion"]
    (told,) = [text for text in levels[2].result.warnings if "another way" in text]
    assert "before tfi in one step" in told
    assert f"accelerated by up to {levels[2].smoothness.acceleration:.3g} steps of the walls" in told
    assert not any("another way" in text for level in levels[:2] for text in level.result.warnings)


def test_the_second_level_in_another_way_has_a_velocity_only():
    still = np.zeros((2, 3))
    moments = [Moment(0.0, still, True, "a"), Moment(1.0, still + [[0.1, 0, 0], [0.3, 0, 0]], False, "b")]
    found = smoothness(moments, np.array([0]), np.ones(2))
    assert found.warning is not None
    assert "b, before a" in found.warning
    assert "move by up to 3 steps of the walls" in found.warning
    slower = [moments[0], moments[1]._replace(points=still + 0.1)]
    assert "move by up to 1 step of the walls" in str(smoothness(slower, np.array([0]), np.ones(2)).warning)


def test_whichever_way_leads_to_a_valid_grid_the_minimum_is_the_same():
    """Grids of smaller steps and of another method are starts of the search for the minimum of one step."""
    setup = bar(6)
    course = Course(setup, setup.motion(96.0), "float64", Timing(), None, Start(setup.grid.points), Limit(float("inf")))
    plain = plain_step(beginning(course, setup.case.method), 1.0)
    assert not plain.valid
    direct = repaired(plain)
    assert direct.repair.converged
    others = [
        impose(setup, setup.motion(96.0), 4, "float64", Timing()),
        single(bar(6, "rbf-tfi"), 96.0),
    ]
    for other in others:
        assert other.valid
        assert np.abs(other.grid.points - direct.found.points).max() > 1e-3
        found = settled(plain, other.grid.points)
        assert found is not None
        assert np.abs(found.found.points - direct.found.points).max() < 1e-6
    folded = settled(plain, np.zeros_like(setup.grid.points))
    assert folded is None


def test_a_motion_from_an_earlier_level_is_prescribed_from_there():
    setup = bar(6)
    start = impose(setup, setup.motion(20.0), 1, "float64", Timing()).grid.points
    course = Course(setup, setup.motion(60.0), "float64", Timing(), None, Start(start), Limit(float("inf")))
    begin = (start - setup.grid.points)[setup.topology.first]
    middle, end = course.prescribed(0.5), course.prescribed(1.0)
    np.testing.assert_array_equal(course.prescribed(0.0), begin)
    np.testing.assert_allclose(middle, (begin + end) / 2, atol=1e-15)
    assert np.abs(end - setup.motion(60.0)(1.0)).max() < 1e-15


def test_a_repair_that_does_not_fit_into_memory_is_refused_not_done_otherwise():
    case = Case(tuple(body_specs(turning("80"), Kind.FIXED)))
    needed = set_up(frame(5, 3), case)
    assert not impose(needed.with_repair("off"), needed.motion(0.0), 1, "float64", Timing()).valid
    tight = set_up(frame(5, 3), case, memory=MemoryLimit(100_000, "--max-memory allows"))
    with pytest.raises(MethodError, match=r"a repair of .* needs about .*, --max-memory allows .*--repair off"):
        impose(tight, tight.motion(0.0), 1, "float64", Timing())
