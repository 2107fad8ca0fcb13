"""blockMeshDict files: against OpenFOAM's own program where it is installed, closed forms, and refusals."""

from __future__ import annotations

import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from poly_mesh_witness import read_mesh, run_foam, write_system
from scipy.spatial import cKDTree

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid, Side
from meshdeform_core.grid.connections import connected_nodes, periodic_image
from meshdeform_core.grid.topology import find_topology, quads_of_patches
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.openfoam.block_mesh_dict import Section, arc_about, arc_by_angle, arc_through, divide

HEAD = "FoamFile { version 2.0; format ascii; class dictionary; object blockMeshDict; }\n"
CUBE = "vertices ((0 0 0) (1 0 0) (1 1 0) (0 1 0) (0 0 1) (1 0 1) (1 1 1) (0 1 1));\n"
BLOCK = "blocks (hex (0 1 2 3 4 5 6 7) (4 3 2) simpleGrading (1 1 1));\n"
ONE = CUBE + BLOCK

CURVED = (
    HEAD
    + """
convertToMeters 0.1;   // comment
n 6; dims ($n 5 4); common { h 2; }
vertices (
 (0 0 0) (2 0 0) (2 1.2 0) (0 1 0) name v4 (0 0 $common.h) (2.1 0 2) (2 1 2) (0 1 2.2) (4 0 0) (4 1.2 0) (4 0 2) (4 1 2)
);
blocks (
 hex (0 1 2 3 v4 5 6 7) $dims edgeGrading (2 2 3 3 1 1 ((0.3 0.4 3) (0.7 0.6 0.2)) 1 4 4 -3 4)
 hex (1 8 9 2 5 10 11 6) zone1 (7 5 4) edgeGrading (1 1 1 1 1 1 1 ((0.3 0.4 3) (0.7 0.6 0.2)) 4 1 1 -3)
);
edges (
 spline 0 1 ((0.5 0.3 0.1) (1.4 -0.2 0)) BSpline 3 2 ((0.5 1.3 0.1) (1.4 1.2 0)) polyLine v4 5 ((1 0.2 2.1))
 arc 1 2 (2.2 0.6 -0.1) arc 10 8 (4.5 0 1) line 9 11
);
boundary ( left { type wall; faces ((0 4 7 3)); } right { type patch; faces ((8 9 11 10)); } );
mergePatchPairs ();
"""
)

WEDGE = (
    HEAD
    + """
vertices (
 (0 0 0) (0.9659258262890683 -0.2588190451025207 0) (0.9659258262890683 0.2588190451025207 0)
 (0 0 1) (0.9659258262890683 -0.2588190451025207 1) (0.9659258262890683 0.2588190451025207 1)
 (1.9318516525781366 -0.5176380902050415 0) (1.9318516525781366 0.5176380902050415 0)
 (1.9318516525781366 -0.5176380902050415 1) (1.9318516525781366 0.5176380902050415 1)
);
blocks (
 hex (0 1 2 0 3 4 5 3) (4 3 5) simpleGrading (1 1 1)
 hex (1 6 7 2 4 8 9 5) (4 3 5) simpleGrading (2 1 1)
);
edges ( arc 1 2 (1 0 0) arc 4 5 (1 0 1) arc 6 7 (2 0 0) arc 8 9 (2 0 1) );
boundary (
 low { type cyclic; neighbourPatch high; transform rotational; rotationAxis (0 0 1); rotationCentre (0 0 0);
       faces ((0 1 4 3) (1 6 8 4)); }
 high { type cyclic; neighbourPatch low; transform rotational; rotationAxis (0 0 1); rotationCentre (0 0 0);
        faces ((0 2 5 3) (2 7 9 5)); }
 in { type patch; faces ((0 1 2 0) (1 6 7 2)); }
 out { type patch; faces ((3 4 5 3) (4 8 9 5)); }
 shroud { type wall; faces ((6 7 9 8)); }
 axis { type empty; faces ((0 3 3 0)); }
);
"""
)


def read(tmp_path: Path, text: str) -> Grid:
    path = tmp_path / "blockMeshDict"
    path.write_text(text)
    return read_grid(path)


UNDECLARED = WEDGE.replace(" axis { type empty; faces ((0 3 3 0)); }", "")


