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
@pytest.mark.parametrize(
    ("suffix", "number"),
    [
        (".cgns", signal.SIGKILL),
        (".vtm", signal.SIGKILL),
        (".med", signal.SIGTERM),
    ],
    ids=str,
)
def test_killed_at_a_random_moment_there_is_a_whole_file_or_none(suffix, number, grid):
    start = time.perf_counter()
    assert subprocess.run(command(f"whole{suffix}"), check=False).returncode == 0
    duration = time.perf_counter() - start
    expected = None if suffix == ".med" else read_grid(f"whole{suffix}").points
    size = (grid / f"whole{suffix}").stat().st_size
    rng = random.Random(f"{number}{suffix}")
    before, target = set(grid.iterdir()), grid / f"out{suffix}"
    with subprocess.Popen(command(target.name), stderr=subprocess.DEVNULL) as process:
        # Most of the time goes into starting; files are written at the end.
        time.sleep(rng.uniform(0.6, 1.1) * duration)
        process.send_signal(number)
    assert process.returncode in (0, 128 + number, -number)
    left = {path for path in set(grid.iterdir()) - before if not path.is_dir()}
    if number == signal.SIGTERM:
        assert left <= {target}
    if target.exists():
        if expected is None:
            assert target.stat().st_size == size
        else:
            np.testing.assert_array_equal(read_grid(target).points, expected)
    # The next run finds its way past what is left, and cleans it up.
    assert subprocess.run([*command(target.name), "--force"], check=False).returncode == 0
    assert not list(grid.rglob(".out*partial*"))
