"""Overset components of one file: moved as one case, with a verdict each."""

from __future__ import annotations

import json
import re

import numpy as np
import pytest
from grids import block_around, frame, polar

from meshdeform_core.grid import Grid, Patch, Side, Window
from meshdeform_formats.grids import read_grid, write_grid

LINE = np.linspace(-5.0, 5.0, 9)
BACKGROUND = Grid.from_blocks([block_around(LINE, LINE, np.linspace(0, 1, 3))])
CASE = """
[grid]
components = { ring = ["ring.*"], bar = "bar.*", main = ["*"] }
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


@pytest.fixture
def folder(tmp_path):
    ring, bar = polar(16, 4, 2), frame(3, 2)
    blocks = [BACKGROUND.block(0), ring.block(0), *map(bar.block, range(bar.n_blocks))]
    names = ["block1", "ring.block1", *(f"bar.{name}" for name in bar.names)]
    wall = Patch("wall", (Window(1, Side.JMIN, (0, 0), (16, 2)),), bc_type="BCWall")
    write_grid(Grid.from_blocks(blocks, names, patches=(wall,)), tmp_path / "all.cgns")
    (tmp_path / "case.toml").write_text(CASE)
    return tmp_path


def test_one_command_moves_all_components_and_judges_each(folder, call):
    reports = [folder / f"report{suffix}" for suffix in (".json", ".html", ".txt")]
    command = ("deform", folder / "all.cgns", "-c", folder / "case.toml", "-o", folder / "out.cgns")
    done = call(*command, *(word for path in reports for word in ("--report", path)))
    assert done.code == 0, done.err
    assert re.search(r"^ +ring +1 +255 +48 ", done.out, re.MULTILINE)
    assert re.search(r"^ +main +1 +243 +0 +0 ", done.out, re.MULTILINE)
    after = read_grid(folder / "out.cgns")
    np.testing.assert_array_equal(after.block(0), BACKGROUND.block(0))
    np.testing.assert_allclose(after.block(2), frame(3, 2).block(0) + [0.1, 0.0, 0.0], atol=1e-14)
    report = json.loads(reports[0].read_text())
    assert [part["name"] for part in report["components"]] == ["main", "ring", "bar"]
    assert "3 components, each moved by its own boundary" in reports[1].read_text()
    assert re.search(r"^ +bar +8 +600 ", reports[2].read_text(), re.MULTILINE)
    series = ("series", folder / "all.cgns", "-c", folder / "case.toml", "--times", "0,1", "-o", folder / "s")
    done = call(*series, "--suffix", ".vtm", "-q", "--report", folder / "s.json")
    assert done.code == 0, done.err
    report = json.loads((folder / "s.json").read_text())
    assert [part["valid"] for part in report["levels"][1]["components"]] == [True] * 3
