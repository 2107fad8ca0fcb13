"""Selection, kinds, precedence, constraints and motions."""

import dataclasses
from itertools import permutations

import numpy as np
import pytest
from cases import apply, body_specs, constant, formulas, prescribed, problem_of, told, turning
from grids import block_around, frame, frame_2d, permuted, polar

from meshdeform_core.boundary import UNSELECTED, BoundarySpec, Kind
from meshdeform_core.boundary.classification import given_displacement, given_gradient, with_plates
from meshdeform_core.boundary.constraints import triangles_of
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.boundary.motions.motion import Follow, Motion
from meshdeform_core.boundary.tables import Matching, SurfaceData
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import CaseError, MotionError
from meshdeform_core.grid import Connection, Grid, Patch, Periodicity, Side, Window
from meshdeform_core.grid.planes import plane_normal
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.methods import IDW, Options
from meshdeform_core.numerics.geometry.coincidence import one_side
from meshdeform_core.repair.constraints import Constraints

FRAME = frame()
XYZ = {"x", "y", "z"}
MOVE = constant(0.1, 0.0, 0.0)


def specs_of(*entries):
    return [BoundarySpec(n, (s,) if isinstance(s, str) else s, k, None, m) for n, s, k, m in entries]


def kinds(problem, where):
    points = problem.grid.points[problem.topology.first]
    return set(problem.boundary.kind[where(points)].tolist())


@pytest.mark.parametrize(
    ("pattern", "quads"),
    [
        ("block1.imin", 4 * 3), ("block1.imin[1:3,*]", 2 * 3), ("block1.imin[*,2:]", 4 * 2), ("block1.imin[:2,:2]", 1),
        ("block1.*min", 4 * 3 + 4 * 3 + 16), ("block*.kmin", 15 * 15 - 25), ("*.kmin", 15 * 15 - 25),
        ("bar", 10), ("walls", 10), ("block2/bar", 10), ("b?r", 10), ("*2/w*", 10), ("block1.imin[:,2:]", 4 * 2),
    ],
)  # fmt: skip
def test_patterns(pattern, quads):
    window = Window(1, Side.IMIN, (0, 0), (5, 2))
    grid = dataclasses.replace(FRAME, patches=(Patch("bar", (window,), "walls"),))
    topology = find_topology(grid)
    found = select_quads(grid, topology, [pattern], "test")
    assert len(found) == quads
    assert np.all(topology.external[found])


@pytest.mark.parametrize(
    ("pattern", "message"),
    [
        ("wing", "no patch, family or block face; the grid has no named patches, block faces are .* like block1.imin$"),
        ("blok1.imin", "'blok1.imin' matches no patch, .*; did you mean 'block1.imin'"),
        ("block1.imax", "'block1.imax' selects only faces that are shared with other blocks; expected"),
        ("block1.imin[1:99,*]", "on block1: range '1:99' lies outside the face; expected 1 <= first <= last <= 5$"),
        ("block1.imin[*,0:2]", "range '0:2' lies outside the face; expected 1 <= first <= last <= 4$"),
        ("block1.imin[3:2,*]", "range '3:2' lies outside"), ("block1.imin[3,*]", "'3' is not a range of nodes;"),
        ("block1.imin[1:2]", r"on block1: window \[1:2\] has 1 ranges; expected two, like \[1:65,\*\]$"),
        ("block1.imin[a:b,*]", "'a:b' is not a range"), ("block1.imin[2:2,*]", "contains no cell face"),
        ("block9.imin", "matches no patch"), ("", "matches no patch"),
    ],
)  # fmt: skip
def test_bad_patterns(pattern, message):
    with pytest.raises(CaseError, match=f"^boundary 'test': .*{message}"):
        select_quads(FRAME, find_topology(FRAME), [pattern], "test")


def test_a_window_of_a_plane_grid_has_one_range():
    for grid, name in ((frame_2d(), "block1.imin"), (permuted(frame_2d(), (2, 0, 1), (False,) * 3), "block1.jmin")):
        one, both = ([f"{name}[{part}]"] for part in ("2:4", "*,2:4" if name.endswith("jmin") else "2:4,*"))
        found, expected = (select_quads(grid, find_topology(grid), each, "") for each in (one, both))
        assert len(found) == 2
        np.testing.assert_array_equal(found, expected)
        assert (select_quads(grid, find_topology(grid), ["block1.*"], "") < find_topology(grid).quads.start[1, 0]).all()


