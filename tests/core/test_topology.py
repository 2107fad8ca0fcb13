"""Coincident nodes and shared faces, whatever the orientation."""

import dataclasses
import itertools
import sys
from collections.abc import Callable

import grids
import numpy as np
import pytest
from cases import problem_of
from grids import block_around, frame, frame_2d, permuted, polar, turn_block, whole_face
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.grid import Connection, Grid, IntArray, Patch, Side
from meshdeform_core.grid import topology as grid_topology
from meshdeform_core.grid.connections import check_connections, connected_nodes, find_interfaces
from meshdeform_core.grid.faces import find_faces, find_outside
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.planes import block_handedness
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import COLLAPSED, find_topology
from meshdeform_core.methods.transfinite.edge_graph import PreparedEdgeGraph
from meshdeform_core.numerics.geometry import coincidence
from meshdeform_core.numerics.geometry.boxes import overlapping_boxes
from meshdeform_core.quality.cells import block_volumes
from meshdeform_core.quality.lines import interface_lines
from meshdeform_core.quality.walls import interface_cells

LINE = np.linspace(0.0, 1.0, 5)


def brick(low=(0, 0, 0), n=(4, 3, 5)):
    return block_around(*(lo + np.linspace(0.0, 1.0, m + 1) for lo, m in zip(low, n, strict=True)))


@pytest.mark.parametrize("axes", list(itertools.permutations(range(3))))
@pytest.mark.parametrize("flips", list(itertools.product((False, True), repeat=3)))
def test_two_blocks_in_all_48_orientations(axes, flips):
    first = brick()
    second = permuted(Grid.from_blocks([brick((1, 0, 0))]), axes, flips).block(0)
    grid = Grid.from_blocks([first, second])
    topology = find_topology(grid)
    assert topology.n_unique == len(topology.face_nodes) - 4 * 6
    assert np.count_nonzero(topology.partner >= 0) == 2 * 3 * 5
    even = np.linalg.det(np.eye(3)[list(axes)]) * (-1) ** sum(flips)
    assert topology.handedness.tolist() == [1, round(even)]
    (connection,) = find_interfaces(grid, topology)
    own, donor = connected_nodes(grid, connection)
    np.testing.assert_array_equal(grid.points[own], grid.points[donor])
    assert len(own) == 4 * 6
    assert check_connections(Grid.from_blocks([first, second], connections=(connection,)), topology) == []


def test_partial_face():
    small = block_around(np.array([1.0, 1.5, 2.0]), LINE[1:4], LINE[:3])
    grid = Grid.from_blocks([block_around(LINE, LINE, LINE), small])
    topology = find_topology(grid)
    (connection,) = find_interfaces(grid, topology)
    assert (connection.begin, connection.end) == ((4, 1, 0), (4, 3, 2))
    assert np.count_nonzero(topology.external[topology.quads.of_side(0, Side.IMAX)]) == 16 - 4


def test_o_grid_seam_and_face_corner_orientation():
    grid = polar()
    topology = find_topology(grid)
    assert topology.n_unique == len(topology.face_nodes) - 9 * 5
    assert np.all(topology.partner[topology.quads.of_side(0, Side.IMIN)] >= 0)
    corners = grid.points[topology.first[topology.quads.corners]]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    outer = topology.quads.of_side(0, Side.JMIN)
    inner = topology.quads.of_side(0, Side.JMAX)
    radial = corners.mean(axis=1) * [1, 1, 0]
    # Outside of the ring is away from the axis, at the cylinder it is towards it.
    sign = np.einsum("ni,ni->n", normal, radial)
    assert {tuple(np.unique(np.sign(sign[part]))) for part in (outer, inner)} == {(1.0,), (-1.0,)}
    radius = np.hypot(*corners[:, 0, :2].T)
    assert np.all(sign[radius > 2.9][: outer.stop - outer.start] > 0) or np.all(sign[radius < 1.1] < 0)


@pytest.mark.parametrize("grid", [frame_2d(), permuted(frame_2d(), (2, 0, 1), (False, True, False))])
def test_outside_lies_to_the_right_in_2d(grid):
    topology = find_topology(grid)
    ends = grid.points[topology.first[topology.quads.corners]]
    tangent = ends[:, 1] - ends[:, 0]
    outward = np.cross(tangent, [0.0, 0.0, 1.0])
    middle = ends.mean(axis=1)
    outer = topology.external & (np.abs(middle[:, :2]).max(axis=1) > 1.9)
    inner = topology.external & ~outer
    assert np.all(np.einsum("ni,ni->n", outward, middle)[outer] > 0)
    assert np.all(np.einsum("ni,ni->n", outward, middle)[inner] < 0)


