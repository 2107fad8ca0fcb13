"""``meshdeform deform`` as a user runs it, with cases and tables: what it writes, what it says, what it returns."""

import json
import os
import re

import numpy as np
import pytest

from meshdeform_formats import read_grid, write_grid

RUN = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
SPOILT = (*RUN, "-m", "tfi", "--repair", "off", "-s", "constants.turn=120")


def rotated(points: np.ndarray, degrees: float) -> np.ndarray:
    c, s = np.cos(np.deg2rad(degrees)), np.sin(np.deg2rad(degrees))
    return points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T


def body_nodes(points: np.ndarray) -> np.ndarray:
    return np.abs(points[:, :2]).max(axis=1) < 0.51


@pytest.mark.parametrize("grid", ["grid.xyz", "grid.p3dfmt", "grid.cgns"])
def test_boundaries_go_where_they_were_told(grid, bench, call):
    source = (bench / grid).read_bytes()
    output = "out" + os.path.splitext(grid)[1]
    result = call("deform", grid, "-c", "case.toml", "-o", output)
    assert result.code == 0, result.err
    assert (bench / grid).read_bytes() == source
    before, after = read_grid(grid), read_grid(output)
    near = body_nodes(before.points)
    np.testing.assert_allclose(after.points[near], rotated(before.points[near], 10.0), rtol=0, atol=1e-15)


def test_verbose_tells_the_stages_on_stderr(bench, call):
    result = call(*RUN, "-v", "--repair", "off")
    stages = [line.split()[1] for line in result.err.splitlines() if "compile" not in line]
    assert stages == ["read", "topology", "prepare", "apply", "quality", "write", "other", "total"]


def test_threads_are_those_of_our_loops(bench, call, monkeypatch):
    from meshdeform_core.parallel import loops as parallel

    monkeypatch.setattr("meshdeform_cli.main.LIBRARIES", ())
    with parallel.sharing():
        for count in (1, 2):
            call(*RUN, "--threads", str(count), "--force")
            assert parallel.thread_count() == count


def test_dry_run_tells_that_the_boundary_crosses_itself(bench, call):
    case = (bench / "case.toml").read_text().split("motion")[0] + 'motion = [{ displace = ["1.6", "0", "0"] }]\n'
    (bench / "case.toml").write_text(case + '[[boundary]]\nname = "span"\nselect = ["*.k*"]\nkind = "slip"\n')
    dry = ("deform", "grid.xyz", "-c", "case.toml", "--dry-run")
    result = call(*dry)
    assert result.code == 3
    assert "'(not selected)' and 'body' meet at (2, " in result.err
    assert "from 93.75% of the motion on" in result.err
    assert any("crosses itself, so no valid grid exists" in text for text in result.warnings)
    assert any("no repair can mend that" in text for text in result.warnings)
    assert [call(*dry, word).code for word in ("--strict", "--allow-invalid")] == [2, 0]
    advice = r"\d+ cells became invalid, the worst near 'body' around .*; try a smaller motion, or another method"
    assert re.search(advice, call(*RUN).error)


# Invalid cells: exit code 3


def test_invalid_cells_give_exit_code_3_and_are_listed(bench, call):
    result = call(*SPOILT, "--report", "out.json")
    assert result.code == 3
    report = json.loads((bench / "out.json").read_text())
    count = report["quality"]["after"]["invalid_cells"]
    assert (report["valid"], count > 0) == (False, True)
    assert report["motion"][0]["max_rotation_deg"] == pytest.approx(120.0)
    assert len(report["invalid_cells"]) == min(count, 200)
    first = report["invalid_cells"][0]
    assert first["min_jacobian"] <= 0 < first["step"] == min(first["ijk"] + [1])
    assert not (bench / "out.xyz").exists(), "make would take it for done"
    assert report["output"] == "out.invalid.xyz"
    assert read_grid("out.invalid.xyz").n_nodes == 1152
    for words in ("The grid is in out.invalid.xyz", f"{count} cells became invalid", "--steps auto"):
        assert words in result.err
    assert "INVALID" in result.out
    os.remove("out.invalid.xyz")
    allowed = call(*SPOILT, "--allow-invalid", "-q")
    assert (allowed.code, allowed.out) == (0, "")
    assert "became invalid" in allowed.err
    assert not (bench / "out.invalid.xyz").exists()
    assert read_grid("out.xyz").n_nodes == 1152


def test_an_invalid_grid_never_replaces_an_input_or_a_good_result(bench, call):
    assert call(*RUN).code == 0
    good = (bench / "out.xyz").read_bytes()
    assert call(*SPOILT, "--force", "-q").code == 3
    assert (bench / "out.xyz").read_bytes() == good
    bad = (bench / "grid.xyz").read_bytes()
    (bench / "out.invalid.xyz").write_bytes(bad)
    for more in ((), ("--allow-invalid",)):
        result = call("deform", "out.invalid.xyz", "-c", "case.toml", "-o", "out.xyz", "--force", *more)
        assert (result.code, "out.invalid.xyz is an input" in result.err) == (2, True)
        assert (bench / "out.invalid.xyz").read_bytes() == bad


