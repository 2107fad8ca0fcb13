"""Tables that do not fit their walls are refused or warned of; splines pass through the table's own points."""

import dataclasses
import re

import numpy as np
import pytest
from cases import body_specs
from grids import block_around, frame, frame_2d, with_walls
from scipy.interpolate import RBFInterpolator

from meshdeform_core.boundary import Boundary, BoundarySpec, Kind, tables
from meshdeform_core.boundary.constraints import triangles_of
from meshdeform_core.boundary.fitting import fit_table
from meshdeform_core.boundary.motions.motion import Follow, Motion
from meshdeform_core.boundary.tables import AUTOMATIC, BoundaryNodes, Matching, SurfaceData, other_frame
from meshdeform_core.deform import Case, set_up
from meshdeform_core.errors import MotionError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.numerics.geometry.local_spline import local_spline
from meshdeform_core.wording import vector
from meshdeform_samples import generate

FRAME = frame(cells=6, layers=6)
NO_TRIANGLES = np.empty((0, 3), np.int64)
SHIFT = np.array([0.02, 0.01, 0.0])


def bar() -> np.ndarray:
    """Nodes of the bar, each once."""
    points = FRAME.points
    return np.unique(points[np.abs(points[:, :2]).max(axis=1) < 0.51], axis=0)


def data(points: np.ndarray, displacement: np.ndarray | None = None) -> SurfaceData:
    moved = np.tile(SHIFT, (len(points), 1)) if displacement is None else displacement
    return SurfaceData(np.ascontiguousarray(points), moved, NO_TRIANGLES, "table.csv")


def ring(low: float, high: float) -> SurfaceData:
    """The corners of the bar at two heights, with the faces between them."""
    around = (-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)
    quads = np.array([(n, (n + 1) % 4, (n + 1) % 4 + 4, n + 4) for n in range(4)])
    points = np.array([(x, y, z) for z in (low, high) for x, y in around])
    return dataclasses.replace(data(points), triangles=triangles_of(quads))


def whole_table(table: SurfaceData, grid: Grid = FRAME, **matching) -> Boundary:
    """The boundary when the table says alone what moves, as -d does."""
    motion = Motion((Follow(table, Matching(partial=True, **matching)),), {})
    entries = (BoundarySpec("table.csv", ("*",), Kind.MOVING, None, motion), BoundarySpec("rest", ("*",), Kind.SLIP))
    return set_up(grid, Case(entries)).boundary


def on_body(table: SurfaceData, **matching) -> tuple[str, ...]:
    """Warnings when the bar follows the table."""
    specs = body_specs(Motion((Follow(table, Matching(**matching)),), {}))
    return set_up(FRAME, Case((*specs, BoundarySpec("rest", ("*",), Kind.SLIP)))).boundary.notes


def test_a_table_of_the_wall_gives_no_warning():
    assert whole_table(data(bar())).notes == ()
    for how in ("exact", "nearest", "interpolate"):
        assert on_body(data(bar()), how=how) == ()


@pytest.mark.parametrize("far", [1e160, 1e300])
def test_points_farther_than_any_length_are_refused(far):
    """Squares of distances overflow: the nearest node has no number."""
    with pytest.raises(MotionError, match=r"table.csv has coordinates of 1e\+.* expected lengths below 1e\+100"):
        data(np.concatenate([bar(), [[far, 0.0, 0.0]]]))
    with pytest.raises(MotionError, match=r"table.csv has displacements of 1e\+.* expected lengths below 1e\+100"):
        data(bar(), far * bar())


def test_a_table_without_dz_on_a_3d_grid_is_a_warning():
    plane = dataclasses.replace(data(bar()), plane=True)
    (note,) = on_body(plane)
    assert note.startswith("table.csv has two components of the displacement, the grid is three-dimensional")
    section = frame_2d()
    square = np.unique(section.points[np.abs(section.points[:, :2]).max(axis=1) < 0.51], axis=0)
    assert whole_table(dataclasses.replace(data(square), plane=True), section).notes == ()


