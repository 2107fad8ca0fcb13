"""Faces of blocks: geometry against exact values, roles against what the files and samples declare."""

import dataclasses
import itertools
from itertools import product

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, permuted, polar, whole_face

from meshdeform_core.grid import Connection, Grid, Patch, Side, Window
from meshdeform_core.grid.faces import (
    Role,
    clustered_interfaces,
    find_faces,
    find_outside,
    outward_areas,
    quad_sizes,
    thin_direction,
)
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.topology import find_topology, separated
from meshdeform_samples import load


def outside_of(grid):
    return find_outside(grid, find_topology(grid))


def roles_of(grid):
    found = outside_of(grid)
    return {face.label(grid): role for face, role in zip(found.faces, found.roles, strict=True)}


# geometry


@pytest.mark.parametrize("make", [frame, frame_2d])
@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
@pytest.mark.parametrize("flips", [(False, False, False), (True, False, True), (False, True, False)])
def test_area_vectors_close_and_point_outwards(make, axes, flips):
    grid = permuted(make(), axes, flips)
    topology = find_topology(grid)
    area, height = quad_sizes(grid, topology)
    quads = np.flatnonzero(topology.external)
    corners, outward = outward_areas(grid, topology, quads, plane_normal(grid))
    np.testing.assert_allclose(np.linalg.norm(outward, axis=1), area[quads])
    np.testing.assert_allclose(outward.sum(axis=0), 0.0, atol=1e-12)
    # Gauss: the flux of the position is three times the volume, 4 x 4 - 1 x 1, in a plane twice the area.
    flux = np.einsum("ni,ni->", corners.mean(axis=1), outward)
    assert flux == pytest.approx(grid.dimension * 15.0)
    assert (height > 0).all()


def test_boxes_areas_and_first_cells_of_a_single_block():
    x, y, z = np.array([0.0, 0.1, 0.5, 2.0]), np.linspace(0.0, 3.0, 4), np.array([0.0, 0.25, 1.0])
    grid = Grid.from_blocks([block_around(x, y, z)])
    faces = {face.label(grid): face for face in find_faces(grid, find_topology(grid))}
    assert set(faces) == {f"block1.{side.label}" for side in Side}
    first = faces["block1.imin"]
    assert (first.area, first.first_height, first.median_height) == pytest.approx((3.0, 0.1, 0.1))
    assert first.stretching == pytest.approx((2.0 / 3) / 0.1)
    assert faces["block1.imax"].stretching == pytest.approx((2.0 / 3) / 1.5)
    assert faces["block1.imax"].finest == pytest.approx(0.1 / 1.5)
    np.testing.assert_array_equal(faces["block1.kmax"].box, [[0, 0, 1], [2, 3, 1]])
    assert faces["block1.kmax"].plane is not None


def test_pieces_are_windows_of_patches_and_of_what_is_left():
    grid = Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 5),) * 3)])
    patch = Patch("hot", (Window(0, Side.KMIN, (0, 0), (2, 4)),))
    grid = dataclasses.replace(grid, patches=(patch,))
    found = [face for face in find_faces(grid, find_topology(grid)) if face.window.side is Side.KMIN]
    assert {(face.patch and face.patch.name, face.window.ranges) for face in found} == {
        ("hot", "1:3,1:5"), (None, "3:5,1:5")
    }  # fmt: skip
    assert sum(face.area for face in found) == pytest.approx(1.0)


