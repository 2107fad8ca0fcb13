"""The benchmark programs fit the code that they measure; `make bench` runs them in full."""

import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent.parent / "benchmarks"


@pytest.mark.slow
@pytest.mark.parametrize("section", ["passes", "levels"])
def test_small_sizes_run(section, tmp_path):
    # All programs are imported by the one that runs them.
    command = [sys.executable, FOLDER / "run.py", "--quick", "--only", section, "--json", tmp_path / "x.json"]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    assert result.returncode == 0, result.stderr
    assert "| hemisphere" in result.stdout
