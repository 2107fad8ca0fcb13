"""``meshdeform repair``: grids that another program deformed."""

from __future__ import annotations

import json

import numpy as np
import pytest

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid


@pytest.fixture
def spoilt(bench, call):
    """A grid whose cells were inverted by a turn of 110 degrees."""
    done = call("deform", "grid.xyz", "-c", "case.toml", "-s", "constants.turn=110", "--repair", "off", "-o", "bad.xyz")
    assert done.code == 3
    return call


def test_a_spoilt_grid_is_made_valid(spoilt, bench):
    done = spoilt(
        "repair", "bad.invalid.xyz", "--reference", "grid.xyz", "-c", "case.toml", "-o", "good.xyz",
        "--report", "r.json", "--report", "r.html", "--report", "r.txt",
    )  # fmt: skip
    assert done.code == 0, done.err
    assert "repair    " in done.out
    report = json.loads((bench / "r.json").read_text())
    assert report["valid"]
    assert report["output"] == "good.xyz"
    assert report["repair"]["invalid"] + report["repair"]["weak"] > 0
    assert "Newton steps" in (bench / "r.html").read_text()
    again = spoilt("quality", "good.xyz", "--reference", "grid.xyz")
    assert again.code == 0
    before, after = (read_grid(bench / name).points for name in ("bad.invalid.xyz", "good.xyz"))
    assert np.abs(before - after).max() > 0.01


def test_walls_that_have_passed_through_each_other_are_reported(call, bench):
    sides = np.linspace(0, 1, 5), np.linspace(0, 1, 5), np.zeros(1)
    plane = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1)
    write_grid(Grid.from_blocks([plane]), bench / "apart.xyz")
    plane[1:4, 0, 0, 1] = 1.5
    write_grid(Grid.from_blocks([plane]), bench / "through.xyz")
    done = call("repair", "through.xyz", "--reference", "apart.xyz", "-o", "o.xyz", "--json")
    assert done.code == 3, done.err
    report = json.loads(done.out)
    assert report["repair"]["converged"] is False


def test_nothing_is_written_in_a_dry_run_and_inputs_stay(spoilt, bench):
    done = spoilt("repair", "bad.invalid.xyz", "--reference", "grid.xyz", "-c", "case.toml", "--dry-run")
    assert done.code == 0
    judged = json.loads(spoilt("quality", "bad.invalid.xyz", "--reference", "grid.xyz", "--json").out)
    assert f"{len(judged['invalid_cells'])} cells are invalid; dry run, nothing written\n" in done.err
    for target in ("bad.invalid.xyz", "grid.xyz"):
        done = spoilt("repair", "bad.invalid.xyz", "--reference", "grid.xyz", "-o", target, "--force")
        assert done.code == 2
    assert spoilt("repair", "bad.invalid.xyz", "--reference", "grid.xyz").code == 2
    assert spoilt("repair", "bad.invalid.xyz", "-o", "good.xyz").code == 2