def test_a_surface_is_made_of_its_faces():
    x, y, z = 5.0 + np.array([0.0, 0.1, 0.5, 2.0]), np.linspace(-3.0, 0.0, 4), 7.0 + np.array([0.0, 0.25, 1.0])
    grid = Grid.from_blocks([block_around(x, y, z)])
    whole = {side: whole_face(grid.shapes[0], 0, side) for side in Side}
    patches = (Patch("far", (whole[Side.JMIN],), "wing", "BCFarfield"),
               Patch("a", (whole[Side.KMIN], whole[Side.IMIN]), "wing", "BCWall"))  # fmt: skip
    outside = outside_of(dataclasses.replace(grid, patches=patches))
    (wing,) = (surface for surface in outside.surfaces if surface.named)
    assert (wing.name, wing.role, wing.declared, set(wing.patches)) == ("wing", Role.WALL, True, {"far", "a"})
    assert len(wing.patches) == 2 < len(wing.faces)
    assert wing.area == pytest.approx(2 * 3 + 2 * 1 + 3 * 1)
    np.testing.assert_array_equal(wing.box, [[5, -3, 7], [7, 0, 8]])
    # Nine cells of height 0.25, six of height 1, six of height 0.1.
    assert (wing.first_height, wing.median_height) == pytest.approx((0.1, 0.25))
    assert sorted(wing.quads) == sorted(quad for face in wing.faces for quad in face.quads)
    np.testing.assert_array_equal(outside.extent, [2, 3, 1])
    assert outside.of_role(Role.WALL) == (wing,)


@pytest.mark.parametrize(
    ("parts", "bodies"),
    [
        ({"low": (Side.KMIN, 0, 4)}, set()), ({"low": (Side.KMIN, 0, 2)}, {"low"}),
        ({"low": (Side.KMIN, 0, 2), "next": (Side.KMIN, 2, 4)}, set()),
        ({"low": (Side.KMIN, 0, 2), "above": (Side.KMAX, 2, 4)}, {"low", "above"}),
    ],
)  # fmt: skip
def test_walls_that_cover_most_of_a_plane_are_no_bodies(parts, bodies):
    line = np.linspace(0.0, 1.0, 5)
    grid = Grid.from_blocks([block_around(line, line, line)])
    patches = tuple(Patch(name, (Window(0, side, (first, 0), (last, 4)),), bc_type="BCWall")
                    for name, (side, first, last) in parts.items())  # fmt: skip
    assert {body.name for body in outside_of(dataclasses.replace(grid, patches=patches)).bodies} == bodies


# roles


def test_a_body_without_clustered_cells_is_a_wall():
    x = np.linspace(-2.0, 2.0, 4)
    lines = [np.linspace(a, b, 4) for a, b in itertools.pairwise(x)]
    blocks = [block_around(lines[i], lines[j], lines[k]) for i in range(3) for j in range(3) for k in range(3)
              if (i, j, k) != (1, 1, 1)]  # fmt: skip
    grid = Grid.from_blocks(blocks)
    found = outside_of(grid)
    inner = [s for s in found.surfaces if np.abs(s.box).max() < 1.0]
    assert len(inner) == 6
    assert {s.role for s in inner} == {Role.WALL}
    assert {s.role for s in found.surfaces if s not in inner} == {Role.FAR}


def test_a_ring_has_wall_far_field_and_end_planes():
    assert roles_of(polar(n_radial=16)) == {
        "block1.imin": Role.INTERFACE, "block1.imax": Role.INTERFACE, "block1.jmin": Role.WALL,
        "block1.jmax": Role.FAR, "block1.kmin": Role.END, "block1.kmax": Role.END,
    }  # fmt: skip
    # Of half of it, the first quads of two planes are folded.
    half = polar(n_radial=16).block(0)[:13]
    half[[0, -1], 0, 1, 2] = 1.5
    wall = Patch("wall", (whole_face(half.shape[:3], 0, Side.JMIN),), "BCWall")
    roles = roles_of(Grid.from_blocks([half], patches=(wall,)))
    assert roles["block1.imin"] == roles["block1.imax"] == Role.SYMMETRY


def test_a_cube_says_nothing():
    assert set(roles_of(Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 5),) * 3)])).values()) == {Role.UNKNOWN}


