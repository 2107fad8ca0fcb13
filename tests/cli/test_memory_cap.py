"""``--max-memory``: a run keeps to it or is refused before it takes the memory."""

import re
import subprocess
import sys

import numpy as np
import pytest
from grids import frame

from meshdeform_formats import write_grid

pytestmark = pytest.mark.slow

SERIES = ("series", "-m", "tfi", "--repair", "off", "--velocity", "second")
RUNS = {
    "idw-rbf": ("deform", "-m", "idw-rbf", "-o", "out.cgns", "--repair", "off"),
    "repair": ("deform", "-m", "tfi", "-o", "out.cgns", "-s", "constants.turn=50", "--allow-invalid"),
    "velocity": (*SERIES, "-o", "levels", "--times", "0:1:0.5", "--suffix", "vtm"),
}
OTHERS = {
    "quality": ("quality", "bent.cgns", "--reference", "large.cgns"),
    "fields of a conversion": ("convert", "bent.cgns", "out.vtm", "--reference", "large.cgns", "--field", "all",
                               "--force"),
    "a repair": ("repair", "bent.cgns", "--reference", "large.cgns", "-o", "out.cgns", "--force"),
}  # fmt: skip


def capped(cap: int, *words: str) -> subprocess.CompletedProcess[str]:
    """A command whose last output is its peak."""
    code = (
        "import sys; from meshdeform_cli.main import run; from meshdeform_core import memory; "
        "code = run(sys.argv[1:]); print('peak', memory.peak_memory()); sys.exit(code)"
    )
    command = [sys.executable, "-c", code, *words, "--max-memory", str(cap)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def keeps_to_what_it_asks_for(*words: str) -> None:
    """The message of a refused run says what is needed; with that the run succeeds and keeps to it."""
    cap = 10**6
    for _ in range(8):
        done = capped(cap, *words)
        # The first run that is accepted may compile, which takes memory of its own.
        if done.returncode != 2 and (done.returncode not in (0, 3) or int(done.stdout.split()[-1]) <= cap):
            break
        if done.returncode == 2:
            needed = re.search(r"needs about ([\d.]+) (MiB|GiB)", done.stderr)
            assert needed, done.stderr
            assert done.stderr.count("error:") == 1
            least = int(float(needed[1]) * 2 ** (20 if needed[2] == "MiB" else 30) * 1.01)
            cap = max(least, int(1.05 * cap))
    assert done.returncode in (0, 3), done.stderr
    assert int(done.stdout.split()[-1]) <= cap


@pytest.fixture
def turning(bench):
    """A case whose motion depends on time."""
    text = (bench / "case.toml").read_text()
    (bench / "case.toml").write_text(text.replace('angle = "turn"', 'angle = "turn*(1+t)"'))
    return bench


@pytest.mark.parametrize("name", RUNS)
def test_the_smallest_cap_that_is_accepted_is_kept(name, turning):
    write_grid(frame(*((20, 10) if name == "idw-rbf" else (36, 18))), "large.cgns")
    command, *options = RUNS[name]
    keeps_to_what_it_asks_for(command, "large.cgns", "-c", "case.toml", *options, "-q", "--force")


@pytest.mark.parametrize("name", OTHERS)
def test_commands_that_deform_nothing_keep_to_the_cap(name, bench):
    grid = frame(36, 18)
    write_grid(grid, "large.cgns")
    write_grid(grid.moved(grid.points + 1e-3 * np.sin(grid.points[:, [1, 2, 0]])), "bent.cgns")
    keeps_to_what_it_asks_for(*OTHERS[name])
