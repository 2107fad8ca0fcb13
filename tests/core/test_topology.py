"""Coincident nodes and shared faces, whatever the orientation."""

import dataclasses
import itertools

import grids
import numpy as np
import pytest
from grids import LINE, block_around, turn_block
from hypothesis import given, settings
from hypothesis import strategies as st
from random_grids import ORIENTATIONS

from meshdeform_core.grid import Grid, Side, Window
from meshdeform_core.grid.connections import check_connections, connected_nodes, find_interfaces
from meshdeform_core.grid.topology import COLLAPSED, EXTERNAL, FaceQuads, find_topology, quads_of_windows
from meshdeform_core.grid.windows import rectangles
from meshdeform_core.numerics.geometry.boxes import overlapping_boxes


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


def storeys() -> Grid:
    """Six frames, one on the other, whose indices run in all directions."""
    blocks = [grids.frame(2, 2).block(b) + [0.0, 0.0, z] for z in range(6) for b in range(8)]
    return Grid.from_blocks([turn_block(x, *turn) for x, turn in zip(blocks, ORIENTATIONS, strict=True)])


# With the number of interfaces of each.
GRIDS = {
    "frame": (grids.frame, 8),
    "turned": (storeys, 88),
    "partial": (
        lambda: Grid.from_blocks([block_around(LINE, LINE, LINE), block_around(1.0 + LINE, LINE[1:4], LINE[:3])]),
        1,
    ),
    "plane": (grids.frame_2d, 8),
    "seam": (grids.polar, 1),
    "cut": (grids.cut_behind_a_body, 1),
    "discs": (grids.discs, 3),
    # No transformation of indices describes it.
    "prisms": (grids.prisms, 0),
    "turned plane": (lambda: grids.permuted(grids.frame_2d(), (2, 0, 1), (True, False, True)), 8),
}


@pytest.fixture(params=GRIDS)
def grid(request) -> Grid:
    return GRIDS[request.param][0]()


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


def test_shared_faces_are_those_with_the_same_corners(grid):
    """By the coordinates of every face of a cell, one by one."""
    topology, x, same = find_topology(grid), grid.points.round(9) + 0.0, {}
    for block, side in itertools.product(range(grid.n_blocks), Side):
        plane = np.take(grid.block(block, x), side.layer(grid.shapes[block]), axis=side.axis)
        first = topology.quads.of_side(block, side).start
        for number, (u, v) in enumerate(np.ndindex(*topology.quads.counts[block, side])):
            corners = frozenset(map(tuple, plane[u : u + 2, v : v + 2].reshape(-1, 3).tolist()))
            same.setdefault(corners, []).append(first + number)
    assert topology.n_unique == len(np.unique(x[topology.face_nodes], axis=0))
    for corners, quads in same.items():
        alone = COLLAPSED if len(corners) < grid.dimension else EXTERNAL
        pair = len(quads) == 2 and alone == EXTERNAL
        assert topology.partner[quads].tolist() == (quads[::-1] if pair else [alone] * len(quads))
        for quad in quads:
            assert set(map(tuple, x[topology.first[topology.quads.corners[quad]]].tolist())) == corners


def plain_windows(grid: Grid, faces: FaceQuads, label: np.ndarray) -> list[tuple[int, Window]]:
    """Runs of faces with the same label in each row of a side; equal runs of successive rows are one window."""
    found = []
    for block, side in itertools.product(range(grid.n_blocks), Side):
        most, begun = [grid.shapes[block][axis] - 1 for axis in side.tangential], {}
        rows = label[faces.of_side(block, side)].reshape(faces.counts[block, side])
        for u, row in enumerate([*rows.tolist(), []]):
            places = [(number, v) for v, number in enumerate(row) if number >= 0]
            starts = [(number, v) for number, v in places if (number, v - 1) not in places]
            ends = [(number, v) for number, v in places if (number, v + 1) not in places]
            runs = {(number, low, high + 1) for (number, low), (_, high) in zip(starts, ends, strict=True)}
            for run in begun.keys() - runs:
                low, high = (begun.pop(run), run[1]), (min(u, most[0]), min(run[2], most[1]))
                found.append((run[0], Window(block, side, low, high)))
            begun = {run: begun.get(run, u) for run in runs}
    return sorted(
        found, key=lambda each: (each[1].block, each[1].side, each[0], each[1].low[1], each[1].high[1], each[1].low)
    )


@pytest.mark.parametrize("seed", range(3))
def test_windows_are_equal_runs_of_successive_rows(grid, seed):
    random, faces = np.random.default_rng(seed), find_topology(grid).quads
    label = random.choice([-1, 0, 1, 1, 1], len(faces.corners))
    assert not quads_of_windows(faces, [Window(0, Side.JMIN, (0, 0), (0, 0))])[0].size
    found = rectangles(grid, faces, label)
    assert list(zip(found.label.tolist(), found.windows(), strict=True)) == plain_windows(grid, faces, label)
    for number, window in enumerate(found.windows()):
        np.testing.assert_array_equal(found.quads_of(number), quads_of_windows(faces, [window])[0])


def test_interfaces_cover_every_shared_quad_once(grid, request):
    topology = find_topology(grid)
    connections = find_interfaces(grid, topology)
    count = 0
    for connection in connections:
        own, donor = connected_nodes(grid, connection)
        np.testing.assert_array_equal(topology.numbers_of(own), topology.numbers_of(donor))
        cells = np.abs(np.array(connection.end) - connection.begin)
        count += int(np.prod(cells[cells > 0]))
    number, shared = GRIDS[request.node.callspec.params["grid"]][1], np.count_nonzero(topology.partner >= 0) // 2
    assert count == (shared if number else 0) <= shared > 0
    assert len({(c.block, c.begin, c.end, c.donor_block) for c in connections}) == len(connections)
    assert len(connections) == number
    assert not number or check_connections(dataclasses.replace(grid, connections=connections), topology) == []


def test_handedness_is_that_of_the_indices():
    turns = [round(np.linalg.det(np.eye(3)[list(axes)])) * (-1) ** sum(flips) for axes, flips in ORIENTATIONS]
    assert find_topology(storeys()).handedness.tolist() == turns
