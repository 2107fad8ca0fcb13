"""Cells in a repair: which need one, and their weights, large at walls."""

from dataclasses import replace

import numpy as np
import pytest
from cases import body_specs, formulas, turning
from grids import frame

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, Timing, impose, set_up
from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_core.methods import Options
from meshdeform_core.repair import RepairOptions
from meshdeform_core.repair import repair as repairs
from meshdeform_core.repair.constraints import Constraints
from meshdeform_core.repair.energy import share_of
from meshdeform_core.repair.outcome import unhealthy_cells
from meshdeform_core.repair.region import FARTHEST, Basis, nearness, weigh


def test_first_cells_at_walls_weigh_most_and_less_where_walls_are_few_cells_apart():
    cells, first = np.array([[0, 1, 2, 3], [2, 3, 4, 5], [6, 7, 8, 9]]), []
    for layers in (5, 9, 11, 40):
        share, near = nearness(np.repeat(np.arange(layers), 2), layers - 1)
        start = np.random.default_rng(0).uniform(1.0, 2.0, (2 * layers, 2))
        weight = weigh(share[cells], near, start, cells)
        assert weight[0] > weight[1] >= weight[2] >= 1.0
        first.append(weight[0] * near)
    np.testing.assert_allclose(first[2:], 400.0)
    assert first[0] < 10.0 < 50.0 < first[1] < 100.0
    # Walls reach two fifths of the way to where they are farthest, but at least one cell and at most 32.
    np.testing.assert_allclose([1.0 / nearness(np.zeros(1), far)[1] for far in (1, 10, 70, 90)], [1, 4, 28, 32])
    free, near = nearness(np.full(10, FARTHEST + 1), 0)
    np.testing.assert_array_equal(weigh(free[cells], near, start, cells), 1.0)
    # Thin cells, one of them with an edge without length, in which all others are as thin as 100.
    for aspect, expected in ((49.0, 1.0), (100.0, 2.0**1.25), (1e4, 40.0)):
        corners = np.array([[0.0, 0.0], [0.0, 1.0], [aspect, 0.0], [aspect, 1.0], [0.0, 0.0], [0.0, 0.0]])
        found = weigh(np.ones((2, 4)), near, corners, np.array([[0, 1, 2, 3], [0, 4, 2, 3]]))
        np.testing.assert_allclose(found, expected, rtol=1e-3)


def test_moving_far_field_is_no_wall_unless_nothing_else_moves():
    """A ring around a body: its outer side, towards which cells grow, is moved by another program, too.

    Only if the file says that it is far field: in another format the same grid is deformed alike.
    """
    angle, radius = np.linspace(0.0, 2.0 * np.pi, 49), 1.15 ** np.arange(17)
    angle[-1] = 0.0
    ring = radius[None, :] * np.exp(1j * angle)[:, None]
    grid = Grid.from_blocks([np.stack([ring.real, ring.imag, 0.0 * ring.real], axis=-1)[:, :, None]])
    far = Patch("outer", (Window(0, Side.JMAX, (0, 0), (48, 1)),), bc_type="BCFarfield")
    moved = formulas("0.1", "0", "0")

    def walls(*sides, patches=(far,)):
        setup = set_up(replace(grid, patches=patches), Case((BoundarySpec("given", sides, Kind.MOVING, None, moved),)))
        found = Constraints.of(setup.original, setup.boundary).walls
        return np.linalg.norm(setup.grid.points[setup.topology.first[found]], axis=1)

    both = [1.0, radius[-1].round(9)]
    np.testing.assert_allclose(walls("*.jmin", "*.jmax"), 1.0)
    np.testing.assert_allclose(np.unique(walls("*.jmin", "*.jmax", patches=()).round(9)), both)
    # The fixed body is a wall, too.
    np.testing.assert_allclose(np.unique(walls("*.jmax").round(9)), both)


