"""Damaged, foreign and mismatched files: each is refused by every command that would read it."""

import re
from collections.abc import Callable
from pathlib import Path

import h5py
import numpy as np
import pytest
from cgns_witness import two_zones, write_hdf5

from meshdeform_formats import read_grid, write_grid


def _put(at: int, kind: str, value: float) -> Callable[[bytes], bytes]:
    """grid.xyz (Fortran, little-endian float64) with a number changed."""
    raw = np.array(value, kind).tobytes()
    return lambda good: good[:at] + raw + good[at + len(raw) :]


def _damaged_root() -> bytes:
    """A bit of the root group of an HDF5 file has changed; its checksum is wrong."""
    path = write_hdf5(Path("root.cgns"), two_zones())
    data = bytearray(path.read_bytes())
    with h5py.File(path) as file:
        at = h5py.h5o.get_info(file.id).addr
    if data[at : at + 4] != b"OHDR":
        # Old object headers have no checksum; their first byte is the version.
        data[at] = 77
    data[at + 12] ^= 0xFF
    return bytes(data)


# Where things are in grid.xyz: a record with the number of blocks, one with the dimensions of 8 blocks, coordinates.
DIMENSIONS = 12 + 4
COORDINATES = DIMENSIONS + 8 * 3 * 4 + 4 + 4

# id: (made from the bytes of grid.xyz, fragments of the message)
GRIDS: dict[str, tuple[Callable[[bytes], bytes], tuple[str, ...]]] = {
    "empty": (lambda good: b"", ("is empty",)),
    "truncated-middle": (lambda good: good[: len(good) // 2], ("bad.xyz", "bytes")),
    "dimension-other": (_put(DIMENSIONS, "<i4", 6), ("bad.xyz",)),
    "nan": (_put(COORDINATES, "<f8", np.nan), ("1 nodes", "not finite", "block1 (1, 1, 1)", "nan")),
    "hdf5-damaged": (lambda good: _damaged_root(), ("cannot read bad.xyz as HDF5: it is damaged",)),
    "png": (lambda good: b"\x89PNG\r\n\x1a\n" + bytes(99), ("PNG picture",)),
}

COMMANDS = {
    "info": ("info", "bad.xyz"),
    "deform": ("deform", "bad.xyz", "-c", "case.toml", "-o", "out.xyz", "--report", "out.json"),
    "convert": ("convert", "bad.xyz", "out.cgns"),
    "compare": ("compare", "grid.xyz", "bad.xyz"),
    "quality": ("quality", "grid.xyz", "--reference", "bad.xyz", "--report", "out.html"),
    "plot": ("plot", "bad.xyz", "-o", "out.png"),
}


def assert_refused(result, fragments) -> None:
    assert (result.code, result.out, result.error.count("\n")) == (2, "", 1), result.err
    assert result.error.startswith("meshdeform: error: ")
    assert result.error[:-1].isprintable(), result.err
    missing = [fragment for fragment in fragments if fragment not in result.err]
    assert not missing, result.err


@pytest.mark.parametrize("name", GRIDS)
def test_wrong_grid_is_refused(name, bench, call, snapshot):
    make, fragments = GRIDS[name]
    (bench / "bad.xyz").write_bytes(make((bench / "grid.xyz").read_bytes()))
    before = snapshot(bench)
    for command in COMMANDS if name in ("truncated-middle", "nan") else ("info", "deform"):
        assert_refused(call(*COMMANDS[command]), fragments)
        assert snapshot(bench) == before


def test_a_gap_is_named_with_the_tolerance_that_closes_it(bench, call):
    """0.2 % of a cell, which is all that the results then differ by."""
    grid = read_grid("grid.xyz")
    points = grid.points.copy()
    grid.block(0, points)[-1, :-1, :, 0] -= 1e-3
    write_grid(grid.moved(points), "gap.xyz")
    command = ("deform", "gap.xyz", "-c", "case.toml", "-o", "out.xyz")
    result = call(*command)
    told = re.search(r"block1\.imax.* \(12 quads\) and block4\.imin nearly coincide.* = (\S+) closes it", result.err)
    assert (result.code, told is not None, Path("out.xyz").exists()) == (2, True, False), result.err
    assert call(*command, "-s", f"grid.tolerance={told[1]}").code == 0
    assert call("deform", "grid.xyz", *command[2:-1], "closed.xyz").code == 0
    assert np.abs(read_grid("out.xyz").points - read_grid("closed.xyz").points).max() < 0.0011
    assert "nearly coincide" in call("info", "gap.xyz").out
