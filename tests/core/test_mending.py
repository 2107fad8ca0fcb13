"""Repairs of grids that something else deformed, the polishing of valid ones, and interiors that are made again."""

import dataclasses

import numpy as np
import pytest
from cases import body_specs, turning
from grids import clustered, frame

from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import GridError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.mending import judge_grid, mend
from meshdeform_core.quality.validity import judge
from meshdeform_core.repair import RepairOptions
from meshdeform_core.repair.outcome import Judged
from meshdeform_core.repair.repair import Repairer


def o_grid(around: int = 121, layers: int = 61) -> Grid:
    """An ellipse of 1 x 0.12 in a conformal O-grid, one block whose ends meet."""
    angle = np.linspace(0.0, 2.0 * np.pi, around)
    angle[-1] = 0.0
    # The steps of the map shrink with it at the wall: by its derivative there, about 1 at the sides.
    circle = (0.28 + clustered(0.0, 15.0, layers - 1, 15.0)) * np.exp(1j * angle)[:, None]
    return in_plane(circle + 0.28 * 0.22 / circle)


def in_plane(place: np.ndarray) -> Grid:
    """A block from complex numbers."""
    return Grid.from_blocks([np.stack([place.real, place.imag, 0 * place.real], axis=-1)[:, :, None]], ["o"])


def moved_by_a_script(grid: Grid, degrees: float, layers: int = 20) -> Grid:
    """The grid with its wall turned and the nodes of the first ``layers`` carried along, less and less."""
    x = grid.block(0)[:, :, 0]
    angle = np.radians(degrees) * np.clip(1.0 - np.arange(x.shape[1]) / layers, 0.0, 1.0)
    return in_plane((x[..., 0] + 1j * x[..., 1]) * np.exp(1j * angle))


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
    first = setup.topology.first[setup.topology.number]
    np.testing.assert_array_equal(mended.grid.points[setup.topology.face_nodes], mended.grid.points[first])


def test_a_valid_grid_is_left_alone_but_for_polish():
    grid = frame(6, 2)
    case = Case(tuple(body_specs(turning("20"))))
    good = deform(grid, case, steps=1)
    assert good.repair is None
    same = mend(good.grid, grid, case)
    assert same.repair is None
    np.testing.assert_array_equal(same.grid.points, good.grid.points)
    single = mend(good.grid, grid, case, "float32").grid.points
    np.testing.assert_array_equal(single, good.grid.points.astype(np.float32))
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


def test_a_polished_grid_whose_worst_cell_is_worse_is_not_taken(monkeypatch):
    grid = frame(6, 3)
    case = Case(tuple(body_specs(turning("20"))), repair=RepairOptions("polish"))
    good = deform(grid, dataclasses.replace(case, repair=RepairOptions("off")), steps=1).grid
    worse, inner = good.points.copy(), np.setdiff1d(np.arange(grid.n_nodes), find_topology(grid).face_nodes)
    worse[inner] += 0.01 * np.random.default_rng(0).standard_normal((len(inner), 3))
    polished = Judged(worse, judge(set_up(grid, case).original, worse))
    assert polished.verdict.valid
    monkeypatch.setattr(Repairer, "repair", lambda *_: polished)
    np.testing.assert_array_equal(mend(good, grid, case).grid.points, good.points)


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


def test_what_the_boundary_makes_impossible_is_said():
    """Without a case the end planes stay, whose cells the motion has turned over."""
    thick, bad, case = spoilt(2, size=4)
    mended = mend(bad.grid, thick, Case((), repair=RepairOptions(time_limit=1e-9)))
    assert not mended.assessment.valid
    why, hint = mended.warnings
    assert why.startswith("the boundary crosses itself, so no valid grid exists: '(not selected)' meets itself at (")
    assert hint == "all outside nodes stay where they are; a case file (-c) tells which faces may slide"
    hurried = mend(bad.grid, thick, dataclasses.replace(case, repair=RepairOptions(time_limit=1e-9)))
    assert hurried.warnings[-1:] == ("no valid grid was found; whether there is one is not known",)
    assessment, notes = judge_grid(bad.grid, thick, case)
    assert (assessment.after, notes) == (bad.assessment.after, bad.setup.boundary.notes)
    alone, nothing = judge_grid(bad.grid, thick, Case(()))
    assert (alone.after.walls["moving"], len(alone.invalid), nothing) == (None, len(assessment.invalid), ())


def test_blocks_that_came_apart_are_refused():
    grid = frame(5, 2)
    points = grid.points.copy()
    grid.block(0, points)[-1] += 0.01 + 0.02 * (grid.block(0)[-1, :, :, 2:] == 0.5)
    with pytest.raises(GridError, match=r"^21 block nodes .*, by up to 0.052 at \(-0.5, -0.5, 0.5\); expected a grid"):
        mend(grid.moved(points), grid, Case(()))
    with pytest.raises(GridError):
        mend(frame(4, 2), grid, Case(()))


@pytest.mark.parametrize("degrees", [3.0, 25.0])
def test_interior_is_made_again_from_the_reference(degrees):
    grid = o_grid(around=81, layers=41)
    x = grid.block(0)
    edges = [np.linalg.norm(np.diff(x[:, :, 0], axis=axis), axis=-1) for axis in (0, 1)]
    assert edges[0][:, 0].max() / edges[1][:, 0].min() > 1e4
    bent = moved_by_a_script(grid, degrees)
    mended = mend(bent, grid, Case(()))
    assert mended.assessment.valid
    assert mended.renewal.method == "idw-tfi"
    assert "cells were bad" in mended.renewal.reason
    known = mended.boundary.known[mended.topology.number]
    rows = mended.topology.face_nodes[known]
    np.testing.assert_array_equal(mended.grid.points[rows], bent.points[rows])
    assert np.abs(mended.grid.points[rows] - grid.points[rows]).max() > 0.02
    before, after = mended.assessment.before, mended.assessment.after
    assert after.min_scaled_jacobian > 0.6 * before.min_scaled_jacobian
    assert after.min_relative_jacobian > 0.5


def test_moving_nodes_comes_first_where_few_cells_are_bad_and_then_the_reference():
    """A grid with one tangled spot is mended there; where that fails, the whole interior is made again."""
    grid = frame(6, 3)
    case = Case(tuple(body_specs(turning("40"))))
    good = deform(grid, case, steps=1)
    spot = good.grid.points.copy()
    inner = np.argmin(np.linalg.norm(spot - [0.0, 1.6, 0.5], axis=1))
    spot[inner] += [0.0, 0.9, 0.0]
    mended = mend(grid.moved(spot), grid, case)
    assert mended.assessment.valid
    assert mended.renewal is None
    assert mended.repair is not None
    # No time is left for Newton steps: what remains is the reference.
    hurried = dataclasses.replace(case, repair=RepairOptions(time_limit=1e-9))
    again = mend(grid.moved(spot), grid, hurried)
    assert again.assessment.valid
    assert "moving nodes left" in again.renewal.reason
    np.testing.assert_allclose(again.grid.points, deform(grid, hurried, steps=1).grid.points, atol=1e-9)


def test_nothing_is_made_again_where_the_boundary_has_not_moved():
    grid = o_grid(41, 31)
    points = grid.points.copy()
    points[grid.offsets[0] + 31 * 5 + 10 : grid.offsets[0] + 31 * 30 + 10] *= 1.2
    block = points.reshape(grid.block(0).shape)
    block[:, 0], block[:, -1] = grid.block(0)[:, 0], grid.block(0)[:, -1]
    block[-1] = block[0]
    mended = mend(grid.moved(points), grid, Case(()))
    assert mended.renewal is None