@pytest.mark.parametrize("text", [CURVED, WEDGE, UNDECLARED], ids=["curved", "wedge", "axis in no patch"])
def test_nodes_and_patches_are_those_of_block_mesh(text, tmp_path):
    """Every point of OpenFOAM's program is a node, and every node is one of its points, to round-off."""
    write_system(tmp_path, blockMeshDict=text)
    run_foam("blockMesh", tmp_path)
    known = read_mesh(tmp_path)
    grid = read_grid(tmp_path / "system/blockMeshDict")
    far, found = cKDTree(known.points).query(grid.points)
    assert far.max() < 1e-14
    assert len(set(found.tolist())) == len(known.points)
    write_grid(grid, tmp_path / "own/case.foam")
    own, declared = ([(name, e["type"], e["nFaces"]) for name, e in mesh.patches.items()]
                     for mesh in (read_mesh(tmp_path / "own"), known))  # fmt: skip
    assert own == declared


def test_public_benchmark_is_read_as_its_oracle(third_party):
    """Turek and Hron's flap: 19 blocks with arcs and gradings, against an independent reader's nodes."""
    grid, known = (read_grid(third_party / "turek" / name) for name in ("blockMeshDict", "turek.p3d"))
    assert grid.shapes == known.shapes
    np.testing.assert_allclose(grid.points, known.points, rtol=0, atol=1e-14)
    types = {patch.name: patch.bc_type for patch in grid.patches}
    assert types == dict.fromkeys(("front", "back"), "empty") | dict.fromkeys(("inlet", "outlet"), "patch") | (
        dict.fromkeys(("top", "bottom", "flap", "cylinder"), "wall"))  # fmt: skip
    topology = find_topology(grid)
    assert topology.external.sum() == len(quads_of_patches(topology.quads, grid.patches)[0])


DEFAULTS = {
    WEDGE: ("axis", "empty"),
    UNDECLARED: ("defaultFaces", "empty"),
    UNDECLARED + "defaultPatch { name rest; type wall; }": ("rest", "wall"),
    WEDGE.replace("axis {", "in2 { type patch; faces ((0 3 3 0)); } axis {"): ("axis", "empty"),
}


@pytest.mark.parametrize("text", DEFAULTS)
def test_patches_of_a_wedge_and_the_default_patch(text, tmp_path):
    """Sides that are collapsed to lines have no faces; other entries of a patch than those of its faces stay."""
    grid = read(tmp_path, text.replace("{ type wall; faces", "{ type wall; inGroups 1 (walls); nFaces 7; faces"))
    known = [(name, "cyclic", 2) for name in ("low", "high")] + [(name, "patch", 2) for name in ("in", "out")]
    known += [("shroud", "wall", 1)] + [("in2", "patch", 0)] * ("in2" in text) + [(*DEFAULTS[text], 0)]
    assert [(patch.name, patch.bc_type, len(patch.windows)) for patch in grid.patches] == known
    write_grid(grid, tmp_path / "own/case.foam")
    assert read_mesh(tmp_path / "own").patches["shroud"]["inGroups"] == "1 (walls)"
    assert (tmp_path / "own/constant/polyMesh/boundary").read_text().count("nFaces") == len(known)


AWAY = re.sub(r"(?<!Axis )\((\S+) (\S+ \d)\)", lambda found: f"({float(found[1]) + 5!r} {found[2]})", WEDGE)
CYCLIC = {
    "an axis": WEDGE.replace("transform rotational;", ""),
    "another centre": AWAY.replace("rotationCentre (5.0 0 0)", "rotationCentre (0.5 0 3)") + "scale 0.1;",
}


@pytest.mark.parametrize("name", CYCLIC)
def test_cyclic_patches_are_periodic_connections(name, tmp_path):
    grid = read(tmp_path, CYCLIC[name])
    assert [connection.name for connection in grid.connections] == ["low-1", "low-2"]
    for connection in grid.connections:
        own, donor = connected_nodes(grid, connection)
        assert connection.periodic is not None
        moved = periodic_image(grid.points[own], connection.periodic)
        np.testing.assert_allclose(moved, grid.points[donor], atol=1e-14)
    grid = read(tmp_path, WEDGE.replace(" 0.5176380902050415 0)", " 0.5176380902050415 0.3)"))
    assert grid.connections == ()
    assert grid.notes == (f"{grid.path}: no motion maps cyclic patch low onto high; they are not connected",)


def test_translational_cyclic_patches_may_be_numbered_differently(tmp_path):
    text = (
        HEAD
        + CUBE
        + """blocks (hex (1 2 3 0 5 6 7 4) (3 4 2) simpleGrading (3 1 1));
    boundary (
      a { type cyclic; neighbourPatch b; faces ((0 1 5 4)); }
      b { type cyclic; neighbourPatch a; faces ((3 2 6 7)); }
    ); scale (1 3 1);"""
    )
    grid = read(tmp_path, text)
    (connection,) = grid.connections
    own, donor = connected_nodes(grid, connection)
    np.testing.assert_allclose(grid.points[own] + [0, 3, 0], grid.points[donor], atol=1e-15)
    assert {patch.name for patch in grid.patches} == {"a", "b", "defaultFaces"}


