"""Levels written while the next one is computed: same files, same order, errors where they belong."""

from __future__ import annotations

import json
import threading
from pathlib import Path

import pytest

from meshdeform_cli import series_run
from meshdeform_core.errors import FormatError
from meshdeform_formats.series.outputs import LevelFiles

CASE = """\
[[boundary]]
name = "body"
select = ["*.i*", "*.j*"]
where = "abs(x) < 0.51 and abs(y) < 0.51"
motion = [{ rotate = { angle = "20*sin(2*pi*t)", axis = [0, 0, 1] } }]

[[boundary]]
name = "span"
select = ["*.kmin", "*.kmax"]
kind = "slip"
"""
RUN = ("series", "grid.xyz", "-c", "case.toml", "--times", "0:0.8:0.2", "--threads", "2", "--repair", "off")
COUNT = 5


@pytest.fixture
def swing(bench: Path) -> Path:
    (bench / "case.toml").write_text(CASE)
    return bench


def levels_of(folder: str) -> list[str]:
    return [level["file"] for level in json.loads(Path(folder, "series.json").read_text())["levels"]]


@pytest.fixture
def written(monkeypatch):
    """Which levels are written, by which thread."""
    found: list[tuple[int, bool]] = []
    plain = LevelFiles.write

    def write(self, number, grid, *rest):
        found.append((number, threading.current_thread() is threading.main_thread()))
        plain(self, number, grid, *rest)

    monkeypatch.setattr(LevelFiles, "write", write)
    return found


@pytest.mark.parametrize("extra", [
    ("--suffix", ".vtm", "--velocity", "second", "--from", "last"),
], ids=lambda extra: extra[-1])  # fmt: skip
def test_files_are_the_same_as_when_levels_are_written_alone(extra, swing, call, written, monkeypatch):
    assert call(*RUN, *extra, "-o", "beside").code == 0
    # The last level has no next one.
    assert [alone for _, alone in written] == [*[False] * (COUNT - 1), True]
    monkeypatch.setattr(series_run.Recorder, "_alone", lambda *_: True)
    assert call(*RUN, *extra, "-o", "alone").code == 0
    assert written[COUNT:] == [(n, True) for n in range(COUNT)]
    files = sorted(path.relative_to("alone") for path in Path("alone").rglob("*") if path.is_file())
    assert files == sorted(path.relative_to("beside") for path in Path("beside").rglob("*") if path.is_file())
    for name in files:
        if name.suffix not in (".json", ".cgns"):
            assert Path("alone", name).read_bytes() == Path("beside", name).read_bytes(), name
    assert levels_of("alone") == levels_of("beside")


@pytest.mark.parametrize("extra", [("--threads", "1"), ("--field", "invalid", "--suffix", ".vtm"), ("--suffix", ".vtu"),
                                   ("--max-memory", "tight")])  # fmt: skip
def test_without_threads_or_memory_to_spare_levels_are_written_alone(extra, swing, call, written):
    if extra[-1] == "tight":
        from meshdeform_core.memory import Demand, deforming
        from meshdeform_formats import read_grid

        need = Demand.of("deforming", deforming("tfi", beside=0), read_grid("grid.xyz"))
        extra = ("--max-memory", str(need.in_memory))
    assert call(*RUN, "-m", "tfi", *extra, "-o", "out").code == 0
    assert written == [(n, True) for n in range(COUNT)]


def test_a_level_that_cannot_be_written_ends_the_series_there(swing, call, monkeypatch):
    plain = LevelFiles.write

    def write(self, number, grid, *rest):
        if number == 2:
            raise FormatError("cannot write grid_0002.xyz: No space left on device")
        plain(self, number, grid, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(LevelFiles, "write", write)
        result = call(*RUN, "-o", "out")
    assert result.code == 2
    assert result.error == "meshdeform: error: cannot write grid_0002.xyz: No space left on device\n"
    assert levels_of("out") == ["grid_0000.xyz", "grid_0001.xyz"]
    assert not list(Path("out").glob("*0003*"))
    assert call(*RUN, "-o", "out", "--resume").code == call(*RUN, "-o", "whole").code == 0
    for name in (f"grid_{n:04d}.xyz" for n in range(COUNT)):
        assert Path("out", name).read_bytes() == Path("whole", name).read_bytes()


def test_an_invalid_level_gets_its_name_before_it_is_written(swing, call, written):
    text = CASE.replace("20*sin(2*pi*t)", "200*sin(2*pi*t)")
    Path("case.toml").write_text(text)
    assert call(*RUN, "-m", "tfi", "-o", "out").code == 3
    names = levels_of("out")
    assert names[0] == "grid_0000.xyz"
    assert names[1] == "grid_0001.invalid.xyz"
    assert sorted(names) == sorted(path.name for path in Path("out").glob("grid_0*"))
    assert not all(alone for _, alone in written)
