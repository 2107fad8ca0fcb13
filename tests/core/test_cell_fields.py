"""Measures cell by cell, against the totals of the report and against plain geometry, with their gradients; two grids
compared node by node."""

import numpy as np
import pytest
from cases import STILL
from grids import block_around, frame, frame_2d, polar, waved, with_walls

from meshdeform_cli.looking import MEASURES
from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.errors import CaseError, GridError
from meshdeform_core.grid import Grid, Side
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess, gradients
from meshdeform_core.quality.cells import corner_nodes, places
from meshdeform_core.quality.difference import BlockDifference, compare_points
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields
from meshdeform_core.quality.gradients import quality_gradient
from meshdeform_core.quality.listed import Worst
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.quality.validity import EXTREMES
from meshdeform_core.quality.walls import wall_cells


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
    found = assess(Original(grid, topology), grid.points + 0.0, None)
    assert found.before.min_relative_jacobian == found.after.min_relative_jacobian == 1.0
    assert set(found.after.worst) == EXTREMES.keys() - {"volume_ratio_min", "volume_ratio_max"}


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
    x, walls = fields.grid.points, fields.topology.first[np.unique(fields.topology.quads.corners[fields.walls])]
    middles = x[corner_nodes(grid, *places(grid, np.arange(grid.n_cells)))].mean(axis=1)
    nearest = np.linalg.norm(middles[:, None] - x[walls], axis=2).min(axis=1)
    np.testing.assert_allclose(everything(fields, "wall_distance"), nearest, rtol=1e-12)


def test_bad_cells_and_what_measures_require():
    """Two nodes of the second block are swapped; patches that the reference lacks come from the grid."""
    plain, grid = frame(3, 2), with_walls(frame(3, 2))
    x = grid.points.copy()
    block = grid.block(1, x)
    block[1, 1, 1], block[2, 1, 1] = block[2, 1, 1].copy(), block[1, 1, 1].copy()
    alone, fields = CellFields.of(grid.moved(x)), CellFields.of(grid.moved(x), plain)
    box = slice(1, 3), slice(0, 2), slice(0, 2)
    expected = np.zeros((3, 4, 2), dtype=bool)
    expected[1, :2] = True
    for each in (alone, fields):
        found = [each.of_all(lambda own, n=n, each=each: each.bad(n, own), n, each.whole(n)) for n in range(8)]
        np.testing.assert_array_equal(found[1], expected)
        assert sum(part.sum() for part in found) == 4
        np.testing.assert_array_equal(each.bad(1, box), expected[box])
    listed, jacobian = assess(Original(plain, find_topology(plain)), x, None).invalid, fields.values("jacobian", 1, box)
    assert sorted(cell.min_jacobian for cell in listed) == pytest.approx(sorted(jacobian[expected[box]]))
    assert {surface.name for surface in fields.outside.surfaces} == {"body", "outer", "span"}
    cube = CellFields.of(Grid.from_blocks([block_around(*[np.arange(4.0)] * 3)]))
    for where, measure, message in (
        (alone, "f_skev", "measure 'f_skev' is unknown; did you mean 'f_skew'?"),
        (alone, "displacement", "displacement needs the undeformed grid; give --reference"),
        (cube, "wall_distance", "wall_distance: no wall is known; see `meshdeform info`"),
    ):
        with pytest.raises(CaseError) as caught:
            where.values(measure, 0, where.whole(0))
        assert str(caught.value) == message


def test_two_grids_are_compared_block_by_block():
    one = frame_2d(2)
    x = one.points.copy()
    x[:3] += [[3.0, 0.0, 4.0], [0.0, 2.0, 0.0], [0.0, 0.0, 0.0]]
    x[one.offsets[2] + 1] -= [0.0, 7.0, 0.0]
    found, sizes = compare_points(one, one.moved(x)), np.diff(one.offsets)
    assert (found.largest, found.where, found.differing_nodes, found.nodes) == (7.0, "block3 (1, 2, 1)", 3, one.n_nodes)
    assert found.rms == pytest.approx(np.sqrt(78.0 / one.n_nodes))
    parts = zip(("block1", "block2", "block3"), (5.0, 0.0, 7.0), (29.0, 0.0, 49.0), sizes[:3], strict=True)
    rms = [BlockDifference(name, most, pytest.approx((square / n) ** 0.5)) for name, most, square, n in parts]
    assert found.blocks[:3] == tuple(rms)
    fewer = Grid.from_blocks([one.block(n) for n in range(7)])
    other = Grid.from_blocks([*(one.block(n) for n in range(7)), one.block(6)[:-1]])
    for grid, message in (
        (fewer, "the first grid has 8 blocks, the second grid has 7"),
        (other, "block8 of the first grid has 5 x 5 x 1 nodes, block 8 of the second grid has 4 x 4 x 1"),
    ):
        with pytest.raises(GridError) as caught:
            compare_points(one, grid)
        assert str(caught.value) == f"{message}; expected the same blocks in the same order"