def test_a_table_a_thousand_times_larger_is_refused_where_it_covers_the_wall():
    """A plate in m and its table in mm, both from the origin: every node lies on the table."""
    x = np.linspace(0.0, 2.0, 9)
    grid = Grid.from_blocks([block_around(x, x, np.linspace(0, 1, 5))])
    plate = data(block_around(1e3 * x[::2], 1e3 * x[::2], np.zeros(1)).reshape(-1, 3))
    motion = Motion((Follow(plate, Matching("interpolate", tolerance=1e4)),), {})
    with pytest.raises(MotionError, match=r"table.csv: 24 of 25 table points.*multiplied by 0.001"):
        set_up(grid, Case((BoundarySpec("plate", ("block1.kmin",), Kind.MOVING, None, motion),)))


@pytest.mark.parametrize(("how", "gap"), [("nearest", 1e-13), *(("interpolate", gap) for gap in (1e-13, 1e-9, 1e-7))])
def test_two_displacements_at_practically_one_place_are_refused(how, gap):
    points = bar()
    twice = np.concatenate([points, points[[2, 5]] + gap])
    moved = np.tile(SHIFT, (len(twice), 1))
    moved[-1] += max(gap, 1e-8)
    assert on_body(data(twice, moved), how=how) == ()
    moved[-1] = 2 * SHIFT
    places = f"table.csv has the points {vector(points[5])} and {vector(twice[-1])}, {np.sqrt(3) * gap:.2g} apart, with"
    count = "1 such point" if how == "nearest" else "2 such points"
    moves = f"the displacements (0.02, 0.01, 0) and (0.04, 0.02, 0) ({count}); expected one displacement at one place"
    with pytest.raises(MotionError, match=re.escape(f"{places} {moves}")):
        on_body(data(twice, moved), how=how)


def test_a_coarser_surface_is_refused():
    points = bar()
    heights = np.unique(points[:, 2])
    with pytest.raises(MotionError, match=r"112 of the 112 nodes .* belong to no face that moves as a whole"):
        whole_table(data(points[np.isin(points[:, 2], heights[::2])]))


def test_half_of_the_wall_ends_abruptly():
    points, inside = bar(), bar()[:, 2] < 0.6
    boundary = whole_table(data(points[inside], ((1.0 + points[:, :1]) * SHIFT)[inside]))
    np.testing.assert_array_equal(boundary.patches[0].nodes, np.sort(boundary.movers[0][0]))
    (note,) = boundary.notes
    assert "abruptly at 28 faces of a smooth wall, where nodes that move by up to 0.0335 (at block7 (1, 2, 4))" in note
    fading = np.maximum(0.0, 0.5 - points[:, 2:]) * SHIFT
    for matching in ({}, {"how": "interpolate", "tolerance": 0.1}):
        assert whole_table(data(points[inside], fading[inside]), **matching).notes == ()


def test_the_farthest_of_the_nodes_without_a_match_is_named():
    """Matched are nodes within a tenth of the diagonal of the table, which is shorter than that of the wall."""
    message = (
        "table.csv: 84 of 196 selected nodes have no match (interpolate); the farthest is block1 (7, 7, 7) = (-0.5, "
        "-0.5, 1), 0.5 away. The table spans [-0.5, 0.5] x [-0.5, 0.5] x [0, 0.5], the nodes [-0.5, 0.5] x [-0.5, 0.5] "
        "x [0, 1]. Set a larger tolerance, or a selection that the table covers"
    )
    with pytest.raises(MotionError, match=f"^{re.escape(message)}$"):
        on_body(data(bar()[bar()[:, 2] < 0.6]), how="interpolate")
    with pytest.raises(MotionError, match=r'lie on the nodes: .* larger tolerance, match = "interpolate", or a'):
        on_body(data(1e3 * bar()))
    with pytest.raises(MotionError, match=r"196 of 196 table points lie on no outside face of .* grid is in metres"):
        whole_table(data(1e3 * bar()))


def test_points_off_the_wall_are_counted():
    points = bar()
    away = np.array([[7.0, 7.0, 7.0], [8.0, 7.0, 7.0]])
    (note,) = whole_table(data(np.concatenate([points, away]))).notes
    assert f"2 of {len(points) + 2} table points lie on no face that the table moves, first (7, 7, 7)" in note


def test_one_table_for_several_entries_is_used_as_a_whole():
    table = data(bar())
    entries = [
        BoundarySpec(name, (face,), Kind.MOVING, None, Motion((Follow(table, Matching()),), {}))
        for name, face in (("a", "block2.imax"), ("b", "block7.imin"), ("c", "block4.jmax"), ("d", "block5.jmin"))
    ]
    assert set_up(FRAME, Case((*entries, BoundarySpec("rest", ("*",), Kind.SLIP)))).boundary.notes == ()


