"""Reading shared among ranks: each goes to its own blocks, together they have the whole grid."""

import dataclasses

import numpy as np
import pytest
from cgns_witness import AdfWriter, box, tree, zone
from grids import frame
from pretended import UNTOUCHED, rank

from meshdeform_core.grid import Field
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.plot3d.binary import _Data

VARIANTS = [
    {"encoding": "binary"},
    {"encoding": "binary", "byte_order": "big", "precision": "float32"},
    {"encoding": "fortran"},
    {"encoding": "fortran", "markers": "8", "records": "array"},
    {"encoding": "fortran", "records": "plane"},
    {"encoding": "ascii"},
]


def dealt(path, count=3):
    """The grid after every rank has read its part; after each of them only blocks up to its own are there."""
    arrays = []
    for number in range(count):
        with rank(number, count, arrays):
            grid = read_grid(path)
        for block in range(grid.n_blocks):
            is_there = not (grid.block(block) == UNTOUCHED).any()
            assert is_there == (block % count <= number)
    return grid


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
    alone, together = read_grid(path), dealt(path)
    np.testing.assert_array_equal(together.points, alone.points)
    assert len(alone.fields) == (8 if iblank else 0)
    for one, other in zip(alone.fields, together.fields, strict=True):
        np.testing.assert_array_equal(one.values, other.values)


def test_a_rank_reads_the_coordinates_of_its_own_blocks_only(tmp_path, monkeypatch):
    grid = frame()
    write_grid(grid, tmp_path / "grid.xyz")
    counts, take = [], _Data.take
    monkeypatch.setattr(_Data, "take", lambda self, dtype, n: counts.append(n) or take(self, dtype, n))
    with rank(1, 3, []):
        read_grid(tmp_path / "grid.xyz")
    sizes = [int(np.prod(grid.shapes[block])) for block in (1, 4, 7)]
    assert counts == [size for size in sizes for _ in range(3)]


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
    np.testing.assert_array_equal(dealt(tmp_path / f"grid{suffix}").points, grid.points)
