"""What fuzz campaigns found, each as the smallest input that shows it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from grids import frame

from fuzz.samples import CASE, called
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


@pytest.mark.parametrize("length", ["1e-320", "5e-324", "1e200", "1.7e308"])
def test_the_length_of_an_axis_does_not_matter(length, folder):
    assert deformed(CASE, "one.xyz")[0] == 0
    assert deformed(CASE.replace("[0, 0, 1]", f"[0, 0, {length}]"), "other.xyz")[0] == 0
    np.testing.assert_array_equal(read_grid("one.xyz").points, read_grid("other.xyz").points)


@pytest.mark.parametrize("size", ["1e31", "1e200", "-1e308"])
def test_a_displacement_larger_than_any_length_is_refused(size, folder):
    code, told = deformed(CASE.replace("center = [0, 0, 0]", f"center = [{size}, 0, 0]"))
    assert code == 2
    assert "expected finite numbers up to 1e+30" in told


def test_an_exponent_without_its_letter_is_read_as_fortran_reads_it(folder):
    write_grid(frame(2, 2), "grid.p3dfmt", {"encoding": "ascii"})
    text = Path("grid.p3dfmt").read_text()
    Path("bad.p3dfmt").write_text(text.replace("-2", "-20-1", 1))
    np.testing.assert_array_equal(read_grid("bad.p3dfmt").points, read_grid("grid.p3dfmt").points)
