"""Boundaries that pass through themselves: pairs of faces against an exact twin, cases whose answer is known."""

from fractions import Fraction
from itertools import combinations, product

import numpy as np
import pytest
from cases import INNER, STILL, body_specs, constant, everything_moves, formulas, prescribed, problem_of, turning
from grids import block_around, frame, frame_2d

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.crossing import Contact
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion
from meshdeform_core.deform import Case, Setup, deform, set_up
from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_core.methods import Options
from meshdeform_core.numerics.geometry.crossing import BESIDE, ORDINARY, SLIDING, crossing_faces
from meshdeform_core.numerics.geometry.surface import TriangleTree
from meshdeform_core.quality.listed import find_pinned
from meshdeform_core.quality.original import Original
from meshdeform_core.repair import RepairOptions
from meshdeform_core.wording import kind_of

NEAR = expression(INNER, {"x", "y", "z"})


def contact(grid: Grid, *specs: BoundarySpec) -> Contact | None:
    setup = set_up(grid, Case(specs))
    return setup.undeformed.contact(lambda part: setup.displacement(0.0, part))


def crossings(setup: Setup):
    return setup.undeformed.crossings(setup.displacement(0.0))


def moving(name: str, select: str, motion: Motion, where=None) -> BoundarySpec:
    return BoundarySpec(name, (select,), Kind.MOVING, where, motion)


def channel(cells: int = 6) -> Grid:
    line = np.linspace(0.0, 1.0, cells + 1)
    return Grid.from_blocks([block_around(2.0 * line, line, line)])


FLOOR = BoundarySpec("floor", ("*.kmin",), Kind.FIXED)
SIDES = BoundarySpec("sides", ("*.i*", "*.j*"), Kind.SLIP)


HALVES = (((0, 1, 2), (2, 3, 0)), ((1, 2, 3), (3, 0, 1)))
"""The triangles of a face that is divided from corner 0 to 2, and from 1 to 3."""


def cross_exactly(one, two):
    """Do two faces (4, 3) cross whatever their diagonals, in rational arithmetic?"""
    # Faces whose boxes are apart do not cross.
    if (one.max(axis=0) < two.min(axis=0)).any() or (two.max(axis=0) < one.min(axis=0)).any():
        return False
    a, b = np.vectorize(Fraction, otypes=[object])(np.stack([one, two]))
    halves = product(HALVES, HALVES)
    return all(any(pierced(a[[*s]], b[[*t]]) for s, t in product(first, second)) for first, second in halves)


def pierced(one, two):
    """Does an edge of one triangle pierce the other?"""
    for edges, triangle in ((one, two), (two, one)):
        for k in range(3):
            p, q = edges[k], edges[(k + 1) % 3]
            around = [volume(p, q, triangle[side], triangle[(side + 1) % 3]) for side in range(3)]
            if volume(*triangle, p) * volume(*triangle, q) < 0 and (max(around) < 0 or min(around) > 0):
                return True
    return False


def volume(a, b, c, d):
    return (a - d) @ np.cross(b - d, c - d)


def crossing_places(one, two):
    points, faces = np.concatenate([one, two]), np.arange(8, dtype=np.int32).reshape(2, 4)
    return crossing_faces(points, faces, np.zeros(2, np.int8), np.ones(2, bool))[1]


@pytest.mark.parametrize("lattice", [0, 3])
def test_pairs_are_those_of_exact_arithmetic(lattice):
    """Random quads, also on a coarse lattice where most tetrahedra are flat and corners coincide in space."""
    random = np.random.default_rng(5)
    middle = random.uniform(0, 1.3, (14, 1, 3))
    points = (middle + random.uniform(-0.7, 0.7, (14, 4, 3))).reshape(-1, 3)
    if lattice:
        points = np.round(points * lattice) / lattice
    faces = np.arange(56).reshape(14, 4)
    faces[::7, 3] = faces[::7, 0]
    faces[1::9, 0] = faces[::9, 1][: len(faces[1::9])]
    asked, role = random.random(14) < 0.7, random.choice([ORDINARY, BESIDE, SLIDING, SLIDING], 14)
    pairs, places = crossing_faces(points, faces, role.astype(np.int8), asked)
    wanted = [
        (a, b)
        for a, b in combinations(range(14), 2)
        if (asked[a] or asked[b])
        and not set(faces[a]) & set(faces[b])
        and {role[a], role[b]} != {BESIDE, SLIDING}
        and cross_exactly(points[faces[a]], points[faces[b]])
    ]
    assert [tuple(pair) for pair in pairs] == wanted
    assert len(wanted) > 5
    for (a, b), place in zip(pairs, places, strict=True):
        for face in (a, b):
            corners = points[faces[face]]
            assert (place >= corners.min(axis=0) - 1e-9).all()
            assert (place <= corners.max(axis=0) + 1e-9).all()


