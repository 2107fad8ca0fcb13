"""Wrong calls and mistakes of newcomers: one message each that names what is wrong, nothing written;
what is doubtful is a warning."""

import codecs
import os
from pathlib import Path

import numpy as np
import pytest

DEFORM = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")
PLOT = ("plot", "grid.cgns", "-o", "out.png")
SERIES = ("series", "grid.xyz", "-c", "case.toml")
LEVELS = (*SERIES, "-o", "out", "--times", "0:1:0.5")
PIPE = ("pipe: it is a pipe; expected a file",)
STRANGE = os.fsdecode(b"gr\xff d.vtm")
TO_PIPES = (
    (*DEFORM[:-1], "pipe.vtm"), (*DEFORM[:-1], "link.xyz"), (*DEFORM, "--report", "pipe.json"),
    (*PLOT[:-1], "pipe.png"), ("init", "grid.xyz", "-o", "pipe.toml"),
)  # fmt: skip

# id: (arguments, fragments of the message)
CALLS = {
    # commands and options
    "command-unknown": (("deforn", "grid.xyz"), ("no such command 'deforn'; did you mean 'deform'?",)),
    "option-unknown": ((*DEFORM, "--stepz", "3"), ("No such option", "--stepz", "--steps")),
    "argument-missing": (("deform",), ("Missing argument 'GRID'",)),
    "output-missing": (("deform", "grid.xyz", "-c", "case.toml"), ("Missing option '-o'", "--dry-run")),
    "nothing-to-do": (
        ("deform", "grid.xyz", "-o", "out.xyz"), ("case file (-c)", "table (-d)", "init grid.xyz -o case.toml"),
    ),
    # numbers
    "threads-zero": ((*DEFORM, "--threads", "0"), ("--threads", "x>=1")),
    "steps-fraction": ((*DEFORM, "--steps", "2.5"), ("--steps '2.5'", "whole number >= 1")),
    "memory-small": ((*DEFORM, "--max-memory", "10KiB"), ("1,152 nodes", "--max-memory allows 10 KiB", "allow more")),
    "memory-system": (
        (*DEFORM, "-m", "rbf", "--max-memory", "188.1MiB"),
        ("radial basis function system", "centres needs about", "187 MiB for program and grid", "greedy"),
    ),
    "tolerance-nan": (("compare", "grid.xyz", "grid.cgns", "--tolerance", "nan"), ("--tolerance", "finite")),
    "tolerance-inf": (("compare", "grid.xyz", "grid.cgns", "--tolerance", "inf"), ("--tolerance", "finite")),
    "memory-of-two": (
        ("compare", "grid.xyz", "grid.cgns", "--max-memory", "10KiB"), ("comparing 2,304 nodes needs about",),
    ),
    # KEY=VALUE
    "set-no-equals": ((*DEFORM, "-s", "method.name"), ("--set 'method.name'", "KEY=VALUE")),
    "variant-of-cgns": (
        ("convert", "grid.xyz", "out.cgns", "--variant", "encoding=hex"), ("unknown option 'encoding'",),
    ),
    "read-as-wrong": (("info", "grid.xyz", "--read-as", "byte_order=big"), ("grid.xyz", "big")),
    "match-without-table": ((*DEFORM, "--match", "exact"), ("belong to --displacement",)),
    # output names
    "output-exists": (("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz"), ("old.xyz exists", "--force")),
    "output-suffix": (("deform", "grid.xyz", "-c", "case.toml", "-o", "out.foo"), ("'.foo'", "plot3d:", ".cgns")),
    "output-adf": (("convert", "grid.xyz", "out.adf"), ("ADF can only be read", ".cgns")),
    "output-folder-missing": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "no/out.xyz"), ("folder no does not exist", "create it first"),
    ),
    "output-below-file": (("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz/out.xyz"), ("old.xyz is a file",)),
    "output-is-folder-forced": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "folder.xyz", "--force"), ("folder.xyz", "is a folder"),
    ),
    "output-name-too-long": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "a" * 300 + ".xyz"), ("File name too long",),
    ),
    **{f"output-{call[-1]}": ((*call, "--force"), ("it is a pipe; give a file name",)) for call in TO_PIPES},
    "output-link-of-a-set": (("convert", "grid.xyz", "link.vtm", "--force"), ("link.vtm: it is a link", "old.xyz")),
    "output-not-utf8": (("convert", "grid.xyz", STRANGE), ("its name is not UTF-8",)),
    "output-of-a-user": ((*DEFORM[:-1], "mine.xyz"), ("mine.invalid.xyz exists and is not a grid of an earlier run",)),
    "output-one-block-only": (("convert", "grid.xyz", "out.vts"), ("one block", "8", ".vtm")),
    "report-exists": ((*DEFORM, "--report", "old.json"), ("old.json exists", "--force")),
    "init-exists": (("init", "grid.xyz", "-o", "case.toml"), ("case.toml exists", "--force")),
    "init-replaces-the-grid": (("init", "grid.xyz", "-o", "grid.xyz", "--force"), ("grid.xyz is an input",)),
    # inputs
    "grid-missing": (("deform", "no.xyz", "-c", "case.toml", "-o", "out.xyz"), ("no.xyz does not exist",)),
    "case-missing": (("deform", "grid.xyz", "-c", "no.toml", "-o", "out.xyz"), ("no.toml", "No such file")),
    "case-binary": (("deform", "grid.xyz", "-c", "grid.xyz", "-o", "out.xyz"), ("grid.xyz", "not a TOML file")),
    "case-for-grid": (
        ("deform", "case.toml", "-c", "grid.xyz", "-o", "out.xyz"),
        ("case.toml is a case file; expected the grid first: grid.xyz -c case.toml",),
    ),
    "map-missing": (("info", "grid.xyz", "--boundary-file", "no.nmf"), ("no.nmf", "No such file")),
    "grid-pipe": (("info", "pipe"), PIPE),
    "map-pipe": (("info", "grid.xyz", "--boundary-file", "pipe"), PIPE),
    "case-pipe": (("deform", "grid.xyz", "-c", "pipe", "-o", "z.xyz"), PIPE),
    "table-pipe": (("deform", "grid.xyz", "-d", "pipe", "-o", "z.xyz"), PIPE),
    "reference-pipe": (("quality", "grid.xyz", "--reference", "pipe"), PIPE),
    "out-of-the-plane": (
        ("deform", "flat.p2dfmt", "-s", "boundary=[{motion={translate=[0, 0, 'x']}}]", "-o", "o.p2dbin"),
        ("leaves the plane of the 2-D grid",),
    ),
    # series
    "series-no-times": ((*SERIES, "-o", "out"), ("the case has no sequence of displacement files; give",)),
    "series-no-output": ((*SERIES, "--times", "0:1:0.5"), ("Missing option '-o'",)),
    "series-times": ((*SERIES, "-o", "out", "--times", "0:1"), ("--times: '0:1'",)),
    "series-suffix": ((*LEVELS, "--suffix", ".abc"), ("cannot tell the format",)),
    "series-velocity": ((*LEVELS, "--velocity", "first"), (".xyz files cannot hold the grid velocity",)),
    "series-resume-force": ((*LEVELS, "--resume", "--force"), ("--force restarts it",)),
    "series-into-grid": ((*SERIES, "-o", "grid.cgns", "--times", "0:1:0.5"), ("grid.cgns",)),
    "series-steps": ((*LEVELS, "--steps", "0"), ("--steps",)),
    # other commands
    "sample-unknown": (("sample", "splitter", "-o", "new"), ("'splitter' is unknown", "splitter-plate")),
    "sample-size": (("sample", "splitter-plate", "-o", "new", "--size", "-3"), ("size = -3", "multiple of 8")),
    "sample-into-file": (("sample", "splitter-plate", "-o", "old.xyz"), ("old.xyz is a file", "expected a folder")),
    "compare-other-blocks": (("compare", "grid.xyz", "flat.p2dfmt"), ("block1 of grid.xyz has 5 x 5 x 4", "6 x 6 x 1")),
    "reproduce-unknown": (("reproduce", "table9", "-o", "out"), ("table2", "table5", "figB", "all")),
    "plot-no-reference": ((*PLOT, "--metric", "displacement"), ("give --reference",)),
    "plot-logarithm": (
        (*PLOT, "--reference", "grid.xyz", "--plane", "x=0.6", "--metric", "volume", "--log", "--range", "0,1"),
        ("does not begin above zero",),
    ),
    "plot-select-flat": (("plot", "flat.p2dfmt", "-o", "out.png", "--select", "*"), ("2-D grid", "--select")),
    "plot-metric": (("plot", "grid.xyz", "-o", "out.png", "--metric", "skew"), ("--metric", "f_skew")),
    "plot-view": (("plot", "grid.xyz", "-o", "out.png", "--view", "top"), ("--view", "iso")),
}  # fmt: skip