def test_strongest_kind_wins():
    problem = problem_of(
        FRAME,
        specs_of(
            ("free", "block1.kmin", Kind.FREE, None),
            ("span", "*.k*", Kind.SLIP, None),
            ("bar", ("block2.imax", "block4.jmax", "block5.jmin", "block7.imin"), Kind.MOVING, MOVE),
        ),
    )
    assert kinds(problem, lambda x: (np.abs(x[:, 0]) < 0.51) & (np.abs(x[:, 1]) < 0.51)) == {Kind.MOVING}
    assert kinds(problem, lambda x: x[:, 0] == -2.0) == {Kind.FIXED}
    names = {p.name: p.kind for p in problem.boundary.patches}
    assert names[UNSELECTED] is Kind.FIXED


@pytest.mark.parametrize("order", [1, -1])
def test_a_face_of_several_entries_has_the_strongest_kind(order):
    entries = ("still", "block2.imax", Kind.FIXED, None), ("bar", "block2.imax", Kind.MOVING, MOVE)
    boundary = problem_of(FRAME, specs_of(*entries[::order])).boundary
    quads = boundary.quads_of(lambda patch: patch.name == "still")
    assert set(boundary.quad_kind[quads].tolist()) == {Kind.MOVING}


def test_where_takes_faces_with_all_corners_inside():
    spec = [BoundarySpec("left", ("*",), Kind.MOVING, expression("x < -1.99 and z < 0.5", XYZ), MOVE)]
    problem = problem_of(FRAME, spec)
    moving = problem.grid.points[problem.topology.first[problem.boundary.kind == Kind.MOVING]]
    assert np.all(moving[:, 0] == -2.0)
    assert np.all(moving[:, 2] < 0.5)


def test_one_cell_thick_grids_slide_on_their_end_planes():
    thin = frame(layers=1)
    problem = problem_of(thin, body_specs(MOVE)[:1])
    assert {p.name: p.kind for p in problem.boundary.patches}["(end planes)"] is Kind.SLIP
    assert any("one cell thick" in note for note in problem.boundary.notes)
    two = Grid.from_blocks([thin.block(b) + [0.0, 0.0, z] for b in range(8) for z in (0.0, 1.0)])
    assert {p.name for p in problem_of(two, body_specs(MOVE)[:1]).boundary.patches} == {"body", UNSELECTED}


def test_table_on_a_wall_that_moves_already_names_both():
    """Also where the table matches a single node of that wall, which is no face of its own."""
    wall = BoundarySpec("wall", ("block2.imax",), Kind.MOVING, None, MOVE)
    points = np.concatenate([FRAME.block(3)[1:3, -1, :2].reshape(-1, 3), FRAME.block(1)[-1, 2, :1]])
    data = SurfaceData(points, np.tile([0.0, 0.1, 0.0], (5, 1)), np.empty((0, 3), dtype=np.int64), "t.csv")
    table = BoundarySpec("t.csv", ("*",), Kind.MOVING, None, Motion((Follow(data, Matching(partial=True)),), {}))
    for specs in permutations([wall, table]):
        problem = problem_of(FRAME, list(specs))
        with pytest.raises(MotionError, match=r"'wall' .*disagree at their shared node block\d \(") as caught:
            prescribed(problem)
        assert "the table 't.csv' moves all boundary nodes that it matches" in str(caught.value)
        assert "remove the motion of 'wall'" in str(caught.value)


