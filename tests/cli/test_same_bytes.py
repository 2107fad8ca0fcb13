"""Grids and levels are the same bytes, whatever the cap on memory, the threads, and wherever a run was cut off."""

import json
import shutil
from pathlib import Path

import pytest
from grids import frame_2d

from meshdeform_core.memory import Demand
from meshdeform_core.parallel import scratch
from meshdeform_core.parallel.loops import set_sharing
from meshdeform_formats import write_grid

FAST = {
    "idw, fast": ("-m", "idw", "-s", "method.idw.summation=fast"),
    "idw-tfi, fast": ("-m", "idw-tfi", "-s", "method.idw.summation=fast"),
    "rbf, fast": ("-m", "rbf", "-s", "method.rbf.summation=fast", "-s", "method.rbf.solver=krylov"),
}
FLAT = """\
[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [{ rotate = { angle = "10*(1+t)", axis = [0, 0, 1] } }]
"""
FOLDED = ("-s", "constants.turn=45")
"""So far that cells are folded by TFI."""
SERIES = {
    **FAST,
    "repair": ("-m", "tfi", *FOLDED),
    "as many steps as needed": ("-m", "tfi", *FOLDED, "--steps", "auto", "--repair", "off"),
    "swept volumes": ("-m", "idw", "--velocity", "swept"),
    "VTK": ("-m", "rbf", "--suffix", ".vtm", "--velocity", "first", "--field", "all"),
    "plane": ("-m", "idw-tfi"),
    "plane, rbf": ("-m", "rbf-tfi", "--suffix", ".vtm"),
}
_OWN = ("timing", "seconds", "peak_memory_bytes", "run", "output")
"""Of a run, not of its result."""


def facts(record: object) -> object:
    """What a report says, without times."""
    if isinstance(record, dict):
        return {key: facts(value) for key, value in record.items() if key not in _OWN}
    return [facts(each) for each in record] if isinstance(record, list) else record


def made(folder: str) -> dict[str, bytes | object]:
    """The files in a folder, and what its reports say."""
    files = (path for path in sorted(Path(folder).rglob("*")) if path.is_file())
    return {
        str(path.relative_to(folder)): facts(json.loads(path.read_text())) if path.suffix == ".json"
        else path.read_bytes() for path in files
    }  # fmt: skip


@pytest.fixture
def run(call):
    def called(*words: str, code: int = 0) -> None:
        try:
            done = call(*words, "-q")
        finally:
            set_sharing(threads=None)
        assert done.code == code, done.err

    return called


@pytest.fixture
def in_files(monkeypatch):
    """Lets all arrays lie in files, of which every look returns the pages."""
    begin = scratch.Scratch.__init__

    def always_full(self, folder, limit):
        begin(self, folder, limit)
        self._full = 1

    def switch() -> tuple[str, str]:
        monkeypatch.setattr(scratch, "SMALLEST", 1000)
        monkeypatch.setattr(scratch.Scratch, "__init__", always_full)
        monkeypatch.setattr(Demand, "in_memory", 2**60)
        return "--max-memory", "2GiB"

    return switch


@pytest.mark.parametrize(
    "name",
    [
        name if name in ("idw, fast", "repair", "plane") else pytest.param(name, marks=pytest.mark.slow)
        for name in SERIES
    ],
)
def test_levels_do_not_depend_on_the_way_they_were_run(name, run, in_files, bench):
    text = (bench / "case.toml").read_text()
    (bench / "case.toml").write_text(text.replace('angle = "turn"', 'angle = "turn*(1+t)"'))
    (bench / "flat.toml").write_text(FLAT)
    write_grid(frame_2d(), "flat.cgns")
    inputs = ("flat.cgns", "-c", "flat.toml") if name.startswith("plane") else ("grid.cgns", "-c", "case.toml")
    words = ("series", *inputs, *SERIES[name], "--times", "0:0.5:0.25", "--allow-invalid")

    run(*words, "-o", "whole", "--threads", "1")
    expected = made("whole")
    assert any(level["repair"] for level in expected["series.json"]["levels"]) == (name == "repair")
    run(*words, "-o", "threads", "--threads", "2")
    assert made("threads") == expected
    for path in Path("threads").glob("*_000[23]*"):
        path.unlink() if path.is_file() else shutil.rmtree(path)
    run(*words, "-o", "threads", "--resume")
    assert made("threads") == expected
    run(*words, "-o", "files", *in_files())
    assert made("files") == expected
