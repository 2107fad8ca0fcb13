"""Measures cell by cell, against the totals of the report and against plain geometry, with their gradients; two grids
compared node by node."""

import numpy as np
import pytest
from cases import STILL, everything_moves
from grids import block_around, frame, frame_2d, prisms, turn_back, turn_block, waved, with_walls
from random_grids import ORIENTATIONS

from meshdeform_cli.looking import MEASURES
from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.errors import CaseError, GridError
from meshdeform_core.grid import Grid, Side
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess, gradients
from meshdeform_core.quality.cells import corner_nodes, places
from meshdeform_core.quality.difference import BlockDifference, compare_points
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields, cell_means
from meshdeform_core.quality.gradients import quality_gradient
from meshdeform_core.quality.listed import Worst
from meshdeform_core.quality.shape import shape_measures
from meshdeform_core.quality.validity import EXTREMES, Range, Spread
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
    for name in ("f_skew", "scaled_jacobian", "relative_jacobian"):
        worst = quality.worst["f_skew" if name == "f_skew" else f"min_{name}"]
        assert at_place(fields, name, worst) == pytest.approx(everything(fields, name).min(), rel=1e-6)
    for end, value in (("min", ratio.min()), ("max", ratio.max())):
        assert at_place(fields, "volume_ratio", quality.worst[f"volume_ratio_{end}"]) == pytest.approx(value, rel=1e-6)
    for name, measure in [*shape_measures(after).items()][:-1]:
        values = everything(fields, name)
        assert values.max() == measure.max
        assert at_place(fields, name, measure.worst) == measure.max


