"""``deform``, ``series`` and ``repair`` look for room on the disk before they compute."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest
from grids import frame

from meshdeform_core import deform, mending, series
from meshdeform_formats import write_grid


@pytest.fixture
def disk(monkeypatch):
    """``disk(1000)`` leaves 1000 bytes free."""

    def leave(free: int) -> None:
        monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=free))

    return leave


@pytest.mark.parametrize("command", ["deform", "repair"])
def test_a_full_disk_is_found_before_the_computation(command, bench, call, disk, monkeypatch):
    def never(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    disk(1000)
    for module, name in ((deform, "set_up"), (mending, "mend")):
        monkeypatch.setattr(module, name, never)
    rest = ["-c", "case.toml"] if command == "deform" else ["--reference", "grid.xyz"]
    done = call(command, "grid.xyz", *rest, "-o", "out.p3dbin")
    assert done.code == 2
    assert "1000 B free" in done.err
    assert not Path("out.p3dbin").exists()


def test_a_series_looks_for_room_for_all_levels(bench, call, disk, monkeypatch):
    write_grid(frame(12, 8), "large.xyz")
    options = ("--suffix", ".cgns", "--velocity", "swept", "--variant", "precision=float32")
    words = ("series", "large.xyz", "-c", "case.toml", "-m", "tfi", "--times", "0:3:1", "-o", "out", "-q", *options)
    assert call(*words).code == 0
    size = sum(path.stat().st_size for path in Path("out").rglob("*") if path.is_file())
    with monkeypatch.context() as patch:
        patch.setattr(series, "impose", None)
        disk(size // 2)
        refused = call(*words, "-o", "other")
        assert refused.code == 2
        assert "free, 4 levels of the series take at least" in refused.err
        assert not Path("other").exists()
        dry = call(*words, "-o", "other", "--dry-run")
        assert dry.code == 0
        assert any("4 levels of the series take at least" in warning for warning in dry.warnings)
    disk(size)
    assert call(*words, "-o", "other").code == 0
    # Levels that exist, or are replaced, need no more room.
    disk(size // 2)
    assert call(*words, "--resume").code == 0
    assert call(*words, "--force").code == 0
    for path in Path("out").glob("large_0003*"):
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    assert call(*words, "--resume").code == 0
