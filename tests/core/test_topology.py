"""Coincident nodes and shared faces, whatever the orientation."""

import itertools

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, permuted, polar

from meshdeform_core.grid import Connection, Grid, Side
from meshdeform_core.grid import topology as grid_topology
from meshdeform_core.grid.connections import check_connections, connected_nodes, find_interfaces
from meshdeform_core.grid.openings import find_openings
from meshdeform_core.grid.topology import COLLAPSED, find_topology
from meshdeform_core.numerics.geometry import coincidence

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
    (good, *_) = find_interfaces(grid, find_topology(grid))
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