def test_arcs_lie_on_their_circles():
    first, last = np.array([1.0, 0, 0]), np.array([0, 1.0, 0])
    at = np.linspace(0, 1, 7)
    exact = np.stack([np.cos(at * np.pi / 2), np.sin(at * np.pi / 2), 0 * at], axis=1)
    long = np.stack([np.cos(at * 1.5 * np.pi), -np.sin(at * 1.5 * np.pi), 0 * at], axis=1)
    middle = np.array([np.cos(0.3), np.sin(0.3), 0])

    for arc, known in (
        (arc_through(first, middle, last), exact),
        (arc_through(first, np.array([np.cos(2.0), -np.sin(2.0), 0]), last), long),
        # More than half a turn away: the shorter way, as blockMesh.
        (arc_through(first, np.array([np.cos(2.0), np.sin(2.0), 0]), last), exact),
        (arc_about(first, last, np.zeros(3)), exact),
        (arc_by_angle(first, last, np.pi / 2, np.array([0, 0, 2.0])), exact),
        (arc_by_angle(first, last, -1.5 * np.pi, np.array([0, 0, 2.0])), long),
    ):
        assert arc is not None
        np.testing.assert_allclose(arc(at), known, atol=1e-14)
    helix = arc_by_angle(first, last + [0, 0, 3], np.pi / 2, np.array([0, 0, 1.0]))
    assert helix is not None
    np.testing.assert_allclose(helix(at), exact + at[:, None] * [0, 0, 3], atol=1e-14)
    assert arc_through(first, 0.5 * (first + last), last) is None


def test_divisions_have_the_ratios_of_their_sections():
    steps = np.diff(divide(10, (Section(ratio=5.0),)))
    assert steps[-1] / steps[0] == pytest.approx(5.0)
    assert np.ptp(steps[1:] / steps[:-1]) < 1e-13
    nodes = divide(10, (Section(1, 1, 4.0), Section(3, 1, 0.25)))
    assert nodes[5] == pytest.approx(0.25)
    assert np.diff(nodes)[4] / np.diff(nodes)[0] == pytest.approx(4.0)
    np.testing.assert_allclose(divide(1, (Section(), Section())), [0, 1])
    assert divide(10, 3 * (Section(),))[4] == pytest.approx(1 / 3)


def test_edges_given_backwards_have_the_same_nodes(tmp_path):
    """Also of several sections, more than there are cells, and of negative ratios, which are reciprocals."""
    parts = "((0.3 0.4 3) (0.7 0.6 0.2))"
    gradings = f"2 {parts} 3 -4 {parts} 1 1 2 {parts} 1 1 1"
    text = HEAD + CUBE + f"blocks (hex (0 1 2 3 4 5 6 7) (9 7 1) edgeGrading ({gradings}));"
    known = read(tmp_path, text)
    steps = np.diff(known.block(0)[:, 0, -1, 0])
    assert steps[-1] / steps[0] == pytest.approx(0.25)
    lines = " line ".join(["", "1 0", "2 3", "6 7", "5 4", "3 0", "2 1", "6 5", "7 4", "4 0", "5 1", "6 2", "7 3"])
    turned = read(tmp_path, f"{text} edges ({lines});")
    np.testing.assert_allclose(turned.points, known.points, rtol=0, atol=1e-15)


def test_left_handed_blocks_and_old_patches(tmp_path):
    text = (
        CUBE
        + """blocks (hex (4 5 6 7 0 1 2 3) (4 3 2) simpleGrading (1 1 1));
    patches (wall floor ((0 1 2 3)) patch rest ((0 0) (0 1)));"""
    )
    grid = read(tmp_path, text)
    assert find_topology(grid).handedness.tolist() == [-1]
    floor, rest, default = grid.patches
    assert (floor.bc_type, floor.windows[0].side) == ("wall", Side.KMAX)
    assert [window.side for window in rest.windows] == [Side.IMIN, Side.IMAX]
    assert default.name == "defaultFaces"
    assert len(default.windows) == 3