def test_nodes_move_that_all_tables_of_a_motion_match():
    points, topology = bar(), find_topology(FRAME)
    nodes = BoundaryNodes.of_quads(FRAME, topology, select_quads(FRAME, topology, ["block2.imax"], "bar"))
    follow = [Follow(data(some), Matching(partial=True)) for some in (points[points[:, 2] < 0.6], points)]
    np.testing.assert_array_equal(Motion(tuple(follow), {}).prepare(nodes).moved, nodes.points[:, 2] < 0.6)


def test_every_table_of_a_sequence_is_looked_at():
    tables = [data(bar()), data(bar() * [1.0, 1.0, 1.055])]
    follow = Follow(lambda number: tables[number], Matching("nearest", tolerance=0.5), (0.0, 1.0))
    specs = body_specs(Motion((Follow(tables[0], Matching()), follow), {}))
    setup = set_up(FRAME, Case((*specs, BoundarySpec("rest", ("*",), Kind.SLIP))))
    assert setup.boundary.tables.warnings() == []
    setup.displacement(1.0)
    (note,) = setup.boundary.tables.warnings()
    assert "140 of 196 nodes lie up to 0.055 away from the table point whose displacement they take" in note


def test_extrapolation_is_said_with_its_distance():
    points = bar()
    notes = on_body(data(points[points[:, 2] < 0.6]), how="interpolate", tolerance=2.0)
    assert any("lie beyond the table" in note for note in notes)
    table = ring(0.0, 0.5)
    (note,) = on_body(table, how="interpolate", tolerance=2.0)
    assert "by up to 0.5; their displacement is extrapolated" in note
    # Beyond an edge that two triangles share is not beyond the table.
    topology = find_topology(FRAME)
    nodes = BoundaryNodes.of_quads(
        FRAME, topology, select_quads(FRAME, topology, ["block2.imax", "block4.jmax"], "bar")
    )
    smaller = dataclasses.replace(table, points=table.points * [0.6, 0.6, 3.0] - [0.0, 0.0, 1.0])
    beyond, (x, y, z) = tables.transfer(smaller, Matching("interpolate", 2.0), nodes).beyond, nodes.points.T
    some = (np.minimum(np.abs(x), np.abs(y)) < 0.3) | (z < 0.5)
    np.testing.assert_allclose(beyond[some], np.maximum(z - 0.5, 0.0)[some], atol=1e-12)


@pytest.mark.parametrize("flat", [True, False])
def test_splines_pass_through_the_points_and_reproduce_linear_fields(flat):
    rng = np.random.default_rng(3)
    points = rng.random((200, 3))
    points[:, 2] = 0.5 if flat else 0.3 * np.sin(3 * points[:, 0]) + points[:, 1] ** 2
    values = rng.random((200, 3))
    got, distance = local_spline(points, values, points + 0.0)
    np.testing.assert_array_equal(got, values)
    assert (distance == 0).all()
    # A step beside a point is a step beside its value.
    near, _ = local_spline(points, values, points + 1e-9)
    np.testing.assert_allclose(near, values, atol=1e-5)
    targets = points[:50] + 0.01 * rng.random((50, 3)) * [1, 1, not flat]
    matrix = rng.random((3, 3))
    linear, _ = local_spline(points, points @ matrix, targets)
    np.testing.assert_allclose(linear, targets @ matrix, atol=1e-9)


def test_splines_equal_those_of_scipy():
    rng = np.random.default_rng(5)
    points, values, targets = rng.random((60, 3)), rng.random((60, 2)), rng.random((20, 3))
    expected = RBFInterpolator(points, values, neighbors=16, kernel="thin_plate_spline", degree=1)(targets)
    np.testing.assert_allclose(local_spline(points, values, targets)[0], expected, rtol=1e-8, atol=1e-10)

    # Of points on a line or at one place.
    line = np.stack([np.linspace(0, 1, 7), np.zeros(7), np.zeros(7)], axis=1)
    got, _ = local_spline(line, line * [2.0, 0, 0], line[:3] + [0.01, 0.0, 0.0])
    np.testing.assert_allclose(got[:, 0], 2 * (line[:3, 0] + 0.01), atol=1e-9)
    one, _ = local_spline(line[:1], np.ones((1, 3)), line)
    np.testing.assert_array_equal(one, np.ones((7, 3)))


