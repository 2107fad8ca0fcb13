"""Gaps that close between a moving wall and another: the default follows both walls there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import apply, body_specs, constant, formulas, problem_of, told, turning
from grids import frame, frame_2d
from scipy.spatial import distance

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, TFI, Options, make_method
from meshdeform_core.methods.composite import Composite, PreparedComposite
from meshdeform_core.methods.gaps import OPEN
from meshdeform_core.methods.limits import BETWEEN
from meshdeform_core.repair import RepairOptions, options
from meshdeform_core.repair.repair import Repairer

DEFAULT = Options("idw-tfi")
PLAIN = Composite(IDW(), TFI())


def channel(ni: int = 91, nj: int = 31) -> Grid:
    """Three blocks with a bump at the floor; cells cluster at floor and roof."""
    x, s = np.linspace(-3.0, 3.0, ni), np.linspace(-1.0, 1.0, nj)
    share = 0.5 * (1.0 + np.tanh(2.2 * s) / np.tanh(2.2))
    floor = 0.2 * np.exp(-((x / 0.5) ** 2))
    y = floor[:, None] + (1.0 - floor[:, None]) * share
    whole = np.stack([np.tile(x[:, None], (1, nj)), y, 0 * y], axis=-1)[:, :, None]
    third = ni // 3
    return Grid.from_blocks([whole[: third + 1], whole[third : 2 * third + 1], whole[2 * third :]])


def lowered(left: float) -> list[BoundarySpec]:
    """The roof comes down to a share of its height above the bump."""
    roof = formulas("0", f"-{0.8 * (1.0 - left)}*exp(-(x/0.8)**2)", "0")
    return [BoundarySpec("roof", ("*.jmax",), Kind.MOVING, None, roof), BoundarySpec("floor", ("*.jmin",), Kind.FIXED)]


def test_nothing_changes_while_gaps_stay_open():
    problem = problem_of(channel(), lowered(OPEN + 0.01))
    np.testing.assert_array_equal(apply(DEFAULT, problem, told(problem)), PLAIN.prepare(problem).apply(told(problem)))


def test_shares_follow_from_the_distances_of_nodes_across_the_gap():
    """From 0.8 of a distance, where they set in, to none; most of the roof stays where it is."""
    problem = problem_of(channel(31, 11), lowered(OPEN - 0.01))
    method, x, at = make_method(DEFAULT).prepare(problem), problem.source_points, told(problem)
    moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
    for factor in (1.0, 2.0, 5.0):
        found = method.closing(factor * at)
        for side in (moving, ~moving):
            before, after = (distance.cdist(y[side], y[~side]).min(axis=1) for y in (x, x + factor * at))
            part = np.minimum(after / before / OPEN, 1.0)
            np.testing.assert_allclose(found.share[side], (1.0 - part) ** 2 * (1.0 + 2.0 * part), atol=1e-14)


@pytest.mark.parametrize("make", [frame, channel])
def test_derivative_is_that_of_the_blend(make):
    specs = body_specs(formulas("0.7", "0.1*y", "0")) if make is frame else lowered(0.3)
    problem = problem_of(channel(31, 11) if make is channel else frame(), specs)
    method, at = make_method(DEFAULT).prepare(problem), told(problem)
    assert method.closing(at) is not None
    rng = np.random.default_rng(5)
    # Sources at rest all have the same motion, or none of the shares that depend on it is what it was.
    moving = problem.boundary.kind[problem.source_numbers] == Kind.MOVING
    change = moving[:, None] * rng.normal(size=at.shape) * [1.0, 1.0, float(make is frame)]
    derivative, h = method.linearised(at), 1e-6
    pushed = derivative.push(change)
    np.testing.assert_allclose(
        pushed,
        (method.apply(at + h * change) - method.apply(at - h * change)) / (2 * h),
        atol=2e-6 * np.abs(pushed).max(),
    )
    gradient = rng.normal(size=pushed.shape)
    assert np.sum(gradient * pushed) == pytest.approx(np.sum(derivative.pull(gradient.copy()) * change), rel=1e-10)


@pytest.mark.parametrize(("aside", "ties"), [(0.0, True), (0.1, False)])
def test_a_node_half_way_between_two_nodes_across_the_gap_has_no_derivative(aside, ties):
    """The roof is staggered by half a cell against the floor."""
    i, s = np.meshgrid(np.arange(21.0), np.linspace(0.0, 1.0, 9), indexing="ij")
    grid = Grid.from_blocks([np.stack([0.2 * (i + 0.5 * s), s, 0 * s], axis=-1)[:, :, None]])
    roof = BoundarySpec("roof", ("*.jmax",), Kind.MOVING, None, constant(0.2 * aside, -0.7, 0))
    rest = BoundarySpec("floor", ("*.jmin",), Kind.FIXED), BoundarySpec("sides", ("*.i*",), Kind.FREE)
    problem = problem_of(grid, [roof, *rest])
    kinks = make_method(DEFAULT).prepare(problem).linearised(told(problem)).kinks
    # At floor and roof, all nodes but the one that has only one neighbour across the gap.
    assert kinks == ({BETWEEN: 40} if ties else {})


def test_the_papers_kinds_are_left_as_they_are():
    problem = problem_of(channel(31, 11), lowered(0.3))
    for each in (Options("idw-tfi", idw=IDW(rotation="quaternion")), Options("idw-tfi", tfi=TFI(max_cells=0))):
        assert type(make_method(each).prepare(problem)) is PreparedComposite


def test_the_method_that_made_the_grid_instead_is_told(monkeypatch):
    """Without repairs only small steps of another method help."""
    monkeypatch.setattr(Repairer, "repair", lambda *_: None)
    case = Case(tuple(body_specs(turning("75"))[:1]), method=Options("tfi"))
    result = deform(frame_2d(6), case)
    assert (result.valid, result.steps, result.repair) == (True, 8, None)
    assert result.warnings[-1] == (
        "the grid was made by rbf-tfi in 8 steps, as attempts with tfi left cells invalid or nearly collapsed (listed "
        "under attempts in the report)"
    )


@pytest.mark.parametrize(("amplitude", "least"), [(0.55, 0.4), (0.4, 0.6)])
def test_untangled_cells_are_improved_until_they_reach_the_limit(amplitude, least):
    x, y = np.meshgrid(np.linspace(0.0, 2.0, 9), np.linspace(0.0, 1.0, 6), indexing="ij")
    motion = formulas("0", f"{amplitude}*sin(pi*x/2)", "0")
    specs = (BoundarySpec("roof", ("*.jmin",), Kind.MOVING, None, motion),)
    result = deform(
        Grid.from_blocks([np.stack([x, y, 0.0 * x], axis=-1)[:, :, None]]),
        Case(specs, repair=options.RepairOptions(min_jacobian=least)),
    )
    assert result.valid
    assert result.steps == 1
    assert result.repair is not None


@pytest.mark.parametrize(("seconds", "work", "why"), [(1800.0, 1e-6, "as much work as is"), (1e-9, 1.0, "of 1e-09 s")])
def test_work_is_limited_by_counts_and_time(seconds, work, why, monkeypatch):
    """By counts the same wherever it is done; whatever was found is kept, and the reason told."""
    monkeypatch.setattr(options, "_PER_NODE", work)
    body, _ = body_specs(turning("110"), Kind.SLIP)
    case = Case((dataclasses.replace(body, select=("*",)),), repair=RepairOptions(time_limit=seconds))
    short, again = deform(frame_2d(6), case), deform(frame_2d(6), case)
    assert not short.valid
    assert sum(a.repair for a in short.attempts) == 1
    assert any(why in text for text in short.warnings)
    np.testing.assert_array_equal(short.grid.points, again.grid.points)


def test_a_squeezed_valid_grid_may_take_up_to_the_work_of_an_invalid_one():
    whole = options.Limit.of(Grid.allocate([(50, 100, 10)]), 1.0)
    sound, bound, half, least, invalid = (
        whole.of_repair(50_000, ratio).affords(1.0) for ratio in (1.0, 0.22, 0.11, 1e-9, 0.0)
    )
    assert sound == bound
    assert half == 2 * sound
    assert least == invalid == 15_000_000
