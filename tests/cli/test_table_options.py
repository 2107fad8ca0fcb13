"""--match and --tolerance beside -d, and tables that do not fit, from the command line."""

import json
import re

import numpy as np
import pytest
from grids import block_around

from meshdeform_core.grid import Grid
from meshdeform_formats.grids import read_grid, write_grid

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


@pytest.mark.parametrize("nk", [1, 4], ids=["2-D", "3-D"])
def test_positions_by_number_move_the_points_that_have_them(nk, tmp_path, monkeypatch, call):
    """As SU2 writes them, with its numbers of the points: those of one marker; the other walls are fixed."""
    monkeypatch.chdir(tmp_path)
    x = block_around(np.linspace(0, 2, 9), np.linspace(0, 1, 6), np.linspace(0, 1, nk))
    write_grid(Grid.from_blocks([x]), tmp_path / "grid.xyz")
    assert call("convert", "grid.xyz", "grid.su2").code == 0
    text = (tmp_path / "grid.su2").read_text()
    marker = re.search(r"MARKER_TAG= block1.jmax\nMARKER_ELEMS= \d+\n([^A-Z]*)", text)
    assert marker is not None
    numbers = np.unique([[int(word) for word in row.split()[1:]] for row in marker[1].splitlines()])
    points = np.array([row.split() for row in text.split("NPOIN=")[1].splitlines()[1:]][: x[..., 0].size], dtype=float)
    moved = points[numbers]
    moved[:, 1] += 0.1 * np.sin(moved[:, 0])
    np.savetxt("surface_positions.dat", np.column_stack([numbers, moved]), ["%d", *moved.shape[1] * ["%.17g"]])
    done = call("deform", "grid.xyz", "-d", "surface_positions.dat", "-o", "out.xyz")
    assert done.code == 0, done.err
    after = read_grid(tmp_path / "out.xyz").block(0)
    np.testing.assert_allclose(after[:, -1, :, 1], x[:, -1, :, 1] + 0.1 * np.sin(x[:, -1, :, 0]), atol=1e-15)
    np.testing.assert_array_equal(after[:, 0], x[:, 0])
    moved[:, 0] += 7 * numbers
    np.savetxt("surface_positions.dat", np.column_stack([numbers, moved]), ["%d", *moved.shape[1] * ["%.17g"]])
    done = call("deform", "grid.xyz", "-d", "surface_positions.dat", "-o", "again.xyz")
    assert (done.code, "of another mesh" in done.err) == (2, True)


@pytest.mark.parametrize("header", ["", "x,y,dx,dy"])
def test_whole_coordinates_are_no_numbers_of_points(header, tmp_path, monkeypatch, call):
    """A table in the plane of a grid one cell thick; the first coordinates of its points are 0 to 30."""
    monkeypatch.chdir(tmp_path)
    along = np.arange(31.0)
    x = block_around(along, np.linspace(0, 8, 9), np.array([0.0, 1.0]))
    write_grid(Grid.from_blocks([x]), tmp_path / "grid.xyz")
    rise = 0.01 * np.sin(np.pi * along / 30)
    rows = np.column_stack([along, 0 * along, 0 * along, rise])
    np.savetxt("table.csv", rows, "%.17g", delimiter=",", header=header, comments="")
    done = call("deform", "grid.xyz", "-d", "table.csv", "--match", "nearest", "--tolerance", "1.1", "-o", "out.xyz")
    assert done.code == 0, done.err
    after = read_grid(tmp_path / "out.xyz").block(0)
    np.testing.assert_allclose(after[:, 0, 0, 1], rise, atol=1e-15)
    np.testing.assert_array_equal(after[:, -1], x[:, -1])