@pytest.mark.parametrize(
    ("words", "role"),
    [
        (("BCWallViscous", "", "a"), Role.WALL),
        (("viscous_solid", "", "a"), Role.WALL),
        (("symmetry_y_strong", "", "wall"), Role.SYMMETRY),
        (("BCFarfield", "", "wall"), Role.FAR),
        (("FamilySpecified", "Wing_Wall", "a"), Role.WALL),
        (("", "", "SYMM"), Role.SYMMETRY),
        (("", "", "outlet_2"), Role.FAR),
        (("UserDefined", "", "a"), Role.UNKNOWN),
    ],
)
def test_what_the_file_declares_decides(words, role):
    kind, family, name = words
    grid = Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 5),) * 3)])
    patch = Patch(name, (whole_face(grid.shapes[0], 0, Side.JMAX),), family, kind)
    surface = next(s for s in outside_of(dataclasses.replace(grid, patches=(patch,))).surfaces if s.named)
    assert (surface.name, surface.role) == (family or name, role)
    assert surface.declared is (role is not Role.UNKNOWN)


@pytest.mark.parametrize(("kind", "role"), [("patch", Role.UNKNOWN), ("", Role.SYMMETRY)])
def test_a_plane_that_openfoam_calls_a_patch_is_no_symmetry_plane(kind, role):
    """The open top of a tank, beside its walls: OpenFOAM has types of its own for symmetry planes."""
    grid = Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 5),) * 3)])
    walls = tuple(whole_face(grid.shapes[0], 0, side) for side in (Side.IMIN, Side.IMAX, Side.KMIN))
    top = whole_face(grid.shapes[0], 0, Side.KMAX)
    patches = (Patch("wall", walls, "", "wall"), Patch("top", (top,), "", kind))
    found = {s.name: s.role for s in outside_of(dataclasses.replace(grid, patches=patches)).surfaces}
    assert (found["wall"], found["top"]) == (Role.WALL, role)


def test_one_layer_of_cells_is_thin():
    square = np.linspace(0.0, 1.0, 5)
    assert thin_direction(Grid.from_blocks([block_around(square, square, square)])) is None
    np.testing.assert_array_equal(
        thin_direction(Grid.from_blocks([block_around(square, np.array([0.0, 9.0]), square)])), [0, 1, 0]
    )
    np.testing.assert_array_equal(thin_direction(frame_2d()), [0, 0, 1])


SMALL = {"airfoil": 41, "splitter-plate": 8, "hemisphere": 8, "wing": 8, "valve": 8}


@pytest.mark.parametrize("name", SMALL)
def test_walls_of_samples_are_found_without_their_names(name):
    grid = load(name).generate(SMALL[name])
    declared = np.concatenate([s.quads for s in outside_of(grid).of_role(Role.WALL)])
    guessed = np.concatenate([s.quads for s in outside_of(dataclasses.replace(grid, patches=())).of_role(Role.WALL)])
    # All that is called a wall is one, and what is missed are floors, never the body that the grid surrounds.
    assert np.isin(guessed, declared).all()
    assert len(guessed) > 0.3 * len(declared)


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


@pytest.mark.parametrize(("other", "wakes"), [(False, []), (True, ["block1.imax", "block2.imin"])])
def test_a_wake_is_where_cells_cluster_from_both_sides(other, wakes):
    x = np.linspace(0, 1, 9)
    to_end = 1.0 - (1.0 - x) ** 2.5
    blocks = [block_around(to_end, x, x), block_around(1.0 + (1.0 - to_end[::-1] if other else x), x, x)]
    grid = Grid.from_blocks(blocks)
    topology = find_topology(grid)
    assert [face.label(grid) for face in clustered_interfaces(topology, find_outside(grid, topology))] == wakes


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
    met = {(0, Side.IMAX), (1, Side.IMIN)}
    neither = [patch for patch in patches if (patch.windows[0].block, patch.windows[0].side) not in met]
    joined = Grid.from_blocks(blocks, patches=tuple(neither))
    assert separated(joined, find_topology(joined)).n_unique == 2 * 26 - 3


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
