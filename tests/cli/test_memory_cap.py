"""``--max-memory``: a run keeps to it or is refused before it takes the memory."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from grids import frame

from meshdeform_core.memory import PICTURE_BYTES
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


RUNS = {
    "idw": ("deform", "-m", "idw", "-o", "out.cgns", "--repair", "off"),
    "idw-rbf": ("deform", "-m", "idw-rbf", "-o", "out.cgns", "--repair", "off"),
    "fields": ("deform", "-m", "tfi", "-o", "out.vtm", "--repair", "off", "--field", "all"),
    "repair": ("deform", "-m", "tfi", "-o", "out.cgns", "-s", "constants.turn=50", "--allow-invalid"),
    "velocity": (
        "series",
        "-m",
        "tfi",
        "-o",
        "levels",
        "--times",
        "0:1:0.5",
        "--velocity",
        "second",
        "--suffix",
        "vtm",
    ),
    "pictures": ("deform", "-m", "tfi", "-o", "out.cgns", "--repair", "off", "--report", "out.html"),
}


OTHERS = {
    "info": ("info", "large.cgns", "--json"),
    "quality": ("quality", "bent.cgns", "--reference", "large.cgns"),
    "compare": ("compare", "bent.cgns", "large.cgns"),
    "convert": ("convert", "large.cgns", "out.p3dbin", "--force"),
    "fields of a conversion": ("convert", "bent.cgns", "out.vtm", "--reference", "large.cgns", "--field", "all",
                               "--force"),
    "a repair": ("repair", "bent.cgns", "--reference", "large.cgns", "-o", "out.cgns", "--force"),
}  # fmt: skip


def capped(cap: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command whose last output is its peak."""
    code = (
        "import sys; from meshdeform_cli.main import run; from meshdeform_core.memory import peak_memory; "
        "code = run(sys.argv[1:]); print('peak', peak_memory()); sys.exit(code)"
    )
    command = [sys.executable, "-c", code, *words, "--max-memory", str(cap)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def keeps_to_what_it_asks_for(*words: str, extra: int = 0) -> None:
    """The message of a refused run says what is needed; with that the run succeeds and keeps to it."""
    cap = 10**6
    for _ in range(8):
        done = capped(cap, *words)
        if done.returncode != 2:
            break
        needed = re.search(r"needs about ([\d.]+) (MiB|GiB)", done.stderr)
        assert needed, done.stderr
        assert done.stderr.count("error:") == 1
        least = int(float(needed[1]) * 2 ** (20 if needed[2] == "MiB" else 30) * 1.01) + extra
        cap = max(least, int(1.05 * cap))
    # The first run may compile, which takes memory of its own.
    done = capped(cap, *words)
    assert done.returncode in (0, 3), done.stderr
    assert int(done.stdout.split()[-1]) <= cap


@pytest.mark.parametrize("name", RUNS)
def test_the_smallest_cap_that_is_accepted_is_kept(name, bench):
    write_grid(frame(36, 18), "large.cgns")
    text = (bench / "case.toml").read_text()
    (bench / "case.toml").write_text(text.replace('angle = "turn"', 'angle = "turn*(1+t)"'))
    command, *options = RUNS[name]
    extra = PICTURE_BYTES if name == "pictures" else 0
    keeps_to_what_it_asks_for(command, "large.cgns", "-c", "case.toml", *options, "-q", "--force", extra=extra)


@pytest.mark.parametrize("name", OTHERS)
def test_commands_that_deform_nothing_keep_to_the_cap(name, bench):
    grid = frame(60, 30)
    write_grid(grid, "large.cgns")
    write_grid(grid.moved(grid.points + 1e-3 * np.sin(grid.points[:, [1, 2, 0]])), "bent.cgns")
    keeps_to_what_it_asks_for(*OTHERS[name])


def test_a_series_larger_than_the_memory_is_the_same(bench):
    """Levels, velocities and the search for jumps work on arrays in files."""
    write_grid(frame(70, 36), "large.cgns")
    text = (bench / "case.toml").read_text()
    (bench / "case.toml").write_text(text.replace('angle = "turn"', 'angle = "turn*(1+t)"'))
    words = ("series", "large.cgns", "-c", "case.toml", "-m", "tfi", "--repair", "off", "--times", "0:0.3:0.1", "-q")
    words += ("--velocity", "second", "--allow-invalid")
    for folder, cap in (("whole", 10**11), ("files", 740 * 2**20)):
        done = capped(cap, *words, "-o", folder)
        assert done.returncode == 0, done.stderr
        assert int(done.stdout.split()[-1]) <= cap
    for number in range(4):
        name = f"large_{number:04d}.cgns"
        assert (bench / "whole" / name).read_bytes() == (bench / "files" / name).read_bytes()
