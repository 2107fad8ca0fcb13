"""What a dry run foretells is what the run then meets, and what it says that a run takes: from the header of the file
alone, where the grid is larger than the memory."""

from __future__ import annotations

import json
import os
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from grids import frame

from meshdeform_cli import dry_run
from meshdeform_cli.main import run
from meshdeform_core.memory import PICTURE_BYTES
from meshdeform_formats import write_grid

BILLION = 10**9


@pytest.fixture
def sparse(tmp_path):
    """A Plot3D file of 1e9 nodes in 1000 blocks, nearly all of it a hole."""
    shapes = np.full((1000, 3), 100, np.int32)
    with (tmp_path / "sparse.xyz").open("wb") as stream:
        stream.write(struct.pack("<i", len(shapes)) + shapes.tobytes())
        stream.truncate(4 + shapes.nbytes + 24 * BILLION)
    if os.stat(tmp_path / "sparse.xyz").st_blocks * 512 > 10**6:
        pytest.skip("this file system has no holes")
    return tmp_path / "sparse.xyz"


def test_a_billion_nodes_are_foretold_from_a_header(sparse, call, bench, tmp_path):
    output = tmp_path / "out.xyz"
    done = call("deform", sparse, "-c", "case.toml", "-o", output, "--dry-run", "--json", "-q", "--max-memory", "64GiB",
                "--variant", "precision=float32")  # fmt: skip
    assert done.code == 0, done.err
    assert "only the header of its file was read" in done.err
    report = json.loads(done.out)
    assert report["grid"]["nodes"] == BILLION
    expected = report["expected"]
    assert 16 * 2**30 < expected["memory_bytes"] <= 64 * 2**30
    assert 52 * BILLION < expected["work_bytes"] < 60 * BILLION
    assert expected["output_bytes"] == 12 * BILLION
    assert not output.exists()


def test_what_fits_in_no_way_is_refused_with_its_size(sparse, call, bench):
    command = "deform", sparse, "-c", "case.toml", "--dry-run", "-q", "--max-memory"
    done = call(*command, "8GiB")
    assert done.code == 2
    assert "deforming 1,000,000,000 nodes needs about 10 GiB" in done.err
    assert call(*command, "10.2GiB").code == 0


def test_grids_too_large_for_a_trial_are_told_what_they_take(call, bench, monkeypatch):
    """By the same numbers, in a report and as text."""
    monkeypatch.setattr(dry_run, "TRIAL_NODES", 1000)
    command = ("deform", "grid.cgns", "-c", "case.toml", "-o", "out.cgns", "--dry-run")
    expected = json.loads(call(*command, "--json", "-q").out)["expected"]
    assert expected["output_bytes"] == os.path.getsize("grid.cgns")
    assert expected["work_bytes"] == 0
    assert 150e6 < expected["memory_bytes"] < 400e6
    assert "expected  memory" in call(*command).out
    pictured = json.loads(call(*command, "--json", "-q", "--report", "out.html").out)["expected"]
    assert pictured["memory_bytes"] == expected["memory_bytes"] + PICTURE_BYTES


def test_a_series_of_a_billion_nodes_is_foretold_from_a_header(sparse, call, bench, tmp_path, monkeypatch):
    command = ("series", sparse, "-c", "case.toml", "-o", tmp_path / "levels", "--times", "0:4:1", "--dry-run",
               "--json", "-q", "--max-memory", "64GiB")  # fmt: skip
    for free, warned in ((2 * 10**11, True), (10**13, False)):
        monkeypatch.setattr(shutil, "disk_usage", lambda _, free=free: SimpleNamespace(free=free))
        done = call(*command)
        assert done.code == 0, done.err
        assert ("free, files to work in and the output take at least" in done.err) == warned
    swept = json.loads(call(*command, "--suffix", ".vtm", "--velocity", "swept").out)["expected"]
    # Velocities in three components, and two fields at the faces across three directions, of 99^3 cells per block.
    assert swept["output_bytes"] == 5 * 1000 * (2 * 24 * 100**3 + 48 * 99**3)
    expected = json.loads(done.out)["expected"]
    assert expected["output_bytes"] == 5 * 24 * BILLION
    # Like the 604 MB that four levels of 4,578,948 nodes took, 132 bytes per node, and some for face nodes.
    assert 132 * BILLION < expected["work_bytes"] < 136 * BILLION
    assert not (tmp_path / "levels").exists()


