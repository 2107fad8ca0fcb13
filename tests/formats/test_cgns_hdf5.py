"""CGNS trees in HDF5: forms of arrays that few writers choose, user blocks, damage."""

import h5py
import numpy as np
import pytest
from cgns_witness import two_zones, write_hdf5
from h5py import h5d, h5p, h5s, h5t

from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.cgns.file import opened_cgns


def odd_arrays():
    """Types of numbers and creation properties by which six values are stored."""
    short, shifted = h5t.STD_I32LE.copy(), h5t.STD_I32LE.copy()
    short.set_precision(16)
    shifted.set_precision(16)
    shifted.set_offset(8)
    compact, early, pieces = (h5p.create(h5p.DATASET_CREATE) for _ in range(3))
    compact.set_layout(h5d.COMPACT)
    early.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    pieces.set_chunk((1, 3))
    kinds = (h5t.IEEE_F64BE, None), (short, None), (shifted, None), (h5t.STD_I64LE, None), (h5t.IEEE_F64LE, compact)
    return *kinds, (h5t.IEEE_F64LE, early), (h5t.IEEE_F64LE, pieces)


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
def test_odd_arrays_have_the_values_that_h5py_finds(tmp_path, oldest):
    path = tmp_path / "odd.cgns"
    with h5py.File(path, "w", track_order=True, libver=(oldest, "v108")) as file:
        for number, (kind, layout) in enumerate(odd_arrays()):
            group = file.create_group(f"n{number}", track_order=True)
            group.attrs["label"], group.attrs["type"] = np.array(b"DataArray_t", "S33"), np.array(b"R8", "S3")
            stored = h5d.create(group.id, b" data", kind, h5s.create_simple((2, 3)), layout)
            stored.write(h5s.ALL, h5s.ALL, np.arange(6.0).reshape(2, 3))
    with opened_cgns(path) as root:
        assert len(root.children) == 7
        for node in root.children:
            node.require_stored()
            np.testing.assert_array_equal(node.data(), np.arange(6).reshape(2, 3).T)
            if (place := node.place()) is not None:
                raw = np.fromfile(path, node.dtype, 6, offset=place)
                np.testing.assert_array_equal(raw, np.arange(6))
        assert [node.place() is not None for node in root.children] == [True, False, False, True, False, True, False]


@pytest.mark.parametrize("size", [512, 4096])
def test_user_blocks_are_read_and_kept(tmp_path, size):
    write_hdf5(tmp_path / "plain.cgns", two_zones())
    with (
        h5py.File(tmp_path / "a.cgns", "w", userblock_size=size, track_order=True) as file,
        h5py.File(tmp_path / "plain.cgns") as plain,
    ):
        for name in plain:
            plain.copy(name, file)
    with (tmp_path / "a.cgns").open("r+b") as stream:
        stream.write(b"#!notes")
    grid = read_grid(tmp_path / "a.cgns")
    np.testing.assert_array_equal(grid.points, read_grid(tmp_path / "plain.cgns").points)
    grid.points[...] += 1.0
    for options in ({}, {"precision": "float32"}):
        write_grid(grid, tmp_path / "b.cgns", options)
        assert (tmp_path / "b.cgns").read_bytes()[:7] == b"#!notes"
        np.testing.assert_allclose(read_grid(tmp_path / "b.cgns").points, grid.points, rtol=1e-6)
