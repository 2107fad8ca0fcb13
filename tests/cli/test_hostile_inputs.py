"""Every kind of input that once gave a wrong grid, a traceback or an abort: what it must give now, and at what cost."""

from __future__ import annotations

import re
import time
import tracemalloc
from pathlib import Path

import hostile_inputs
import numpy as np
import pytest

from meshdeform_formats import read_grid

MOVED = "boundary=[{select=['block1.jmin'],motion=[{translate=[0,0.01,0]}]}]"
WALLS = "boundary=[{select=['block1.jmin','block2.jmin'],motion=[{MOTION}]}]"

# Command, and what its message says. The first column of the table is the maker's name.
REFUSED = [
    ("e1_partial", ("info", "e1_partial.vts"), r"expected one Piece with all nodes of the WholeExtent 0 4 0 3 0 2"),
    ("e1_partial", ("deform", "e1_partial.vts", "-s", MOVED, "-o", "out.vts"), "expected one Piece with all nodes"),
    ("e5_extra", ("info", "e5_extra.vts"), r"array Points continues after an element inside it: '1 2 3"),
    ("d1_abort", ("info", "d1_abort.vts"), r"no '_' follows the AppendedData tag"),
    ("d2_abort", ("info", "d2_abort.vts"), r"array Points has 2147483647 components, expected 3"),
    ("c_deep", ("info", "c_deep.vtm"), r"elements are nested more than 100 deep"),
    (
        "e2_zone",
        ("deform", "e2_zone_link_missing.cgns", "-s", MOVED, "-o", "out.cgns"),
        r"/Base/right is a broken link to part2\.cgns:/Base/right",
    ),
    ("e2b_zonebc", ("info", "e2b_zonebc_link_missing.cgns"), r"/Base/left/ZoneBC is a broken link"),
    (
        "e2b_zonebc",
        ("deform", "e2b_zonebc_link_missing.cgns", "-s", MOVED, "-o", "out.cgns"),
        r"/Base/left/ZoneBC is a broken link",
    ),
    ("c_root", ("info", "c_root.cgns"), r"cannot read c_root\.cgns as HDF5: it is damaged"),
    (
        "g3",
        ("deform", "g3.xyz", "-d", "e3_table_mm.csv", "-m", "tfi", "-o", "out.xyz"),
        r"11 of 12 table points .*multiplied by 0\.001, 100% of its points .* different length units",
    ),
    (
        "e4",
        (
            "deform", "e4_closed.xyz", "-o", "out.xyz", "-s",
            WALLS.replace("MOTION", "file='e3b_wall_mm.csv',match='interpolate'"),
        ),
        r"multiplied by 0\.001, 100% of its points .* different length units",
    ),
    ("e6_integers", ("info", "e6_integers.fmt"), r"2 ways.*multiblock=true.*3 blocks.*iblank=true.*1 block"),
    ("c_const", ("info", "c_const.xyz"), r"all 27 nodes lie at one point"),
    ("t_bad", ("deform", "g3.xyz", "-d", "t_bad.npz", "-o", "out.xyz"), r"cannot read t_bad\.npz: .*decompress"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "arguments", "message"), REFUSED, ids=[f"{row[0]}-{row[1][0]}" for row in REFUSED])
def test_refused_at_once_with_one_message(make, arguments, message, call, tmp_path, monkeypatch, snapshot):
    monkeypatch.chdir(tmp_path)
    getattr(hostile_inputs, make)()
    before = snapshot(tmp_path)
    start = time.process_time()
    tracemalloc.start()
    result = call(*arguments)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert result.code == 2
    assert result.err.count("meshdeform: error: ") == 1
    assert re.search(message, result.err), result.err
    assert "Traceback" not in result.err
    assert result.out == ""
    assert peak < 200e6
    # Some tenths of a second, but for imports on a loaded machine.
    assert time.process_time() - start < 10
    assert snapshot(tmp_path) == before


def test_a_gap_is_named_with_the_tolerance_that_closes_it(call, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hostile_inputs.e4()
    motion = WALLS.replace("MOTION", "translate=[0,0.002,0]")
    assert call("deform", "e4_closed.xyz", "-s", motion, "-o", "closed.xyz").code == 0
    result = call("deform", "e4_gap.xyz", "-s", motion, "-o", "gap.xyz")
    assert result.code == 2
    assert re.search(r"block1\.imax\[1:4,1:3\] \(6 quads\) and block2\.imin nearly coincide", result.err)
    tolerance = re.search(r"grid\.tolerance = (\S+) closes it", result.err)
    assert tolerance
    assert not Path("gap.xyz").exists()
    assert call("deform", "e4_gap.xyz", "-s", motion, "-s", f"grid.tolerance={tolerance[1]}", "-o", "gap.xyz").code == 0
    # The gap itself is all that the two results differ by.
    assert np.abs(read_grid("gap.xyz").points - read_grid("closed.xyz").points).max() < 0.0011
    assert "nearly coincide" in call("info", "e4_gap.xyz").out


def test_integers_are_read_as_the_option_says(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    hostile_inputs.e6_integers()
    grid = read_grid("e6_integers.fmt", {"multiblock": "true"})
    assert grid.shapes == ((2, 5, 1), (2, 8, 1), (8, 4, 1))
    assert not grid.fields
    assert read_grid("e6_integers.fmt", {"iblank": "true"}).shapes == ((3, 2, 5),)


def test_good_parts_are_good(call, tmp_path, monkeypatch):
    """What is refused above is refused for its defect: the same commands work without it."""
    monkeypatch.chdir(tmp_path)
    hostile_inputs.g3()
    table = np.loadtxt("e3_table_mm.csv", delimiter=",") / 1000.0
    np.savetxt("table.csv", table, "%.17g", delimiter=",")
    result = call("deform", "g3.xyz", "-d", "table.csv", "-m", "tfi", "-o", "out.xyz", "--tolerance", "1e-6")
    assert result.code == 0, result.err
    moved = read_grid("out.xyz").block(0)[0] - read_grid("g3.xyz").block(0)[0]
    np.testing.assert_allclose(moved.reshape(-1, 3), table[:, 3:], atol=1e-9)