def test_an_earlier_invalid_grid_goes_when_the_grid_is_valid(bench, call):
    assert call(*SPOILT, "-q").code == 3
    missing = call("plot", "out.xyz", "-o", "out.png")
    assert missing.code == 2
    assert "out.xyz does not exist; out.invalid.xyz is the invalid grid of a run" in missing.err
    assert call(*RUN, "-q").code == 0
    assert not (bench / "out.invalid.xyz").exists()
    # Whatever else has the name stays.
    (bench / "out.invalid.xyz").write_text("my own notes")
    assert call(*RUN, "-q", "--force").code == 0
    assert (bench / "out.invalid.xyz").read_text() == "my own notes"


# Steps and time


def test_automatic_steps_stop_before_the_grid_breaks(bench, call):
    result = call(*SPOILT, "--steps", "auto", "--report", "out.json")
    report = json.loads((bench / "out.json").read_text())
    assert result.code == 3
    assert 0.0 < report["reached"] < 1.0
    assert report["quality"]["after"]["invalid_cells"] == 0
    assert report["invalid_cells"], "the cells that the next step would break"
    assert f"only {report['reached']:.1%} of the motion was imposed" in result.err
    before, after = read_grid("grid.xyz").points, read_grid("out.invalid.xyz").points
    near = body_nodes(before)
    np.testing.assert_allclose(after[near], rotated(before[near], 120.0 * report["reached"]), rtol=0, atol=1e-12)


# Tables


def test_a_table_alone_is_enough(bench, call):
    report = json.loads(call("deform", "grid.xyz", "-d", "table.csv", "-o", "out.xyz", "--report", "-").out)
    assert [report["boundary"][f"{kind}_nodes"] for kind in ("moving", "fixed", "interior")] == [80, 560, 256]
    assert report["motion"][0]["mean_displacement"] == pytest.approx([0.1, 0, 0], abs=1e-15)
    matched = report["boundary"]["matches"][0]
    assert (matched["table"], matched["matched_nodes"], matched["unmatched_nodes"]) == ("table.csv", 80, 560)
    assert matched["table_points_used"] == matched["table_points"]
    before, after = read_grid("grid.xyz").points, read_grid("out.xyz").points
    near = body_nodes(before)
    np.testing.assert_allclose((after - before)[near], np.tile([0.1, 0, 0], (near.sum(), 1)), atol=1e-15)


# Formats


def test_fields_at_walls_are_those_of_moving_ones(bench, call):
    assert call(*RUN[:-1], "out.vtm", "--field", "first_cell_height_ratio").code == 0
    beside = [np.isfinite(each.values) for each in read_grid("out.vtm").fields if each.block == 1]
    assert [(each[-1].all(), each[:-1].any()) for each in beside] == [(True, False)]


def test_the_variant_of_the_input_is_kept(bench, call):
    assert call("convert", "grid.xyz", "big.xyz", "--variant", "byte_order = big", "--variant", "markers=8").code == 0
    assert call("deform", "big.xyz", "-c", "case.toml", "-o", "out.xyz").code == 0
    assert read_grid("out.xyz").format == read_grid("big.xyz").format


def test_the_verdict_is_about_the_precision_that_is_written(bench, call):
    """Cells thinner than float32 can hold are invalid in a float32 file, and only there."""
    grid = read_grid("grid.xyz")
    thin = grid.points.copy()
    thin[:, :2] = thin[:, :2] * 1e-3 + 7000.0
    write_grid(grid.moved(thin), "thin.xyz")
    shifted = ("-s", 'boundary=[{select=["*"], motion=[{translate=[0.1, 0, 0]}]}]', "--steps", "1", "--repair", "off")
    assert call("deform", "thin.xyz", *shifted, "-o", "out.xyz").code == 0
    assert call("deform", "thin.xyz", *shifted, "-o", "out32.xyz", "--variant", "precision=float32").code == 3


BY_TABLE = ("deform", "grid.xyz", "-d", "table.csv", "-o", "out.xyz", "--report", "out.json")


def test_tolerance_and_match_reach_the_table(bench, call):
    table = np.loadtxt(bench / "table.csv", delimiter=",")
    table[:, 2] += 0.02
    np.savetxt(bench / "table.csv", table, "%.17g", delimiter=",")
    assert call(*BY_TABLE, "--match", "exact").code == 2
    assert call(*BY_TABLE, "--tolerance", "0.03").code == 0
    match = json.loads((bench / "out.json").read_text())["boundary"]["matches"][0]
    assert (match["match"], match["max_distance"]) == ("nearest", pytest.approx(0.02))
    assert call(*BY_TABLE, "--match", "interpolate", "--tolerance", "0.03", "--force").code == 0
    match = json.loads((bench / "out.json").read_text())["boundary"]["matches"][0]
    assert match["match"] == "interpolate"
