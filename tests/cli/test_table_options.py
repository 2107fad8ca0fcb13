"""--match and --tolerance beside -d, and tables that do not fit, from the command line."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

HOSTILE = Path(__file__).parents[3] / "shared" / "hostile"
RUN = ("deform", "grid.xyz", "-d", "table.csv", "-o", "out.xyz", "--report", "out.json")


def rows(bench) -> np.ndarray:
    return np.loadtxt(bench / "table.csv", delimiter=",")


def write(bench, table) -> None:
    np.savetxt(bench / "table.csv", table, "%.17g", delimiter=",")


def test_tolerance_and_match_reach_the_table(bench, call):
    table = rows(bench)
    table[:, 2] += 0.02
    write(bench, table)
    assert call(*RUN, "--match", "exact").code == 2
    assert call(*RUN, "--tolerance", "0.03").code == 0
    match = json.loads((bench / "out.json").read_text())["boundary"]["matches"][0]
    assert match["match"] == "nearest"
    assert match["max_distance"] == pytest.approx(0.02)
    assert match["size_ratio"] == pytest.approx(1.0)
    assert call(*RUN, "--match", "interpolate", "--tolerance", "0.03", "--force").code == 0
    match = json.loads((bench / "out.json").read_text())["boundary"]["matches"][0]
    assert match["match"] == "interpolate"


def test_they_need_a_table(bench, call):
    result = call("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz", "--match", "exact")
    assert result.code == 2
    assert "belong to --displacement" in result.err
    assert call(*RUN, "--match", "closest").code == 2


@pytest.mark.parametrize("factor", [1000.0, 1e-3])
def test_table_in_other_units_is_refused(factor, bench, call):
    table = rows(bench)
    # A table whose first point is the origin matches there, whatever its unit.
    table = np.concatenate([table, [[2.0, 2.0, 0.0, 0.1, 0.0, 0.0]]])
    table[:, :3] *= factor
    write(bench, table)
    result = call(*RUN)
    assert result.code == 2
    assert "different length units?" in result.err
    assert not (bench / "out.xyz").exists()


def test_half_of_the_rows_is_refused(bench, call):
    write(bench, rows(bench)[::2])
    result = call(*RUN)
    assert result.code == 2
    assert "belong to no face that moves as a whole" in result.err


# The files that showed the defects, where they are at hand.


@pytest.fixture
def hostile(tmp_path, monkeypatch):
    if not HOSTILE.is_dir():
        pytest.skip("the hostile files are not part of the repository")
    monkeypatch.chdir(tmp_path)
    for path in HOSTILE.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def test_hostile_table_in_mm(hostile, call):
    result = call("deform", "g3.xyz", "-d", "e3_table_mm.csv", "-m", "tfi", "-o", "out.xyz")
    assert result.code == 2
    assert "11 of 12 table points" in result.err
    assert "multiplied by 0.001" in result.err


def test_hostile_wall_in_mm(hostile, call):
    entry = "boundary=[{select=['block1.jmin','block2.jmin'],motion=[{file='e3b_wall_mm.csv',match='interpolate'}]}]"
    result = call("deform", "e4_closed.xyz", "-s", entry, "-o", "out.xyz")
    assert result.code == 2
    assert "different length units?" in result.err


def test_hostile_archive(hostile, call):
    result = call("deform", "g3.xyz", "-d", "t_bad.npz", "-o", "out.xyz")
    assert result.code == 2
    assert "t_bad.npz" in result.err


def test_hostile_gap(hostile, call):
    moved = "boundary=[{select=['block1.jmin','block2.jmin'],motion=[{translate=[0,0.002,0]}]}]"
    assert call("deform", "e4_closed.xyz", "-s", moved, "-o", "closed.xyz").code == 0
    result = call("deform", "e4_gap.xyz", "-s", moved, "-o", "gap.xyz")
    assert result.code == 2
    assert "block1.imax[1:4,1:5] (12 quads) and block2.imin nearly coincide" in result.err
    assert "grid.tolerance = 0.0021 closes it" in result.err
    assert call("deform", "e4_gap.xyz", "-s", moved, "-s", "grid.tolerance=0.0021", "-o", "gap.xyz").code == 0
    assert call("compare", "gap.xyz", "closed.xyz", "--tolerance", "2e-4").code == 0
    assert "nearly coincide" in call("info", "e4_gap.xyz").out


def test_hostile_point(hostile, call):
    result = call("info", "c_const.xyz")
    assert result.code == 2
    assert "Traceback" not in result.err
