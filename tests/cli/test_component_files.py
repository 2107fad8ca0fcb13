"""Components in files of their own: joined as one grid, moved as one case."""

from __future__ import annotations

import dataclasses
import json

import jsonschema
import numpy as np
import pytest
from grids import block_around, frame, polar

from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Field, Grid, Patch, Side, Window
from meshdeform_formats.case import case_of, read_case
from meshdeform_formats.grids import read_grid, write_grid
from meshdeform_formats.joined import grid_of_case, join
from meshdeform_formats.report.measures import report_schema

LINE = np.linspace(-5.0, 5.0, 9)
BACKGROUND = Grid.from_blocks([block_around(LINE, LINE, np.linspace(0, 1, 3))])
CASE = """
[grid]
components = { ring = { file = "ring.cgns" }, bar = { file = "bar.vtm" } }
[[boundary]]
name = "ring"
select = ["ring.*/wall"]
motion = [ { rotate = { angle = 10 } } ]
[[boundary]]
name = "outer"
select = ["ring.block1.jmax", "bar.*.i*", "bar.*.j*"]
kind = "free"
[[boundary]]
name = "ends"
select = ["*.k*"]
kind = "slip"
[[boundary]]
name = "bar"
select = ["bar.*.i*", "bar.*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [ { translate = [0.1, 0, 0] } ]
"""


def walled(grid: Grid) -> Grid:
    return dataclasses.replace(
        grid, patches=(Patch("wall", (Window(0, Side.JMIN, (0, 0), (16, 2)),), bc_type="BCWall"),)
    )


@pytest.fixture
def folder(tmp_path):
    write_grid(BACKGROUND, tmp_path / "background.xyz")
    write_grid(walled(polar(16, 4, 2)), tmp_path / "ring.cgns")
    write_grid(frame(3, 2), tmp_path / "bar.vtm")
    (tmp_path / "case.toml").write_text(CASE)
    return tmp_path


def test_files_are_joined_with_the_name_of_their_component(folder):
    grid = grid_of_case(read_grid(folder / "background.xyz"), read_case(folder / "case.toml"))
    assert grid.names[:2] == ("block1", "ring.block1")
    assert grid.components == ("main", "ring", *["bar"] * 8)
    assert [(patch.name, patch.windows[0].block) for patch in grid.patches] == [("wall", 1)]
    np.testing.assert_array_equal(grid.block(1), polar(16, 4, 2).block(0))
    assert all(connection.block == connection.donor_block == 1 for connection in grid.connections)
    assert "written as one new file" in grid.notes[-1]


def test_fields_and_a_common_variant_are_kept(tmp_path):
    values = np.arange(9 * 9 * 3).reshape(9, 9, 3)
    blanked = dataclasses.replace(BACKGROUND, fields=(Field("iblank", "node", 0, values),))
    for name in ("one", "two"):
        write_grid(blanked, tmp_path / f"{name}.xyz", {"precision": "float32", "byte_order": "big"})
    one, two = (read_grid(tmp_path / f"{name}.xyz") for name in ("one", "two"))
    grid = join(one, {"two": two})
    assert grid.format == one.format
    assert not grid.notes
    assert [field.block for field in grid.fields] == [0, 1]
    write_grid(grid, tmp_path / "both.xyz")
    again = read_grid(tmp_path / "both.xyz")
    assert again.format == one.format
    np.testing.assert_array_equal(again.block(1), one.block(0))


def test_one_command_moves_all_files(folder, call):
    done = call("deform", folder / "background.xyz", "-c", folder / "case.toml", "-o", folder / "out.cgns")
    assert done.code == 0, done.err
    assert "ring: 1 block, 255 nodes; moves by up to" in done.out
    assert "main: 1 block, 243 nodes; rests" in done.out
    after = read_grid(folder / "out.cgns")
    np.testing.assert_array_equal(after.block(0), BACKGROUND.block(0))
    np.testing.assert_allclose(after.block(2), frame(3, 2).block(0) + [0.1, 0.0, 0.0], atol=1e-14)


def test_reports_have_a_verdict_for_every_component(folder, call):
    command = ("deform", folder / "background.xyz", "-c", folder / "case.toml", "-o", folder / "out.cgns", "-q")
    reports = [folder / f"report{suffix}" for suffix in (".json", ".html", ".md", ".txt")]
    assert call(*command, *(word for path in reports for word in ("--report", path))).code == 0
    report = json.loads(reports[0].read_text())
    jsonschema.Draft202012Validator(report_schema()).validate(report)
    assert [part["name"] for part in report["components"]] == ["main", "ring", "bar"]
    assert "3 components, each moved by its own boundary" in reports[1].read_text()
    assert "| ring | 1 | 255 |" in reports[2].read_text()
    assert "bar: 8 blocks" in reports[3].read_text()
    series = ("series", folder / "background.xyz", "-c", folder / "case.toml", "--times", "0,1", "-o", folder / "s")
    done = call(*series, "--suffix", ".vtm", "-q", "--report", folder / "s.json")
    assert done.code == 0, done.err
    report = json.loads((folder / "s.json").read_text())
    jsonschema.Draft202012Validator(report_schema()).validate(report)
    assert [part["valid"] for part in report["levels"][1]["components"]] == [True] * 3


def test_component_files_are_inputs_that_no_output_replaces(folder, call):
    before = (folder / "ring.cgns").read_bytes()
    command = ("deform", folder / "background.xyz", "-c", folder / "case.toml", "-o", folder / "ring.cgns", "--force")
    done = call(*command)
    assert done.code == 2
    assert "ring.cgns" in done.err
    assert (folder / "ring.cgns").read_bytes() == before


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ("zones", "found 'zones'; expected"),
        ({}, "found {}; expected"),
        ({"a": 3}, "grid.components.a: found 3"),
        ({"a": []}, "grid.components.a: found"),
        ({"a": {"fiel": "x.cgns"}}, "unknown key 'fiel'"),
        ({"a": {}}, "there is no file; expected a grid file"),
        ({"main": {"file": "x.cgns"}}, "'main' is the name of the blocks of the grid itself"),
    ],
)
def test_entries_that_are_no_components_are_refused(entry, message):
    with pytest.raises(CaseError, match=message):
        case_of({"grid": {"components": entry}})


def test_components_of_another_dimension_are_refused():
    plane = Grid.from_blocks([block_around(LINE, LINE, np.zeros(1))])
    with pytest.raises(CaseError, match=r"'plane' .* is 2-D, the grid .* 3-D"):
        join(BACKGROUND, {"plane": plane})
