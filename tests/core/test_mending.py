"""Repairs of grids that something else deformed, and the polishing of valid ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame

from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import GridError
from meshdeform_core.mending import mend
from meshdeform_core.quality.validity import judge
from meshdeform_core.repair import RepairOptions


def spoilt(layers=3, angle=110, size=6):
    """A grid, the same turned by another program so that cells are inverted, and the case."""
    grid = frame(size, layers)
    case = Case(tuple(body_specs(turning(str(angle)))), repair=RepairOptions("off"))
    bad = deform(grid, case, steps=1)
    assert not bad.valid
    return grid, bad, dataclasses.replace(case, repair=RepairOptions())


def test_the_boundary_of_a_grid_from_elsewhere_stays_and_its_cells_become_valid():
    grid, bad, case = spoilt()
    mended = mend(bad.grid, grid, case)
    setup = bad.setup
    assert mended.assessment.valid
    assert not judge(setup.original, mended.grid.points).invalid.size
    assert mended.repair is not None
    known = setup.topology.first[setup.boundary.known]
    np.testing.assert_array_equal(mended.grid.points[known], bad.grid.points[known])
    ends = np.isin(grid.points[:, 2], [0.0, 1.0])
    np.testing.assert_array_equal(mended.grid.points[ends, 2], grid.points[ends, 2])


def test_a_valid_grid_is_left_alone_but_for_polish():
    grid = frame(6, 2)
    case = Case(tuple(body_specs(turning("20"))))
    good = deform(grid, case, steps=1)
    assert good.repair is None
    same = mend(good.grid, grid, case)
    assert same.repair is None
    np.testing.assert_array_equal(same.grid.points, good.grid.points)
    case = Case(tuple(body_specs(turning("60"))))
    good = deform(grid, dataclasses.replace(case, repair=RepairOptions("off")), steps=1)
    polish = dataclasses.replace(case, repair=RepairOptions("polish"))
    better = mend(good.grid, grid, polish)
    assert better.assessment.valid
    worst = [step.assessment.after.min_relative_jacobian for step in (good, better)]
    assert worst[1] > 1.2 * worst[0]
    assert better.assessment.after.f_skew.min > good.assessment.after.f_skew.min
    direct = deform(grid, polish, steps=1)
    assert direct.assessment.after.min_relative_jacobian > 1.2 * worst[0]


def test_without_boundary_entries_all_outside_nodes_stay():
    grid = frame(5, 3)
    points = grid.points.copy()
    setup = set_up(grid, Case(tuple(body_specs(turning("0.1")))))
    inner = np.setdiff1d(np.arange(grid.n_nodes), setup.topology.face_nodes)[7]
    points[inner] += [0.5, 0.4, 0.0]
    assert judge(setup.original, points).invalid.size
    mended = mend(grid.moved(points), grid, Case(()))
    assert mended.assessment.valid
    outside = np.unique(setup.topology.quads.corners[setup.topology.external])
    nodes = setup.topology.first[outside]
    np.testing.assert_array_equal(mended.grid.points[nodes], points[nodes])


def test_ends_of_a_grid_one_cell_thick_slide():
    grid, bad, _ = spoilt(1)
    mended = mend(bad.grid.moved(bad.grid.points), grid, Case((), repair=RepairOptions()))
    assert mended.assessment.valid


@pytest.mark.slow
def test_what_the_boundary_makes_impossible_is_said():
    """Without a case the end planes stay, whose cells the motion has turned over."""
    thick, bad, _ = spoilt(2, size=4)
    mended = mend(bad.grid, thick, Case(()))
    assert not mended.assessment.valid
    assert any("no valid grid" in warning for warning in mended.warnings)
    assert any("case file" in warning for warning in mended.warnings)


def test_blocks_that_came_apart_are_refused():
    grid = frame(5, 2)
    points = grid.points.copy()
    grid.block(0, points)[-1] += 0.01
    with pytest.raises(GridError, match="coincide"):
        mend(grid.moved(points), grid, Case(()))
    with pytest.raises(GridError):
        mend(frame(4, 2), grid, Case(()))
