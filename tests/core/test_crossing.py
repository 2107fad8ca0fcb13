"""Boundaries that pass through themselves: pairs of faces against an exact twin, cases whose answer is known."""

from fractions import Fraction
from itertools import combinations, product

import numpy as np
import pytest
from cases import INNER, constant, formulas, turning
from grids import block_around, frame, frame_2d, polar

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.boundary.crossing import Contact
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Motion
from meshdeform_core.deform import Case, Setup, deform, set_up
from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_core.methods import Options
from meshdeform_core.numerics.geometry.crossing import FaceTree, crossing_faces
from meshdeform_core.repair import RepairOptions
from meshdeform_core.series import Schedule, deform_series

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
    corners = [[[Fraction(float(x)) for x in corner] for corner in face] for face in (one, two)]
    return all(
        any(pierced([corners[0][n] for n in s], [corners[1][n] for n in t]) for s, t in product(first, second))
        for first, second in product(HALVES, HALVES)
    )


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
    u, v, w = ([x - y for x, y in zip(corner, d, strict=True)] for corner in (a, b, c))
    return sum(u[i] * (v[(i + 1) % 3] * w[(i + 2) % 3] - v[(i + 2) % 3] * w[(i + 1) % 3]) for i in range(3))


def found_to_cross(one, two):
    faces = np.arange(8).reshape(2, 4)
    points = np.concatenate([one, two])
    tree = FaceTree(points, faces.astype(np.int32), np.zeros(2, np.int8))
    return len(crossing_faces(tree, points, faces, np.ones(2, bool))[0]) > 0


@pytest.mark.parametrize("lattice", [0, 3])
def test_pairs_are_those_of_exact_arithmetic(lattice):
    """Random quads, also on a coarse lattice where most tetrahedra are flat and corners coincide in space."""
    random = np.random.default_rng(5)
    middle = random.uniform(0, 1.3, (18, 1, 3))
    points = (middle + random.uniform(-0.7, 0.7, (18, 4, 3))).reshape(-1, 3)
    if lattice:
        points = np.round(points * lattice) / lattice
    faces = np.arange(72).reshape(18, 4)
    faces[::7, 3] = faces[::7, 0]
    faces[1::9, 0] = faces[::9, 1][: len(faces[1::9])]
    asked = random.random(18) < 0.7
    tree = FaceTree(points + random.normal(0, 1, points.shape), faces, np.zeros(18, dtype=np.int8))
    pairs, places = crossing_faces(tree, points, faces, asked)
    wanted = [
        (a, b)
        for a, b in combinations(range(18), 2)
        if (asked[a] or asked[b])
        and not set(faces[a]) & set(faces[b])
        and cross_exactly(points[faces[a]], points[faces[b]])
    ]
    assert [tuple(pair) for pair in pairs] == wanted
    assert len(wanted) > 10
    for (a, b), place in zip(pairs, places, strict=True):
        for face in (a, b):
            corners = points[faces[face]]
            assert (place >= corners.min(axis=0) - 1e-9).all()
            assert (place <= corners.max(axis=0) + 1e-9).all()


@pytest.mark.parametrize("decide", [cross_exactly, found_to_cross])
def test_exact_decision_of_known_pairs(decide):
    square = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=float)
    upright = square[:, [0, 2, 1]] * [0.5, 1, 1] + [0.25, 0.5, -0.5]
    assert decide(square, upright)
    assert not decide(square, upright + [0, 0, 0.5]), "touching is not crossing"
    assert decide(square, upright + [0, 0, np.nextafter(0.5, 0)])
    assert not decide(square, square + [0.5, 0, 0]), "overlapping in one plane is not crossing"


@pytest.mark.parametrize("shift", [-0.5, -0.99, -0.99999])
def test_roof_above_the_floor_does_not_cross(shift):
    assert contact(channel(), moving("roof", "*.kmax", constant(0, 0, shift)), FLOOR, SIDES) is None


@pytest.mark.parametrize("shift", [-1.0, -1.01, -1.3, -5.0])
def test_roof_through_the_floor(shift):
    """Parallel planes cross nowhere; the roof lies outside."""
    found = contact(channel(), moving("roof", "*.kmax", constant(0, 0, shift)), FLOOR, SIDES)
    assert found is not None
    assert found.crossings[0].patches == ("floor", "roof")
    assert found.fraction == pytest.approx(-1.0 / shift, abs=1e-4)
    assert found.crossings[0].point[2] == pytest.approx(0.0, abs=1e-4)


