"""No file that a run reads is ever replaced, with --force too, however it is named; links as outputs are followed."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from cgns_witness import N, box, tree, write_hdf5, zone
from grids import frame

from meshdeform_formats import read_grid, write_grid

FORCED = ("--force", "--allow-invalid")


@pytest.fixture
def inputs(bench):
    """A grid as a set, a CGNS file with links into another one, a table, a case, and other names of them."""
    write_grid(frame(), bench / "set.vtm")
    shutil.copy("set.vtm", "other.vtm")
    linked = [N("left", "", link=("parts/second.cgns", "/Base/left"))]
    (bench / "parts").mkdir()
    write_hdf5(bench / "parts" / "second.cgns", tree(zone("left", box(3, 3, 3))))
    write_hdf5(bench / "linked.cgns", tree(*linked))
    grid = read_grid("linked.cgns")
    table = np.hstack([grid.points[:9], np.full((9, 3), 1e-3)])
    for name in ("first.txt", "table.txt"):
        np.savetxt(name, table)
    Path("follow.toml").write_text(
        '[[boundary]]\nname = "b"\nselect = ["left.imin"]\nmotion = [{ file = "first.txt" }, { file = "table.txt" }]\n'
    )
    os.link("table.txt", "same.txt")
    os.symlink("follow.toml", "case.json")
    for name in ("short.cgns", "linked_0001.cgns"):
        os.symlink(bench / "parts" / "second.cgns", name)
    return bench


@pytest.mark.parametrize(
    "arguments",
    [
        ("convert", "linked.cgns", "parts/second.cgns"),
        ("convert", "other.vtm", "set.vtm"),
        ("convert", "other.vtm", "set/set_0.vts"),
        ("deform", "linked.cgns", "-c", "follow.toml", "-o", "out.cgns", "--report", "same.txt"),
        ("deform", "linked.cgns", "-c", "follow.toml", "-o", "out.cgns", "--report", "case.json"),
        ("quality", "linked.cgns", "--reference", "short.cgns", "--report", "report.json"),
        ("plot", "other.vtm", "-o", "picture.png"),
        ("plot", "grid.xyz", "--reference", "other.vtm", "-o", "picture.png"),
        ("convert", "grid.xyz", "short.cgns", "--reference", "linked.cgns"),
        ("init", "grid.xyz", "--table", "table.txt", "-o", "same.txt"),
        ("series", "linked.cgns", "-c", "follow.toml", "--times", "0,1", "-o", "."),
    ],
    ids=" ".join,
)
def test_no_input_is_replaced(inputs, call, snapshot, arguments):
    os.symlink("parts/second.cgns", "report.json")
    os.symlink("set/set_0.vts", "picture.png")
    before = snapshot(inputs)
    force = FORCED if arguments[0] == "deform" else FORCED[:1]
    result = call(*arguments, *force)
    assert result.code == 2, result.err
    assert "the output must be another file (even with --force)" in result.err
    assert snapshot(inputs) == before


@pytest.mark.parametrize("name", ["a.xyz", "a.vts", "a.cgns", "a.vtu"])
def test_a_link_as_an_output_is_followed(inputs, call, name):
    os.mkdir("store")
    target = Path("store") / f"real{Path(name).suffix}"
    os.symlink(target, name)
    for _ in range(2):
        assert call("convert", "parts/second.cgns", name, "--force").code == 0
        assert Path(name).is_symlink()
        assert target.is_file()
    assert not target.is_symlink()
    if name != "a.vtu":
        np.testing.assert_array_equal(read_grid(name).points, read_grid("linked.cgns").points)
    assert not list(Path().rglob(".*"))