def test_an_undeformed_grid_has_no_worst_change():
    grid = frame()
    topology = find_topology(grid)
    boundary = classify(grid, topology, everything_moves(), {})
    found = assess(Original(grid, topology), grid.points + 0.0, boundary)
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
    boundary = classify(grid, topology, (BoundarySpec("low", ("*.kmin",), Kind.MOVING, None, STILL),), {})
    walls = assess(Original(grid, topology), taller.points, boundary).after.walls["moving"]
    assert walls.first_cell_height_ratio == Range(pytest.approx(3.0), pytest.approx(3.0))
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
    for each in (fields, CellFields.of(plain.moved(x), grid)):
        assert {surface.name for surface in each.outside.surfaces} == {"body", "outer", "span"}
    # What was joined before remains so.
    x[plain.offsets[1] - 1] += 0.1
    torn = CellFields.of(plain.moved(x), plain)
    np.testing.assert_array_equal(torn.topology.partner, fields.topology.partner)
    collapsed = CellFields.of(prisms())
    assert not collapsed.bad(1, collapsed.whole(1)).any()
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
    x[:3] += [[3.0, 0.0, 4.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1e-15]]
    x[one.offsets[2] + 1] -= [0.0, 7.0, 0.0]
    found, sizes = compare_points(one, one.moved(x)), np.diff(one.offsets)
    assert (found.largest, found.where, found.differing_nodes, found.nodes) == (7.0, "block3 (1, 2, 1)", 4, one.n_nodes)
    assert found.rms == pytest.approx(np.sqrt(78.0 / one.n_nodes))
    parts = zip(("block1", "block2", "block3"), (5.0, 0.0, 7.0), (29.0, 0.0, 49.0), sizes[:3], strict=True)
    rms = [BlockDifference(name, most, pytest.approx((square / n) ** 0.5)) for name, most, square, n in parts]
    assert found.blocks[:3] == tuple(rms)
    fewer = Grid.from_blocks([one.block(n) for n in range(7)])
    other = Grid.from_blocks([one.block(n).transpose(1, 0, 2, 3) for n in range(8)])
    for grid, message in (
        (fewer, "the first grid has 8 blocks, the second grid has 7"),
        (other, "block2 of the first grid has 3 x 4 x 1 nodes, block 2 of the second grid has 4 x 3 x 1"),
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


def turned_halves(shape: tuple[int, int, int], seed: int):
    """A wild block, cut in two along i, before and after a motion, and the two grids, whose indices run otherwise."""
    random = np.random.default_rng(seed)
    wild = 0.2 * (np.array(shape) > 1)
    before = np.stack(np.indices(shape), axis=-1) + wild * random.uniform(-1.0, 1.0, (*shape, 3))
    after = before + wild * random.uniform(-1.0, 1.0, (*shape, 3))
    turns = [ORIENTATIONS[n] for n in random.integers(48, size=2)]
    # A line that has no length before the interface does not jump.
    after[-5, -1, 0] = after[-4, -1, 0]
    halves = [[x[:-3], x[-4:]] for x in (before, after)]
    grids = [Grid.from_blocks([turn_block(x, *turn) for x, turn in zip(parts, turns, strict=True)]) for parts in halves]
    return *halves, *grids, turns


def widest(values: np.ndarray) -> np.ndarray:
    """Of values at the nodes of a side, at each face that of the largest magnitude at its corners."""
    for axis in (0, 1):
        if values.shape[axis] > 1:
            low, high = (np.take(values, np.arange(values.shape[axis] - 1) + shift, axis) for shift in (0, 1))
            values = np.where(np.abs(low) > np.abs(high), low, high)
    return values


def lines_off(x: np.ndarray, axis: int) -> np.ndarray:
    """Angle to the wall normal, height and thickness of the first layers (n, m, 3) of the grid lines off the first
    nodes of a block along an axis; in a plane normal to z (n, 1, 3)."""
    x = np.moveaxis(x, axis, 0)
    arm, normal = x[1] - x[0], np.zeros_like(x[0])
    for a, b in np.ndindex(x.shape[1] - 1, max(x.shape[2] - 1, 1)):
        corners = x[0, a : a + 2, b : b + 2]
        along = corners[1, -1] - corners[0, 0]
        area = np.cross(along, corners[0, -1] - corners[1, 0] if x.shape[2] > 1 else [0.0, 0.0, 1.0])
        normal[a : a + 2, b : b + 2] += area / np.linalg.norm(area) * np.sign(area @ arm[a, b])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    height, deep = ((normal * each).sum(axis=-1) for each in (arm, x[min(max((len(x) - 1) // 2, 1), 8)] - x[0]))
    angle = np.rad2deg(np.arccos(height / np.linalg.norm(arm, axis=-1)))
    return np.stack([angle, height, deep], axis=-1)


WILD = pytest.mark.parametrize(("shape", "seed"), [((24, 4, 5), 0), ((8, 3, 4), 1), ((7, 4, 1), 2), ((8, 4, 1), 3)])


def spread(values: np.ndarray) -> Spread:
    return Spread(pytest.approx(np.sqrt(np.mean(values**2))), pytest.approx(np.abs(values).max()))


def assert_cells(fields: CellFields, measure: str, turns, expected: list[np.ndarray]) -> None:
    for block, values in enumerate(expected):
        found = fields.values(measure, block, fields.whole(block))[..., None]
        np.testing.assert_allclose(turn_back(found, *turns[block])[..., 0], values, rtol=1e-9)


@WILD
def test_lines_across_interfaces_by_their_definitions(shape, seed):
    before, after, grid, moved, turns = turned_halves(shape, seed)

    def kink_and_jump(parts):
        u, v = parts[0][-1] - parts[0][-2], parts[1][1] - parts[1][0]
        one, two = (np.linalg.norm(each, axis=-1) for each in (u, v))
        angle = np.rad2deg(np.arctan2(np.linalg.norm(np.cross(u, v), axis=-1), (u * v).sum(axis=-1)))
        return np.array([angle, np.log(np.where(one > 0.0, two / np.maximum(one, 1e-9), 1.0))])

    topology = find_topology(grid)
    report, fields = assess(Original(grid, topology), moved.points, None), CellFields(moved, topology, grid)
    alone = assess(Original(grid, topology), grid.points, None).after, CellFields(grid, topology)
    then = kink_and_jump(before)
    for quality, where, values, parts in (
        (report.after, fields, kink_and_jump(after) - then, after), (*alone, then, before),
    ):  # fmt: skip
        for name, each in zip(("interface_kink_deg", "interface_spacing_jump"), values, strict=True):
            assert getattr(quality, name) == spread(each)
            expected = [np.full([max(n - 1, 1) for n in part.shape[:3]], np.nan) for part in parts]
            expected[0][-1] = expected[1][0] = np.abs(widest(each))
            assert_cells(where, name, turns, expected)
            worst, most = quality.worst[name], np.abs(each).max()
            assert (worst.value, worst.block) == (pytest.approx(most), "block1")
            assert worst.center in [pytest.approx(x) for x in cell_means(parts[0])[-1][expected[0][-1] == most]]


@WILD
def test_lines_off_walls_by_their_definitions(shape, seed):
    """The first nodes along i and j are walls; of the longest block those along i only, whose lines have most cells."""
    before, after, grid, moved, turns = turned_halves(shape, seed)
    walls = [(0, 0), (0, 1), (1, 1)][: 1 if shape[0] > 20 else 3]
    select = [f"block{part + 1}.{Side(2 * axes.index(axis) + flips[axes.index(axis)]).label}"
              for part, axis in walls for axes, flips in [turns[part]]]  # fmt: skip
    topology = find_topology(grid)
    boundary = classify(grid, topology, (BoundarySpec("wall", tuple(select), Kind.MOVING, None, STILL),), {})
    lines = [[lines_off(parts[part], axis) for part, axis in walls] for parts in (before, after)]
    old, new = (np.concatenate([each.reshape(-1, 3) for each in found]) for found in lines)
    quality = assess(Original(grid, topology), moved.points, boundary)
    for found, each in ((quality.before.walls["moving"], old), (quality.after.walls["moving"], new)):
        assert found.wall_normal_deviation_deg == spread(each[:, 0])
        ranges = [Range(pytest.approx(ratio.min()), pytest.approx(ratio.max())) for ratio in (each / old).T[1:]]
        assert [found.first_cell_height_ratio, found.layer_thickness_ratio] == ranges
    listed, ratios = {"wall_normal_deviation_deg": (max, lines[1], 0)}, [b / a for a, b in zip(*lines, strict=True)]
    for column, name in enumerate(("first_cell_height_ratio", "layer_thickness_ratio"), 1):
        listed |= {f"{name}_min": (min, ratios, column), f"{name}_max": (max, ratios, column)}
    worst = quality.after.walls["moving"].worst
    assert worst.keys() == listed.keys()
    ratio = found.first_cell_height_ratio
    assert quality.change["first_cell_height_ratio"] == {"min": ratio.min - 1.0, "max": ratio.max - 1.0}
    assert "worst" not in str(quality.change)
    for name, (find, values, column) in listed.items():
        at_lines, centers = [each[..., column] for each in values], []
        most = find(find(each.ravel()) for each in at_lines)
        for (part, axis), each in zip(walls, at_lines, strict=True):
            centers += [*cell_means(np.moveaxis(after[part], axis, 0))[0][widest(1 * (each == most)) > 0]]
        assert worst[name].value == pytest.approx(most)
        assert worst[name].center in [pytest.approx(center) for center in centers]
        assert quality.after.worst.get(name) == (None if name.startswith("layer") else worst[name])
    fields = CellFields(moved, topology, grid, np.flatnonzero(boundary.quad_kind == Kind.MOVING))
    shapes = [[max(n - 1, 1) for n in part.shape[:3]] for part in before]
    for number, name in enumerate(("wall_normal_deviation_deg", "first_cell_height_ratio")):
        expected = [np.full(size, np.nan) for size in shapes]
        for (part, axis), then, now in zip(walls, *lines, strict=True):
            some = widest(np.log(now[..., 1] / then[..., 1]) if number else now[..., 0])
            cells = np.moveaxis(expected[part], axis, 0)[0]
            cells[...] = np.where(np.abs(cells) > np.abs(some), cells, some)
        assert_cells(fields, name, turns, [np.exp(each) if number else each for each in expected])
