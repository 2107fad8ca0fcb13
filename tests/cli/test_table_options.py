"""--match and --tolerance beside -d, and tables that do not fit, from the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest

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
    assert "different length units" in result.err
    assert not (bench / "out.xyz").exists()


def test_half_of_the_rows_is_refused(bench, call):
    write(bench, rows(bench)[::2])
    result = call(*RUN)
    assert result.code == 2
    assert "belong to no face that moves as a whole" in result.err
