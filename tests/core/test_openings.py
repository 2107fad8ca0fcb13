"""Outside faces that nearly coincide with others: found with their place, refused unless the case says so."""

import dataclasses

import numpy as np
import pytest
from cases import constant, formulas
from grids import block_around, cut_behind_a_body, discs, frame, polar, whole_face

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, deform, set_up
from meshdeform_core.errors import CaseError, MethodError
from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_core.grid.openings import coincident_blocks, describe_openings, find_openings
from meshdeform_core.grid.topology import find_topology

MOVE = formulas("0", "0.01*x", "0")
WALL = BoundarySpec("wall", ("*.jmin",), Kind.MOVING, None, MOVE)


def pair(gap: float = 0.0, cells: int = 4, other: int = 4, flat: bool = False) -> Grid:
    """Two boxes side by side, ``gap`` apart, with so many cells along the interface."""
    one = np.linspace(0.0, 1.0, 5)
    z = np.zeros(1) if flat else np.linspace(0.0, 1.0, 4)
    left = block_around(one, np.linspace(0.0, 1.0, cells + 1), z)
    right = block_around(one + 1.0 + gap, np.linspace(0.0, 1.0, other + 1), z)
    return Grid.from_blocks([left, right])


def openings(grid: Grid):
    return find_openings(grid, find_topology(grid))


@pytest.mark.parametrize("grid", [frame(), polar(), pair(), pair(flat=True)], ids=["frame", "polar", "pair", "2-D"])
def test_closed_grids_have_none(grid):
    assert openings(grid) == ()


@pytest.mark.parametrize("flat", [False, True], ids=["3-D", "2-D"])
@pytest.mark.parametrize("part", [0.002, 0.05, 0.2])
def test_a_gap_is_found_with_its_size_and_what_closes_it(part, flat):
    grid = pair(0.25 * part, flat=flat)
    (found,) = openings(grid)
    assert (found.window.block, found.window.side.label, found.other, found.other_side.label) == (0, "imax", 1, "imin")
    assert found.matching
    assert found.gap == pytest.approx(0.25 * part)
    assert found.relative == pytest.approx(part)
    assert len(found.quads) == (4 if flat else 12)
    assert find_topology(grid, found.tolerance).external.sum() == find_topology(pair(flat=flat)).external.sum()
    assert f"block1.imax[1:5,1:{1 if flat else 4}]" in found.describe(grid)


@pytest.mark.parametrize("finer", [0, 1])
def test_a_gap_is_relative_to_the_finer_of_its_two_sides(finer):
    blocks = [pair().block(number).copy() for number in (0, 1)]
    blocks[finer][..., 0] = 1.0 + 0.4 * (blocks[finer][..., 0] - 1.0)
    blocks[1][..., 0] += 0.01
    (found,) = openings(Grid.from_blocks(blocks))
    assert (found.gap, found.relative) == (pytest.approx(0.01), pytest.approx(0.1))


def test_a_single_node_out_of_place_opens_the_quads_around_it():
    grid = pair()
    points = grid.points.copy()
    grid.block(1, points)[0, 2, 1, 0] += 0.02
    found = openings(grid.moved(points))
    assert sum(len(each.quads) for each in found) == 4
    assert {each.describe(grid).split("[")[0] for each in found} == {"block1.imax"}


def test_a_gap_whose_side_is_a_wall_in_part_is_found():
    def walled(window: Window) -> Grid:
        return dataclasses.replace(pair(0.001), patches=(Patch("wall", (window,), "", "BCWall"),))

    assert openings(walled(whole_face((5, 5, 4), 0, Side.IMAX))) == ()
    assert len(openings(walled(Window(0, Side.IMAX, (0, 0), (2, 3))))) == 1


@pytest.mark.parametrize(
    ("grid", "half", "sides", "quads"),
    [(polar(), np.s_[-1], ("imin", "imax"), 32), (cut_behind_a_body(), np.s_[5:, 0], ("jmin", "jmin"), 8),
     (discs(), np.s_[:, :, -1], ("kmax", "kmax"), 16)],
)  # fmt: skip
def test_a_seam_of_one_block_may_be_open_too(grid, half, sides, quads):
    points = grid.points.copy()
    grid.block(0, points)[half][..., 1] += 1e-3
    (found,) = openings(grid.moved(points))
    assert ((found.window.side.label, found.other_side.label), len(found.quads)) == (sides, quads)