GRID, TABLES = generate("wing", 8)
TOPOLOGY = find_topology(GRID)
NODES = BoundaryNodes.of_quads(GRID, TOPOLOGY, select_quads(GRID, TOPOLOGY, ["wing"], "wing"))
TABLE = TABLES["structure.npz"]

UNITS = {"metres": 1.0, "millimetres": 1e-3, "centimetres": 1e-2, "micrometres": 1e-6, "inches": 0.0254, "feet": 0.3048}
MISTAKES = [*((unit, "metres") for unit in [*UNITS][1:]), *(("metres", unit) for unit in [*UNITS][1:-1])]


@pytest.mark.parametrize(("own", "of_grid"), [*MISTAKES, ("inches", "millimetres"), ("millimetres", "inches")])
def test_the_units_that_fit_are_named(own, of_grid):
    factor, told = UNITS[own] / UNITS[of_grid], f"different length units, in {own} where the grid is in {of_grid}"
    message = f" (multiplied by {factor:.6g}, 100% of its points would lie on the nodes: {told}?)"
    assert other_frame(NODES.points / factor, NODES) == message


def test_nothing_is_proposed_for_points_that_fit_nowhere():
    points = np.random.default_rng(1).uniform(-1.0, 1.0, (200, 3))
    sizes = [np.linalg.norm(np.ptp(x, axis=0)) for x in (points, NODES.points)]
    for ratio in (50.0, 0.02):
        hint = other_frame(ratio * sizes[1] / sizes[0] * points, NODES)
        assert hint == " (sizes differ by a factor 50: different length units?)"
    assert other_frame(points, NODES) == other_frame(NODES.points, NODES) == ""


@pytest.mark.parametrize(
    ("off", "tolerance", "how"), [(0.0, None, "nearest"), (0.01, None, "interpolate"), (0.01, 0.02, "nearest")]
)
def test_a_table_beside_the_nodes_is_of_them_within_the_tolerance(off, tolerance, how):
    (match,) = whole_table(data(bar() + [0.0, 0.0, off]), how=AUTOMATIC, tolerance=tolerance).movers[0][1].matches
    assert (match.how, match.matched.sum()) == (how, len(bar()))
    # Points that several nodes follow count once.
    (match,) = whole_table(data(bar()[::3]), how="nearest", tolerance=0.5).movers[0][1].matches
    assert match.used == (len(bar()[::3]),) * 2


def test_a_table_alone_moves_the_wall_that_it_fits():
    boundary = whole_table(TABLE, GRID, how=AUTOMATIC)
    (match,) = boundary.movers[0][1].matches
    assert (match.matching.walls, match.how) == (("wing",), "interpolate")
    assert set(boundary.movers[0][0]) == set(NODES.numbers)


@pytest.mark.parametrize(
    ("parts", "found"),
    [
        (["body"], "body"), (["body", "span"], "body"), (["body", "outer"], "body"), (["outer", "span"], "outer span"),
        (["outer"], "table.csv: its points lie on 'outer' (far) (multiplied by 0.3"),
        (["*.kmin"], "table.csv: its points lie on 'span' (symmetry); expected"),
    ],
)  # fmt: skip
def test_a_table_moves_walls_rather_than_other_faces(parts, found):
    """As the file declares them; never a symmetry alone."""
    grid = with_walls(FRAME)
    topology = find_topology(grid)
    points = BoundaryNodes.of_quads(grid, topology, select_quads(grid, topology, parts, "")).points
    try:
        names = " ".join(each.name for each in fit_table(grid, topology, data(points), Matching(partial=True)).surfaces)
    except MotionError as error:
        names = str(error)
    assert names.startswith(found)