@pytest.mark.parametrize("name", CALLS)
def test_it_is_refused_with_one_message_and_nothing_is_written(name, bench, call, snapshot):
    (bench / "folder.xyz").mkdir()
    for each in ("pipe", "pipe.vtm", "pipe.xyz", "pipe.json", "pipe.png", "pipe.toml"):
        os.mkfifo(each)
    os.symlink("pipe.xyz", "link.xyz")
    os.symlink("old.xyz", "link.vtm")
    Path("mine.invalid.xyz").write_text("my own notes")
    arguments, fragments = CALLS[name]
    before = snapshot(bench)
    result = call(*arguments)
    assert snapshot(bench) == before
    assert (result.code, result.out) == (2, ""), result.err
    assert result.error.startswith("meshdeform: error: ")
    assert result.error.count("\n") == 1, result.err
    assert [fragment for fragment in fragments if fragment not in result.error] == [], result.err


DOUBTS = {
    "positions": (("deform", "grid.xyz", "-d", "positions.csv", "--dry-run"), "are they positions?"),
    "radians": ((*DEFORM, "-s", "constants.turn=0.17", "--dry-run"), "degrees; angles are in degrees"),
    "turns": ((*DEFORM, "-s", "constants.turn=-4e3", "--dry-run"), "by -4000 degrees; its nodes come to where a"),
}


@pytest.mark.parametrize("name", DOUBTS)
def test_what_is_doubtful_is_a_warning_before_anything_is_moved(name, bench, call):
    np.savetxt("positions.csv", np.loadtxt("table.csv", delimiter=",")[:, [0, 1, 2, 0, 1, 2]], delimiter=",")
    arguments, message = DOUBTS[name]
    assert any(message in warning for warning in call(*arguments).warnings)


def test_byte_order_marks_of_editors_are_accepted(bench, call):
    for name in ("case.toml", "table.csv", "grid.p3dfmt"):
        Path(name).write_bytes(codecs.BOM_UTF8 + Path(name).read_bytes())
    assert call("deform", "grid.p3dfmt", "-c", "case.toml", "-o", "out.p3dfmt", "-q").code == 0
    assert call("deform", "grid.p3dfmt", "-d", "table.csv", "-o", "moved.p3dfmt", "-q").code == 0
