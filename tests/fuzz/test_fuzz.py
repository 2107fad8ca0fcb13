"""A short campaign in every run of the tests, and faults at random moments; ``make fuzz N=20000`` for long ones."""

from __future__ import annotations

import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from grids import frame

from fuzz.campaign import RIGHT, campaign
from fuzz.samples import CASE
from meshdeform_formats import read_grid, write_grid

PROGRAM = Path(sys.executable).with_name("meshdeform")
SUFFIXES = (".xyz", ".p3dfmt")


def test_no_sample_is_silently_wrong_or_ends_in_a_traceback():
    wrong = [sample for sample in campaign(285, seed=20240) if sample[2] not in RIGHT]
    assert wrong == []


@pytest.fixture
def grid(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("case.toml").write_text(CASE)
    write_grid(frame(6, 6), "grid.xyz")
    return tmp_path


def command(output: str) -> list[str]:
    return [str(PROGRAM), "deform", "grid.xyz", "-c", "case.toml", "-m", "tfi", "-o", output, "-q"]


@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX systems")
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL], ids=["SIGTERM", "SIGKILL"])
def test_killed_at_a_random_moment_there_is_a_whole_file_or_none(number, grid):
    start = time.perf_counter()
    assert subprocess.run(command("whole.cgns"), check=False).returncode == 0
    duration = time.perf_counter() - start
    expected = read_grid("whole.cgns").points
    rng = random.Random(number)
    for attempt in range(4):
        before = set(grid.iterdir())
        with subprocess.Popen(command(f"out{attempt}.cgns"), stderr=subprocess.DEVNULL) as process:
            time.sleep(rng.uniform(0.3, 1.1) * duration)
            process.send_signal(number)
        assert process.returncode in (0, 128 + number, -number)
        left = set(grid.iterdir()) - before
        if number == signal.SIGTERM:
            assert left <= {grid / f"out{attempt}.cgns"}
        if (grid / f"out{attempt}.cgns").exists():
            np.testing.assert_array_equal(read_grid(f"out{attempt}.cgns").points, expected)


@pytest.mark.skipif(shutil.which("bash") is None, reason="needs ulimit")
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_leaves_the_old_file(suffix, grid):
    write_grid(frame(6, 6), f"out{suffix}")
    old = {path: path.read_bytes() for path in grid.rglob("*") if path.is_file()}
    words = " ".join([*command(f"out{suffix}"), "--force"])
    done = subprocess.run(
        ["bash", "-c", f"ulimit -f 16; exec {words}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2, done.stderr
    assert "meshdeform: error: " in done.stderr
    assert "Traceback" not in done.stderr
    assert {path: path.read_bytes() for path in grid.rglob("*") if path.is_file()} == old
