"""``--max-memory``: a run keeps to it or is refused before it takes the memory."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from grids import frame

from meshdeform_formats import write_grid

pytestmark = pytest.mark.slow

PROGRAM = Path(sys.executable).with_name("meshdeform")
CAPS = (215, 260, 400)


@pytest.mark.parametrize("method", ["tfi", "rbf"])
def test_the_peak_is_below_the_cap_or_the_run_refused(method, bench):
    write_grid(frame(24, 12), "large.cgns")
    outcomes = []
    for cap in CAPS:
        # The first run may compile, which takes memory of its own.
        done = [subprocess.run(
            [PROGRAM, "deform", "large.cgns", "-c", "case.toml", "-m", method, "-o", f"out{cap}.cgns", "-q",
             "--max-memory", f"{cap}MiB", "--repair", "off", "--report", f"out{cap}.json", "--force"],
            capture_output=True, text=True, check=False,
        ) for _ in range(2)][-1]  # fmt: skip
        assert done.returncode in (0, 2, 3), done.stderr
        outcomes.append(done.returncode)
        if done.returncode == 2:
            assert "--max-memory allows" in done.stderr
        else:
            assert json.loads(Path(f"out{cap}.json").read_text())["peak_memory_bytes"] <= cap * 2**20
    assert outcomes[0] == 2
    assert outcomes[-1] != 2
