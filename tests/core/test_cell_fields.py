"""Measures cell by cell: against the totals of the report and against plain geometry."""

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, polar

from meshdeform_cli.looking import MEASURES
from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Displace, Motion
from meshdeform_core.grid import Grid, Side
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields
from meshdeform_core.quality.listed import Worst
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.quality.validity import EXTREMES
from meshdeform_core.quality.walls import wall_cells

STILL = Motion((Displace(tuple(expression("0", frozenset()) for _ in range(3))),), {})


def waved(grid: Grid) -> Grid:
    """The grid with all nodes moved by a smooth function."""
    x = grid.points
    shift = 0.05 * np.sin(2 * x[:, [1, 2, 0]] + x)
    return grid.moved(x + shift * (np.ptp(x, axis=0) > 0))


def everything(fields: CellFields, measure: str) -> np.ndarray:
    """A measure of all cells of the grid, block after block."""
    blocks = range(fields.grid.n_blocks)
    return np.concatenate([fields.values(measure, b, fields.whole(b)).ravel() for b in blocks])


def at_place(fields: CellFields, measure: str, worst: Worst) -> float:
    """A measure of the cell that a report names."""
    block = fields.grid.names.index(worst.block)
    return float(fields.values(measure, block, fields.whole(block))[tuple(n - 1 for n in worst.ijk)])


def test_the_command_line_knows_all_measures():
    assert tuple(CELL_MEASURES) == MEASURES


@pytest.mark.parametrize("grid", [frame(), frame_2d()], ids=["3-D", "2-D"])
def test_extremes_are_those_of_the_report(grid):
    after = waved(grid)
    topology = find_topology(grid)
    fields = CellFields(after, topology, grid)
    quality = assess(Original(grid, topology), after.points, None).after
    assert everything(fields, "f_skew").min() == pytest.approx(quality.f_skew.min, rel=1e-12)
    assert everything(fields, "scaled_jacobian").min() == pytest.approx(quality.min_scaled_jacobian, rel=1e-12)
    assert everything(fields, "relative_jacobian").min() == pytest.approx(quality.min_relative_jacobian, rel=1e-6)
    assert everything(fields, "volume").sum() == pytest.approx(quality.total_volume)
    ratio = everything(fields, "volume_ratio")
    assert (ratio.min(), ratio.max()) == pytest.approx((quality.volume_ratio.min, quality.volume_ratio.max), rel=1e-12)
    assert np.nanmax(everything(fields, "interface_kink_deg")) == quality.interface_kink_deg.max
    assert np.nanmax(everything(fields, "interface_spacing_jump")) == quality.interface_spacing_jump.max
    for name in ("f_skew", "scaled_jacobian", "relative_jacobian"):
        worst = quality.worst["f_skew" if name == "f_skew" else f"min_{name}"]
        assert at_place(fields, name, worst) == pytest.approx(everything(fields, name).min(), rel=1e-6)
    for end, value in (("min", ratio.min()), ("max", ratio.max())):
        assert at_place(fields, "volume_ratio", quality.worst[f"volume_ratio_{end}"]) == pytest.approx(value, rel=1e-6)
    for name in ("interface_kink_deg", "interface_spacing_jump"):
        assert at_place(fields, name, quality.worst[name]) == np.nanmax(everything(fields, name))
        assert quality.worst[name].value == np.nanmax(everything(fields, name))
    for name, measure in [*shape_measures(after).items()][:-1]:
        values = everything(fields, name)
        assert values.max() == measure.max
        assert at_place(fields, name, measure.worst) == measure.max


def test_interfaces_of_a_grid_without_a_reference():
    """Grid lines that turn by 30 degrees and become twice as dense at the interface of two blocks."""
    left = block_around(np.linspace(-2.0, 0.0, 3), np.linspace(0.0, 1.0, 3), np.linspace(0.0, 1.0, 3))
    right = block_around(np.linspace(0.0, 1.0, 3), np.linspace(0.0, 1.0, 3), np.linspace(0.0, 1.0, 3))
    turn, x = np.radians(30.0), right[..., 0].copy()
    right[..., 0], right[..., 1] = np.cos(turn) * x, right[..., 1] + np.sin(turn) * x
    grid = Grid.from_blocks([left, right])
    before = assess(Original(grid, find_topology(grid)), grid.points, None).before
    assert before.interface_kink_deg.max == pytest.approx(30.0)
    assert before.interface_spacing_jump.max == pytest.approx(np.log(2.0))


