"""Faces of blocks: geometry against exact values, roles against what the files and samples declare."""

import dataclasses
import itertools
from itertools import product

import numpy as np
import pytest
from grids import block_around, discs, frame, frame_2d, permuted, polar, whole_face

from meshdeform_core.grid import Connection, Grid, Patch, Periodicity, Side, Window
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
from meshdeform_core.grid.windows import rectangles
from meshdeform_samples import load


def outside_of(grid):
    return find_outside(grid, find_topology(grid))


def roles_of(grid):
    found = outside_of(grid)
    return {face.label(grid): role for face, role in zip(found.faces, found.roles, strict=True)}


@pytest.mark.parametrize("make", [frame, frame_2d])
@pytest.mark.parametrize("axes", [(0, 1, 2), (2, 0, 1), (1, 0, 2)])
@pytest.mark.parametrize("flips", [(False, False, False), (True, False, True), (False, True, False)])
def test_area_vectors_close_and_point_outwards(make, axes, flips):
    plain = permuted(make(), axes, flips)
    grid, topology = plain.moved(plain.points + 0.4 * plain.points[:, :1] * [0.0, 1.0, 0.0]), find_topology(plain)
    area, height = quad_sizes(grid, topology)
    # Shearing changes no volume.
    np.testing.assert_allclose(area * height, np.prod(quad_sizes(plain, topology), axis=0))
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
    hot = Patch("hot", (Window(0, Side.KMIN, (0, 0), (2, 3)),))
    grid = Grid.from_blocks([block_around(x, y, z)], patches=(hot,))
    faces = {face.label(grid): face for face in find_faces(grid, find_topology(grid))}
    windows = ["kmin[1:3,1:4]", "kmin[3:4,1:4]"]
    assert list(faces) == [f"block1.{name}" for name in ("imin", "imax", "jmin", "jmax", *windows[::-1], "kmax")]
    first, other, left = (faces[f"block1.{name}"] for name in ("imin", *windows))
    assert (first.area, first.first_height, first.median_height) == pytest.approx((3.0, 0.1, 0.1))
    assert (other.patch, left.patch, other.area, left.area) == (hot, None, pytest.approx(1.5), pytest.approx(4.5))
    assert first.stretching == pytest.approx((2.0 / 3) / 0.1)
    assert faces["block1.imax"].stretching == pytest.approx((2.0 / 3) / 1.5)
    assert faces["block1.imax"].finest == pytest.approx(0.1 / 1.5)
    np.testing.assert_array_equal(faces["block1.kmax"].box, [[0, 0, 1], [2, 3, 1]])
    assert faces["block1.kmax"].plane is not None


def test_a_surface_is_made_of_its_faces():
    x, y, z = 5.0 + np.array([0.0, 0.1, 0.5, 2.0]), np.array([-3.0, -2.5, -1.0, 0.0]), 7.0 + np.array([0.0, 1.0])
    grid = Grid.from_blocks([block_around(x, y, z)])
    whole = {side: whole_face(grid.shapes[0], 0, side) for side in Side}
    patches = (Patch("far", (whole[Side.IMIN],), "wing", "BCFarfield"),
               Patch("a", (whole[Side.KMIN], whole[Side.JMIN]), "wing", "BCWall"))  # fmt: skip
    outside = outside_of(dataclasses.replace(grid, patches=patches))
    (wing,) = (surface for surface in outside.surfaces if surface.named)
    assert (wing.name, wing.role, wing.declared, wing.patches) == ("wing", Role.WALL, True, ("far", "a"))
    assert wing.area == pytest.approx(2 * 3 + 2 * 1 + 3 * 1)
    np.testing.assert_array_equal(wing.box, [[5, -3, 7], [7, 0, 8]])
    # Nine cells of height 1, three of height 0.1, three of height 0.5.
    assert (wing.first_height, wing.median_height) == pytest.approx((0.1, 1.0))
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
    grid = Grid.from_blocks([1e-8 * block_around(line, line, 3.0 * line)])
    patches = tuple(Patch(name, (Window(0, side, (first, 0), (last, 4)),), bc_type="BCWall")
                    for name, (side, first, last) in parts.items())  # fmt: skip
    assert {body.name for body in outside_of(dataclasses.replace(grid, patches=patches)).bodies} == bodies


