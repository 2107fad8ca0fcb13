"""Inputs that once gave a wrong grid, a traceback or an abort: what they must give now, and at what cost.

Damaged files of single formats are in the tests of formats.
"""

from __future__ import annotations

import re
import time
import tracemalloc
from pathlib import Path

import h5py
import numpy as np
import pytest
from cgns_witness import two_zones, write_hdf5

from meshdeform_core.grid import Grid
from meshdeform_formats import read_grid, write_grid


def curved(blocks: int = 2) -> Grid:
    """Blocks of 5 x 4 x 3 nodes one behind the other over a bump, spanned from z = 0 to 0.7."""
    x = np.linspace(0.0, blocks, 4 * blocks + 1)
    y, z = np.array([0.0, 0.24, 0.59, 1.0]), np.array([0.0, 0.35, 0.7])
    box = np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)
    box[..., 1] += 0.05 * np.sin(np.pi * box[..., 0]) * (1.0 - box[..., 1])
    return Grid.from_blocks([np.ascontiguousarray(box[4 * n : 4 * n + 5]) for n in range(blocks)])


def c_root() -> None:
    """A bit of the root group of an HDF5 file has changed; its checksum is wrong."""
    write_hdf5(Path("c_root.cgns"), two_zones())
    data = bytearray(Path("c_root.cgns").read_bytes())
    with h5py.File("c_root.cgns") as file:
        at = h5py.h5o.get_info(file.id).addr
    if data[at : at + 4] != b"OHDR":
        # Old object headers have no checksum; their first byte is the version.
        data[at] = 77
    data[at + 12] ^= 0xFF
    Path("c_root.cgns").write_bytes(data)


def e6_integers() -> None:
    """Three plane blocks of whole numbers, which have as many numbers as one block in space with IBLANK."""
    shapes = ((2, 5), (2, 8), (8, 4))
    lines = ["3", " ".join(f"{a} {b}" for a, b in shapes)]
    for a, b in shapes:
        j, i = np.divmod(np.arange(a * b), a)
        lines += [" ".join(map(str, i)), " ".join(map(str, j))]
    Path("e6_integers.fmt").write_text("\n".join(lines) + "\n")


# Which input, the command, and what its message says.
REFUSED = [
    (c_root, ("info", "c_root.cgns"), r"cannot read c_root\.cgns as HDF5: it is damaged"),
    (e6_integers, ("info", "e6_integers.fmt"), r"2 ways.*multiblock=true.*3 blocks.*iblank=true.*1 block"),
]  # fmt: skip


@pytest.mark.parametrize(("make", "arguments", "message"), REFUSED, ids=[row[0].__name__ for row in REFUSED])
def test_refused_at_once_with_one_message(make, arguments, message, call, tmp_path, monkeypatch, snapshot):
    monkeypatch.chdir(tmp_path)
    make()
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
    closed = curved()
    write_grid(closed, "e4_closed.xyz")
    points = closed.points.copy()
    # 0.2 % of a cell.
    closed.block(1, points)[0, :, :, 0] += 0.002 * 0.25
    write_grid(closed.moved(points), "e4_gap.xyz")
    motion = "boundary=[{select=['block1.jmin','block2.jmin'],motion=[{translate=[0,0.002,0]}]}]"
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
    e6_integers()
    grid = read_grid("e6_integers.fmt", {"multiblock": "true"})
    assert grid.shapes == ((2, 5, 1), (2, 8, 1), (8, 4, 1))
    assert not grid.fields
    assert read_grid("e6_integers.fmt", {"iblank": "true"}).shapes == ((3, 2, 5),)
