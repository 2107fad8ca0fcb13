"""Case files to start from: they name every boundary, and they run."""

import dataclasses
import json
import os
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from grids import frame_2d

from meshdeform_core.boundary import Kind
from meshdeform_core.boundary.motions.expression import expression
from meshdeform_core.deform import set_up
from meshdeform_core.grid import Grid
from meshdeform_core.grid.faces import find_outside
from meshdeform_core.grid.topology import find_topology
from meshdeform_formats import read_grid
from meshdeform_formats.case import read_case
from meshdeform_formats.case.template import case_template

GRIDS = Path(os.environ.get("MESHDEFORM_GRIDS", "../shared/grids")).resolve()
REAL = [
    ("717_wl_L2.cgns", None), ("nak_a_141.cgns", None), ("nak_a_141.p3dfmt", None),
    ("nak_a_141.p3dfmt", "nak_a_141.nmf"), ("backstep5_4levdn.p3dbin", None),
    ("backstep5_4levdn.p3dbin", "backstep5_4levdn.nmf"), ("cylinder_ring_4blk.x", None), ("StructuredGrid.vts", None),
    ("SampleStructGrid.vtk", None), ("shear_3blk_2d.p2dfmt", None), ("shear_3blk_2d.p2dfmt", "shear_3blk.nmf"),
]  # fmt: skip


def test_a_case_for_a_grid_with_patches(bench, call):
    result = call("init", "grid.cgns", "-o", "new.toml")
    assert (result.code, result.err) == (0, "")
    assert "meshdeform deform grid.cgns -c new.toml --dry-run" in result.out
    content = tomllib.loads((bench / "new.toml").read_text())
    assert {(b["name"], b["kind"]) for b in content["boundary"]} == {
        ("body", "moving"), ("outer", "fixed"), ("span", "slip")
    }  # fmt: skip
    assert "# x -0.5..0.5  y -0.5..0.5  z 0..1" in (bench / "new.toml").read_text()
    plan = call("deform", "grid.cgns", "-c", "new.toml", "--dry-run")
    # The motion of the template is still to be filled in.
    assert (plan.code, plan.err.count("\n")) == (0, 1)
    assert "warning: nothing moves: the displacement is zero everywhere; check --time" in plan.err
    assert "not selected" not in plan.out


def test_a_case_for_a_grid_without_names_covers_all_faces(bench, call):
    text = call("init", "grid.xyz").out
    assert 'name = "wall"   # role: wall?' in text
    (bench / "new.toml").write_text(text)
    selected = [face for entry in tomllib.loads(text)["boundary"] for face in entry["select"]]
    facts = json.loads(call("info", "grid.xyz", "--json").out)
    assert sorted(selected) == sorted(facts["external_faces"])
    moved = text.replace("{ translate = [0.0, 0.0, 0.0] }", "{ rotate = { angle = 3.0, axis = [0, 0, 1] } }")
    (bench / "new.toml").write_text(moved)
    assert call("deform", "grid.xyz", "-c", "new.toml", "-o", "turned.xyz").code == 0


def test_names_that_toml_and_patterns_find_difficult(bench):
    grid = read_grid("grid.cgns")
    odd = {"body": 'the "wing" [1] \\ é', "outer": "a # b", "span": "*?"}
    patches = [dataclasses.replace(p, name=odd[p.family], family="") for p in grid.patches]
    grid = dataclasses.replace(grid, patches=tuple(patches))
    text = case_template(grid, find_outside(grid, find_topology(grid)), "grid.cgns")
    (bench / "odd.toml").write_text(text, encoding="utf-8")
    case = read_case("odd.toml").case
    assert odd["body"] in {spec.name for spec in case.boundaries}
    setup = set_up(grid, case)
    assert setup.boundary.count(Kind.MOVING) == 4 * 4 * (4 + 1)