@pytest.mark.parametrize("shift", [-0.99, -0.99999, -1.0, -1.01, -5.0])
def test_roof_to_the_floor_and_through_it(shift):
    """Parallel planes cross nowhere; the roof lies outside."""
    found = contact(channel(), moving("roof", "*.kmax", constant(0, 0, shift)), FLOOR, SIDES)
    assert (found is not None) == (shift <= -1.0)
    if found is not None:
        assert found.crossings[0].patches == ("floor", "roof")
        assert found.fraction == pytest.approx(-1.0 / shift, abs=1e-4)
        assert found.crossings[0].point[2] == pytest.approx(0.0, abs=1e-4)


@pytest.mark.parametrize("make", [frame, frame_2d])
@pytest.mark.parametrize(("shift", "crosses"), [(1.4, False), (1.6, True), (2.6, True)])
def test_body_through_the_far_field(make, shift, crosses):
    """The bar is one wide, the far field two away: it touches at 1.5; from 2.5 on it lies outside as a whole."""
    span = [BoundarySpec("span", ("*.k*",), Kind.SLIP)] if make is frame else []
    span.append(BoundarySpec("upper", ("*.imax",), Kind.FIXED, expression("x > 1.9 and y > 0.1", {"x", "y"})))
    bar = BoundarySpec("bar", ("*.i*", "*.j*"), Kind.MOVING, NEAR, constant(shift, 0, 0))
    found = contact(make(), bar, *span)
    assert (found is not None) == crosses
    if found is not None:
        assert [each.patches for each in found.crossings] == [("(not selected)", "bar"), ("bar", "upper")]
        assert f": from {found.fraction:.2%} of the motion onwards {found.crossings[0]}" in found.message
        assert kind_of(found.message) == "no valid grid: crossing of (not selected) and bar"
        assert found.fraction == pytest.approx(1.5 / shift, abs=1e-3)
        assert found.crossings[0].point[0] == pytest.approx(2.0, abs=1e-3)
        assert make is frame or found.crossings[0].point[2] == 0.0


def test_a_wall_that_folds_onto_itself():
    """A floor that is bent into a loop: the same patch crosses itself."""
    fold = formulas("where(x > 1, -1.6*(x - 1), 0)", "0", "where(x > 1, 0.8*sin(pi*(x - 1)), 0) - 0.7*(x > 1.7)")
    setup = set_up(channel(20), Case((moving("floor", "*.kmin", fold), SIDES)))
    assert [crossing.patches for crossing in crossings(setup)][:1] == [("floor", "floor")]


@pytest.mark.parametrize("order", [1, -1])
def test_crossings_are_those_of_all_pairs_of_faces_by_their_strongest_patches(order):
    """A side of a hollow bar bulges through the other one and drags along the fixed faces beside it."""
    left = moving("left", "block2.imax", formulas("1.1 + 1.6 * (1 - 4*y*y) * z**2", "-0.1", "0.04 + 0.1*y"))
    right, sides = moving("right", "block7.imin", STILL), BoundarySpec("sides", ("*.i*", "*.j*"), Kind.FIXED)
    entries = left, right, BoundarySpec("ends", ("*.k*",), Kind.FREE), sides
    setup = set_up(frame(), Case(entries[::order]))
    corners, displacement = setup.topology.quads.corners, setup.displacement(0.0)
    x, names, places = setup.grid.points[setup.topology.first] + displacement, dict[int, str](), {}
    for patch in sorted(setup.boundary.patches, key=lambda patch: patch.kind)[1:]:
        names |= dict.fromkeys(patch.quads.tolist(), patch.name)
    names |= {quad: "left" for quad in names if displacement[corners[quad]].any()}
    for pair in combinations(sorted(names), 2):
        patches, faces = tuple(sorted(names[quad] for quad in pair)), corners[list(pair)]
        if "left" in patches and not set(faces[0]) & set(faces[1]) and cross_exactly(*x[faces]):
            places.setdefault(patches, []).append(crossing_places(*x[faces])[0])
    found = crossings(setup)
    counts = [(patches, len(at)) for patches, at in places.items()]
    assert [(each.patches, each.count) for each in found] == sorted(counts, key=lambda each: -each[1])
    assert len(found) > 1
    for each in found:
        at = np.array(places[each.patches])
        middle = np.argmin(np.linalg.norm(at - at.mean(axis=0), axis=1))
        np.testing.assert_allclose(each.point, at[middle], atol=1e-5)


