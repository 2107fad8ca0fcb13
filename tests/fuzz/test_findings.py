"""What fuzz campaigns found, each as the smallest input that shows it; and a short campaign (``make fuzz N=20000``)."""

import json
from pathlib import Path

import numpy as np
import pytest
from grids import CASE, frame

from fuzz.bench import called
from fuzz.campaign import KINDS, RIGHT, campaign
from meshdeform_formats import read_grid, write_grid


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(CASE)
    write_grid(frame(2, 2), "grid.xyz")
    return tmp_path


def deformed(case: str, output: str = "out.xyz") -> tuple[int, str]:
    Path("case.toml").write_text(case)
    return called("deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", output, "--force", "-q")


@pytest.mark.parametrize("length", ["5e-324", "1.7e308"])
def test_the_length_of_an_axis_does_not_matter(length, folder):
    assert deformed(CASE, "one.xyz")[0] == 0
    assert deformed(CASE.replace("[0, 0, 1]", f"[0, 0, {length}]"), "other.xyz")[0] == 0
    np.testing.assert_array_equal(read_grid("one.xyz").points, read_grid("other.xyz").points)


NO_FACE = "where(x > 1.9 and y > 1.9 and z < 0.1, 1/0, 0) > 1"


@pytest.mark.parametrize(
    ("old", "new", "options", "message"),
    [
        ("center = [0, 0, 0]", "center = [-1e308, 0, 0]", (), "expected finite numbers up to 1e+30"),
        ("abs(x) < 0.51 and abs(y) < 0.51", NO_FACE, (), "(1 of"),
        ("", "", ("--max-memory", "9" * 400 + "GiB"), "expected a size like 2GiB"),
    ],
)
def test_numbers_beyond_all_bounds_are_refused(old, new, options, message, folder):
    Path("case.toml").write_text(CASE.replace(old, new) if old else CASE)
    code, told = called("deform", "grid.xyz", "-c", "case.toml", *options, "-o", "out.xyz", "-q")
    assert (code, told.count(message)) == (2, 1), told


@pytest.mark.parametrize("angle", ["1e-308", "5e-324"])
def test_a_motion_smaller_than_any_length_writes_no_denormal_numbers(angle, folder):
    assert deformed(CASE.replace("turn = 10.0", f"turn = {angle}"))[0] == 0
    np.testing.assert_array_equal(read_grid("out.xyz").points, read_grid("grid.xyz").points)


def test_an_infinite_length_of_idw_has_a_limit(folder):
    """The weights of the far field cancel; they overflowed once."""
    for name, length in (("one", "1e20"), ("two", "1e200")):
        arguments = ("-c", "case.toml", "-m", "idw", "-s", f"method.idw.length={length}", "-o", f"{name}.xyz", "-q")
        assert called("deform", "grid.xyz", *arguments)[0] == 0
    one, two = (read_grid(f"{name}.xyz").points for name in ("one", "two"))
    np.testing.assert_allclose(two, one, rtol=0, atol=1e-12)


def test_a_block_that_is_thin_in_two_directions_has_the_end_planes_of_its_neighbours(folder):
    """The blocks beside the body are one cell thick along x or y, too; their far sides are fixed."""
    grid = frame(1, 1)
    write_grid(grid, "thin.xyz")
    case = CASE.split("[[boundary]]")
    Path("case.toml").write_text("[[boundary]]".join(case[:3]))
    code, told = called("deform", "thin.xyz", "-c", "case.toml", "-o", "out.xyz", "-q")
    assert code == 0
    assert "end planes" not in told
    assert "24 external face quads are not selected" in told
    far = np.abs(grid.points[:, :2]).max(axis=1) > 1.99
    np.testing.assert_array_equal(read_grid("out.xyz").points[far], grid.points[far])


@pytest.mark.parametrize(("match", "apart"), [("nearest", "-3e-17"), ("interpolate", "5e-324")])
def test_points_that_differ_by_rounding_are_one_point(match, apart, folder):
    """Between two displacements of one place a spline takes either."""
    points = np.unique(frame(2, 2).points[np.abs(frame(2, 2).points[:, :2]).max(axis=1) < 0.51], axis=0)
    moves = 0.03 * np.sin(3 * points)
    rows = [[*map(repr, row)] for row in np.hstack([points, moves]).tolist()]
    at = next(n for n, row in enumerate(rows) if float(row[2]) == 0.0)
    rows.append([*rows[at][:2], apart, "0.001", "0.001", "0.0"])
    Path("table.csv").write_text("\n".join(",".join(row) for row in rows))
    options = ("-m", "tfi", "-o", "no.xyz", "-q", "--match", match)
    code, told = called("deform", "grid.xyz", "-d", "table.csv", *options)
    assert (code, "has two displacements" in told) == (2, True), told


@pytest.mark.parametrize("word", ["1e400", "NaN"])
def test_the_state_of_a_series_holds_finite_numbers(word, folder):
    Path("case.toml").write_text(CASE.replace('angle = "turn"', 'angle = "turn * t"'))
    arguments = ("series", "grid.xyz", "-c", "case.toml", "-m", "tfi", "--times", "0:1:1", "-o", "out", "-q")
    assert called(*arguments)[0] == 0
    state = json.loads(Path("out/series.json").read_text())
    state["levels"][0]["time"] = "HERE"
    Path("out/series.json").write_text(json.dumps(state).replace('"HERE"', word))
    code, told = called(*arguments, "--resume")
    assert code == 2
    assert "is not finite" in told


# The worker compiles every loop first, which takes minutes where nothing is compiled and the machine is busy.
@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_no_sample_is_silently_wrong_or_ends_in_a_traceback():
    wrong = [sample for sample in campaign(3 * len(KINDS), seed=20240) if sample[2] not in RIGHT]
    assert wrong == []