def test_plates_of_the_case_are_opened():
    """Both sides of a face between two blocks become outside faces that can be selected; other faces stay shared."""
    topology = find_topology(FRAME)
    grid, opened = with_plates(FRAME, topology, ["block1.imax[1:3,*]"])
    assert [(patch.name, len(patch.windows)) for patch in grid.patches] == [("plate1", 2)]
    np.testing.assert_array_equal(find_topology(grid).partner, opened.partner)
    # Faces of a patch of the file, or of a plate before, are no second one.
    for known, patterns in ((grid, ["block1.imax"]), (FRAME, ["block1.imax[1:3,*]", "block1.imax"])):
        (_, second) = with_plates(known, topology, patterns)[0].patches
        assert (second.name, sum(w.high[0] - w.low[0] for w in second.windows)) == ("plate2", 2 * 2)
    newly = np.flatnonzero(opened.external & ~topology.external)
    assert len(newly) == 2 * 2 * 3
    assert set(topology.quads.block_side[newly] // 6) == {0, 3}
    one = select_quads(FRAME, opened, ["block1.imax"], "plate")
    other = select_quads(FRAME, opened, ["block4.imin"], "plate")
    np.testing.assert_array_equal(np.sort(topology.partner[one]), other)
    # One displacement for both sides: the nodes stay one.
    assert opened.n_unique == topology.n_unique
    problem = set_up(FRAME, Case((BoundarySpec("plate", ("block1.imax",), Kind.MOVING, None, MOVE),),
                                 plates=("block1.imax[1:3,*]",)))  # fmt: skip
    assert problem.boundary.count(Kind.MOVING) == 3 * 4
    # Both sides of a curved plate that slides are one surface, without creases.
    specs = specs_of(("plate", ("block1.imax", "block4.imin"), Kind.SLIP, None), ("end", "*.kmin", Kind.MOVING, MOVE))
    bent = FRAME.moved(FRAME.points + [0.1, 0.0, 0.0] * np.sin(FRAME.points[:, [1]]))
    (surface,) = set_up(bent, Case(tuple(specs), plates=("block1.imax",))).boundary.slip.curved
    assert len(surface.triangles) == 2 * 4 * 3
    assert not surface.creased.any()
    # Whatever the order of the blocks.
    for faces in ([[0, 1, 4, 3], [0, 3, 4, 1], [1, 4, 5, 2], [1, 2, 5, 4]], [[0, 1], [1, 0], [2, 1], [1, 2]]):
        assert one_side(np.array(faces)).tolist() == [True, False, False, True]
    for pattern, message in (("block1.imin", "shared by two blocks"), ("blok1.imax", "did you mean")):
        with pytest.raises(CaseError, match=message):
            with_plates(FRAME, topology, [pattern])


def box_with_curved_sides(bulge, sides=("block1.jmin", "block1.jmax")):
    """A cube whose floor is to move down out of its curved sides; those of x are plane."""
    x = np.linspace(0.0, 1.0, 11)
    block = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1)
    block[..., 1] += bulge(block[..., 0])
    floor = BoundarySpec("floor", ("block1.kmin",), Kind.MOVING, None, constant(0, 0, -0.3))
    plane = BoundarySpec("plane", ("block1.i*",), Kind.SLIP)
    return Grid.from_blocks([block]), [floor, BoundarySpec("top", ("block1.kmax",), Kind.FIXED), plane,
                                       BoundarySpec("sides", sides, Kind.SLIP)]  # fmt: skip


def test_nodes_at_the_rim_of_a_curved_slip_surface_follow_the_wall():
    grid, specs = box_with_curved_sides(lambda x: 1e-3 * np.sin(6 * x))
    result = deform(grid, Case(tuple(specs)))
    assert result.valid
    assert not result.warnings
    moved = result.grid.block(0)
    np.testing.assert_allclose(moved[:, [0, -1], :, 2], moved[:, [5, 5], :, 2], atol=0.03)
    np.testing.assert_allclose(moved[:, 0, :, 1], 1e-3 * np.sin(6 * moved[:, 0, :, 0]), atol=1e-4)


