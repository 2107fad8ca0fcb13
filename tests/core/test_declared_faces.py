"""Faces that are declared as boundary on both sides: outside faces, and nodes of their own in files."""

from itertools import product

import numpy as np
import pytest

from meshdeform_core.grid import Connection, Grid, Patch, Side, Window
from meshdeform_core.grid.topology import find_topology, separated

from ..grids import block_around, whole_face


def cube_of_blocks(rng):
    """2 x 2 x 2 blocks of 2 x 3 x 2 cells, some of them left-handed, of which all outside faces are patches."""
    blocks, patches = [], []
    for number, place in enumerate(product((0, 1), repeat=3)):
        points = block_around(*(np.linspace(at, at + 1, n) for at, n in zip(place, (3, 4, 3), strict=True)))
        mirrored = rng.random() < 0.5
        blocks.append(points[::-1] if mirrored else points)
        for side in Side:
            if side % 2 == (place[side.axis] + (mirrored and side.axis == 0)) % 2:
                patches.append(Patch("outside", (whole_face(points.shape[:3], number, side),), bc_type="patch"))
    return blocks, patches


def groups_of_cells(grid: Grid, both: set[frozenset]) -> int:
    """Nodes of a grid, one cell at a time: at each place, cells joined by faces that are not declared share one."""
    key = {}
    cells = []
    for block in range(grid.n_blocks):
        x = grid.block(block).round(9)
        for at in np.ndindex(*(n - 1 for n in x.shape[:3])):
            corners = {step: tuple(x[tuple(np.add(at, step))]) for step in np.ndindex(2, 2, 2)}
            cells.append(set(corners.values()))
            for axis, end in product(range(3), (0, 1)):
                face = frozenset(point for step, point in corners.items() if step[axis] == end)
                key.setdefault(face, []).append(len(cells) - 1)
    joined = [cells_at for face, cells_at in key.items() if len(cells_at) == 2 and face not in both]
    count = 0
    for place in set().union(*cells):
        left = {number for number, cell in enumerate(cells) if place in cell}
        links = [pair for pair in joined if left.issuperset(pair)]
        while left:
            count += 1
            group = {left.pop()}
            while more := {n for pair in links for n in pair if group & set(pair)} - group:
                group |= more
            left -= group
    return count