def test_a_body_without_clustered_cells_is_a_wall():
    x = np.linspace(-2.0, 2.0, 4)
    lines = [np.linspace(a, b, 4) for a, b in itertools.pairwise(x)]
    blocks = [block_around(lines[i], lines[j], lines[k]) for i in range(3) for j in range(3) for k in range(3)
              if (i, j, k) != (1, 1, 1)]  # fmt: skip
    for block in blocks:
        block[..., 0] += 0.1 * np.cos(block[..., 1:]).prod(axis=-1) * (block[..., 0] == 2.0)
    found = outside_of(Grid.from_blocks(blocks))
    inner = [s for s in found.surfaces if np.abs(s.box).max() < 1.0]
    assert len(inner) == 6
    assert {s.role for s in inner} == {Role.WALL}
    curved = [s for s in found.surfaces if s.box[0, 0] > 1.9]
    assert {s.role for s in curved} == {Role.UNKNOWN}
    assert {s.role for s in found.surfaces if s not in inner and s not in curved} == {Role.FAR}


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
        (("BCWallViscous", "", "a"), Role.WALL), (("viscous_solid", "", "a"), Role.WALL),
        (("symmetry_y_strong", "", "wall"), Role.SYMMETRY), (("BCFarfield", "", "wall"), Role.FAR),
        (("FamilySpecified", "Wing_Wall", "a"), Role.WALL), (("", "", "SYMM"), Role.SYMMETRY),
        (("", "", "outlet_2"), Role.FAR), (("UserDefined", "", "a"), Role.UNKNOWN),
        (("wedge", "wall", "a"), Role.END), (("", "Far", "wall"), Role.FAR),
    ],
)  # fmt: skip
def test_what_the_file_declares_decides(words, role):
    kind, family, name = words
    grid = Grid.from_blocks([block_around(*(np.linspace(0.0, 1.0, 5),) * 3)])
    patch = Patch(name, (whole_face(grid.shapes[0], 0, Side.JMAX),), family, kind)
    surface = next(s for s in outside_of(dataclasses.replace(grid, patches=(patch,))).surfaces if s.named)
    assert (surface.name, surface.role) == (family or name, role)
    assert surface.declared is (role is not Role.UNKNOWN)


EVEN, END = np.linspace(0.0, 1.0, 7), ["end", "end"]
TO_WALL, STEEP = (np.expm1(a * np.linspace(0.0, 1.0, 13)) / np.expm1(a) for a in (4.0, 7.0))
TO_BOTH = 0.5 + 0.5 * np.tanh(np.linspace(-3.0, 3.0, 13)) / np.tanh(3.0)
FINE_AWAY = np.array([0.0, 0.05, 0.06, 0.07, 0.4, 1.0])


@pytest.mark.parametrize(
    ("y", "kinds", "roles"),
    [
        (TO_WALL, {}, ["unknown", "unknown", "wall", "far", *END]),
        (TO_WALL, {"imax": "outlet", "kmin": "farfield", "kmax": "symmetry"},
         ["symmetry", "far", "wall", "far", "end", "symmetry"]),
        # OpenFOAM has types of its own for symmetry planes: this is the open side of a tank.
        (TO_WALL, {"imin": "patch", "imax": "outlet"}, ["unknown", "far", "wall", "far", *END]),
        # Converters call all faces far fields, but not all are.
        (TO_WALL, {"jmin": "farfield"}, ["unknown", "unknown", "far", "far", *END]),
        (STEEP, {"jmin": "farfield"}, ["unknown", "unknown", "wall", "far", *END]),
        (TO_BOTH, {"imin": "outlet"}, ["far", "symmetry", "wall", "wall", *END]),
        (FINE_AWAY, {}, ["unknown", "unknown", "unknown", "far", *END]),
    ],
)  # fmt: skip
def test_roles_of_one_block(y, kinds, roles):
    """Two layers of cells along z, others along y; in any length unit."""
    block = block_around(EVEN, y, EVEN[:3])
    patches = tuple(Patch("p", (whole_face(block.shape[:3], 0, Side[side.upper()]),), "", kind)
                    for side, kind in kinds.items())  # fmt: skip
    for size in (1.0, 1e-9):
        found = roles_of(Grid.from_blocks([size * block], patches=patches))
        assert [role.value for role in found.values()] == roles
        # Curved ends are no end planes, nor walls.
        curved = size * (block + [0.0, 0.0, 0.1] * np.sin(block[..., :1]))
        bent = outside_of(Grid.from_blocks([curved]))
        assert bent.roles[4:] == (Role.UNKNOWN,) * 2
        assert [face.plane is None for face in bent.faces] == [False] * 4 + [True] * 2