def channel(cells, depth, width, method, mode="auto"):
    """A channel whose roof comes down, with clustered cells at both walls; the far ends are no walls."""
    x, s = np.linspace(-3.0, 3.0, 61), np.linspace(-1.0, 1.0, cells + 1)
    y = np.tile(0.5 + 0.5 * np.tanh(2.2 * s) / np.tanh(2.2), (x.size, 1))
    grid = Grid.from_blocks([np.stack([x[:, None] + 0.0 * y, y, 0.0 * y], axis=-1)[:, :, None]])
    lowered = formulas("0", f"-{depth}*exp(-(x/{width})**2)", "0")
    roof = BoundarySpec("roof", ("*.jmax",), Kind.MOVING, None, lowered)
    specs = (roof, BoundarySpec("floor", ("*.jmin",), Kind.FIXED))
    return set_up(grid, Case(specs, method=Options(method), repair=RepairOptions(mode)))


def test_fixed_walls_are_kept_like_moving_ones():
    setup = channel(24, 0.9, 0.6, "idw")
    constraints = Constraints.of(setup.original, setup.boundary)
    at_wall = setup.grid.points[setup.topology.first[constraints.walls]]
    assert set(np.unique(at_wall[:, 1])) == {0.0, 1.0}
    result = impose(setup, setup.motion(0.0), None, "float64", Timing())
    assert result.valid
    assert result.repair.converged
    walls = result.assessment.after.walls
    assert walls["fixed"].first_cell_height_ratio.min > 0.3
    assert walls["fixed"].wall_normal_deviation_deg.rms < 10.0


@pytest.mark.parametrize("share", [1.0, 0.95])
def test_what_walls_gain_the_worst_cell_of_a_valid_grid_loses_in_part_only(monkeypatch, share):
    monkeypatch.setattr(repairs, "KEPT", 0.9)
    setups = [channel(12, 0.9, 1.0, "tfi", mode) for mode in ("off", "auto")]
    plain = impose(setups[0], setups[0].motion(0.0), 1, "float64", Timing())
    # Where the method has squashed its cells, proportionally less is kept.
    monkeypatch.setattr(repairs, "SQUASHED", plain.assessment.after.min_relative_jacobian / share)
    repaired = impose(setups[1], setups[1].motion(0.0), 1, "float64", Timing())
    assert plain.valid
    assert repaired.repair is not None
    worst = [result.assessment.after.min_scaled_jacobian for result in (plain, repaired)]
    assert worst[1] == pytest.approx(share * 0.9 * worst[0], rel=1e-5)
    told = f"the repair lowers the smallest scaled Jacobian from {worst[0]:.3g} to {worst[1]:.3g} for better cells"
    assert [told in text for text in repaired.warnings if "scaled Jacobian" in text] == [True] * (share < 1.0)


def test_cells_are_healthy_up_to_the_shear_at_which_their_energy_has_a_share():
    grid = frame(4, 3)
    setup = set_up(grid, Case(tuple(body_specs(turning("5")))))
    plot = Basis(setup.original, setup.boundary).whole

    def sheared(amount):
        return grid.points + amount * grid.points[:, [1]] * [1.0, 0.0, 0.0]

    low, high = 0.0, 3.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if unhealthy_cells(setup.original, sheared(middle)).size else (middle, high)
    below, above = (share_of(plot.region.energy, plot.inside(sheared(low * at)))[0] for at in (1 - 1e-6, 1 + 1e-6))
    assert below == 0.0 < above


def test_cells_with_collapsed_edges_are_judged_by_their_other_corners():
    """A sector whose inner side is its axis, sheared by more than is healthy everywhere."""
    r, a, h = np.meshgrid(np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 4), np.linspace(0.0, 1.0, 3), indexing="ij")
    grid = Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)])
    original = set_up(grid, Case((BoundarySpec("all", ("*",), Kind.MOVING, None, formulas("0", "0", "0")),))).original
    assert not unhealthy_cells(original, grid.points).size
    sheared = grid.points + 4.0 * grid.points[:, [2]] * [1.0, 0.0, 0.0]
    np.testing.assert_array_equal(unhealthy_cells(original, sheared), np.arange(grid.n_cells))
