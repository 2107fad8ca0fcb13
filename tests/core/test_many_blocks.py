"""Grids of hundreds of blocks: searches against plain loops over all pairs, and work that does not grow faster."""

from __future__ import annotations

import itertools
import json
import sys
from collections.abc import Callable

import grids
import numpy as np
import pytest
from cases import body_specs, problem_of, turning
from hypothesis import given, settings
from hypothesis import strategies as st
from random_grids import turn_block

from meshdeform_core.deform import Case, deform
from meshdeform_core.grid import Grid, IntArray, Side, Window
from meshdeform_core.grid import windows as windows_module
from meshdeform_core.grid.connectivity.declared import check_connections, connected_nodes
from meshdeform_core.grid.connectivity.interfaces import find_interfaces
from meshdeform_core.grid.connectivity.openings import find_openings
from meshdeform_core.grid.extent import Bounds, block_extents
from meshdeform_core.grid.faces.pieces import find_faces
from meshdeform_core.grid.faces.surfaces import find_outside
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.sides import side_numbers
from meshdeform_core.grid.topology import find_topology, quads_of_windows, side_nodes
from meshdeform_core.grid.topology.handedness import block_handedness
from meshdeform_core.grid.windows import rectangles
from meshdeform_core.methods.transfinite.edge_graph import PreparedEdgeGraph, _face_parts, _Rows, _segments
from meshdeform_core.numerics.arrays import batches, medians, runs, spans, spread
from meshdeform_core.numerics.geometry.boxes import overlapping_boxes
from meshdeform_core.quality import lines as lines_module
from meshdeform_core.quality import original
from meshdeform_core.quality.cells import block_volumes
from meshdeform_core.quality.lines import interface_lines, kink_and_jump
from meshdeform_core.quality.walls import interface_cells
from meshdeform_formats.picture.overview import Pair
from meshdeform_formats.text import json_text


def lattice(counts: tuple[int, int, int], nodes: int = 3, turned: bool = False, gap: float = 0.0) -> Grid:
    """A bent box cut into blocks with ``nodes`` along each index; ``turned``: their indices run in all directions."""
    orientations = itertools.cycle(
        itertools.product(itertools.permutations(range(3)), [(False, True, False), (True, False, False)])
    )
    blocks = []
    for place in np.ndindex(*counts):
        lines = [(1 + gap) * at + np.linspace(0.0, 1.0, nodes) for at in place]
        x = grids.block_around(*lines)
        x[..., 2] += 0.1 * np.sin(x[..., 0]) * np.cos(x[..., 1])
        blocks.append(turn_block(x, *next(orientations)) if turned else x)
    return Grid.from_blocks(blocks)


GRIDS = {
    "lattice": lambda: lattice((3, 3, 2)),
    "turned": lambda: lattice((3, 2, 3), turned=True),
    "frame": grids.frame,
    "plane": grids.frame_2d,
    "seam": grids.polar,
    "turned plane": lambda: grids.permuted(grids.frame_2d(), (2, 0, 1), (True, False, True)),
}


@pytest.fixture(params=GRIDS)
def grid(request) -> Grid:
    return GRIDS[request.param]()


@settings(deadline=None, max_examples=40)
@given(st.integers(0, 2**32 - 1))
def test_overlapping_boxes_are_those_of_all_pairs(seed):
    random = np.random.default_rng(seed)
    sets = []
    for count in random.integers(1, 60, 2):
        # Sizes over many orders of magnitude, flat and single points among them; some share their bounds exactly.
        size = 10.0 ** random.uniform(-7, 0, (count, 1)) * random.choice([0.0, 0.3, 1.0], (count, 3))
        low = np.round(random.uniform(-1, 1, (count, 3)), random.integers(1, 4))
        sets.append((low, low + size))
    one, two = sets
    hit = ((one[0][:, None] <= two[1]) & (two[0] <= one[1][:, None])).all(axis=2)
    np.testing.assert_array_equal(overlapping_boxes(one, two), np.argwhere(hit))


def test_no_boxes_overlap_none():
    none, some = np.empty((0, 3)), np.zeros((2, 3))
    assert overlapping_boxes((none, none), (some, some)).shape == (0, 2)
    assert overlapping_boxes((some, some), (none, none)).shape == (0, 2)


