"""Levels of a series are the same bytes, whatever the cap on memory, the threads, and wherever a run was cut off."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from meshdeform_core.memory import Demand
from meshdeform_core.methods import CATALOGUE
from meshdeform_core.parallel import scratch
from meshdeform_core.parallel.loops import set_threads

_LEVELS = 4
FAST = {
    "idw, fast": ("-m", "idw", "-s", "method.idw.summation=fast"),
    "idw-tfi, fast": ("-m", "idw-tfi", "-s", "method.idw.summation=fast"),
    "rbf, fast": ("-m", "rbf", "-s", "method.rbf.summation=fast", "-s", "method.rbf.solver=krylov"),
}
CHOSEN = {**{name: ("-m", name) for name in CATALOGUE}, **FAST}


def facts(record: object) -> object:
    """What a level says, without times."""
    if isinstance(record, dict):
        return {
            key: facts(value) for key, value in record.items() if key not in ("timing", "seconds", "peak_memory_bytes")
        }
    return [facts(each) for each in record] if isinstance(record, list) else record


def levels(folder: str) -> tuple[list[bytes], list[dict]]:
    files = [(Path(folder) / f"grid_{number:04d}.cgns").read_bytes() for number in range(_LEVELS)]
    return files, facts(json.loads((Path(folder) / "series.json").read_text())["levels"])


@pytest.mark.parametrize(
    "name", [name if name == "idw, fast" else pytest.param(name, marks=pytest.mark.slow) for name in CHOSEN]
)
def test_levels_do_not_depend_on_the_way_they_were_run(name, call, bench, monkeypatch):
    text = (bench / "case.toml").read_text()
    (bench / "case.toml").write_text(text.replace('angle = "turn"', 'angle = "turn*(1+t)"'))
    words = ("series", "grid.cgns", "-c", "case.toml", *CHOSEN[name], "--times", "0:0.75:0.25", "-q", "--allow-invalid")

    def made(folder: str, *more: str) -> tuple[list[bytes], list[dict]]:
        try:
            done = call(*words, "-o", folder, *more)
        finally:
            set_threads(None)
        assert done.code == 0, done.err
        return levels(folder)

    expected = made("whole", "--threads", "1")
    assert made("threads", "--threads", "2") == expected
    for number in (2, 3):
        (Path("threads") / f"grid_{number:04d}.cgns").unlink()
    assert made("threads", "--resume") == expected
    # All arrays in files, of which every look returns the pages.
    monkeypatch.setattr(scratch, "SMALLEST", 1000)
    monkeypatch.setattr(scratch.Scratch, "__init__", _always_full(scratch.Scratch.__init__))
    monkeypatch.setattr(Demand, "in_memory", 2**60)
    assert made("files", "--max-memory", "2GiB") == expected


def _always_full(begin):
    def changed(self, folder, limit):
        begin(self, folder, limit)
        self._full = 1

    return changed
