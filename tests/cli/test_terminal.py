"""On the terminal: boundaries beside converted grids, and progress."""

import io
import json
import re
import sys
from collections.abc import Callable
from functools import partial

import pytest
import rich.progress

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
    # Those that a case names are those of the reference, too, and their file stays as it is.
    (bench / "named.toml").write_text(
        '[grid]\nboundary_file = "new.nmf"\n[[boundary]]\nselect = ["body"]\nkind = "fixed"'
    )
    (bench / "new.nmf").write_bytes((bench / "new.nmf").read_bytes() + b"# mine\n")
    for command, *more in (("quality",), ("repair", "-o", "new.vtm")):
        assert call(command, "new.xyz", "--reference", "grid.xyz", "-c", "named.toml", *more).code == 0
    other = ("-s", 'grid.boundary_file="again.nmf"', "--boundary-file", "new.nmf")
    assert call("quality", "new.xyz", "-c", "named.toml", *other).code == 0
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


class Clock:
    """In place of the module ``time``, and of the event that ends the display: waiting only sets the clock forward, and
    each time does one of the steps; without any more it ends."""

    def __init__(self, *steps: Callable[[], object]):
        self.now, self.waited, self.steps = 0.0, [], list(steps)

    def perf_counter(self) -> float:
        return self.now

    def wait(self, seconds: float) -> bool:
        self.waited.append(seconds)
        self.now += seconds
        if not self.steps:
            return True
        self.steps.pop(0)()
        return False


class Terminal(io.StringIO):
    """In place of stderr."""

    def isatty(self) -> bool:
        return True


class Refreshed(rich.progress.Progress):
    """Drawn at every update."""

    def update(self, *args, **more):
        super().update(*args, **more)
        self.refresh()


@pytest.mark.parametrize("coloured", [True, False])
def test_a_terminal_shows_stages_and_what_remains(coloured, monkeypatch):
    monkeypatch.setattr(rich.progress, "Progress", Refreshed)
    for name in ("NO_COLOR", "FORCE_COLOR", "TTY_COMPATIBLE", "COLORTERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in (("TERM", "xterm-256color"), ("COLUMNS", "100"), *[("NO_COLOR", "1")] * (not coloured)):
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(sys, "stderr", Terminal())
    bar = process.ProgressBar(compiles=False)
    steps = [partial(bar, *step) for step in (("idw", 2, 8), ("levels", 1, 2), ("idw", 4, 8), ("write", 0, 0))]
    bar._over = Clock(int, *steps)
    bar._draw()
    text = sys.stderr.getvalue()
    for words in ("idw", "levels", "write", "remaining", "25%", "50%", "0:00:0"):
        assert words in text
    # The bar goes when all is done.
    assert "\x1b[2K" in text[-60:]
    assert bool(re.search(r"\x1b\[[0-9;]*3[0-8][;0-9]*m", text)) == coloured
    assert bar._over.waited[0] == 1.0
    with process.ProgressBar(False, compiles=False) as bar:
        assert bar._display is None


def test_long_work_tells_a_log_how_far_it_is(monkeypatch, capsys):
    """At intervals that grow with the time taken, but not without bound."""
    clock = Clock(*[int] * 8)
    monkeypatch.setattr(process, "time", clock)
    bar = process.ProgressBar(compiles=False)
    bar._over = clock
    bar("levels", 3, 2)
    bar("idw", 9, 8)
    clock.steps[-1] = partial(bar, "write", 0, 0)
    bar._log()
    assert clock.waited == pytest.approx([10.0, 10.0, 10.0, 15.0, 22.5, 33.75, 50.625, 60.0, 60.0])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 8
    assert lines[:2] == [f"meshdeform: {n} s, levels 2 of 2, idw 8 of 8" for n in (10, 20)]
    assert lines[-1] == "meshdeform: 212 s, levels 2 of 2, write"