def test_slip_planes_that_the_motion_carries_along_are_not_crossed():
    assert crossings(set_up(frame(), Case(tuple(body_specs(constant(0.6, 0, 0.5)))))) == ()


def test_a_block_that_moves_within_another_does_not_lie_outside():
    line = np.linspace(-1.0, 1.0, 5)
    grid = Grid.from_blocks([block_around(*[size * line] * 3) for size in (4.0, 1.0)])
    setup = set_up(grid, Case((moving("inner", "block2.*", constant(0.5, 0, 0)),), open_faces=True))
    assert setup.undeformed.contact(lambda part: setup.displacement(0.0, part)) is None


def test_plate_without_thickness_does_not_cross_itself():
    """Both sides of a plate within the grid have the same nodes, here strongly bent."""
    line = np.linspace(0.0, 1.0, 7)
    blocks = [block_around(line, line, line - 1.0), block_around(line, line, line)]
    faces = [Window(0, Side.KMAX, (1, 1), (5, 5)), Window(1, Side.KMIN, (1, 1), (5, 5))]
    walls = tuple(Patch(f"wall{n}", (face,), bc_type="BCWall") for n, face in enumerate(faces))
    plate = moving("plate", "wall*", formulas("0", "0", "0.3*sin(9*x)*cos(7*y)"))
    setup = set_up(Grid.from_blocks(blocks, patches=walls), Case((plate,)))
    assert setup.boundary.count(Kind.MOVING) == 25
    assert crossings(setup) == ()


def test_faces_that_abut_without_matching_are_no_crossing():
    """Two blocks side by side with other numbers of cells on a curved interface; both move alike, and differently."""

    def blocks(bend):
        for cells, low, high in ((8, 0.0, 1.0), (13, 1.0, 2.0)):
            line = np.linspace(0.0, 1.0, cells + 1)
            x = block_around(np.linspace(low, high, 4), line, line)
            x[..., 0] += bend * np.sin(3.0 * x[..., 1])
            yield x

    setup = set_up(Grid.from_blocks([*blocks(0.1)]), Case((moving("all", "*", turning(40.0)),)))
    assert crossings(setup) == ()
    # A bar that touches nothing comes to lie across a plane interface, and only there.
    bar = block_around(np.linspace(3.0, 4.0, 4), *[np.linspace(0.3, 0.7, 4)] * 2)
    through = moving("all", "*", formulas("where(x > 2.5, -2.5, 0)", "0", "0"))
    assert crossings(set_up(Grid.from_blocks([*blocks(0.0), bar]), Case((through,))))


@pytest.mark.parametrize("grid", [frame(), frame_2d()], ids=["frame", "frame-2d"])
@pytest.mark.parametrize(("depth", "overlaps"), [(0.99, False), (1.1, True)])
def test_a_wall_through_its_body_is_told_although_every_cell_is_valid(grid, depth, overlaps):
    """The left side of a hollow bar bulges to the right: no cells lie between it and the right side."""
    bulge = formulas(f"{depth} * (1 - 4*y*y)", "0", "0")
    specs = [moving("left", "block2.imax", bulge), BoundarySpec("ends", ("*.kmin", "*.kmax"), Kind.SLIP)]
    specs = specs[: grid.dimension - 1]
    result = deform(grid, Case(tuple(specs), {}, Options("tfi"), repair=RepairOptions("off")))
    assert result.valid
    told = [text for text in result.warnings if "the grid overlaps itself there" in text]
    assert bool(told) == overlaps
    if told:
        assert "the moved boundary crosses itself: '(not selected)' and 'left' meet at (0." in told[0]


def pinned(grid, motion):
    problem = problem_of(grid, everything_moves(motion))
    return find_pinned(Original(grid, problem.topology), problem.boundary, prescribed(problem))