def test_one_layer_of_cells_is_thin():
    assert thin_direction(Grid.from_blocks([block_around(EVEN, EVEN, EVEN)])) is None
    layer = Grid.from_blocks([block_around(EVEN, np.array([0.0, 9.0]), EVEN)])
    assert [thin_direction(grid).tolist() for grid in (layer, frame_2d())] == [[0, 1, 0], [0, 0, 1]]


SMALL = {"airfoil": 41, "splitter-plate": 8, "hemisphere": 8, "wing": 8, "valve": 8}


@pytest.mark.parametrize("name", SMALL)
def test_walls_of_samples_are_found_without_their_names(name):
    grid = load(name).generate(SMALL[name])
    declared = np.concatenate([s.quads for s in outside_of(grid).of_role(Role.WALL)])
    guessed = np.concatenate([s.quads for s in outside_of(dataclasses.replace(grid, patches=())).of_role(Role.WALL)])
    # All that is called a wall is one, and what is missed are floors, never the body that the grid surrounds.
    assert np.isin(guessed, declared).all()
    assert len(guessed) > 0.3 * len(declared)


def some_blocks_of_a_cube(rng):
    """Some of 2 x 2 x 2 blocks of 2 x 3 x 2 cells in any order, some of them left-handed."""
    blocks = []
    for place in rng.permutation(list(product((0, 1), repeat=3)))[: rng.integers(2, 7)]:
        points = block_around(*(np.linspace(at, at + 1, n) for at, n in zip(place, (3, 4, 3), strict=True)))
        blocks.append(points[::-1] if rng.random() < 0.5 else points)
    return blocks


def groups_of_cells(grid: Grid, both: set[frozenset], undeclared: set[frozenset]) -> int:
    """Nodes of a grid, one cell at a time: at each place, cells joined by faces that are not declared share one; groups
    of them away from plates share theirs if an outside face is undeclared."""
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
        links, shared = [pair for pair in joined if left.issuperset(pair)], set()
        while left:
            group = {left.pop()}
            while more := {n for pair in links for n in pair if group & set(pair)} - group:
                group |= more
            left -= group
            faces = {face for face, cells_at in key.items() if place in face and group.intersection(cells_at)}
            shared.add(len(left) if faces & both or not faces & undeclared else -1)
        count += len(shared)
    return count