@pytest.fixture(scope="module")
def plate(tmp_path_factory):
    folder = tmp_path_factory.mktemp("plate")
    assert run(["sample", "splitter-plate", "-o", str(folder), "--size", "8"]) == 0
    return folder


@pytest.fixture
def both(plate, call, tmp_path):
    """Warnings of a dry run about the trial, and the exit code and report of the run."""

    def called(*options: str) -> tuple[list[str], int, dict]:
        command = ("deform", plate / "grid.cgns", "-c", plate / "case.toml", *options, "-m", "tfi")
        dry = call(*command, "--dry-run")
        assert dry.code == 0, dry.err
        assert list(tmp_path.iterdir()) == []
        real = call(*command, "-o", tmp_path / "out.cgns", "--report", tmp_path / "out.json", "-q")
        report = json.loads((tmp_path / "out.json").read_text()) if real.code in (0, 3) else {}
        return dry.warnings, real.code, report

    return called


@pytest.mark.parametrize(
    ("options", "steps", "response"),
    [
        (("60", "--repair", "off", "--steps", "3"), "3 steps",
         "without repair the run is bound to fail: try --repair auto, --steps auto or another method"),
        (("60", "--repair", "off", "--steps", "auto"), "1 step",
         "the run divides the motion, which may not reach all of it"),
        (("45",), "1 step", "the run will repair them, then smaller steps, which takes longer and may fail"),
        (("45", "--steps", "1"), "1 step", "the run will repair them, which takes longer and may fail"),
    ],
)  # fmt: skip
def test_it_counts_the_cells_that_fail_and_says_what_will_be_done(options, steps, response, both):
    warnings, code, report = both("-s", f"constants.angle={options[0]}", *options[1:])
    (told,) = [text for text in warnings if text.startswith("tried")]
    cells = next(each["invalid_cells"] for each in report["attempts"] if each["reached"] == 1.0)
    begin, place, end = re.fullmatch("(.*), the worst (.*); (.*)", told).groups()
    assert (begin, end) == (f"tried with tfi in {steps}: {cells} cells become invalid", response)
    assert code == (3 if "off" in options else 0)
    if steps == "3 steps":
        worst = report["invalid_cells"][0]
        assert place.endswith(f": {worst['block']} {tuple(worst['ijk'])}")


def test_of_a_series_the_worst_level_is_tried(plate, call):
    """Which is not the last one."""
    case = (plate / "case.toml").read_text().replace('angle = "angle"', 'angle = "angle*t*(3-t)"')
    Path(plate / "moving.toml").write_text(case)
    command = ("series", plate / "grid.cgns", "-c", plate / "moving.toml", "-m", "tfi", "--repair", "off")
    result = call(*command, "--times", "0:3:1", "-o", plate / "out", "--dry-run")
    assert any(text.startswith("at t = 2, where the displacement is largest: tried") for text in result.warnings)
    assert not call(*command, "--times", "0:0.1:0.1", "-o", plate / "out", "--dry-run").warnings


SERIES = ("series", "-m", "tfi", "--repair", "off", "--velocity", "second")
RUNS = {
    "idw-rbf": ("deform", "-m", "idw-rbf", "-o", "out.cgns", "--repair", "off"),
    "repair": ("deform", "-m", "tfi", "-o", "out.cgns", "-s", "constants.turn=50", "--allow-invalid"),
    "velocity": (*SERIES, "-o", "levels", "--times", "0:1:0.5", "--suffix", "vtm"),
}
WITH_TWO = ("bent.cgns", "--reference", "large.cgns")
COMMANDS = {
    **{name: (words[0], "large.cgns", "-c", "case.toml", *words[1:], "-q", "--force") for name, words in RUNS.items()},
    "quality": ("quality", *WITH_TWO),
    "fields of a conversion": ("convert", "bent.cgns", "out.vtm", *WITH_TWO[1:], "--field", "all", "--force"),
    "a repair": ("repair", *WITH_TWO, "-o", "out.cgns", "--force"),
}


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


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_the_smallest_cap_that_is_accepted_is_kept(name, turning):
    grid = frame(*((20, 10) if name == "idw-rbf" else (36, 18)))
    write_grid(grid, "large.cgns")
    write_grid(grid.moved(grid.points + 1e-3 * np.sin(grid.points[:, [1, 2, 0]])), "bent.cgns")
    keeps_to_what_it_asks_for(*COMMANDS[name])
