"""Coincident nodes and shared faces, whatever the orientation."""

import dataclasses
import itertools

import grids
import numpy as np
import pytest
from grids import block_around, permuted, transform_matrix, turn_block, whole_face
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.grid import Grid, Patch, Side
from meshdeform_core.grid.connections import check_connections, connected_nodes, find_interfaces
from meshdeform_core.grid.topology import COLLAPSED, find_topology
from meshdeform_core.numerics.geometry.boxes import overlapping_boxes

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
    assert round(np.linalg.det(transform_matrix(connection))) == round(even)
    assert check_connections(Grid.from_blocks([first, second], connections=(connection,)), topology) == []


def test_partial_face():
    small = block_around(np.array([1.0, 1.5, 2.0]), LINE[1:4], LINE[:3])
    grid = Grid.from_blocks([block_around(LINE, LINE, LINE), small])
    topology = find_topology(grid)
    (connection,) = find_interfaces(grid, topology)
    assert (connection.begin, connection.end) == ((4, 1, 0), (4, 3, 2))
    assert np.count_nonzero(topology.external[topology.quads.of_side(0, Side.IMAX)]) == 16 - 4


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


def test_a_connection_joins_patches_also_where_another_is_between_walls():
    grid = Grid.from_blocks([brick((n, 0, 0)) for n in range(3)])
    connections = find_interfaces(grid, find_topology(grid))
    places = (0, Side.IMAX, "BCWall"), (1, Side.IMIN, "BCWall"), (1, Side.IMAX, ""), (2, Side.IMIN, "")
    patches = tuple(Patch(str(n), (whole_face((5, 4, 6), *at),), "", kind) for n, (*at, kind) in enumerate(places))
    topology = find_topology(dataclasses.replace(grid, patches=patches, connections=connections))
    joined = [bool((topology.partner[topology.quads.of_side(*at)] >= 0).all()) for *at, _ in places]
    assert joined == [False, False, True, True]


def lattice(counts: tuple[int, int, int], nodes: int = 3, turned: bool = False) -> Grid:
    """A bent box cut into blocks with ``nodes`` along each index; ``turned``: their indices run in all directions."""
    orientations = itertools.cycle(
        itertools.product(itertools.permutations(range(3)), [(False, True, False), (True, False, False)])
    )
    blocks = []
    for place in np.ndindex(*counts):
        lines = [at + np.linspace(0.0, 1.0, nodes) for at in place]
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
