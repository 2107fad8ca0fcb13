"""Wrong calls: options, values and file names that cannot be; one message each, nothing written."""

from __future__ import annotations

import pytest

DEFORM = ("deform", "grid.xyz", "-c", "case.toml", "-o", "out.xyz")

# id: (arguments, fragments of the message)
WRONG = {
    # commands and options
    "option-unknown": ((*DEFORM, "--stepz", "3"), ("No such option", "--stepz", "--steps")),
    "argument-missing": (("deform",), ("Missing argument 'GRID'",)),
    "output-missing": (("deform", "grid.xyz", "-c", "case.toml"), ("Missing option '-o'", "--dry-run")),
    "nothing-to-do": (("deform", "grid.xyz", "-o", "out.xyz"), ("case file (-c)", "displacement table (-d)")),
    # numbers
    "threads-zero": ((*DEFORM, "--threads", "0"), ("--threads", "x>=1")),
    "steps-fraction": ((*DEFORM, "--steps", "2.5"), ("--steps '2.5'", "whole number >= 1")),
    "memory-text": ((*DEFORM, "--max-memory", "lots"), ("--max-memory 'lots'", "2GiB")),
    "memory-small": ((*DEFORM, "--max-memory", "10KiB"), ("1,152 nodes", "--max-memory allows 10 KiB", "allow more")),
    "memory-system": (
        (*DEFORM, "-m", "rbf", "--max-memory", "255.8MiB"),
        ("radial basis function system", "centres needs about", "255 MiB for program and grid", "greedy"),
    ),
    "tolerance-negative": (("compare", "grid.xyz", "grid.cgns", "--tolerance", "-1"), ("--tolerance", "x>=0")),
    "tolerance-nan": (("compare", "grid.xyz", "grid.cgns", "--tolerance", "nan"), ("--tolerance", "finite")),
    # KEY=VALUE
    "set-no-equals": ((*DEFORM, "-s", "method.name"), ("--set 'method.name'", "KEY=VALUE")),
    "set-through-value": ((*DEFORM, "-s", "constants.turn.x=1"), ("'turn' is a value, not a table",)),
    "set-boundary-unknown": ((*DEFORM, "-s", "boundary.wing.kind=fixed"), ("no entry 'wing'", "body, span")),
    "set-boundary-itself": ((*DEFORM, "-s", "boundary.body=3"), ("boundary.body=3", "name an entry and its key")),
    "set-boundary-all": ((*DEFORM, "-s", "boundary=3"), ("boundary", "double brackets")),
    "set-inside-list": ((*DEFORM, "-s", "boundary.body.select.1=x"), ("boundary.body.select", "as a whole")),
    "variant-key": ((*DEFORM, "--variant", "encodin=ascii"), ("'encodin'", "did you mean 'encoding'")),
    "variant-value": ((*DEFORM, "--variant", "encoding=asci"), ("encoding = 'asci'", "did you mean 'ascii'")),
    "variant-meaningless": (
        (*DEFORM, "--variant", "encoding=ascii", "--variant", "markers=8"),
        ("markers does not apply",),
    ),
    "variant-of-cgns": (
        ("convert", "grid.xyz", "out.cgns", "--variant", "encoding=hex"),
        ("unknown option 'encoding'",),
    ),
    "variant-of-vtu": (("convert", "grid.xyz", "out.vtu", "--variant", "encoding=ascii"), ("out.vtu", "encoding")),
    "read-as-key": (("info", "grid.xyz", "--read-as", "endian=big"), ("'endian'", "byte_order")),
    "read-as-wrong": (("info", "grid.xyz", "--read-as", "byte_order=big"), ("grid.xyz", "big")),
    # output names
    "output-exists": (("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz"), ("old.xyz exists", "--force")),
    "output-suffix": (("deform", "grid.xyz", "-c", "case.toml", "-o", "out.foo"), ("'.foo'", "plot3d:", ".cgns")),
    "output-adf": (("convert", "grid.xyz", "out.adf"), ("ADF can only be read", ".cgns")),
    "output-folder-missing": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "no/out.xyz"),
        ("folder no does not exist", "create it first"),
    ),
    "output-below-file": (("deform", "grid.xyz", "-c", "case.toml", "-o", "old.xyz/out.xyz"), ("old.xyz is a file",)),
    "output-is-folder-forced": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "folder.xyz", "--force"),
        ("folder.xyz", "is a folder"),
    ),
    "output-name-too-long": (
        ("deform", "grid.xyz", "-c", "case.toml", "-o", "a" * 300 + ".xyz"),
        ("File name too long",),
    ),
    "output-one-block-only": (("convert", "grid.xyz", "out.vts"), ("one block", "8", ".vtm")),
    "report-exists": ((*DEFORM, "--report", "old.json"), ("old.json exists", "--force")),
    # inputs
    "grid-missing": (("deform", "no.xyz", "-c", "case.toml", "-o", "out.xyz"), ("no.xyz does not exist",)),
    "case-missing": (("deform", "grid.xyz", "-c", "no.toml", "-o", "out.xyz"), ("no.toml", "No such file")),
    "case-binary": (("deform", "grid.xyz", "-c", "grid.xyz", "-o", "out.xyz"), ("grid.xyz", "not a TOML file")),
    "method-unknown": ((*DEFORM, "-m", "idv"), ("method 'idv' is unknown", "idw-tfi")),
    # other commands
    "sample-unknown": (("sample", "splitter", "-o", "new"), ("'splitter' is unknown", "splitter-plate")),
    "sample-size": (("sample", "splitter-plate", "-o", "new", "--size", "-3"), ("size = -3", "multiple of 8")),
    "sample-suffix-unstructured": (("sample", "splitter-plate", "-o", "new", "--suffix", ".vtu"), (".vtu", "cgns")),
    "sample-into-file": (("sample", "splitter-plate", "-o", "old.xyz"), ("old.xyz is a file", "expected a folder")),
    "compare-other-blocks": (("compare", "grid.xyz", "flat.p2dfmt"), ("block1 of grid.xyz has 5 x 5 x 4", "6 x 6 x 1")),
    "quality-other-blocks": (
        ("quality", "grid.xyz", "--reference", "flat.p2dfmt"),
        ("block1 of grid.xyz has 5 x 5 x 4", "flat.p2dfmt"),
    ),
    "plot-no-output": (("plot", "grid.xyz"), ("Missing option '-o'",)),
    "plot-plane-and-select": (
        ("plot", "grid.xyz", "-o", "out.png", "--plane", "k=1", "--select", "*"),
        ("exclude each other",),
    ),
    "plot-select-flat": (("plot", "flat.p2dfmt", "-o", "out.png", "--select", "*"), ("2-D grid", "--select")),
    "plot-metric": (("plot", "grid.xyz", "-o", "out.png", "--metric", "skew"), ("--metric", "f_skew")),
    "plot-view": (("plot", "grid.xyz", "-o", "out.png", "--view", "top"), ("--view", "iso")),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_call_is_refused(name, bench, call, snapshot):
    arguments, fragments = WRONG[name]
    (bench / "folder.xyz").mkdir()
    (bench / "folder.json").mkdir()
    (bench / "case.txt").write_text((bench / "case.toml").read_text())
    (bench / "table.txt").write_text((bench / "table.csv").read_text())
    before = snapshot(bench)
    result = call(*arguments)
    assert snapshot(bench) == before
    assert result.code == 2, result.err
    assert result.out == ""
    missing = [fragment for fragment in fragments if fragment not in result.err]
    assert not missing, result.err
    message = result.err.rstrip("\n")
    assert "\n" not in message
    assert message.startswith("meshdeform: error: ")