@pytest.mark.parametrize(("name", "boundaries"), REAL)
def test_cases_for_real_grids_run(name, boundaries, tmp_path, monkeypatch, call):
    if not (GRIDS / name).exists():
        pytest.skip(f"{GRIDS / name} is absent (MESHDEFORM_GRIDS)")
    monkeypatch.chdir(tmp_path)
    more = ("--boundary-file", GRIDS / boundaries) if boundaries else ()
    assert call("init", GRIDS / name, *more, "-o", "case.toml").code == 0
    result = call("deform", GRIDS / name, "-c", "case.toml", "--dry-run")
    if "# No wall was found." in Path("case.toml").read_text():
        assert "no node moves" in result.err
        return
    assert result.code == 0, result.err
    assert "not selected" not in result.out


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_motion_to_fill_in_turns_a_plane_grid_in_its_plane(axis):
    """Of a grid that is one cell thick along x, y or z."""
    flat = frame_2d()
    points = np.roll(flat.points, axis - 2, axis=1)
    blocks = [flat.block(b, points) for b in range(flat.n_blocks)]
    layers = [np.concatenate([x, x + np.eye(3)[axis]], axis=2) for x in blocks]
    grid = Grid.from_blocks(layers)
    text = case_template(grid, find_outside(grid, find_topology(grid)), "a.xyz")
    assert f"axis = {[int(n == axis) for n in range(3)]}, center" in text
    (line,) = [line for line in text.splitlines() if "displace = " in line]
    parts = json.loads(line.split("displace = ")[1].removesuffix(" }"))
    assert parts[axis] == "0"
    assert "xyz"[axis] not in "".join(parts).replace("sin", "")


def test_the_motions_proposed_keep_the_wall_on_the_symmetry_plane(tmp_path, monkeypatch, call):
    """Each example of the template is tried; nothing is said about nodes that leave the plane."""
    monkeypatch.chdir(tmp_path)
    assert call("sample", "wing", "-o", ".", "--size", "8").code == 0
    text = call("init", "grid.cgns").out
    assert "# The wall ends at the symmetry plane y = 0" in text
    examples = re.findall(r"^#   (\{ (?:rotate|displace).*)$", text, re.MULTILINE)
    assert len(examples) == 2
    for example in examples:
        Path("case.toml").write_text(text.replace("{ translate = [0.0, 0.0, 0.0] }", example))
        result = call("deform", "grid.cgns", "-c", "case.toml", "-o", "out.cgns", "-q", "--force")
        assert (result.code, result.err) == (0, "")
        wall = read_grid("out.cgns").block(0)[:, 0, 0]
        assert np.abs(wall[:, 1]).max() < 1e-12


def test_without_a_wall_nothing_moves_and_ends_are_given_with_all_digits():
    axes = [np.array([0.1, 1 / 3, 2 / 3]), np.array([0.0, 0.5, 1.1]), np.array([0.0, 1.0, 2.0])]
    cube = Grid.from_blocks([np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)])
    text = case_template(cube, find_outside(cube, find_topology(cube)), "a.xyz")
    assert [entry["kind"] for entry in tomllib.loads(text)["boundary"]] == ["fixed"]
    assert "# No wall was found." in text
    plane = frame_2d()
    plane = plane.moved(plane.points / 3.0 + [0.1, 0.7, 0.0])
    text = case_template(plane, find_outside(plane, find_topology(plane)), "a.xyz")
    (line,) = [line for line in text.splitlines() if "displace = " in line]
    (formula,) = [part for part in json.loads(line.split("displace = ")[1].removesuffix(" }")) if part != "0"]
    body = np.abs(plane.points[:, :2] - [0.1, 0.7]).max(axis=1) < 0.51 / 3
    values = {name: plane.points[body, n] for n, name in enumerate("xyz")}
    found = expression(formula, ("x", "y", "z"))(values)
    along = values[re.search(r"pi\*\(*([xyz])", formula)[1]]
    for end in (along.min(), along.max()):
        assert np.abs(found[along == end]).max() < 1e-15
    assert np.abs(found).max() > 0.01