@pytest.mark.parametrize("fold", [40, 100, 130, 170])  # the first as between coarse faces of a smooth surface
def test_creases_of_slip_surfaces_are_named_at_moving_walls_and_held_in_repairs(fold):
    grid, specs = box_with_curved_sides(lambda x: np.tan(np.deg2rad(fold / 2)) * np.abs(x - 0.5))
    # The other two sides are curved, too; nodes where two of them meet are held. A face is a triangle.
    grid.block(0)[1, 0, 0] = grid.block(0)[0, 0, 0]
    setup = set_up(grid.moved(grid.points + [0.1, 0.0, 0.0] * np.sin(3 * grid.points[:, 2:])), Case(tuple(specs)))
    assert all((each.rim == (each.points[:, 2] == 0.0)).all() for each in setup.boundary.slip.curved)
    assert len(setup.boundary.notes) == (fold > 40)
    for crease in setup.boundary.notes:
        assert "'sides' has creases of more than 30 degrees" in crease
        assert "at 2 nodes, first block1 (6, 1, 1)" in crease
    nodes = np.arange(11**3).reshape(11, 11, 11)[[0, 4, 5, 6], ::10, 1:-1].transpose(1, 2, 0)
    held = Constraints.of(setup.original, setup.boundary).held[setup.topology.numbers_of(nodes)]
    assert (held == [True, False, fold > 40, False]).all()


def test_fixed_faces_torn_at_a_moving_edge_are_named():
    grid, specs = box_with_curved_sides(lambda x: 0.0 * x)
    specs[3] = dataclasses.replace(specs[3], kind=Kind.FIXED)
    specs[0] = dataclasses.replace(specs[0], motion=formulas("0", "0", "-0.2*(1+x)"))
    torn = next(text for text in deform(grid, Case(tuple(specs))).warnings if "torn" in text)
    assert "fixed boundary 'sides'" in torn
    assert "by up to 0.4 where its faces are 0.1 long, near (1, 0, 0.1); let" in torn
    vanishing = dataclasses.replace(specs[0], motion=formulas("0", "0", "-0.3*sin(pi*y)**2"))
    # Faces whose nodes all move are not torn, but stretched.
    low, top = Grid.from_blocks([grid.block(0)[:, :, :2]]), dataclasses.replace(specs[1], kind=Kind.MOVING, motion=MOVE)
    for other, entries in ((grid, [vanishing, *specs[1:]]), (low, [specs[0], top, *specs[2:]])):
        assert not [text for text in deform(other, Case(tuple(entries))).warnings if "torn" in text]


def test_symmetry_plane_is_the_middle_of_a_mirrored_grid():
    """Half a grid with a symmetry plane deforms as the half of the whole grid does."""
    whole = frame(4, 6)
    half = Grid.from_blocks([whole.block(b)[:, :, :4] for b in range(8)])
    bend = formulas("0.2*sin(3*z)*sin(3*(1-z))", "0.1*(1-cos(2*pi*z))", "0")
    inner = expression("abs(x) < 0.51 and abs(y) < 0.51", XYZ)
    sides = BoundarySpec("bar", ("*.i*", "*.j*"), Kind.MOVING, inner, bend)
    ends = BoundarySpec("end", ("*.kmin",), Kind.FIXED)
    for options in (Options("idw"), Options("idw", idw=IDW(rotation="none", remove_mean=True))):
        full = problem_of(whole, [sides, BoundarySpec("ends", ("*.k*",), Kind.FIXED)])
        mirrored = problem_of(half, [sides, ends, BoundarySpec("mid", ("*.kmax",), Kind.SYMMETRY)])
        options = dataclasses.replace(options, idw=dataclasses.replace(options.idw, length=3.0))
        one = apply(options, full, told(full))
        two = apply(options, mirrored, told(mirrored))
        for b in range(8):
            np.testing.assert_allclose(whole.block(b, one)[:, :, :4], half.block(b, two), atol=1e-12)


C, S = np.cos(np.pi / 3), np.sin(np.pi / 3)
PITCH = np.array([[C, -S, 0], [S, C, 0], [0, 0, 1]])


def sector():
    """A sixth of a ring, i around the z axis, and what its boundary does except at the two periodic sides."""
    angle, radius, z = np.linspace(0, np.pi / 3, 7), np.linspace(1, 2, 5), np.linspace(0, 1, 4)
    a, r, h = np.meshgrid(angle, radius, z, indexing="ij")
    specs = specs_of(
        ("hub", "block1.jmin", Kind.MOVING, formulas("0.1*x", "0.1*y", "0")),
        ("casing", "block1.jmax", Kind.FIXED, None),
        ("span", "*.k*", Kind.SLIP, None),
    )
    return Grid.from_blocks([np.stack([r * np.cos(a), r * np.sin(a), h], axis=-1)]), specs


