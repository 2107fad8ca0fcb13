"""A rank is killed at a random moment: what was there is left or what is new is complete, every process ends, and no
more than one message is printed."""

import contextlib
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

import pytest
from grids import CASE, frame
from started_ranks import LIMIT, MPIEXEC, environment, needs_mpi, start

from meshdeform_formats import write_grid

pytestmark = [needs_mpi, pytest.mark.slow]

RANKS = 3
# In memory or in files; every rank notes its process when it starts.
PROGRAM = """
import os
from pathlib import Path
from meshdeform_cli import process

if here := process.place():
    Path(f"process{here.number}").write_text(f"{os.getpid()}.")

from meshdeform_cli.main import main
from meshdeform_core.memory import Demand
from meshdeform_core.parallel import scratch

if os.environ["PLACE"] == "files":
    scratch.SMALLEST = 1000
    Demand.in_memory = 2**60
main()
"""
INPUT = ("grid.xyz", "-c", "case.toml", "-m", "idw-tfi", "--repair", "off", "-q", "--max-memory", "4GiB")
COMMANDS = {
    "deform": ("deform", *INPUT, "--time", "1", "-o", "out/grid.xyz"),
    "series": ("series", *INPUT, "--times", "0:5:1", "-o", "out"),
}
ANEW = {"deform": "--force", "series": "--resume"}


class Whole(NamedTuple):
    """What a command leaves that nothing interrupts, and the seconds that its ranks take."""

    outputs: dict[str, bytes]
    seconds: float


def outputs() -> dict[str, bytes]:
    """Files by name, but for those that tell times."""
    return {path.name: path.read_bytes() for path in Path("out").iterdir() if path.suffix != ".json"}


def prepared(folder: Path) -> None:
    (folder / "out").mkdir()
    (folder / "case.toml").write_text(CASE.replace('"turn"', '"turn * (1 + t)"'))
    (folder / "program.py").write_text(PROGRAM)
    write_grid(frame(12, 10), folder / "grid.xyz")


@pytest.fixture(scope="module")
def whole(tmp_path_factory, compiled):
    """By command: from one process; the time is that of ranks, from their start."""
    found = {}
    for name, command in COMMANDS.items():
        with contextlib.chdir(tmp_path_factory.mktemp(name)):
            prepared(Path())
            alone = start(sys.executable, "program.py", *command, PLACE="memory")
            assert alone.returncode == 0, alone.stderr
            expected = outputs()
            shutil.rmtree("out")
            Path("out").mkdir()
            code, told, seconds = on_ranks(command, "memory")
            assert (code, told, outputs()) == (0, "", expected)
            found[name] = Whole(expected, seconds)
    return found


def on_ranks(command, place, victim=0, moment=None) -> tuple[int, str, float]:
    """Exit code, stderr, and seconds from the start of the last rank to the end of all; rank ``victim`` is killed
    ``moment`` seconds after that start."""
    words = [MPIEXEC, "-n", str(RANKS), sys.executable, "program.py", *command]
    with subprocess.Popen(words, env=environment(PLACE=place), stderr=subprocess.PIPE, text=True) as launcher:
        notes = [Path(f"process{number}") for number in range(RANKS)]
        within(lambda: all(note.exists() and note.read_text().endswith(".") for note in notes))
        begin, processes = time.monotonic(), [int(note.read_text()[:-1]) for note in notes]
        if moment is not None:
            time.sleep(moment)
            with contextlib.suppress(ProcessLookupError):
                os.kill(processes[victim], signal.SIGKILL)
        _, told = launcher.communicate(timeout=LIMIT)
    within(lambda: not any(Path(f"/proc/{process}").exists() for process in processes))
    return launcher.returncode, told, time.monotonic() - begin


def within(condition) -> None:
    """Wait until it is true."""
    end = time.monotonic() + LIMIT
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("place", ["memory", "files"])
@pytest.mark.parametrize("name", COMMANDS)
def test_a_rank_killed_at_a_random_moment_ends_all(name, place, seed, whole, tmp_path, monkeypatch, call):
    monkeypatch.chdir(tmp_path)
    prepared(tmp_path)
    command, expected = COMMANDS[name], whole[name].outputs
    old = {"grid.xyz": b"old"} if name == "deform" else {}
    for file, content in old.items():
        Path("out", file).write_bytes(content)
    rng = random.Random(f"{name} {place} {seed}")
    victim, moment = rng.randrange(RANKS), rng.uniform(0, whole[name].seconds)
    code, told, _ = on_ranks((*command, *["--force"] * bool(old)), place, victim, moment)
    case = f"seed {seed}: rank {victim} after {moment:.3f} of {whole[name].seconds:.3f} s, exit code {code}: {told}"
    left = outputs()
    partial = {each for each in left if re.fullmatch(r"\..*\.partial(\..*)?", each)}
    found = {each: left[each] for each in left.keys() - partial}
    done = found == expected
    assert done if code == 0 else code not in (2, 3), case
    assert len(re.findall(r"^(?:rank \d of \d: )?meshdeform: ", told, re.MULTILINE)) <= 1, case
    assert "Traceback" not in told, case
    if name == "deform":
        assert done or found == old, case
    else:
        state = Path("out/series.json")
        listed = json.loads(state.read_text())["levels"] if state.exists() else []
        assert all(found[level["file"]] == expected[level["file"]] for level in listed), case
        assert found.keys() <= expected.keys(), case
    # The next run goes on, and removes what a killed process left.
    assert call(*command, ANEW[name]).code == 0, case
    assert outputs() == expected, case
