"""Reading and writing shared among ranks: each its own ranges of planes, together the whole grid."""

import dataclasses
from contextlib import contextmanager

import numpy as np
import pytest
from cgns_witness import AdfWriter, box, tree, zone
from grids import frame
from pretended import UNTOUCHED, Pretended, rank

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, Planes
from meshdeform_core.parallel import alone
from meshdeform_formats import files, planes, read_grid, write_grid
from meshdeform_formats.cgns.storage import hdf5
from meshdeform_formats.planes import Stored

VARIANTS = [
    {"encoding": "binary"},
    {"encoding": "binary", "byte_order": "big", "precision": "float32"},
    {"encoding": "fortran"},
    {"encoding": "fortran", "markers": "8", "records": "array"},
    {"encoding": "fortran", "records": "plane"},
    {"encoding": "ascii"},
]


def dealt(path, count=3, whole=False):
    """The grid after every rank has read its part; after each of them only ranges up to its own are there.

    ``whole``: the file can only be read block by block.
    """
    arrays = []
    for number in range(count):
        with rank(number, count, arrays):
            grid = read_grid(path)
        blocks = list(enumerate(grid.shapes))
        parts = [Planes(block, 0, shape[2]) for block, shape in blocks] if whole else planes.ranges_of(blocks)
        assert whole or len(parts) > 2 * grid.n_blocks
        for n, part in enumerate(parts):
            is_there = not (grid.block(part.block)[:, :, part.first : part.last] == UNTOUCHED).any()
            assert is_there == (n % count <= number)
    return grid


@pytest.fixture(autouse=True)
def thin(monkeypatch):
    """Even blocks of a few planes are read and written in several ranges."""
    monkeypatch.setattr(planes, "_NODES", 1)
    monkeypatch.setattr(planes, "_PLANES", 1)
    # Small arrays are kept as the nodes of the file are listed.
    monkeypatch.setattr(hdf5, "_FEW_BYTES", 0)


def with_iblank(grid):
    flags = np.random.default_rng(1).integers(0, 3, grid.n_nodes)
    return dataclasses.replace(
        grid, fields=tuple(Field("iblank", "node", b, grid.block(b, flags)) for b in range(grid.n_blocks))
    )


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda v: "-".join(v.values()))
@pytest.mark.parametrize("iblank", [False, True], ids=["bare", "iblank"])
def test_plot3d(tmp_path, variant, iblank):
    path = tmp_path / "grid.xyz"
    write_grid(with_iblank(frame()) if iblank else frame(), path, variant)
    alone, together = read_grid(path), dealt(path, whole=variant["encoding"] == "ascii")
    np.testing.assert_array_equal(together.points, alone.points)
    assert len(alone.fields) == (8 if iblank else 0)
    for one, other in zip(alone.fields, together.fields, strict=True):
        np.testing.assert_array_equal(one.values, other.values)


@pytest.mark.parametrize("suffix", [".xyz", ".cgns"])
def test_a_rank_reads_the_planes_of_its_own_ranges_only(suffix, tmp_path, monkeypatch):
    grid = frame()
    write_grid(grid, tmp_path / f"grid{suffix}")
    seen, read = [], Stored.read
    monkeypatch.setattr(Stored, "read", lambda self, *ends: seen.append((self.plane, ends)) or read(self, *ends))
    with rank(1, 3, []):
        read_grid(tmp_path / f"grid{suffix}")
    own = planes.ranges_of(list(enumerate(grid.shapes)))[1::3]
    each = [(grid.shapes[part.block][1::-1], (part.first, part.last)) for part in own]
    assert sorted(seen) == sorted(3 * each)


@pytest.mark.parametrize("variant", [*VARIANTS[:-1], {"precision": "float32"}], ids=lambda v: "-".join(v.values()))
@pytest.mark.parametrize("source", ["made", "read"])
@pytest.mark.parametrize("iblank", [False, True], ids=["bare", "iblank"])
def test_ranks_write_their_ranges_of_one_file(variant, source, iblank, tmp_path, monkeypatch):
    """The file is complete, and as one process writes it, when each of three ranks has written its ranges."""
    suffix = ".xyz" if "encoding" in variant else ".cgns"
    grid = with_iblank(frame()) if iblank else frame()
    if source == "read":
        write_grid(grid, tmp_path / f"in{suffix}")
        grid = read_grid(tmp_path / f"in{suffix}")
    write_grid(grid, tmp_path / f"alone{suffix}", variant)
    told, written, write = [], [], Stored.write

    def note(self, first, values, *rest):
        written.append((self.start, first))
        write(self, first, values, *rest)

    def on_first(self, action):
        self.asked = getattr(self, "asked", -1) + 1
        if self.number == 0:
            with alone():
                told.append(action())
        return told[self.asked]

    @contextmanager
    def unfinished(target):
        yield target

    monkeypatch.setattr(Stored, "write", note)
    monkeypatch.setattr(Pretended, "on_first", on_first)
    monkeypatch.setattr(files, "replacing", unfinished)
    shared, sizes = tmp_path / f"shared{suffix}", []
    for number in range(3):
        with rank(number, 3, []):
            write_grid(grid, shared, variant)
        sizes.append(len(written))
        assert (shared.read_bytes() == (tmp_path / f"alone{suffix}").read_bytes()) == (number == 2)
    assert len(set(written)) == len(written)
    assert max(np.diff(sizes)) - min(np.diff(sizes)) <= 3 + iblank


def test_a_folder_that_a_rank_does_not_see(tmp_path):
    place = Stored(tmp_path / "elsewhere" / "part.xyz", np.dtype(float), (1, 2), 0, 16)
    with pytest.raises(FormatError, match=r"does not see .*part\.xyz, to which all ranks write; choose"):
        place.write(0, np.zeros((1, 1, 2)))


def test_a_file_that_is_cut_while_it_is_read(tmp_path):
    (tmp_path / "grid.xyz").write_bytes(bytes(31))
    with pytest.raises(FormatError, match=r"grid\.xyz ends before all of its coordinates"):
        Stored(tmp_path / "grid.xyz", np.dtype(float), (1, 2), 0, 16).read(0, 2)


def test_cgns_in_hdf5(tmp_path):
    write_grid(frame(), tmp_path / "grid.cgns")
    np.testing.assert_array_equal(dealt(tmp_path / "grid.cgns").points, frame().points)


def test_cgns_in_adf(tmp_path):
    zones = [zone(f"zone{n}", box(2 + n, 3, 4, (10.0 * n, 0, 0))) for n in range(4)]
    path = AdfWriter().write(tmp_path / "grid.adf", tree(*zones))
    np.testing.assert_array_equal(dealt(path, 2).points, read_grid(path).points)


@pytest.mark.parametrize("suffix", [".vtm", ".vts"])
def test_vtk(tmp_path, suffix):
    grid = frame() if suffix == ".vtm" else frame().__class__.from_blocks([frame().block(0)])
    write_grid(grid, tmp_path / f"grid{suffix}")
    np.testing.assert_array_equal(dealt(tmp_path / f"grid{suffix}", whole=True).points, grid.points)