@pytest.fixture(scope="module", params=["3-D", "2-D"])
def measured(request):
    """A deformed grid with one left-handed block, and the measure of it, or with other points."""
    grid = frame(3, 2) if request.param == "3-D" else frame_2d(5)
    blocks = [grid.block(number) for number in range(grid.n_blocks)]
    grid = waved(Grid.from_blocks([blocks[0][::-1].copy(), *blocks[1:]]))
    topology = find_topology(grid)
    return grid, lambda measure, sharpness=40.0, blocks=None, x=grid.points: quality_gradient(
        grid, x, topology, measure, sharpness, blocks
    )


@pytest.mark.parametrize("measure", gradients.MEASURES)
@pytest.mark.parametrize("blocks", [None, [2, 0, 2]])
def test_central_differences(measured, measure, blocks, monkeypatch):
    monkeypatch.setattr(gradients, "_CELLS", 30)
    grid, value = measured
    change = np.random.default_rng(2).standard_normal(grid.points.shape) * (np.ptp(grid.points, axis=0) > 0)
    gradient = value(measure, blocks=blocks)[1]
    told, size = (gradient * change).sum(), np.abs(gradient * change).sum()
    errors = []
    for h in (1e-5, 2.5e-6):
        one, two = (value(measure, 40.0, blocks, grid.points + s * h * change)[0] for s in (1, -1))
        errors.append(abs((one - two) / (2 * h) - told) / size)
    assert errors[1] < 1e-6
    assert errors[1] < errors[0] / 12 or errors[1] < 1e-9
    moved = [grid.block(block, gradient).any() for block in range(grid.n_blocks)]
    assert moved == [blocks is None or block in blocks for block in range(grid.n_blocks)]


@pytest.mark.parametrize("blocks", [None, [2, 0, 2]])
def test_values_by_their_definitions(measured, blocks):
    grid, value = measured
    fields, some = CellFields(grid, find_topology(grid)), set(range(grid.n_blocks) if blocks is None else blocks)
    skew, volume = (
        np.concatenate([fields.values(name, block, fields.whole(block)).ravel() for block in some])
        for name in ("f_skew", "volume")
    )
    assert value("volume", blocks=blocks)[0] == pytest.approx(volume.sum(), rel=1e-12)
    assert value("f_skew", blocks=blocks)[0] == pytest.approx(1.0 / np.mean(1.0 / skew), rel=1e-12)
    smooth = -np.log(np.exp(-30.0 * skew).sum()) / 30.0
    assert value("f_skew_min", 30.0, blocks)[0] == pytest.approx(smooth, rel=1e-12)
    scaled = assess(Original(grid, find_topology(grid)), grid.points, None).after.min_scaled_jacobian
    sharp, soft = (value("scaled_jacobian_min", sharpness)[0] for sharpness in (1e6, 30.0))
    corners = 2**grid.dimension * grid.n_cells
    assert scaled - np.log(corners) / 1e6 <= sharp <= scaled
    assert scaled - np.log(corners) / 30.0 <= soft < sharp


def test_refusals(measured):
    grid, value = measured
    for blocks in ([], [-1], [grid.n_blocks], [0, 99]):
        with pytest.raises(GridError, match=rf"blocks = .*; expected numbers from 0 to {grid.n_blocks - 1}$"):
            value("volume", blocks=blocks)
    with pytest.raises(GridError, match=r"no quality measure 'beauty'; expected one of f_skew, f_skew_min, "):
        value("beauty")
    x = grid.points.copy()
    x[grid.offsets[1] - 1] += 9.0 * (x[0] - x[grid.offsets[1] - 1])
    for measure in ("f_skew", "f_skew_min"):
        with pytest.raises(GridError, match=rf"^{measure} is zero in 1 cells"):
            value(measure, x=x)
    assert value("scaled_jacobian_min", x=x)[0] < 0