def test_c_grid_cut_folds_a_face_onto_itself():
    upper = np.stack([np.linspace(3, 1, 5), 0 * LINE], axis=1)
    nose = np.stack([np.cos(np.linspace(0, 2 * np.pi, 9)), 0.3 * np.sin(np.linspace(0, 2 * np.pi, 9))], axis=1)
    wall = np.concatenate([upper[:-1], nose, upper[::-1][1:]])
    wall[-5:] = wall[:5][::-1]
    away = np.stack([np.linspace(0, 0, len(wall)), np.linspace(-1, 1, len(wall))], axis=1)
    plane = np.stack([wall + s * away for s in (0.0, 0.5, 1.0)], axis=1)
    x = np.zeros((*plane.shape[:2], 2, 3))
    x[..., :2] = plane[:, :, None]
    x[:, :, 1, 2] = 1.0
    topology = find_topology(Grid.from_blocks([x]))
    on_cut = topology.partner[topology.quads.of_side(0, Side.JMIN)] >= 0
    assert on_cut.sum() == 2 * 4


def test_collapsed_edge_and_pole():
    angle, radius = np.linspace(0, np.pi / 2, 6), np.linspace(0, 1, 4)
    a, r, z = np.meshgrid(angle, radius, LINE, indexing="ij")
    grid = Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), z], axis=-1)])
    topology = find_topology(grid)
    assert np.all(topology.partner[topology.quads.of_side(0, Side.JMIN)] == COLLAPSED)
    assert np.all(topology.external[topology.quads.of_side(0, Side.KMIN)])
    axis = topology.numbers_of(np.flatnonzero((grid.points[:, :2] == 0).all(axis=1)))
    assert len(np.unique(axis)) == 5


@pytest.mark.parametrize("noise", [0.0, 1e-13])
def test_tolerance_is_relative_to_the_local_edge(noise):
    """Boundary-layer nodes closer together than far-field noise stay apart; noisy copies are one node."""
    y = np.r_[0.0, 1e-8, 3e-8, 1e-7, 1e-3, 1.0]
    one = block_around(LINE, y, LINE)
    two = block_around(1.0 + LINE, y, LINE)
    two = two + noise * np.sin(1e3 * two)
    topology = find_topology(Grid.from_blocks([one, two]))
    assert np.count_nonzero(topology.partner >= 0) == 2 * 5 * 4
    assert topology.n_unique == len(topology.face_nodes) - 6 * 5


def test_wrong_connections_are_reported():
    grid = frame()
    (good, *others) = find_interfaces(grid, find_topology(grid))
    wrong = Connection(
        "twisted", good.block, good.begin, good.end, good.donor_block, good.donor_end, good.donor_begin,
        (good.transform[0], -good.transform[1], -good.transform[2]),
    )  # fmt: skip
    outside = Connection("outside", 0, (0, 0, 0), (0, 99, 0), 1, (0, 0, 0), (0, 99, 0), (1, 2, 3))
    declared = Grid.from_blocks([grid.block(b) for b in range(8)], connections=(wrong, outside))
    messages = check_connections(declared, find_topology(declared))
    assert any("twisted" in m and "do not coincide" in m for m in messages)
    assert any("outside" in m and "reaches node" in m for m in messages)
    assert any("no connection declares them" in m for m in messages)
    (missing,) = check_connections(dataclasses.replace(grid, connections=tuple(others)), find_topology(grid))
    own, donor = connected_nodes(grid, good)
    count = sum(np.prod([len(np.unique(x.round(9))) - 1 or 1 for x in grid.points[some].T]) for some in (own, donor))
    assert f"{count} face quads coincide but no connection declares them" in missing


def test_a_connection_joins_patches_also_where_another_is_between_walls():
    grid = Grid.from_blocks([brick((n, 0, 0)) for n in range(3)])
    connections = find_interfaces(grid, find_topology(grid))
    places = (0, Side.IMAX, "BCWall"), (1, Side.IMIN, "BCWall"), (1, Side.IMAX, ""), (2, Side.IMIN, "")
    patches = tuple(Patch(str(n), (whole_face((5, 4, 6), *at),), "", kind) for n, (*at, kind) in enumerate(places))
    topology = find_topology(dataclasses.replace(grid, patches=patches, connections=connections))
    joined = [bool((topology.partner[topology.quads.of_side(*at)] >= 0).all()) for *at, _ in places]
    assert joined == [False, False, True, True]