def test_roof_with_fixed_ends_meets_the_neighbours_of_its_edge():
    """The nodes of the ends stay: the roof cannot pass the row below it."""
    ends = BoundarySpec("ends", ("*.i*", "*.j*"), Kind.FIXED)
    found = contact(channel(), moving("roof", "*.kmax", constant(0, 0, -0.9)), FLOOR, ends)
    assert found is not None
    assert {name for crossing in found.crossings for name in crossing.patches} == {"roof", "ends"}
    assert found.fraction < 0.3


@pytest.mark.parametrize("make", [frame, frame_2d])
@pytest.mark.parametrize(("shift", "crosses"), [(1.4, False), (1.6, True), (2.2, True), (2.6, True), (9.0, True)])
def test_body_through_the_far_field(make, shift, crosses):
    """The bar is one wide, the far field two away: it touches at 1.5; from 2.5 on it lies outside as a whole."""
    span = [BoundarySpec("span", ("*.k*",), Kind.SLIP)] if make is frame else []
    bar = BoundarySpec("bar", ("*.i*", "*.j*"), Kind.MOVING, NEAR, constant(shift, 0, 0))
    found = contact(make(), bar, *span)
    assert (found is not None) == crosses
    if found is not None:
        assert found.crossings[0].patches == ("(not selected)", "bar")
        assert found.fraction == pytest.approx(1.5 / shift, abs=1e-3)
        assert found.crossings[0].point[0] == pytest.approx(2.0, abs=1e-3)


def test_turning_and_shifting_everything_is_no_crossing():
    everything = moving("all", "*", turning(150.0))
    assert contact(frame(), everything) is None
    assert contact(frame_2d(), moving("all", "*", constant(1e3, 5, 0))) is None


@pytest.mark.parametrize(("shift", "crosses"), [(1.9, False), (1.99, False), (2.3, True)])
def test_ring_squeezed_to_a_narrow_gap(shift, crosses):
    """Inner radius 1 and outer radius 3: curved walls of the same facets close to each other."""
    ends = BoundarySpec("ends", ("*.k*",), Kind.SLIP)
    found = contact(polar(48, 6, 2), moving("wall", "*.jmin", constant(shift, 0, 0)), ends)
    assert (found is not None) == crosses


def test_a_wall_that_folds_onto_itself():
    """A floor that is bent into a loop: the same patch crosses itself."""
    fold = formulas("where(x > 1, -1.6*(x - 1), 0)", "0", "where(x > 1, 0.8*sin(pi*(x - 1)), 0) - 0.7*(x > 1.7)")
    setup = set_up(channel(20), Case((moving("floor", "*.kmin", fold), SIDES)))
    assert [crossing.patches for crossing in crossings(setup)][:1] == [("floor", "floor")]


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

    def block(cells, low, high):
        line = np.linspace(0.0, 1.0, cells + 1)
        x = block_around(np.linspace(low, high, 4), line, line)
        x[..., 0] += 0.1 * np.sin(3.0 * x[..., 1])
        return x

    grid = Grid.from_blocks([block(8, 0.0, 1.0), block(13, 1.0, 2.0)])
    setup = set_up(grid, Case((moving("all", "*", turning(40.0)),)))
    assert crossings(setup) == ()


@pytest.mark.parametrize("grid", [frame(), frame_2d()], ids=["frame", "frame-2d"])
@pytest.mark.parametrize(("depth", "overlaps"), [(0.5, False), (0.99, False), (1.1, True), (1.4, True)])
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


def told(warnings) -> bool:
    return any("the moved boundary crosses itself" in text for text in warnings)


@pytest.mark.parametrize("times", [(2.0,), (1.0, 2.0), (0.0, 0.5, 1.0, 1.5, 2.0), (2.0, 2.00001), (1.0, 2.0, 3.0)])
def test_every_level_of_a_series_is_tested(times):
    """Whatever was tested before, and however little larger or smaller the displacement is."""
    left = moving("left", "block2.imax", formulas("1.2 * (1 - 4*y*y) * sin(pi * (t - 1.5))", "0", "0"))
    setup = set_up(frame_2d(), Case((left,), {}, Options("tfi"), repair=RepairOptions("off")))
    found = {level.time: told(level.result.warnings) for level in deform_series(setup, Schedule(times), "float64")}
    assert found == {t: np.sin(np.pi * (t - 1.5)) > 0.9 for t in times}