def windows_of_quads(shape, block, side, quads):
    """Row by row: runs of marked quads, continued while the next row has the same run."""
    a, b = side.tangential
    found, begun = [], {}
    for row in range(quads.shape[0] + 1):
        marked = [*quads[row], False] if row < quads.shape[0] else [False]
        edges = np.flatnonzero(np.diff([False, *marked]))
        runs = set(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
        for run in begun.keys() - runs:
            found.append((*run, begun.pop(run), row))
        for run in runs - begun.keys():
            begun[run] = row
    more_a, more_b = int(shape[a] > 1), int(shape[b] > 1)
    return [
        Window(block, side, (first, start), (last - 1 + more_a, stop - 1 + more_b))
        for start, stop, first, last in sorted(found)
    ]


@pytest.mark.parametrize("seed", range(3))
def test_rectangles_are_the_windows_of_every_side(grid, seed):
    faces = find_topology(grid).quads
    label = np.random.default_rng(seed).integers(-1, 3, len(faces.corners))
    expected = []
    for side in range(6 * grid.n_blocks):
        span = faces.of_side(side // 6, side % 6)
        for each in np.unique(label[span][label[span] >= 0]):
            marked = (label[span] == each).reshape(faces.counts[side // 6, side % 6])
            expected += windows_of_quads(grid.shapes[side // 6], side // 6, Side(side % 6), marked)
    found = rectangles(grid, faces, label)
    assert found.windows() == expected
    assert np.array_equal(np.sort(found.quads), np.flatnonzero(label >= 0))
    for number in range(len(found)):
        assert (label[found.quads_of(number)] == found.label[number]).all()
        assert (faces.block_side[found.quads_of(number)] == found.side[number]).all()


def test_quads_of_windows_are_those_between_its_nodes(grid):
    faces = find_topology(grid).quads
    label = np.random.default_rng(1).integers(-1, 3, len(faces.corners))
    pieces = rectangles(grid, faces, label)
    found, number = quads_of_windows(faces, pieces.windows())
    np.testing.assert_array_equal(found, pieces.quads)
    np.testing.assert_array_equal(number, np.repeat(np.arange(len(pieces)), np.diff(pieces.start)))
    assert quads_of_windows(faces, [])[0].shape == (0,)


def test_rectangles_of_interfaces_are_those_found_face_by_face(grid):
    topology = find_topology(grid)
    reached = np.random.default_rng(2).random(topology.n_unique) < 0.3
    parts, width, wanted = _face_parts(grid, topology, reached)
    done, expected = reached.copy(), []
    for block, side in itertools.product(range(grid.n_blocks), Side) if grid.dimension == 3 else ():
        quads, numbers = topology.quads.of_side(block, side), side_numbers(grid, topology, block, side)
        partner = topology.partner[quads]
        neighbour = np.where(partner >= 0, topology.quads.block_side[partner], partner)
        for label in np.unique(neighbour):
            marked = (neighbour == label).reshape(topology.quads.counts[block, side])
            for window in windows_of_quads(grid.shapes[block], block, side, marked):
                nodes = numbers[window.low[0] : window.high[0] + 1, window.low[1] : window.high[1] + 1]
                if not done[nodes].all():
                    expected.append((nodes, ~done[nodes]))
                    done[nodes] = True
    assert len(parts) == len(width) == len(expected)
    for number, (nodes, own) in enumerate(expected):
        some = slice(parts.start[number], parts.start[number + 1])
        assert width[number] == nodes.shape[1]
        np.testing.assert_array_equal(parts.nodes[some], nodes.ravel())
        np.testing.assert_array_equal(wanted[some], own.ravel())


def test_segments_of_lines_are_those_found_one_by_one():
    random = np.random.default_rng(3)
    points = random.random((30, 3))
    points[7] = points[8]
    lines = [random.permutation(30)[: random.integers(2, 9)] for _ in range(12)]
    lines += [lines[0][::-1], lines[1], np.array([7, 8])]
    knot = random.random(30) < 0.5
    knot[[line[end] for line in lines for end in (0, -1)]] = True
    known = knot & (random.random(30) < 0.4)
    expected = {}
    for line in lines:
        at = np.flatnonzero(knot[line])
        for first, last in itertools.pairwise(at.tolist()):
            nodes = line[first : last + 1]
            length = np.linalg.norm(np.diff(points[nodes], axis=0), axis=1).sum()
            if length > 0 and (last - first > 1 or not known[nodes[[0, -1]]].all()):
                key = frozenset(nodes[[0, -1]].tolist()), nodes[1:-1].min(initial=30)
                expected.setdefault(key, (nodes, length))
    rows = _Rows.of(np.array([len(line) for line in lines]), np.concatenate(lines))
    found = _segments(points, rows, np.zeros(len(lines), dtype=np.int64), knot, known)
    nodes, length = zip(*expected.values(), strict=True)
    np.testing.assert_array_equal(found.rows.nodes, np.concatenate(nodes))
    np.testing.assert_array_equal(np.diff(found.rows.start), [len(each) for each in nodes])
    np.testing.assert_allclose(found.length, length, rtol=1e-14)


def test_interfaces_cover_every_shared_quad_once(grid):
    topology = find_topology(grid)
    connections = find_interfaces(grid, topology)
    count = 0
    for connection in connections:
        own, donor = connected_nodes(grid, connection)
        np.testing.assert_array_equal(topology.numbers_of(own), topology.numbers_of(donor))
        cells = np.abs(np.array(connection.end) - connection.begin)
        count += int(np.prod(cells[cells > 0]))
    assert count == np.count_nonzero(topology.partner >= 0) // 2 > 0
    assert len({(c.block, c.begin, c.end, c.donor_block) for c in connections}) == len(connections)


def test_declared_connections_agree_with_the_coordinates(grid):
    topology = find_topology(grid)
    connections = find_interfaces(grid, topology)
    whole = Grid(grid.points, grid.shapes, grid.names, connections=connections)
    assert check_connections(whole, topology) == []
    moved = grid.points.copy()
    own, _ = connected_nodes(grid, connections[0])
    moved[own[0]] += 0.4 * topology.edge.min()
    other = Grid(moved, grid.shapes, grid.names, connections=connections)
    told = check_connections(other, find_topology(other))
    assert any("node pairs do not coincide" in text and repr(connections[0].name) in text for text in told)


def test_handedness_by_the_volume_of_every_cell(grid):
    if grid.dimension == 2:
        pytest.skip("a plane has no volume")
    for block, hand in enumerate(block_handedness(grid)):
        i, j, k = (np.diff(grid.block(block), axis=axis) for axis in range(3))
        n = tuple(size - 1 for size in grid.shapes[block])
        edges = [each[: n[0], : n[1], : n[2]] for each in (i, j, k)]
        assert np.sign(np.einsum("ijkx,ijkx->", edges[0], np.cross(edges[1], edges[2]))) == hand


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(1, 60), min_size=1, max_size=6), st.integers(1, 20), st.integers(0, 9))
def test_places_are_spread_like_linspace(sizes, most, first):
    run, place = spread(np.array(sizes), most, np.full(len(sizes), first))
    expected = [np.linspace(first, first + n - 1, min(n, most)).astype(int) for n in sizes]
    np.testing.assert_array_equal(place, np.concatenate(expected))
    np.testing.assert_array_equal(run, np.repeat(np.arange(len(sizes)), [len(each) for each in expected]))


@settings(deadline=None, max_examples=40)
@given(st.lists(st.integers(0, 9), min_size=1, max_size=8), st.integers(0, 2**32 - 1))
def test_medians_of_runs(sizes, seed):
    run, place = spans(np.array(sizes))
    assert place.tolist() == [n for size in sizes for n in range(size)]
    values = np.random.default_rng(seed).normal(size=len(run))
    expected = [np.median(values[run == number]) if size else -1.0 for number, size in enumerate(sizes)]
    np.testing.assert_array_equal(medians(values, run, len(sizes), -1.0), expected)


def test_batches_hold_everything_in_order():
    sizes = np.array([3, 9, 1, 1, 1, 0, 2])
    assert batches(sizes, 4) == [(0, 1), (1, 2), (2, 6), (6, 7)]
    assert batches(sizes[:0], 4) == []
    first, last = runs(np.array([2, 2, 5, 5, 5, 7]))
    assert (first.tolist(), last.tolist()) == ([0, 2, 5], [2, 5, 6])


def test_bounds_by_all_nodes(grid):
    bounds, random = Bounds(grid), np.random.default_rng(1)
    low, high = block_extents(grid)
    for block in range(grid.n_blocks):
        x = grid.block(block).reshape(-1, 3)
        assert (low[block] == x.min(axis=0)).all()
        assert (high[block] == x.max(axis=0)).all()
    for _ in range(50):
        normal = random.normal(size=3)
        normal /= np.linalg.norm(normal)
        farthest = float((grid.points @ normal).max())
        assert bounds.within(normal, farthest + 1e-6)
        assert not bounds.within(normal, farthest - 1e-6)


def test_lines_across_interfaces_meet_and_leave_into_both_blocks(grid):
    topology = find_topology(grid)
    lines = interface_lines(grid, topology)
    np.testing.assert_array_equal(topology.numbers_of(lines.here), topology.numbers_of(lines.there))
    for near, far in ((lines.here, lines.before), (lines.there, lines.beyond)):
        block = np.searchsorted(grid.offsets, near, side="right")
        np.testing.assert_array_equal(block, np.searchsorted(grid.offsets, far, side="right"))
        assert not np.isin(far, near).all()


@pytest.mark.parametrize("portion", [1, 5])
def test_lines_and_pieces_do_not_depend_on_how_much_is_done_at_a_time(grid, portion, monkeypatch):
    topology = find_topology(grid)
    lines = interface_lines(grid, topology)
    label = np.where(topology.partner >= 0, 1, 0)
    expected = [vars(lines), vars(rectangles(grid, topology.quads, label))]
    measured = kink_and_jump(lines, grid.points)
    monkeypatch.setattr(lines_module, "_TOGETHER", portion)
    monkeypatch.setattr(windows_module, "_TOGETHER", portion)
    found = [vars(interface_lines(grid, topology)), vars(rectangles(grid, topology.quads, label))]
    for one, two in zip(found, expected, strict=True):
        for name in two:
            np.testing.assert_array_equal(one[name], two[name])
    np.testing.assert_array_equal(kink_and_jump(lines, grid.points), measured)


def test_lines_are_told_apart_by_numbers_of_any_size():
    random = np.random.default_rng(8)
    pairs = random.choice([0, 1, 2**31, 2**32 + 1, 6 * 10**9, 2**62], (2, 60))
    found = lines_module._distinct(pairs)
    columns = list(map(tuple, pairs.T.tolist()))
    assert [columns[n] for n in found] == sorted(set(columns))
    assert all(columns.index(columns[n]) == n for n in found)
    assert lines_module._distinct(pairs[:, :0]).size == 0


def test_cells_beside_interfaces(grid):
    topology = find_topology(grid)
    kink, jump = interface_cells(grid, topology, grid.points, None)
    expected = np.zeros(grid.n_cells, dtype=bool)
    start = 0
    for block, shape in enumerate(grid.cell_shapes):
        mine = expected[start : start + int(np.prod(shape))].reshape(shape)
        for side in range(6):
            shared = topology.partner[topology.quads.of_side(block, side)] >= 0
            if shared.size:
                layer = np.moveaxis(mine, side // 2, 0)[-1 if side % 2 else 0]
                layer |= shared.reshape(layer.shape)
        start += mine.size
    np.testing.assert_array_equal(~np.isnan(kink), expected)
    np.testing.assert_array_equal(~np.isnan(jump), expected)


def test_all_sides_have_their_nodes(grid):
    for number in range(6 * grid.n_blocks):
        expected = side_nodes(grid, number // 6, Side(number % 6))
        _, _, _, flat = grid.sides.all_nodes(np.array([number]))
        np.testing.assert_array_equal(flat, expected.ravel())


def calls(work: Callable[[], object]) -> int:
    """Functions, of Python and compiled, that ``work`` calls."""
    count = 0

    def tick(frame: object, event: str, argument: object) -> None:
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(tick)
    try:
        work()
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize(
    ("work", "per_block"),
    [
        (lambda grid, topology: find_topology(grid), 6.0),
        (lambda grid, topology: find_openings(grid, topology), 6.0),
        (lambda grid, topology: find_interfaces(grid, topology), 30.0),
        (lambda grid, topology: find_faces(grid, topology), 60.0),
        (lambda grid, topology: find_outside(grid, topology), 200.0),
        (lambda grid, topology: select_quads(grid, topology, ["*.jmin", "*.?max"], "all"), 60.0),
        (lambda grid, topology: PreparedEdgeGraph(problem_of(grid, [])), 120.0),
        (lambda grid, topology: block_volumes(grid, grid.points, topology.handedness), 1.0),
        (lambda grid, topology: interface_lines(grid, topology), 2.0),
        (lambda grid, topology: interface_cells(grid, topology, grid.points, None), 4.0),
    ],
    ids=["topology", "openings", "interfaces", "faces", "outside", "selection", "edges", "volumes", "lines", "cells"],
)
def test_calls_per_block_do_not_grow(work, per_block):
    few, many = lattice((3, 3, 3)), lattice((6, 6, 6))
    counts = []
    for grid in (few, many):
        topology = find_topology(grid)
        work(grid, topology)
        counts.append(calls(lambda grid=grid, topology=topology: work(grid, topology)))
    more = counts[1] - counts[0]
    assert more / (many.n_blocks - few.n_blocks) < per_block
    assert counts[1] < 1.2 * counts[0] * many.n_blocks / few.n_blocks


def test_faces_are_found_once(monkeypatch):
    """Both the repair and the measures of walls need their roles, as do pictures and fields."""
    found: list[Grid] = []
    monkeypatch.setattr(original, "find_outside", lambda *given: found.append(given[0]) or find_outside(*given))
    result = deform(grids.frame(), Case(body_specs(turning(20))))
    assert result.repair is None
    assert Pair(result.setup.grid, result.grid, result.setup.topology, original=result.setup.original).new.outside
    assert len(found) == 1


def test_sides_of_separate_blocks_are_not_compared_with_all_others():
    grid = lattice((7, 7, 5), gap=0.3)
    topology = find_topology(grid)
    assert topology.external.all()
    compared: list[IntArray] = []
    original = overlapping_boxes
    module = sys.modules["meshdeform_core.grid.connectivity.openings"]
    module.overlapping_boxes = lambda *sets: compared.append(original(*sets)) or compared[-1]
    try:
        assert find_openings(grid, topology) == ()
    finally:
        module.overlapping_boxes = original
    # Each side has the four beside it on its own block, and itself.
    assert 0 < sum(map(len, compared)) <= 5 * 6 * grid.n_blocks


def test_long_lists_of_a_report_have_an_entry_per_line():
    record = {
        "few": [{"a": 1.5}, {"b": [2]}],
        "many": [{"n": n, "text": "line\nbreak"} for n in range(150)],
        "none": None,
    }
    text = json_text(record)
    assert json.loads(text) == record
    assert json_text({"few": record["few"], "none": None}) == json.dumps({"few": record["few"], "none": None}, indent=2)
    assert text.count("\n") == len(json.dumps({"few": record["few"]}, indent=2).splitlines()) + 152
    with pytest.raises(ValueError, match="JSON"):
        json_text({"x": [float("nan")] * 101}, allow_nan=False)
    assert json_text({}) == "{}"


def test_connections_of_so_many_blocks_that_pairs_of_sides_exceed_32_bits():
    n = 23
    place = np.random.default_rng(1).permutation(n**3)
    at = np.stack(np.unravel_index(place, (n, n, n)), axis=1)
    unit = np.stack(np.meshgrid(*[np.arange(2.0)] * 3, indexing="ij"), axis=-1)
    grid = Grid.from_blocks([unit + corner for corner in at])
    found = find_interfaces(grid, find_topology(grid))
    pairs = np.array([(c.block, c.donor_block) for c in found])
    step = at[pairs[:, 1]] - at[pairs[:, 0]]
    assert len(np.unique(pairs, axis=0)) == len(found) == 3 * n * n * (n - 1)
    assert (np.abs(step).sum(axis=1) == 1).all()
    assert (np.diff(pairs[:, 0]) >= 0).all()
    for connection, axis in zip(found, (2 * np.abs(step).argmax(axis=1) + step.max(axis=1)).tolist(), strict=True):
        own, donor = Side(axis), Side(axis ^ 1)
        names = f"{grid.names[connection.block]}.{own.label}", f"{grid.names[connection.donor_block]}.{donor.label}"
        assert connection.name == "-".join(names)