def test_edges_that_touch_with_other_nodes_are_found():
    grid = pair(0.0, 4, 8, True)
    assert describe_openings(grid, openings(grid)) == [
        "block2.imin[1:9,1:1] (8 quads) and block1.imax touch, but their nodes do not match (patched blocks)"
    ]


def test_a_gap_can_be_settled():
    """By a tolerance, by faces that may be open, or as a thin wall that moves."""
    grid, topology = pair(0.001), find_topology(pair(0.001))
    assert set_up(grid, Case((WALL,), tolerance=0.0042)).topology.external.sum() < topology.external.sum()
    set_up(grid, Case((WALL,), open_faces=("block1.imax", "block2.imin")))
    for other in ("block2.jmax", "block1.imax[1:3,1:4]"):
        with pytest.raises(CaseError, match="nearly coincide"):
            set_up(grid, Case((WALL,), open_faces=(other,)))
    plate = BoundarySpec("plate", ("block1.imax", "block2.imin"), Kind.MOVING, None, MOVE)
    specs = plate, BoundarySpec("rest", ("*",), Kind.FIXED)
    assert not any("nearly coincide" in text for text in set_up(grid, Case(specs)).warnings)


def test_a_forgotten_symmetry_plane_is_named_with_the_remedy():
    span = BoundarySpec("far", ("*.jmax", "*.i*"), Kind.FIXED)
    notes = set_up(pair(), Case((WALL, span))).warnings
    (touching,) = [text for text in notes if "touch moving nodes" in text]
    assert "block1.kmin" in touching
    assert 'kind = "symmetry" or "slip"' in touching


def overset(flat: int | None, turn=(0, 1, 2)) -> Grid:
    """A ring round a bar in the middle of a box, reaching across many of its cells; ``flat``: plane, normal to that."""
    ring, box = polar(), block_around(*[np.linspace(-5.0, 5.0, 21)] * 2, np.linspace(-1.0, 2.0, 7))
    blocks = [np.transpose(x, (*turn, 3)) for x in (ring.block(0), box)]
    if flat is not None:
        blocks = [x[:, :, :1] for x in (ring.block(0), box)]
        order = np.roll([0, 1, 2], 2 - flat)
        blocks = [
            np.transpose(x - [0, 0, x[0, 0, 0, 2]], (*np.argsort(order), 3))[..., np.argsort(order)] for x in blocks
        ]
    return Grid.from_blocks([np.ascontiguousarray(x) for x in blocks])


@pytest.mark.parametrize("turn", [(0, 1, 2), (1, 0, 2), (2, 0, 1), (0, 2, 1)], ids=str)
def test_faces_inside_another_block_are_found(turn):
    grid = overset(None, turn)
    found = [each for each in openings(grid) if each.inside]
    # The ring is closed in itself: its inner and outer side and its two ends lie in the box.
    assert {(each.window.block, each.other) for each in found} == {(0, 1)}
    assert len(found) == 4
    assert all(each.relative == 1.0 for each in found)
    assert "lies inside block2, 100% of it up to" in found[0].describe(grid)


@pytest.mark.parametrize("flat", [0, 1, 2])
def test_the_same_in_a_plane(flat):
    found = openings(overset(flat))
    assert [(each.window.block, each.other, each.relative) for each in found] == [(0, 1, 1.0)] * 2


