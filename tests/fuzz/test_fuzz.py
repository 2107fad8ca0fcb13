"""A short campaign in every run of the tests, and faults at random moments; ``make fuzz N=20000`` for long ones."""

from __future__ import annotations

import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from grids import CASE, frame

from fuzz.campaign import KINDS, RIGHT, campaign
from meshdeform_formats import read_grid, write_grid

pytestmark = pytest.mark.slow

PROGRAM = Path(sys.executable).with_name("meshdeform")


# The worker compiles every loop first, which takes minutes where nothing is compiled and the machine is busy.
@pytest.mark.timeout(1200)
def test_no_sample_is_silently_wrong_or_ends_in_a_traceback():
    wrong = [sample for sample in campaign(3 * len(KINDS), seed=20240) if sample[2] not in RIGHT]
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
@pytest.mark.parametrize("suffix", [".cgns", ".vtm"])
def test_killed_at_a_random_moment_there_is_a_whole_file_or_none(suffix, grid):
    start = time.perf_counter()
    assert subprocess.run(command(f"whole{suffix}"), check=False).returncode == 0
    duration = time.perf_counter() - start
    target = grid / f"out{suffix}"
    with subprocess.Popen(command(target.name), stderr=subprocess.DEVNULL) as process:
        # Most of the time goes into starting; files are written at the end.
        time.sleep(random.Random(suffix).uniform(0.6, 1.1) * duration)
        process.kill()
    assert process.returncode in (0, -signal.SIGKILL)
    if target.exists():
        np.testing.assert_array_equal(read_grid(target).points, read_grid(f"whole{suffix}").points)
    # The next run finds its way past what is left, and cleans it up.
    assert subprocess.run([*command(target.name), "--force"], check=False).returncode == 0
    assert not list(grid.rglob(".out*partial*"))