@pytest.mark.parametrize("casing", [Kind.FIXED, Kind.SLIP])
@pytest.mark.parametrize("name", ["idw", "tfi", "idw-tfi"])
def test_periodic_sector_moves_alike_by_rotation(name, casing):
    grid, specs = sector()
    specs[1] = dataclasses.replace(specs[1], kind=casing)
    problem = problem_of(grid, [*specs, *specs_of(("pitch", ("block1.imin", "block1.imax"), Kind.PERIODIC, None))])
    moved = grid.block(0, apply(Options(name), problem, told(problem)))
    np.testing.assert_allclose(moved[-1], moved[0] @ PITCH.T, atol=1e-14)
    assert np.abs(moved[0, 1:-1]).max() > 1e-3
    with pytest.raises(CaseError, match="do not match by a translation"):
        problem_of(grid, [*specs[:2], *specs_of(("pitch", ("block1.imin", "block1.kmax"), Kind.PERIODIC, None))])


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("order", [1, -1])
def test_images_found_through_two_periodicities_are_turned(order, axis):
    """Where pitch and span meet, from the root first along the span, then around the axis."""
    grid, specs = sector()
    grid = grid.moved(np.roll(grid.points, axis - 2, axis=1))
    both = specs_of(
        ("pitch", ("block1.imin", "block1.imax")[::order], Kind.PERIODIC, None),
        ("span", ("block1.kmax", "block1.kmin"), Kind.PERIODIC, None),
    )
    problem = problem_of(grid, [*specs[:2], *both[::order]])
    x, periodic = grid.points[problem.topology.first] * (np.arange(3) != axis), problem.boundary.periodic
    assert len(np.unique(periodic.root)) == 5 * (6 + 3 - 1)
    np.testing.assert_allclose(x[periodic.nodes], np.einsum("nij,nj->ni", periodic.turn, x[periodic.root]), atol=1e-14)


def test_periodic_images_of_fixed_nodes_are_fixed():
    grid, specs = sector()
    casing = ("casing", "block1.jmax[1:2,*]", Kind.FIXED, None), ("rest", "block1.jmax[2:*,*]", Kind.SLIP, None)
    pitch = ("pitch", ("block1.imin", "block1.imax"), Kind.PERIODIC, None)
    problem = problem_of(grid, [specs[0], specs[2], *specs_of(*casing, pitch)])
    ends = problem.topology.numbers_of(np.arange(grid.n_nodes).reshape(grid.shapes[0])[[0, -1], -1])
    assert (problem.boundary.kind[ends] == Kind.FIXED).all()


@pytest.mark.parametrize("sides", [1, 2])
def test_gradients_of_given_nodes_are_the_transpose_of_their_displacements(sides):
    """Given on one or on both sides of a period; both then share a gradient, along which they move alike."""
    grid, specs = sector()
    setup = set_up(grid, Case((*specs, *specs_of(("pitch", ("block1.imin", "block1.imax"), Kind.PERIODIC, None)))))
    where = grid, setup.topology, setup.boundary
    hub = np.arange(grid.n_nodes).reshape(grid.shapes[0])[[0, 6][:sides], 0].ravel()
    nodes = np.unique(setup.topology.numbers_of(hub))
    change, gradient = np.random.default_rng(3).standard_normal((2, setup.topology.n_unique, 3))
    setup.boundary.periodic.constrain(change, np.ones(len(change), dtype=bool))
    moved, found = given_displacement(*where, nodes, change[nodes]), given_gradient(*where[::2], nodes, gradient)
    assert (found * change[nodes]).sum() == pytest.approx((gradient * moved).sum(), rel=1e-12)
    given_displacement(*where, nodes, found)
    plane, nodes = problem_of(frame_2d()), np.arange(9)[::-1]
    np.testing.assert_array_equal(
        given_gradient(plane.grid, plane.boundary, nodes, gradient), gradient[nodes] * [1, 1, 0]
    )