def test_third_party_grids(third_party):
    import json

    for entry in json.loads((third_party / "oracle" / "summary.json").read_text()):
        oracle = third_party / "oracle" / f"{entry['name']}.npz"
        if not oracle.is_file():
            continue
        data = np.load(oracle)
        grid = Grid.from_blocks([data[f"b{n}"] for n in range(len(entry["dims"]))])
        topology = find_topology(grid)
        shared = {(c.block, c.begin, c.end): c for c in find_interfaces(grid, topology)}
        assert len(shared) == len(entry["faces_shared"]) + len(entry["folds"])
        for _, a, side_a, b, side_b, nodes in entry["faces_shared"]:
            assert any(
                (c.block, c.donor_block) == (a, b)
                and c.name.split("-")[0].endswith(side_a)
                and c.name.endswith(side_b)
                and len(np.unique(topology.numbers_of(connected_nodes(grid, c)[0]))) == nodes
                for c in shared.values()
            )


def noisy_bricks():
    """Eight blocks whose common nodes differ by noise, one of them too far from the others."""
    random, grids = np.random.default_rng(5), []
    for place in itertools.product((0, 1), repeat=3):
        x = brick(place)
        grids.append(x + 1e-6 * random.uniform(-1.0, 1.0, x.shape) + 0.02 * (place == (1, 1, 1)))
    return Grid.from_blocks(grids)


@pytest.mark.parametrize("make", [frame_2d, noisy_bricks])
@pytest.mark.parametrize("window", [1, 50])
def test_topology_does_not_depend_on_how_much_is_done_at_a_time(make, window, monkeypatch):
    grid = make()
    whole = find_topology(grid)
    monkeypatch.setattr(coincidence, "_WINDOW", window)
    monkeypatch.setattr(grid_topology, "_MATCHED", window)
    monkeypatch.setattr(grid_topology, "_TOGETHER", window)
    found = find_topology(grid)
    for name in ("face_nodes", "number", "first", "edge", "partner", "handedness"):
        np.testing.assert_array_equal(getattr(found, name), getattr(whole, name))
    np.testing.assert_array_equal(found.quads.corners, whole.quads.corners)
    assert found.crowded == whole.crowded
    assert [opening.describe(grid) for opening in find_openings(grid, found)] == [
        opening.describe(grid) for opening in find_openings(grid, whole)
    ]


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


def test_handedness_by_the_volume_of_every_cell(grid):
    if grid.dimension == 2:
        pytest.skip("a plane has no volume")
    for block, hand in enumerate(block_handedness(grid)):
        i, j, k = (np.diff(grid.block(block), axis=axis) for axis in range(3))
        n = tuple(size - 1 for size in grid.shapes[block])
        edges = [each[: n[0], : n[1], : n[2]] for each in (i, j, k)]
        assert np.sign(np.einsum("ijkx,ijkx->", edges[0], np.cross(edges[1], edges[2]))) == hand


def test_lines_across_interfaces_meet_and_leave_into_both_blocks(grid):
    topology = find_topology(grid)
    lines = interface_lines(grid, topology)
    np.testing.assert_array_equal(topology.numbers_of(lines.here), topology.numbers_of(lines.there))
    for near, far in ((lines.here, lines.before), (lines.there, lines.beyond)):
        block = np.searchsorted(grid.offsets, near, side="right")
        np.testing.assert_array_equal(block, np.searchsorted(grid.offsets, far, side="right"))
        assert not np.isin(far, near).all()


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


def test_sides_of_separate_blocks_are_not_compared_with_all_others():
    grid = lattice((7, 7, 5), gap=0.3)
    topology = find_topology(grid)
    assert topology.external.all()
    compared: list[IntArray] = []
    original = overlapping_boxes
    module = sys.modules["meshdeform_core.grid.openings"]
    module.overlapping_boxes = lambda *sets: compared.append(original(*sets)) or compared[-1]
    try:
        assert find_openings(grid, topology) == ()
    finally:
        module.overlapping_boxes = original
    # Each side has the four beside it on its own block, and itself; in the search for overlaps its own block.
    assert 0 < sum(map(len, compared)) <= (5 + 1) * 6 * grid.n_blocks


def test_connections_of_so_many_blocks_that_pairs_of_sides_exceed_32_bits():
    n = 20
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
