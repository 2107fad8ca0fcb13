"""Gaps that close between a moving wall and another: the default follows both walls there."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from cases import apply, body_specs, constant, formulas, problem_of, told, turning
from grids import frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import Grid
from meshdeform_core.methods import IDW, TFI, Options, make_method
from meshdeform_core.methods.composite import Composite, PreparedComposite
from meshdeform_core.methods.gaps import OPEN, PreparedInGaps
from meshdeform_core.methods.limits import BETWEEN
from meshdeform_core.quality import Original, assess
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


def walls(quality) -> float:
    """Deviation from the normal over moving and fixed walls, degrees rms."""
    both = [quality.walls[kind].wall_normal_deviation_deg.rms for kind in ("moving", "fixed")]
    return float(np.sqrt(np.mean(np.square(both))))


def test_channel_that_closes_to_three_percent_is_as_good_as_tfi_and_its_walls_are_better():
    grid, found = channel(), {}
    for name in ("idw-tfi", "tfi"):
        problem = problem_of(grid, lowered(0.03))
        moved = apply(Options(name), problem, told(problem))
        found[name] = assess(Original(grid, problem.topology), grid.points + moved, problem.boundary).after
    default, tfi = found["idw-tfi"], found["tfi"]
    assert default.invalid_cells == 0
    assert default.min_scaled_jacobian > tfi.min_scaled_jacobian
    assert default.f_skew.min > tfi.f_skew.min
    assert walls(default) < 0.6 * walls(tfi)
    alone = deform(grid, Case(tuple(lowered(0.03)), repair=RepairOptions("off")), steps=1)
    assert alone.valid


def test_nothing_changes_while_gaps_stay_open():
    problem = problem_of(channel(), lowered(OPEN + 0.01))
    np.testing.assert_array_equal(apply(DEFAULT, problem, told(problem)), PLAIN.prepare(problem).apply(told(problem)))


def test_the_grid_is_a_smooth_function_of_the_displacement():
    """From open to nearly closed, where it sets in included: second differences fall with the square of the step."""
    problem = problem_of(channel(61, 21), lowered(0.03))
    method, total = make_method(DEFAULT).prepare(problem), told(problem)
    assert isinstance(method, PreparedInGaps)

    def acceleration(step: float, start: float, stop: float) -> float:
        levels = [method.apply(f * total) for f in np.arange(start, stop, step)]
        return max(np.abs(a - 2 * b + c).max() for a, b, c in zip(levels, levels[1:], levels[2:], strict=False))

    onset = (1.0 - OPEN) / 0.97
    for start, stop in ((onset - 0.05, onset + 0.05), (0.5, 0.6)):
        coarse, fine = (acceleration(step, start, stop) for step in (0.01, 0.005))
        assert coarse < 0.02 * np.abs(total).max()
        assert fine < 0.5 * coarse


@pytest.mark.parametrize("make", [frame, frame_2d])
def test_boundary_and_slip_planes_stay_as_told(make):
    grid = make()
    specs = body_specs(formulas("0.7", "0", "0"))
    problem = problem_of(grid, specs if make is frame else specs[:1])
    moved, given = apply(DEFAULT, problem, told(problem)), told(problem)
    assert make_method(DEFAULT).prepare(problem).closing(given) is not None
    np.testing.assert_array_equal(moved[problem.source_flat], given)
    assert not moved[:, 2].any()
    number = problem.topology.number
    faces = moved[problem.topology.face_nodes]
    np.testing.assert_array_equal(faces, moved[problem.topology.first][number])


def test_a_gap_that_closes_evenly_is_shared_out_evenly():
    """Between two planes whose distance falls to a tenth, every cell keeps a tenth of its height."""
    x, y = np.meshgrid(np.linspace(0, 4, 41), np.linspace(0, 1, 13) ** 1.5, indexing="ij")
    grid = Grid.from_blocks([np.stack([x, y, 0 * x], axis=-1)[:, :, None]])
    specs = [
        BoundarySpec("lid", ("*.jmax",), Kind.MOVING, None, constant(0, -0.97, 0)),
        BoundarySpec("sides", ("*.imin", "*.imax"), Kind.SLIP),
    ]
    problem = problem_of(grid, specs)
    moved = (grid.points + apply(DEFAULT, problem, told(problem))).reshape(41, 13, 3)
    middle = np.diff(moved[20, :, 1]) / np.diff(y[20])
    np.testing.assert_allclose(middle, 0.03, atol=0.012)


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
    problem = problem_of(grid, [roof, BoundarySpec("floor", ("*.jmin",), Kind.FIXED)])
    kinks = make_method(DEFAULT).prepare(problem).linearised(told(problem)).kinks
    assert (kinks[BETWEEN] > 10) == ties
    assert set(kinks) <= {BETWEEN}


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