@pytest.mark.parametrize("thick", [1, 2])
def test_columns_without_names_are_numbers_and_positions_where_they_can_be(thick):
    """In a plane, and in space where there are many, most of which are not the coordinates of nodes."""
    grid = Grid.from_blocks([block_around(np.arange(30.0), np.arange(2.0), np.arange(1.0 * thick))])
    topology = find_topology(grid)
    numbers = np.random.default_rng(1).permutation(topology.n_unique)[:21]
    x = grid.points[topology.first[numbers]]
    moved = x + 0.1 * np.sin(x + 1.0) * [1.0, 1.0, thick - 1.0]
    rows = np.column_stack([numbers, moved[:, : grid.dimension]])

    def read(columns):
        found = np.zeros((len(columns), 6))
        found[:, [0, 1, 3, 4][: columns.shape[1]]] = columns
        table = SurfaceData(found[:, :3], found[:, 3:], NO_TRIANGLES, "t", columns.shape[1] == 4, numbered=True)
        return tables.by_place(table, grid, topology)

    found, at_nodes = read(rows), np.column_stack([np.arange(30), np.zeros((30, 3))])
    np.testing.assert_array_equal(found.points, x)
    np.testing.assert_allclose(found.displacement, moved - x, atol=1e-15)
    coordinates = [np.column_stack([rows, x[:, 0]])], [rows[:20], rows + 0.5, rows[[0, *range(21)]], at_nodes]
    assert all(read(columns).numbered for columns in coordinates[thick - 1])
    with pytest.raises(MotionError, match="this grid is in space" if thick > 1 else "not all in the first are whole"):
        read(rows[:, :3] if thick > 1 else rows + 0.5)


def test_nodes_of_collapsed_faces_are_matched_within_their_edges():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 2, 0]])
    np.testing.assert_array_equal(tables.edges_at_corners(points, np.array([[0, 0, 1, 2]]))[0], [1.0, 1.0, 2.0])


def test_the_shift_of_a_table_of_a_part_of_the_wall_is_told():
    """The middle of the part is not that of the wall, and the far field is among the faces that it may lie on."""
    part = NODES.points[NODES.points[:, 1] > 0.6] + [7.0, -30.0, 2.0]
    with pytest.raises(MotionError, match=r"shifted by \(-7, 30, -2\), 100% of its points would lie on the nodes"):
        whole_table(data(part), GRID, how=AUTOMATIC)


def test_a_coarse_table_moves_all_sides_of_the_wall():
    """Its points lie at the edges of the body, where they are as near to one side as to the next."""
    grid = frame(2, 2)
    nodes = whole_table(ring(0.0, 1.0), grid, how="interpolate").movers[0][0]
    body = np.abs(grid.points[find_topology(grid).first][:, :2]).max(axis=1) < 0.51
    assert set(nodes) >= set(np.flatnonzero(body))


def plate(gap: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of both sides of a plate, staggered, with displacements in opposite directions, and normals."""
    sides = []
    for sign, shift in ((1.0, 0.0), (-1.0, 0.03)):
        x, z = np.meshgrid(np.linspace(-0.02, 1.02, 14) + shift, np.linspace(-0.02, 0.52, 8), indexing="ij")
        points = np.stack([x.ravel(), np.full(x.size, sign * gap / 2), z.ravel()], axis=-1)
        sides.append((points, opening(points[:, 0], sign), np.tile([0.0, -sign, 0.0], (len(points), 1))))
    return tuple(np.concatenate(parts) for parts in zip(*sides, strict=True))


def opening(x: np.ndarray, sign: float) -> np.ndarray:
    return np.stack([0 * x, 0.1 * x**2 + sign * 0.1 * np.sin(np.pi * x), 0 * x], axis=-1)


@pytest.mark.parametrize("gap", [1e-2, 1e-3, 1e-5])
def test_the_sides_of_a_thin_body_are_told_apart(gap):
    points, displacement, normals = plate(gap)
    x, z = np.meshgrid(np.linspace(0.0, 1.0, 11), np.linspace(0.0, 0.5, 6), indexing="ij")
    upper = np.stack([x.ravel(), np.full(x.size, gap / 2), z.ravel()], axis=-1)
    facing = np.tile([0.0, -1.0, 0.0], (len(upper), 1))
    moved, _ = local_spline(points, displacement, upper, normals=(normals, facing))
    assert np.abs(moved - opening(upper[:, 0], 1.0)).max() < 1e-3
    mixed, _ = local_spline(points, displacement, upper)
    assert np.abs(mixed - opening(upper[:, 0], 1.0)).max() > 1e-2
    # Sides that move alike are used together.
    alike = np.outer(0.1 * points[:, 0] ** 2, [0, 1, 0])
    one, both = (local_spline(points, alike, upper, **told)[0] for told in ({"normals": (normals, facing)}, {}))
    assert (one == both).all()