def slab(cells_across=1):
    line = np.linspace(0.0, 1.0, 5)
    return Grid.from_blocks([block_around(line, line, np.linspace(0.0, 0.1, cells_across + 1))])


def test_what_moves_rigidly_can_give_way_or_was_collapsed_is_not_named():
    for grid in (slab(), frame(3, 1), frame_2d(3)):
        assert pinned(grid, turning(170.0)) is None
    # Four cells across: the nodes between are free, whatever the boundary does.
    dent = "where(z > 0.09, -0.2, 0) * where(x > 0.2 and x < 0.8 and y > 0.2 and y < 0.8, 1, 0)"
    assert pinned(slab(4), formulas("0", "0", dent)) is None
    # A wedge whose inner face is a line.
    points = slab().points.copy()
    points[points[:, 0] == 0.0, 2] = 0.0
    assert pinned(slab().moved(points), turning(40.0)) is None


def test_a_layer_turned_inside_out_is_told_with_its_place():
    """Where x > 0.6 the upper face goes below the lower one: the cells from there on, 4 in a row."""
    found = pinned(slab(), formulas("0", "0", "where(x > 0.6 and z > 0.05, -0.2, 0)")) or ""
    assert "16 cells" in (pinned(slab(), formulas("0", "0", "where(z > 0.05, -0.1, 0)")) or ""), "exactly flat"
    # Between the nodes at 0.5 and 0.75 only two of the corners have changed their sign.
    assert "8 cells, whose nodes are all prescribed, are inverted" in found
    assert "first in block1 at (3, 1, 1), around (0.625, 0.125, 0)" in found


def test_corner_of_a_plane_grid():
    """The cell at the corner of a square block has four nodes on its boundary only if it is one cell wide."""
    line = np.linspace(0.0, 1.0, 4)
    grid = Grid.from_blocks([block_around(line, np.array([0.0, 0.2]), np.zeros(1))])
    found = pinned(grid, formulas("0", "where(y > 0.1 and x < 0.1, -0.3, 0)", "0")) or ""
    assert "1 cell, whose nodes are all prescribed, is inverted" in found
    assert "first in block1 at (1, 1, 1)" in found


def to_segment(p, a, b):
    """Distances (n, m) of points (n, 1, 3) from segments (m, 3)."""
    along = np.einsum("nmi,mi->nm", p - a, b - a) / np.maximum(((b - a) ** 2).sum(axis=-1), 1e-300)
    return np.linalg.norm(p - a - np.clip(along, 0.0, 1.0)[..., None] * (b - a), axis=-1)


def to_triangles(points, corners):
    """Distances (n, m): to the plane where the foot of the perpendicular is inside, else to the nearest edge."""
    p, (a, b, c) = points[:, None], np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inside = np.ones((len(points), len(corners)), dtype=bool)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("nmi,mi->nm", p - one, np.cross(normal, other - one)) >= 0
    edges = np.min([to_segment(p, *pair) for pair in ((a, b), (b, c), (c, a))], axis=0)
    return np.where(inside, np.abs(np.einsum("nmi,mi->nm", p - a, normal)), edges)


@pytest.mark.parametrize("count", [1, 9, 200])
def test_closest_points_are_those_of_all_triangles(count):
    rng = np.random.default_rng(count)
    # Small triangles in a large flat box: most are far from any point, and bounds of boxes matter on every axis.
    corners = rng.uniform(-1, 1, (count, 1, 3)) * [10.0, 5.0, 2.0] + rng.uniform(-0.5, 0.5, (count, 3, 3))
    points = rng.uniform(-1.5, 1.5, (300, 3)) * [10.0, 5.0, 2.0]
    tree = TriangleTree(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    triangle, weights, distance = tree.closest(points)
    expected = to_triangles(points, corners)
    np.testing.assert_allclose(distance, expected.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(expected[np.arange(300), triangle], distance, rtol=1e-12)
    assert (weights >= -1e-14).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    at = np.einsum("nc,ncd->nd", weights, corners[triangle])
    np.testing.assert_allclose(np.linalg.norm(points - at, axis=1), distance, rtol=1e-10)
    # Looked for within a distance only.
    within = distance * rng.choice([0.5, 0.999, 1.001, 3.0], 300)
    near, some = within > distance, tree.closest(points, within)
    assert np.isinf(some[2][~near]).all()
    for all_found, found in zip((triangle, weights, distance), some, strict=True):
        np.testing.assert_array_equal(found[near], all_found[near])