@pytest.mark.parametrize("make", [frame, frame_2d, polar])
def test_wall_measures_are_those_of_the_report(make):
    grid = make()
    topology = find_topology(grid)
    walls = ["block1.jmax"] if make is polar else ["block4.jmax", "block2.imax"]
    specs = (BoundarySpec("wall", tuple(walls), Kind.MOVING, None, STILL),)
    boundary = classify(grid, topology, specs, {})
    after = waved(grid)
    quality = assess(Original(grid, topology), after.points, boundary).after
    moving = np.flatnonzero(boundary.quad_kind == Kind.MOVING)
    angle, ratio = wall_cells(grid, topology, after.points, moving)
    assert np.nanmax(angle) == pytest.approx(quality.wall_normal_deviation_deg.max, rel=1e-12)
    extremes = quality.first_cell_height_ratio
    assert max(1 / np.nanmin(ratio), np.nanmax(ratio)) == pytest.approx(max(1 / extremes.min, extremes.max))
    fields = CellFields(after, topology, grid, moving)
    worst = quality.worst["wall_normal_deviation_deg"]
    assert at_place(fields, "wall_normal_deviation_deg", worst) == worst.value == quality.wall_normal_deviation_deg.max
    found = [quality.worst[f"first_cell_height_ratio_{end}"] for end in ("min", "max")]
    assert [one.value for one in found] == [extremes.min, extremes.max]
    # A cell has the ratio that is farthest from 1, which may be another one of its own.
    for one in found:
        at_cell = at_place(fields, "first_cell_height_ratio", one)
        assert abs(np.log(at_cell)) >= abs(np.log(one.value)) * (1 - 1e-12)
    # One layer of cells has values, as many as there are quads.
    assert np.isfinite(angle).sum() == np.isfinite(ratio).sum() == len(moving)


def test_an_undeformed_grid_has_no_worst_change():
    grid = frame()
    topology = find_topology(grid)
    worst = assess(Original(grid, topology), grid.points + 0.0, None).after.worst
    assert set(worst) == EXTREMES.keys() - {"volume_ratio_min", "volume_ratio_max"}


def test_an_orthogonal_wall_has_no_deviation_and_stretched_cells_a_height_ratio():
    x = block_around(np.arange(4.0), np.arange(3.0), np.array([0.0, 1.0, 2.0]))
    # The first cell of a single grid line has no height: those of others count.
    x[1, 1, 1] = x[1, 1, 0]
    grid, taller = Grid.from_blocks([x]), Grid.from_blocks([x * [1.0, 1.0, 3.0]])
    topology = find_topology(grid)
    low = np.arange(topology.quads.of_side(0, Side.KMIN).start, topology.quads.of_side(0, Side.KMIN).stop)
    angle, ratio = (values.reshape(3, 2, 2) for values in wall_cells(grid, topology, taller.points, low))
    np.testing.assert_allclose(angle[:, :, 0], 0.0, atol=1e-12)
    np.testing.assert_allclose(ratio[:, :, 0], 3.0)
    assert np.isnan(angle[:, :, 1]).all()
    assert np.isnan(ratio[:, :, 1]).all()


def test_a_box_has_the_values_of_the_whole():
    grid = frame()
    fields = CellFields(waved(grid), find_topology(grid), grid, np.arange(5))
    box = slice(1, 3), slice(0, 2), slice(2, 3)
    for measure in MEASURES:
        np.testing.assert_allclose(
            fields.values(measure, 4, box), fields.values(measure, 4, fields.whole(4))[box], rtol=1e-12, err_msg=measure
        )


def test_displacement_and_distance():
    grid = frame()
    fields = CellFields(grid.moved(grid.points + [3.0, 0.0, 4.0]), find_topology(grid), grid, np.arange(5))
    np.testing.assert_allclose(everything(fields, "displacement"), 5.0)
    assert everything(fields, "wall_distance").min() > 0