def test_a_declared_rotation_turns_the_displacement():
    """One pattern for both sides: only the file says which node belongs to which, of all of them."""
    grid, specs = sector()
    ni, nj, nk = grid.shapes[0]
    turned = Connection(
        "pitch", 0, (0, 0, 0), (0, nj - 1, nk - 1), 0, (ni - 1, 0, 0), (ni - 1, nj - 1, nk - 1), (1, 2, 3),
        Periodicity(rotation_angle=(0.0, 0.0, 60.0)),
    )  # fmt: skip
    grid = dataclasses.replace(grid, connections=(turned,))
    problem = problem_of(grid, [*specs, *specs_of(("pitch", "block1.i*", Kind.PERIODIC, None))])
    moved = grid.block(0, apply(Options("idw"), problem, told(problem)))
    np.testing.assert_allclose(moved[-1], moved[0] @ PITCH.T, atol=1e-14)
    assert np.abs(moved[0, 1:-1]).max() > 1e-3
    half = dataclasses.replace(turned, end=(0, 2, nk - 1), donor_end=(ni - 1, 2, nk - 1))
    for known, select in ((turned, "block1.imin"), (half, "block1.i*")):
        with pytest.raises(CaseError, match="is periodic but has 1 select patterns"):
            problem_of(dataclasses.replace(grid, connections=(known,)), specs_of(("p", select, Kind.PERIODIC, None)))


def test_motion_steps_act_in_order_on_undeformed_formulas():
    both = Motion((*formulas("y", "0", "0").steps, *turning(90).steps), {})
    problem = problem_of(FRAME, body_specs(both))
    nodes = np.flatnonzero(problem.boundary.kind == Kind.MOVING)
    x = problem.grid.points[problem.topology.first[nodes]]
    told = prescribed(problem)[nodes]
    expected = np.stack([-x[:, 1], x[:, 0] + x[:, 1], x[:, 2]], axis=1) - x
    np.testing.assert_allclose(told, expected, atol=1e-14)
    still, turns = (tuple(body_specs(motion)) for motion in (MOVE, turning("t")))
    assert [Case(specs).depends_on_time for specs in (still, turns, still + turns)] == [False, True, True]


def test_the_plane_of_a_thin_strip_far_from_the_origin_is_exact():
    strip = frame_2d()
    far = strip.points * [1.0, 1e-9, 0.0] + [0.0, 0.0, 1e6 / 3]
    np.testing.assert_array_equal(plane_normal(strip.moved(far)), [0.0, 0.0, 1.0])


def table(points, displacement, triangles=None, label="table.csv"):
    return SurfaceData(points, displacement, np.empty((0, 3), np.int64) if triangles is None else triangles, label)


def following(data, **matching):
    return body_specs(Motion((Follow(data, Matching(**matching)),), {}))


def test_exact_and_nearest_tables():
    points = problem_of(FRAME, body_specs(MOVE)).boundary.movers[0][1].nodes.points
    shift = np.stack([0.1 * points[:, 1], -0.1 * points[:, 0], 0 * points[:, 0]], axis=1)
    shuffled = np.random.default_rng(0).permutation(len(points))
    for how, noise, tolerance in (("exact", 0.0, None), ("exact", 1e-3, 0.01), ("nearest", 1e-3, None)):
        data = table(points[shuffled] + noise, shift[shuffled])
        problem = problem_of(FRAME, following(data, how=how, tolerance=tolerance))
        told = prescribed(problem)
        np.testing.assert_array_equal(told[problem.boundary.kind == Kind.MOVING], shift)
        (match,) = problem.boundary.movers[0][1].matches
        assert match.matched.all()
        assert match.used == (len(points), len(points))


@pytest.mark.parametrize("with_surface", [True, False])
def test_interpolation_across_a_non_matching_surface(with_surface):
    """A linear field on a coarser, differently cut bar surface is reproduced on the nodes."""
    coarse = problem_of(frame(2, 2), body_specs(MOVE)).boundary.movers[0][1].nodes
    points, triangles = coarse.points, triangles_of(coarse.faces) if with_surface else None
    matrix = np.array([[0.1, 0.0, 0.2], [0.0, -0.1, 0.1], [0.0, 0.0, 0.05]])
    specs = following(table(points, points @ matrix.T, triangles), how="interpolate", tolerance=0.3)
    problem = problem_of(FRAME, specs)
    nodes = problem.boundary.kind == Kind.MOVING
    told = prescribed(problem)[nodes]
    expected = problem.grid.points[problem.topology.first[nodes]] @ matrix.T
    np.testing.assert_allclose(told, expected, atol=1e-12 if with_surface else 2e-3)