@pytest.mark.parametrize("seed", range(24))
def test_nodes_are_those_of_cells_that_faces_join(seed):
    rng = np.random.default_rng(seed)
    blocks, patches = some_blocks_of_a_cube(rng), []
    undivided = find_topology(Grid.from_blocks(blocks))
    shared, outside = np.flatnonzero(undivided.partner >= 0), np.flatnonzero(undivided.external)
    chosen = shared[rng.random(len(shared)) < 0.4 * (seed % 3)]
    chosen = np.unique([chosen, undivided.partner[chosen]])
    declared = rng.random(len(outside)) < [1.0, 0.8, 0.4, 0.0][seed % 4]
    for kind, quads in (("patch", outside[declared]), ("wall", chosen)):
        side, u, v = undivided.quads.places(quads)
        for s, a, b in zip(side.tolist(), u.tolist(), v.tolist(), strict=True):
            patches.append(Patch("p", (Window(s // 6, Side(s % 6), (a, b), (a + 1, b + 1)),), bc_type=kind))
    grid = Grid.from_blocks(blocks, patches=tuple(patches))
    topology = find_topology(grid)
    np.testing.assert_array_equal(np.flatnonzero(topology.external & ~undivided.external), chosen)
    # Both sides of a plate move together.
    np.testing.assert_array_equal(topology.number, undivided.number)
    apart = separated(grid, topology)
    both, undeclared = (
        {
            frozenset(map(tuple, quad))
            for quad in grid.points[undivided.first[undivided.quads.corners[some]]].round(9).tolist()
        }
        for some in (chosen, outside[~declared])
    )
    assert apart.n_unique + grid.n_nodes - len(topology.face_nodes) == groups_of_cells(grid, both, undeclared)
    assert (np.diff(apart.first) > 0).all()
    np.testing.assert_array_equal(apart.number[np.searchsorted(apart.face_nodes, apart.first)], range(apart.n_unique))
    corners = apart.first[apart.quads.corners]
    np.testing.assert_array_equal(grid.points[corners], grid.points[topology.first[topology.quads.corners]])
    for block in range(grid.n_blocks):
        own = np.unique(apart.quads.corners[apart.quads.block_side // 6 == block])
        low, high = np.searchsorted(apart.face_nodes, grid.offsets[block : block + 2])
        np.testing.assert_array_equal(own, np.unique(apart.number[low:high]))


@pytest.mark.parametrize(
    ("types", "connection", "open_faces"),
    [
        (("BCWall", "viscous_solid"), {}, True),
        (("cyclicAMI", "cyclicAMI"), None, True),
        (("BCGeneral", "BCGeneral"), {}, False),
        (("BCWall", "BCInflow"), {}, False),
        (("BCGeneral", "BCGeneral"), {"periodic": Periodicity()}, True),
        (("BCGeneral", "BCGeneral"), {"end": (3, 3, 4), "donor_end": (0, 3, 4)}, True),
        (("BCGeneral", "BCGeneral"), {"begin": (1, 0, 0), "end": (1, 3, 3), "donor_begin": (1, 0, 0)}, True),
    ],
)
def test_connections_decide_but_not_against_walls(types, connection, open_faces):
    """Of three cubes in a row; between the last two are walls on both sides."""
    x, whole, places = (
        np.linspace(0, 1, 4),
        ((0, 0), (3, 3)),
        ((0, Side.IMAX), (1, Side.IMIN), (1, Side.IMAX), (2, Side.IMIN)),
    )
    patches = [Patch("p", (Window(*place, *whole),), bc_type=kind)
               for place, kind in zip(places, (*types, "wall", "BCWALL"), strict=True)]  # fmt: skip
    face = Connection("c", 0, (3, 0, 0), (3, 3, 3), 1, (0, 0, 0), (0, 3, 3), (1, 2, 3))
    grid = Grid.from_blocks(
        [block_around(n + x, x, x) for n in range(3)], patches=tuple(patches),
        connections=() if connection is None else (dataclasses.replace(face, **connection),),
    )  # fmt: skip
    topology = find_topology(grid)
    found = [set(topology.external[topology.quads.of_side(*place)].tolist()) for place in places]
    assert found == [{open_faces}, {open_faces}, {True}, {True}]
    assert separated(grid, topology).n_unique == topology.n_unique + 16 * (1 + open_faces)
    assert (roles_of(grid)["block1.imax"] is Role.WALL) == (types[0] == "BCWall")


@pytest.mark.parametrize(("other", "wakes"), [(False, []), (True, ["block1.imax", "block2.imin"])])
def test_a_wake_is_where_cells_cluster_from_both_sides(other, wakes):
    x = np.linspace(0, 1, 9)
    to_end = 1.0 - (1.0 - x) ** 2.5
    blocks = [block_around(to_end, x, x), block_around(1.0 + (1.0 - to_end[::-1] if other else x), x, x)]
    grid = Grid.from_blocks(blocks)
    topology = find_topology(grid)
    assert [face.label(grid) for face in clustered_interfaces(topology, find_outside(grid, topology))] == wakes


@pytest.mark.parametrize("plate", [False, True])
def test_collapsed_edges_stay_one_node(plate):
    """Of two discs with patches all around and, perhaps, a plate between them, which reaches from rim to axis."""
    grid, topology = discs(), find_topology(discs())
    block = topology.quads.block_side // 6
    label = np.where(topology.external | plate & (topology.partner >= 0) & (block != block[topology.partner]), 0, -1)
    windows = rectangles(grid, topology.quads, label).windows()
    divided = dataclasses.replace(grid, patches=(Patch("p", tuple(windows), bc_type="wall"),))
    assert separated(divided, find_topology(divided)).n_unique == topology.n_unique + plate * (1 + 4 * 4)
