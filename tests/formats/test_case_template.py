"""Templates of case files: boundaries with their faces and places, motions; what a fitted table is taken to be."""

from __future__ import annotations

import dataclasses
import json
import re
import tomllib

import numpy as np
import pytest
from grids import frame, frame_2d, whole_face, with_walls

from meshdeform_core.grid import Grid, Patch, Side
from meshdeform_core.grid.faces import find_outside
from meshdeform_core.grid.selection import select_quads
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats.case.template import FittedTable, case_template, fitted_table
from meshdeform_samples import generate


def template(grid: Grid, *more) -> str:
    return case_template(grid, find_outside(grid, find_topology(grid)), "a.xyz", *more)


def renamed(grid: Grid, **names: str) -> Grid:
    patches = tuple(dataclasses.replace(p, name=names[p.family], family="") for p in grid.patches)
    return dataclasses.replace(grid, patches=patches)


def cube() -> Grid:
    axes = [np.array([0.1, 1 / 3, 2 / 3]), np.array([0.0, 0.5, 1.1]), np.array([0.0, 1.0, 2.0])]
    return Grid.from_blocks([np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)], ["b[1]"])


def plane() -> Grid:
    flat = frame_2d()
    return flat.moved(flat.points / 3.0 + [-0.1, 0.7, 0.0])


def thin(axis: int) -> Grid:
    """One cell thick along x, y or z."""
    flat = frame_2d()
    points = np.roll(flat.points, axis - 2, axis=1)
    blocks = [flat.block(b, points) for b in range(flat.n_blocks)]
    return Grid.from_blocks([np.concatenate([x, x + np.eye(3)[axis]], axis=2) for x in blocks])


def mirrored(layers: int) -> Grid:
    """Between two symmetry planes."""
    grid = frame(4, layers)
    sides = {"low": Side.KMIN, "high": Side.KMAX}
    patches = tuple(Patch(name, tuple(whole_face(shape, block, side) for block, shape in enumerate(grid.shapes)), "",
                          "BCSymmetryPlane") for name, side in sides.items())  # fmt: skip
    return dataclasses.replace(grid, patches=patches)


ODD = {"body": 'the "wing" [1] \\ é', "outer": "a # b", "span": "s*?"}
NAMED, GUESSED = {"body": "moving", "span": "slip", "outer": "fixed"}, {"wall": "moving", "far": "fixed", "end": "slip"}
MIRRORS = {"low": "symmetry", "high": "symmetry", "wall": "moving", "far": "fixed"}
DECLARED = "wall symmetry far"
TEMPLATES = {
    "named": (lambda: with_walls(frame()), None, NAMED, DECLARED), "guessed": (frame, None, GUESSED, "wall? far? end?"),
    "odd": (lambda: renamed(with_walls(frame()), **ODD), None, {ODD[name]: NAMED[name] for name in NAMED}, DECLARED),
    "no wall": (cube, None, {"unknown": "fixed"}, "unknown"),
    "plane": (plane, None, {"wall": "moving", "far": "fixed"}, "wall? far?"),
    "wing": (lambda: wing(1, 0), None, {"wing": "moving", "symmetry": "symmetry", "far": "fixed"}, DECLARED),
    "mirrored": (lambda: mirrored(2), None, MIRRORS, "wall? symmetry symmetry far?"),
    "thin": (lambda: mirrored(1), None, MIRRORS | {"low": "slip", "high": "slip"}, "wall? symmetry symmetry far?"),
    "two of three": (lambda: with_walls(frame()), FittedTable("t.csv", ("body", "span"), "exact", 0.25),
                     NAMED | {"span": "moving"}, DECLARED),
    "one of four": (frame, FittedTable("t.csv", ("block2.imax",), "nearest", 1e-9), GUESSED | {"wall-fixed": "fixed"},
                    "wall? wall? far? end?"),
}  # fmt: skip


