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


@pytest.mark.parametrize("angle", ["1e-320", "1e-308", "5e-324"])
def test_a_motion_smaller_than_any_length_writes_no_denormal_numbers(angle, folder):
    assert deformed(CASE.replace("turn = 10.0", f"turn = {angle}"))[0] == 0
    np.testing.assert_array_equal(read_grid("out.xyz").points, read_grid("grid.xyz").points)


@pytest.mark.parametrize(
    "option",
    ["alpha=1e300", "b=300", "a=1e9", "length=1e200", "eta=1e300"],
)
def test_powers_that_overflow_are_refused(option, folder):
    more = ("-s", "method.idw.alpha=auto") if option.startswith("eta") else ()
    arguments = ("deform", "grid.xyz", "-c", "case.toml", "-m", "idw", "-s", f"method.idw.{option}", *more)
    code, told = called(*arguments, "-o", "out.xyz", "-q")
    assert code == 2
    assert "expected at most" in told or "too large a number" in told


def test_data_sets_outside_of_the_set_are_no_part_of_it(folder):
    """Two lines of an index have changed places: its blocks would be lost without a word."""
    write_grid(frame(2, 2), "set.vtm", {"encoding": "ascii"})
    lines = Path("set.vtm").read_text().splitlines()
    ends = next(n for n, line in enumerate(lines) if "</vtkMultiBlockDataSet" in line)
    lines[ends], lines[ends - 3] = lines[ends - 3], lines[ends]
    Path("set.vtm").write_text("\n".join(lines))
    code, told = called("info", "set.vtm")
    assert code == 2
    assert "3 DataSet elements lie outside of vtkMultiBlockDataSet" in told