@pytest.mark.parametrize("seed", range(4))
def test_nodes_are_those_of_cells_that_faces_join(seed):
    rng = np.random.default_rng(seed)
    blocks, patches = cube_of_blocks(rng)
    undivided = find_topology(Grid.from_blocks(blocks))
    shared = np.flatnonzero(undivided.partner >= 0)
    chosen = shared[rng.random(len(shared)) < 0.4]
    chosen = np.unique([chosen, undivided.partner[chosen]])
    side, u, v = undivided.quads.places(chosen)
    for s, a, b in zip(side.tolist(), u.tolist(), v.tolist(), strict=True):
        patches.append(Patch("plate", (Window(s // 6, Side(s % 6), (a, b), (a + 1, b + 1)),), bc_type="wall"))
    grid = Grid.from_blocks(blocks, patches=tuple(patches))
    topology = find_topology(grid)
    np.testing.assert_array_equal(np.flatnonzero(topology.external & ~undivided.external), chosen)
    # Both sides of a plate move together.
    np.testing.assert_array_equal(topology.number, undivided.number)
    apart = separated(grid, topology)
    places = grid.points[undivided.first[undivided.quads.corners[chosen]]].round(9)
    both = {frozenset(map(tuple, quad)) for quad in places.tolist()}
    assert apart.n_unique + grid.n_nodes - len(topology.face_nodes) == groups_of_cells(grid, both)
    assert (np.diff(apart.first) > 0).all()
    np.testing.assert_array_equal(apart.number[np.searchsorted(apart.face_nodes, apart.first)], range(apart.n_unique))
    corners = apart.first[apart.quads.corners]
    np.testing.assert_array_equal(grid.points[corners], grid.points[topology.first[topology.quads.corners]])
    for block in range(grid.n_blocks):
        own = np.unique(apart.quads.corners[apart.quads.block_side // 6 == block])
        low, high = np.searchsorted(apart.face_nodes, grid.offsets[block : block + 2])
        np.testing.assert_array_equal(own, np.unique(apart.number[low:high]))


def two_cubes(one: str, two: str, connected: bool) -> Grid:
    x = np.linspace(0, 1, 4)
    whole = (0, 0), (3, 3)
    patches = (Patch("a", (Window(0, Side.IMAX, *whole),), bc_type=one),
               Patch("b", (Window(1, Side.IMIN, *whole),), bc_type=two))  # fmt: skip
    connection = Connection("c", 0, (3, 0, 0), (3, 3, 3), 1, (0, 0, 0), (0, 3, 3), (1, 2, 3))
    return Grid.from_blocks(
        [block_around(x, x, x), block_around(1 + x, x, x)], patches=patches,
        connections=(connection,) if connected else (),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("types", "connected", "open_faces"),
    [
        (("BCWall", "BCWallViscous"), True, True),
        (("cyclicAMI", "cyclicAMI"), False, True),
        (("BCGeneral", "BCGeneral"), True, False),
        (("BCWall", "BCInflow"), True, False),
    ],
)
def test_connections_decide_but_not_against_walls(types, connected, open_faces):
    grid = two_cubes(*types, connected)
    topology = find_topology(grid)
    assert topology.external[topology.quads.of_side(0, Side.IMAX)].all() == open_faces
    assert separated(grid, topology).n_unique == topology.n_unique + 16 * open_faces


def test_blocks_that_touch_at_an_edge_only():
    """They keep common nodes where the file has no patches, and along the edge of a face between them without one."""
    x = np.linspace(0, 1, 3)
    blocks = [block_around(x, x, x), block_around(1 + x, 1 + x, x)]
    bare = Grid.from_blocks(blocks)
    assert separated(bare, find_topology(bare)).n_unique == 2 * 26 - 3
    patches = [Patch("all", (Window(block, side, (0, 0), (2, 2)),)) for block in (0, 1) for side in Side]
    grid = Grid.from_blocks(blocks, patches=tuple(patches))
    assert separated(grid, find_topology(grid)).n_unique == 2 * 26
    some = Grid.from_blocks(blocks, patches=tuple(patch for patch in patches if patch.windows[0].side != Side.IMAX))
    assert separated(some, find_topology(some)).n_unique == 2 * 26


def test_collapsed_edges_stay_one_node():
    """A half disc of two prisms around an axis, with patches outside, and a plate between them from rim to axis."""
    angle = np.linspace(0, np.pi / 2, 4)
    r, z = np.linspace(0, 1, 4), np.linspace(0, 1, 3)

    arms = [np.cos(angle), np.sin(angle)]
    x, y = (r[:, None, None] * arm[:, None] + 0 * z for arm in arms)
    first = np.stack([x, y, 0 * x + z], axis=-1).round(15)
    blocks = [first, (first * [-1, 1, 1])[:, ::-1]]
    sides = (Side.IMAX, Side.KMIN, Side.KMAX)
    outside = [Patch("o", (Window(b, s, (0, 0), (3, 2) if s == Side.IMAX else (3, 3)),)) for b in (0, 1) for s in sides]
    ends = [Patch("e", (Window(0, Side.JMIN, (0, 0), (3, 2)),)), Patch("e", (Window(1, Side.JMAX, (0, 0), (3, 2)),))]
    plate = [Patch("p", (Window(0, Side.JMAX, (0, 0), (3, 2)),)), Patch("p", (Window(1, Side.JMIN, (0, 0), (3, 2)),))]
    joined = Grid.from_blocks(blocks, patches=(*outside, *ends))
    topology = find_topology(joined)
    assert separated(joined, topology).n_unique == topology.n_unique
    divided = Grid.from_blocks(blocks, patches=(*outside, *ends, *plate))
    assert separated(divided, find_topology(divided)).n_unique == topology.n_unique + 12