def test_matchings_that_make_no_sense_are_refused():
    with pytest.raises(CaseError, match="unknown; known are exact"):
        Matching("closest")
    for wrong in (-1.0, 0.0, np.inf):
        with pytest.raises(CaseError, match="positive length"):
            Matching("exact", wrong)


def test_deformed_grids_as_displacement():
    target = FRAME.moved(FRAME.points + 0.05 * np.sin(FRAME.points[:, [1, 2, 0]]))
    problem = problem_of(FRAME, following(target))
    told = prescribed(problem)
    assert problem.boundary.movers[0][1].matches[0].how == "same nodes"
    nodes = problem.boundary.kind == Kind.MOVING
    flat = problem.topology.first[nodes]
    np.testing.assert_array_equal(told[nodes], target.points[flat] - FRAME.points[flat])
    faces = [target.block(1)[-1], target.block(6)[0], target.block(3)[:, -1], target.block(4)[:, 0]]
    surface = Grid.from_blocks([f[:, :, None] for f in faces])
    problem = problem_of(FRAME, following(surface))
    again = prescribed(problem)
    np.testing.assert_array_equal(again[nodes], told[nodes])
    between = Grid.from_blocks([(0.6 * target.block(1)[-1] + 0.4 * target.block(6)[0])[:, :, None]])
    with pytest.raises(MotionError, match=r"could be any of the faces block2\.imax, block7\.imin"):
        problem_of(FRAME, following(between))
    wrong = Grid.from_blocks([np.zeros((9, 9, 1, 3)) + np.arange(9)[:, None, None, None]])
    with pytest.raises(MotionError, match="no selected block face has this size"):
        problem_of(FRAME, following(wrong))


@pytest.mark.parametrize("layers", [1, 3])
def test_a_curved_symmetry_is_named_with_its_distance_from_a_plane(layers):
    line = np.linspace(0.0, 1.0, 3)
    block = block_around(line, line, line[:layers])
    block[1, 0, :, 1] = 0.03
    message = (
        r"'wall' is a symmetry but not plane: block1\.jmin lies up to 0.02 off its mean plane, at \(0.5, 0.03, 0\);"
    )
    with pytest.raises(CaseError, match=message):
        problem_of(Grid.from_blocks([block]), specs_of(("wall", "*.jmin", Kind.SYMMETRY, None)))


@pytest.mark.parametrize(("bend", "remedy"), [(0.0, "they are flat: symmetry"), (0.1, 'give them a kind: "slip" lets')])
@pytest.mark.parametrize("entries", [(0,), (0, 2), (1,), (1, 2)])
def test_faces_that_nothing_selects_beside_moving_nodes_come_with_a_remedy(entries, bend, remedy):
    """Two end planes, one of them plane or both; the motion of the hub is a table where its number is 1."""
    grid = polar(12, 3, 2)
    x = grid.points
    grid = grid.moved(x + bend * np.outer(np.sin(x[:, 0]) * (x[:, 2] == 1.0), [0, 0, 1]))
    hub = grid.points[np.hypot(*x[:, :2].T) < 1.01]
    follow = Motion((Follow(table(hub, 0.0 * hub + 0.1), Matching("exact", partial=True)),), {})
    specs = specs_of(("hub", "block1.jmin", Kind.MOVING, MOVE), ("table", "*", Kind.MOVING, follow),
                     ("casing", "block1.jmax", Kind.FIXED, None))  # fmt: skip
    *others, note = problem_of(grid, [specs[n] for n in entries]).boundary.notes
    places = "block1.kmin, block1.kmax"
    assert note.startswith(f"faces that no boundary entry selects touch moving nodes but are fixed: {places}; {remedy}")
    assert note.endswith("`meshdeform init --table` writes one") == (entries == (1,))
    assert len(others) == (entries != (1,))