@pytest.mark.parametrize("cells", [8, 16, 36])
def test_curved_interfaces_that_do_not_match_do_not_overlap(cells):
    """Two rings one round the other with other nodes: facets of one lie a little inside the other."""
    inner, outer = (polar(n, 4, 3).block(0) for n in (cells, 3 * cells // 2))
    grid = Grid.from_blocks([inner * [1 / 3, 1 / 3, 1.0], outer])
    found = openings(grid)
    assert not [each for each in found if each.inside]
    told = [f"touch, at most {found[0].gap:.3g} apart, but" in text for text in describe_openings(grid, found)]
    assert told == [True]


@pytest.mark.parametrize(
    ("grid", "message", "warning"),
    [
        (pair(0.001), "block1.imax.*nearly coincide.*0.0042 closes it.* in a boundary entry$", "nearly coincide"),
        (pair(0.0, 4, 8), "their nodes do not match", "nodes do not match"),
        (overset(None), r"block1\.\w+.* lies inside block2.*Say that they are walls: \[grid\] open", "inside block2"),
    ],
)
def test_open_faces_are_refused_unless_the_case_says_so(grid, message, warning):
    with pytest.raises(CaseError, match=message):
        set_up(grid, Case((WALL,)))
    set_up(grid, Case((WALL,), open_faces=True))
    outer = BoundarySpec("rest", ("*",), Kind.FIXED)
    assert any(warning in text for text in set_up(grid, Case((WALL, outer))).warnings)


def test_patched_planes_of_a_rotor_and_a_stator_are_one_note():
    """A block meets two with other nodes: two pairs of faces, one surface."""
    one, z = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 4)
    stator = [block_around(one, np.linspace(n / 2, (n + 1) / 2, 4), z) for n in range(2)]
    grid = Grid.from_blocks([block_around(one - 1.0, np.linspace(0.0, 1.0, 13), z), *stator])
    found = openings(grid)
    assert len(found) > 2
    assert describe_openings(grid, found) == [
        "3 faces touch each other, but their nodes do not match (patched blocks, for example a rotor "
        "and a stator): block1.imax, block2.imin, block3.imin"
    ]


def test_openings_are_described_the_largest_first():
    """Beside a box are one at a small distance and one with other nodes; a third sticks into it from below."""
    line, z = np.linspace(0.0, 1.0, 5), np.linspace(0.0, 1.0, 4)
    grid = Grid.from_blocks([
        block_around(line, line, z), block_around(line + 1.001, line, z),
        block_around(np.linspace(0.0, 1.0, 9), line + 1.0, z),
        block_around(*[0.25 + 0.5 * line] * 2, np.linspace(-0.3, 0.3, 7)),
    ], "abcd")  # fmt: skip
    found = openings(grid)
    assert [len(each.quads) for each in found] == [24] * 5 + [16] * 2 + [12] * 2
    inside = "deep (overset or overlapping blocks); advice"
    assert describe_openings(grid, found, "; advice") == [
        *(
            f"d.{side}[1:5,1:7] (24 quads) lies inside a, 50% of it up to 0.25 {inside}"
            for side in ("imin", "imax", "jmin", "jmax")
        ),
        f"a.kmin[1:5,1:5] (16 quads) lies inside d, 25% of it up to 0.125 {inside}",
        f"d.kmax[1:5,1:5] (16 quads) lies inside a, 100% of it up to 0.3 {inside}",
        "a.imax[1:5,1:4] (12 quads) and b.imin nearly coincide: the gap is up to 0.001, 0.008 of the local edge; "
        "grid.tolerance = 0.0084 closes it",
        "c.jmin[1:9,1:4] (24 quads) and a.jmax touch, but their nodes do not match (patched blocks)",
    ]


@pytest.mark.parametrize("flat", [False, True])
def test_a_block_that_is_there_twice_is_named(flat):
    grid = frame(3, 0 if flat else 2)
    blocks = [grid.block(b) for b in range(grid.n_blocks)]
    again = blocks[2][::-1].transpose(1, 0, 2, 3)
    twice = Grid.from_blocks([*blocks, again])
    topology = find_topology(twice)
    (said,) = coincident_blocks(twice, topology)
    assert said.startswith(f"blocks 'block3' and 'block{len(blocks) + 1}' lie in the same place")
    # Its two interfaces are shared by three blocks each.
    assert topology.crowded == 3 * (3 + 5) * (1 if flat else 2)
    assert coincident_blocks(grid, find_topology(grid)) == []
    apart = dataclasses.replace(twice, components=(*["main"] * len(blocks), "other"))
    assert coincident_blocks(apart, find_topology(apart)) == []


def test_a_moving_block_with_nodes_inside_another_is_named():
    """An inner node of one block at a moving node of the other is a source and is not one."""
    line = np.linspace(0.0, 1.0, 5)
    inner = 0.25 + 0.5 * line
    grid = Grid.from_blocks([block_around(line, line, line), block_around(inner, inner, inner)], ["bg", "body"])
    specs = (
        BoundarySpec("body", ("body.*",), Kind.MOVING, None, constant(0.01, 0.0, 0.0)),
        BoundarySpec("rest", ("bg.*",), Kind.FIXED),
    )
    with pytest.raises(
        MethodError,
        match=r"^body\.imin.* lies inside bg.*finds no place for bg.*name their groups in \[grid\] components",
    ):
        deform(grid, Case(specs))