def test_macros_of_dictionaries_and_lists(tmp_path):
    text = (
        HEAD
        + CUBE
        + """scale (1 2 3);
    grading (2 3 4); inner { cells (4 3 2); again { deep $..cells; } } inner { more 1; } base { type wall; }
    outer { inner { again { deep (9 9 9); } } cells $:inner.again.deep; }
    blocks (hex (0 1 2 3 4 5 6 7) $:outer.cells simpleGrading $grading);
    boundary (floor { $base; faces ((0 1 2 3)); });"""
    )
    grid = read(tmp_path, text + "convertToMeters 7;")
    assert grid.shapes == ((5, 4, 3),)
    assert grid.patches[0].bc_type == "wall"
    np.testing.assert_allclose(grid.points.max(axis=0), [1, 2, 3])
    steps = np.diff(grid.block(0)[:, 0, 0, 0])
    assert steps[-1] / steps[0] == pytest.approx(2.0)


SIDE, FREE = "type wall; faces ((0 1 2 3));", "type cyclic; faces ();"
BAD = {
    "calc": (ONE.replace("(4 3 2)", '(4 3 #calc "1+1")'), "#calc is not evaluated.*foamDictionary"),
    "include": ('#include "other"\n' + ONE, "#include is not evaluated"),
    "merge": (ONE + "mergePatchPairs ((a b));", "mergePatchPairs is not supported"),
    "projected": (ONE.replace("((0 0 0)", "(project (0 0 0) (s)"), "project is not supported"),
    "projected faces": (ONE + "faces (project (0 1 2 3) s);", "faces is not supported"),
    "huge": (ONE.replace("(4 3 2)", "(1000000000 1 1)"), "4,000,000,004 nodes"),
    "no cells": (ONE.replace("(4 3 2)", "(4 0 2)"), "4 x 0 x 2 cells"),
    "deep": (ONE + "x " + "(" * 2000, "nested more than 50 deep"),
    "bomb": ("a 1 1;" + "".join(f"{b} {8 * f'${a} '};" for a, b in pairwise("abcdefghijk")) + ONE, "more values than"),
    "vertex": (ONE.replace("5 6 7)", "5 6 8)"), "there is no vertex 8"),
    "macro": (ONE.replace("(4 3 2)", "$cells"), r"\$cells refers to an entry that does not exist"),
    "open": (ONE.rstrip()[:-2], "ends within"),
    "comment": (ONE + "/* no end", "comment begins here"),
    "grading": (CUBE + BLOCK.replace("(1 1 1)", "(1 0 1)"), "expansion ratio of 0"),
    "section": (CUBE + BLOCK.replace("(1 1 1)", "(((1 0.01 1) (1 0.99 1)) 1 1)"), "a section has no cells"),
    "edge": (ONE + "edges (circle 0 1 (0 0 0));", "'circle' are not supported; known are arc"),
    "straight arc": (ONE + "edges (arc 0 1 (0.5 0 0));", "lie on one line"),
    "patch": (ONE + "boundary (a { type wall; faces ((0 1 2 5)); });", "is not a side of any block"),
    "twice": (ONE + f"boundary (a {{ {SIDE} }} b {{ {SIDE} }});", "belongs to the patches a and b"),
    "no faces": (ONE + "boundary (a { type wall((0 1 2 3)); });", "the patch 'a' has no faces"),
    "no type": (ONE + "boundary (a { faces ((0 1 2 3)); });", "the patch 'a' has no type"),
    "neighbour": (ONE + "boundary (a { type cyclic; neighbourPatch b; faces ((0 1 2 3)); });", "does not have it"),
    "two": (ONE + f"boundary (a {{ neighbourPatch b; {FREE} }} b {{ neighbourPatch c; {FREE} }});", "neighbour b, wh"),
    "other": ("FoamFile { class volScalarField; object p; }\n", "of class volScalarField; expected a blockMeshDict"),
    "control": (HEAD + "application icoFoam;", "without vertices; expected a blockMeshDict"),
    "number": (ONE.replace("(1 1 0)", "(1 nan 0)"), "expected three coordinates of a vertex, found 'nan'"),
    "underscore": (ONE.replace("(1 1 0)", "(1 1_0 0)"), "expected three coordinates of a vertex, found '1_0'"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_refusals_say_where_and_what(name, tmp_path):
    text, message = BAD[name]
    with pytest.raises(FormatError, match=message):
        read(tmp_path, text if text.startswith("FoamFile") else HEAD + text)


def test_neighbours_must_agree_on_their_common_edges(tmp_path):
    text = (
        HEAD
        + CUBE.replace("));", ") (2 0 0) (2 1 0) (2 0 1) (2 1 1));")
        + "blocks (hex (0 1 2 3 4 5 6 7) (4 3 2) simpleGrading (1 1 1)"
        " hex (1 8 9 2 5 10 11 6) (4 %s 2) simpleGrading (1 %s 1));"
    )
    with pytest.raises(FormatError, match="4 and 3 cells on their common edge 1 2"):
        read(tmp_path, text % (4, 1))
    with pytest.raises(FormatError, match="divide their common edge 1 2 differently"):
        read(tmp_path, text % (3, 2))
    assert find_topology(read(tmp_path, text % (3, 1))).external.sum() == 2 * 52 - 2 * 6


REGIONS = {"rotor rotor stator": "rotor rotor stator", "rotor hub stator": "region1 region1 stator",
           "fluid fluid fluid": "region1 region1 region2"}  # fmt: skip


@pytest.mark.parametrize(("zones", "components"), REGIONS.items())
def test_regions_that_no_side_joins_are_components(zones, components, tmp_path):
    """With the name of the zone of their blocks if it is that of no other region; a common edge joins nothing."""
    blocks = "blocks (hex (0 1 2 3 4 5 6 7) %s (2 2 2) simpleGrading (1 1 1) hex (1 8 9 2 5 10 11 6) %s (2 2 2)"
    blocks += " simpleGrading (1 1 1) hex (12 13 14 3 15 16 17 7) %s (2 2 2) simpleGrading (1 1 1));"
    more = "(2 0 0) (2 1 0) (2 0 1) (2 1 1) (-1 1 0) (-1 2 0) (0 2 0) (-1 1 1) (-1 2 1) (0 2 1)"
    grid = read(tmp_path, HEAD + CUBE.replace("));", f") {more});") + blocks % tuple(zones.split()))
    assert " ".join(grid.components) == components


@pytest.mark.parametrize("place", ["system", "constant/polyMesh"])
def test_cases_are_read_by_folder_and_by_foam_file(place, tmp_path):
    (tmp_path / place).mkdir(parents=True)
    with pytest.raises(FormatError, match="has no system/blockMeshDict"):
        read_grid(tmp_path)
    (tmp_path / place / "blockMeshDict").write_text(HEAD + ONE)
    (tmp_path / "case.foam").write_text("")
    assert read_grid(tmp_path).shapes == read_grid(tmp_path / "case.foam").shapes == ((5, 4, 3),)
    for start in ("", "\n ", "// x\n", "/* x */ ", "scale 1;", "convertToMeters 1;"):
        assert read(tmp_path, start + ONE).shapes == ((5, 4, 3),)


def hermite(points: list[list[float]], smooth: bool, at: np.ndarray) -> np.ndarray:
    """Through all points: straight between them, or with the slopes of the chords of their neighbours."""
    p = np.array(points)
    p = np.concatenate([2 * p[:1] - p[1:2], p, 2 * p[-1:] - p[-2:-1]])
    place = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(p[1:-1], axis=0), axis=1))])
    found = []
    for s in at * place[-1]:
        n = min(int(np.searchsorted(place, s, side="right")), len(place) - 1)
        t = (s - place[n - 1]) / (place[n] - place[n - 1])
        a, b = p[n], p[n + 1]
        slopes = ((b - p[n - 1]) / 2, (p[n + 2] - a) / 2) if smooth else (b - a, b - a)
        hat = (2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, 3 * t**2 - 2 * t**3, t**3 - t**2)
        found.append(hat[0] * a + hat[1] * slopes[0] + hat[2] * b + hat[3] * slopes[1])
    return np.array(found)


AT, WAY = np.linspace(0, 1, 9), [[0, 0, 0], [0.25, 0.5, 0.1], [0.5, 0.25, -0.1], [1, 0, 0]]
THROUGH = "((0.25 0.5 0.1) (0.5 0.25 -0.1))"


EDGES = {
    f"polyLine 0 1 {THROUGH}": hermite(WAY, False, AT),
    f"polyLine 0 1 {THROUGH} line 0 1 line 1 0": hermite(WAY, False, AT),
    f"spline 0 1 {THROUGH}": hermite(WAY, True, AT),
    "spline 1 0 ((0.5 0.25 -0.1) (0.25 0.5 0.1))": hermite(WAY, True, AT),
}


@pytest.mark.parametrize("edge", EDGES)
def test_curved_edges(edge, tmp_path):
    grid = read(tmp_path, HEAD + CUBE + BLOCK.replace("(4 3 2)", "(8 3 2)") + f"edges ({edge});")
    np.testing.assert_allclose(grid.block(0)[:, 0, 0], EDGES[edge], rtol=0, atol=1e-12)
    np.testing.assert_allclose(grid.block(0)[:, -1, 0], AT[:, None] * [1, 0, 0] + [0, 1, 0], rtol=0, atol=1e-15)
