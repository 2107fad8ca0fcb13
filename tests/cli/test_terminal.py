"""On the terminal: completion, versions, methods as text."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys

import pytest
from click.shell_completion import ShellComplete

from meshdeform_cli.main import cli
from meshdeform_cli.process import progress


def completed(*args):
    *before, typed = args
    found = ShellComplete(cli, {}, "meshdeform", "_MESHDEFORM_COMPLETE").get_completions(list(before), typed)
    return [item.value for item in found]


def test_commands_and_names_are_completed(bench):
    assert {"info", "init"} <= set(completed("in"))
    assert {"idw-tfi", "idw-rbf"} <= set(completed("methods", "idw-"))
    assert completed("sample", "spl") == ["splitter-plate"]
    assert "rbf-tfi" in completed("deform", "grid.xyz", "-m", "rbf")
    assert completed("deform", "grid.xyz", "-s", "method.idw.al") == ["method.idw.alpha="]


def test_patches_and_blocks_of_the_grid_are_completed(bench):
    assert completed("plot", "grid.cgns", "--select", "b")[0] == "body"
    assert completed("plot", "grid.cgns", "--select", "block1.i") == ["block1.imin", "block1.imax"]
    assert completed("plot", "grid.cgns", "--block", "block8") == ["block8"]
    assert completed("plot", "missing.cgns", "--select", "") == []


def test_the_version_tells_what_it_runs_on(call):
    short = call("--version")
    assert (short.code, len(short.out.splitlines())) == (0, 1)
    for arguments in (("--version", "-v"), ("-v", "--version")):
        result = call(*arguments)
        assert result.code == 0
        assert result.out.startswith(short.out)
        for name in ("numpy", "numba", "h5py", "hdf5", "threads", "loops"):
            assert f"\n{name}" in result.out


def test_methods_are_text_for_people(call):
    text = call("methods", "idw-tfi").out
    for markup in ("``", "----", "Attributes"):
        assert markup not in text
    assert max(map(len, text.splitlines())) <= 160
    assert '  rotation = "lie"\n      what is averaged. none: displacements' in text
    assert "default: independent of the frame" in text


def test_convert_keeps_boundaries_beside_what_has_no_place_for_them(bench, call):
    result = call("convert", "grid.cgns", "new.xyz")
    assert (result.code, result.err) == (0, "")
    assert result.out.rstrip().endswith("boundaries in new.nmf")
    before, after = (
        json.loads(call("info", *source, "--json").out)["surfaces"]
        for source in (("grid.cgns",), ("new.xyz", "--boundary-file", "new.nmf"))
    )
    assert {s["name"]: (s["quads"], s["role"]) for s in before}.keys() == {s["name"] for s in after}
    assert {s["name"]: s["quads"] for s in before} == {s["name"]: s["quads"] for s in after}
    assert call("convert", "new.xyz", "back.cgns", "--boundary-file", "new.nmf").code == 0
    assert not (bench / "back.nmf").exists()


def test_boundaries_that_are_there_already_are_left_alone(bench, call):
    """A second format of the same grid has the same boundaries; other boundaries are not replaced unasked."""
    assert call("convert", "grid.cgns", "new.xyz").code == 0
    before = (bench / "new.nmf").read_bytes(), (bench / "new.nmf").stat().st_ino
    assert call("convert", "grid.cgns", "new.vtm", "--field", "invalid").code == 0
    assert before == ((bench / "new.nmf").read_bytes(), (bench / "new.nmf").stat().st_ino)
    (bench / "new.nmf").write_bytes(before[0] + b"# mine\n")
    result = call("convert", "grid.cgns", "new.vts", "--force", "--boundary-file", "new.nmf")
    assert (result.code, "is an input" in result.err) == (2, True)
    result = call("convert", "grid.cgns", "new.p3dfmt")
    assert result.code == 2
    assert "new.nmf exists; use --force to overwrite it" in result.err
    assert "that file has other content" in result.err
    assert (bench / "new.nmf").read_bytes() == before[0] + b"# mine\n"
    assert not (bench / "new.p3dfmt").exists()
    assert call("convert", "grid.cgns", "new.p3dfmt", "--force").code == 0
    assert (bench / "new.nmf").read_bytes() == before[0]


@pytest.mark.slow
@pytest.mark.parametrize("grid", ["grid.cgns", "flat.p2dfmt"])
def test_info_draws_the_boundaries_by_name(grid, bench, call):
    plain = call("info", grid)
    result = call("info", grid, "--picture", "boundaries.svg")
    assert (result.code, result.out, result.err) == (0, plain.out, "")
    text = (bench / "boundaries.svg").read_text()
    for name in ("body (wall)", "outer (far)", "span (symmetry)") if grid == "grid.cgns" else ("wall?", "far?"):
        assert name in text
    assert call("info", grid, "--picture", "boundaries.svg").code == 2
    assert call("info", grid, "--picture", "boundaries.bmp").code == 2


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
from meshdeform_cli.process import progress

drawn, make = threading.Event(), progress._bar

def watched():
    bar = make()
    update = bar.update
    def updated(*args, **more):
        update(*args, **more)
        bar.refresh()
        drawn.set()
    bar.update = updated
    return bar

def shown():
    # What is under way may have begun with the stage before.
    for _ in range(3):
        drawn.clear()
        assert drawn.wait(60)

progress._bar, progress.PATIENCE, progress._TICK, progress.LOGGED = watched, 0.0, 0.001, 0.0
for colour in ({}, {"NO_COLOR": "1"}):
    os.environ |= colour
    with progress.ProgressBar(compiles=False) as bar:
        bar("idw", 2, 8)
        shown()
        bar("levels", 1, 2)
        bar("idw", 4, 8)
        shown()
        with progress.stage("write"):
            shown()
    os.write(2, b"|")
with progress.ProgressBar(False, compiles=False) as bar:
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


@pytest.mark.parametrize(
    ("seconds", "logged", "lines"),
    [
        ({"fast": 0.04, "idw": 1.2, "write": 0.3}, 0.1, "meshdeform: idw 1.2 s, write 0.3 s\n"),
        ({"fast": 0.04, "idw": 1.2, "write": 0.3}, 100.0, ""),
        # Many short stages make a long run.
        ({f"{name} {n}": 0.15 for n in range(4) for name in ("read", "apply")}, 1.0, "read 0.6 s, apply 0.6 s\n"),
    ],
)
def test_a_log_has_one_line(seconds, logged, lines, monkeypatch, capsys):
    clock = Clock()
    monkeypatch.setattr(progress, "time", clock)
    monkeypatch.setattr(progress, "LOGGED", logged)
    with progress.ProgressBar(compiles=False) as bar:
        for stage, spent in seconds.items():
            bar(stage.split()[0], 0, 8)
            clock.now += spent
    printed = capsys.readouterr()
    assert printed.out == ""
    assert printed.err.removeprefix("meshdeform: ") == lines.removeprefix("meshdeform: ")


def test_long_work_tells_a_log_how_far_it_is(monkeypatch, capsys):
    """At intervals that grow with the time taken, but not without bound."""
    clock = Clock(waits=8)
    monkeypatch.setattr(progress, "time", clock)
    bar = progress.ProgressBar(compiles=False)
    bar._over = clock
    bar("levels", 0, 2)
    bar("idw", 3, 8)
    bar._log()
    assert clock.waited == pytest.approx([10.0, 10.0, 10.0, 15.0, 22.5, 33.75, 50.625, 60.0, 60.0])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert lines[:2] == [f"meshdeform: {n} s, levels 0 of 2, idw 3 of 8" for n in (10, 20)]
