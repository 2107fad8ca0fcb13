"""``deform`` and ``repair`` look for room on the disk before they compute."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import SimpleNamespace

import pytest

from meshdeform_core import deform, mending


@pytest.mark.parametrize("command", ["deform", "repair"])
def test_a_full_disk_is_found_before_the_computation(command, bench, call, monkeypatch):
    def never(*_: object, **__: object) -> None:
        raise AssertionError("computed")

    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1000))
    for module, name in ((deform, "set_up"), (mending, "mend")):
        monkeypatch.setattr(module, name, never)
    rest = ["-c", "case.toml"] if command == "deform" else ["--reference", "grid.xyz"]
    done = call(command, "grid.xyz", *rest, "-o", "out.p3dbin")
    assert done.code == 2
    assert "1e+03 B free" in done.err or "1000 B free" in done.err
    assert not Path("out.p3dbin").exists()