@pytest.mark.parametrize("name", TEMPLATES)
def test_templates_name_every_outside_face_and_say_where_it_is(name):
    make, table, kinds, roles = TEMPLATES[name]
    grid = make()
    topology, text = find_topology(grid), template(grid, "a.nmf" if table else None, table)
    assert tomllib.loads(text).get("grid") == ({"boundary_file": "a.nmf"} if table else None)
    assert " ".join(re.findall("# role: (.*)", text)) == roles
    assert ("# No wall was found." in text) == ("moving" not in kinds.values())
    entries = tomllib.loads(text)["boundary"]
    assert {entry["name"]: entry["kind"] for entry in entries} == kinds
    quads = {each: select_quads(grid, topology, [each], "") for entry in entries for each in entry["select"]}
    outside = np.concatenate([face.quads for face in find_outside(grid, topology).faces if face.outside])
    np.testing.assert_array_equal(np.sort(np.concatenate([*quads.values()])), np.sort(outside))
    lines = re.findall(r"(?m)^    (\".*\"),   # (.*?), first cells .*?, ([\d,]+) cell faces$", text)
    assert [json.loads(label) for label, *_ in lines] == list(quads)
    for own, (_, box, count) in zip(quads.values(), lines, strict=True):
        points = grid.points[topology.first[topology.quads.corners[own].ravel()]]
        low_high = [[*map(float, words[2:].split(".."))] for words in box.split("  ")]
        found = [pytest.approx(end, rel=1e-2) for end in (points.min(axis=0), points.max(axis=0))]
        assert [np.array([ends[n] for ends in low_high]) for n in (0, -1)] == found
        assert int(count.replace(",", "")) == len(own)
    moving = [entry["motion"] for entry in entries if entry["kind"] == "moving"]
    motion = (
        {"file": "t.csv", "match": table.match, "tolerance": table.tolerance} if table else {"translate": [0, 0, 0]}
    )
    assert moving == [[motion]] * len(moving)


def wing(factor: float, by: float) -> Grid:
    grid = generate("wing", 8)[0]
    return grid.moved(grid.points * [1, factor, 1] + [0, by, 0])


EXAMPLES = [
    (lambda: thin(0), "[1, 0, 0], center = [0.5, 0.0, 0.0]", ["0", "0.05*sin(pi*(z + 0.5)/1.0)", "0"], ""),
    (lambda: thin(1), "[0, 1, 0], center = [0.0, 0.5, 0.0]", ["0.05*sin(pi*(z + 0.5)/1.0)", "0", "0"], ""),
    (lambda: thin(2), "[0, 0, 1], center = [0.0, 0.0, 0.5]", ["0.05*sin(pi*(y + 0.5)/1.0)", "0", "0"], ""),
    (lambda: mirrored(2), "[0, 0, 1], center = [0.0, 0.0, 0.5]", ["0.05*(z/1.0)**2", "0", "0"], "z = 0"),
    (lambda: mirrored(1), "[0, 0, 1], center = [0.0, 0.0, 0.5]", ["0.05*sin(pi*(y + 0.5)/1.0)", "0", "0"], ""),
    # The plane is at the lower end of a wing, or at the upper one.
    (lambda: wing(1, 0), "[0, 1, 0], center = [0.85, 1.0, 0.0]", ["0", "0", "0.1*(y/2.0)**2"], "y = 0"),
    (lambda: wing(-1, .5), "[0, 1, 0], center = [0.85, -0.5, 0.0]", ["0", "0", "0.1*((y - 0.5)/2.0)**2"], "y = 0.5"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "turn", "parts", "plane"), EXAMPLES)
def test_the_motion_to_fill_in_keeps_walls_in_their_plane(make, turn, parts, plane):
    text = template(make())
    assert f"rotate = {{ angle = 5.0, axis = {turn} }} }}" in text
    assert f"displace = {json.dumps(parts)} }}" in text
    said = f"# The wall ends at the symmetry plane {plane}; a motion along {plane[:1]} leaves it."
    assert re.findall("# The wall ends.*", text) == ([said] if plane else [])


@pytest.mark.parametrize(("off", "match", "reach"), [(0.0, "nearest", 1.8e-9), (0.0125, "interpolate", 0.014)])
def test_a_table_is_fitted_to_the_wall_that_it_covers(off, match, reach, tmp_path):
    grid = with_walls(frame())
    points = grid.points[np.abs(grid.points[:, :2]).max(axis=1) < 0.51] + [0, 0, off]
    table = np.unique(np.hstack([points, np.tile([0.1, 0, 0], (len(points), 1))]), axis=0)
    np.savetxt(tmp_path / "t.csv", table, "%.17g", delimiter=",", header="x,y,z,dx,dy,dz", comments="")
    found = fitted_table(grid, find_topology(grid), tmp_path / "t.csv", "../t.csv")
    assert found == FittedTable("../t.csv", ("body",), match, reach)
