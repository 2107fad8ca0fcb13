"""On the terminal: boundaries beside converted grids, and progress."""

import json
import os
import re
import subprocess
import sys

import pytest

from meshdeform_cli import process


def test_boundaries_are_kept_beside_what_has_no_place_for_them(bench, call):
    result = call("convert", "grid.cgns", "new.xyz")
    assert (result.code, result.err) == (0, "")
    assert result.out.rstrip().endswith("boundaries in new.nmf")
    before, after = (
        json.loads(call("info", *source, "--json").out)["surfaces"]
        for source in (("grid.cgns",), ("new.xyz", "--boundary-file", "new.nmf"))
    )
    assert {s["name"]: s["quads"] for s in before} == {s["name"]: s["quads"] for s in after}
    assert call("convert", "new.xyz", "back.cgns", "--boundary-file", "new.nmf").code == 0
    assert not (bench / "back.nmf").exists()
    assert call("convert", "grid.xyz", "joined.cgns").code == 0
    assert call("convert", "joined.cgns", "again.xyz").out.rstrip().endswith("boundaries in again.nmf")
    assert "one-to-one" in (bench / "again.nmf").read_text()
    # So do commands that make grids.
    case = ("grid.cgns", "-c", "case.toml")
    assert call("deform", *case, "-o", "bent.vtm").code == 0
    assert call("series", *case, "--times", "0,1", "-o", "levels", "--suffix", ".xyz").code == 0
    assert call("repair", "grid.cgns", "--reference", "grid.cgns", "-o", "whole.xyz").code == 0
    for name in ("bent.nmf", "levels/grid.nmf", "whole.nmf"):
        assert (bench / name).read_bytes() == (bench / "new.nmf").read_bytes()
    lost = "patches of the grid; add the outside faces with their families by --variant boundary=true"
    for variant in ("false", "true"):
        told = call("deform", *case, "-o", "a.vtu", "--force", "--json", "--variant", f"boundary={variant}").out
        assert any(lost in text for text in json.loads(told)["warnings"]) == (variant == "false")


def test_boundaries_that_are_there_already_are_left_alone(bench, call):
    """A second format of the same grid has the same boundaries; other boundaries are not replaced unasked."""
    assert call("convert", "grid.cgns", "new.xyz").code == 0
    before = (bench / "new.nmf").read_bytes(), (bench / "new.nmf").stat().st_ino
    assert call("convert", "grid.cgns", "new.vtm", "--field", "invalid").code == 0
    assert before == ((bench / "new.nmf").read_bytes(), (bench / "new.nmf").stat().st_ino)
    (bench / "new.nmf").write_bytes(before[0] + b"# mine\n")
    assert call("convert", "grid.cgns", "new.grd", "--boundary-file", "new.nmf").code == 0
    result = call("convert", "grid.cgns", "new.p3dfmt")
    assert result.code == 2
    assert "new.nmf exists; use --force to overwrite it" in result.err
    assert "that file has other content" in result.err
    assert (bench / "new.nmf").read_bytes() == before[0] + b"# mine\n"
    assert not (bench / "new.p3dfmt").exists()
    assert call("convert", "grid.cgns", "new.p3dfmt", "--force").code == 0
    assert (bench / "new.nmf").read_bytes() == before[0]


# progress


def on_a_terminal(code: str, **environment: str) -> tuple[str, int]:
    """What a Python program writes to a terminal that is its stderr, and its exit code."""
    import pty

    parent, child = pty.openpty()
    told = {
        name: value for name, value in os.environ.items() if name not in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE")
    }
    process = subprocess.Popen(
        [sys.executable, "-c", code], stderr=child, stdout=subprocess.DEVNULL,
        env={**told, "TERM": "xterm-256color", "COLUMNS": "100", **environment},
    )  # fmt: skip
    os.close(child)
    seen = b""
    while True:
        try:
            part = os.read(parent, 65536)
        except OSError:
            break
        if not part:
            break
        seen += part
    os.close(parent)
    return seen.decode(errors="replace"), process.wait(timeout=30)


DRAWN = """
import os, threading
import rich.progress
from meshdeform_cli import process

drawn = threading.Event()

class Watched(rich.progress.Progress):
    def update(self, *args, **more):
        super().update(*args, **more)
        self.refresh()
        drawn.set()

def shown():
    # What is under way may have begun with the stage before.
    for _ in range(3):
        drawn.clear()
        assert drawn.wait(60)

rich.progress.Progress, process.PATIENCE, process._TICK = Watched, 0.0, 0.001
for colour in ({}, {"NO_COLOR": "1"}):
    os.environ |= colour
    with process.ProgressBar(compiles=False) as bar:
        bar("idw", 2, 8)
        shown()
        bar("levels", 1, 2)
        bar("idw", 4, 8)
        shown()
        with process.stage("write"):
            shown()
    os.write(2, b"|")
with process.ProgressBar(False, compiles=False) as bar:
    bar("idw", 2, 8)
    assert bar._display is None
"""


def test_a_terminal_shows_stages_and_what_remains():
    seen, code = on_a_terminal(DRAWN)
    assert code == 0
    coloured, plain, quiet = seen.split("|")
    for words in ("idw", "levels", "write", "remaining", "50%", "0:00:0"):
        assert words in coloured
        assert words in plain
    assert re.search(r"\x1b\[[0-9;]*3[0-8][;0-9]*m", coloured)
    assert not re.search(r"\x1b\[[0-9;]*3[0-8][;0-9]*m", plain)
    # The bar goes when all is done, and a terminal needs no summary.
    assert coloured.rstrip().endswith(("\x1b[?25h", "\x1b[2K")) or "\x1b[2K" in coloured[-60:]
    assert "meshdeform:" not in seen
    assert quiet == ""


class Clock:
    """In place of the module ``time``, and of the event that ends the display: waiting only sets the clock forward."""

    def __init__(self, waits: int = 0):
        self.now, self.waited, self._waits = 0.0, [], waits

    def perf_counter(self) -> float:
        return self.now

    def wait(self, seconds: float) -> bool:
        self.waited.append(seconds)
        self.now += seconds
        return len(self.waited) > self._waits


def test_long_work_tells_a_log_how_far_it_is(monkeypatch, capsys):
    """At intervals that grow with the time taken, but not without bound."""
    clock = Clock(waits=8)
    monkeypatch.setattr(process, "time", clock)
    bar = process.ProgressBar(compiles=False)
    bar._over = clock
    bar("levels", 0, 2)
    bar("idw", 3, 8)
    bar._log()
    assert clock.waited == pytest.approx([10.0, 10.0, 10.0, 15.0, 22.5, 33.75, 50.625, 60.0, 60.0])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert lines[:2] == [f"meshdeform: {n} s, levels 0 of 2, idw 3 of 8" for n in (10, 20)]
