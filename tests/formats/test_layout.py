"""The blocks of a grid file without its coordinates: as reading all of it finds them, or not at all."""

import os
import struct

import numpy as np
import pytest
from grids import frame, frame_2d

from meshdeform_core.errors import FormatError
from meshdeform_formats.grids import layout_of, read_grid, write_grid

PLOT3D = [
    {"encoding": "fortran"},
    {"encoding": "binary", "byte_order": "big", "precision": "float32"},
    {"encoding": "fortran", "iblank": "true", "markers": "8"},
    {"encoding": "fortran", "records": "plane"},
]


@pytest.mark.parametrize("variant", PLOT3D, ids=str)
@pytest.mark.parametrize("grid", [frame(), frame_2d()], ids=["3-D", "2-D"])
def test_layouts_of_plot3d_are_those_of_the_grid(grid, variant, tmp_path):
    path = tmp_path / "grid.xyz"
    write_grid(grid, path, variant)
    found, whole = layout_of(path), read_grid(path)
    assert found is not None
    assert found.shapes == whole.shapes
    assert (found.n_nodes, found.n_face_nodes, found.dimension) == (whole.n_nodes, whole.n_face_nodes, whole.dimension)
    assert (found.format, found.precision) == (whole.format, whole.precision)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_layouts_of_cgns_are_those_of_the_grid(precision, tmp_path):
    write_grid(frame(), tmp_path / "grid.cgns", {"precision": precision})
    found, whole = layout_of(tmp_path / "grid.cgns"), read_grid(tmp_path / "grid.cgns")
    assert found is not None
    assert (found.shapes, found.format) == (whole.shapes, whole.format)


@pytest.mark.parametrize("name", ["grid.p3dfmt", "grid.vtm"])
def test_formats_that_are_read_as_a_whole_tell_no_layout(name, tmp_path):
    write_grid(frame(), tmp_path / name)
    assert layout_of(tmp_path / name) is None


def test_a_dictionary_tells_no_layout(tmp_path):
    """Also once modules of its package are loaded, whatever their names."""
    corners = "vertices ((0 0 0) (1 0 0) (1 1 0) (0 1 0) (0 0 1) (1 0 1) (1 1 1) (0 1 1));"
    blocks = "blocks (hex (0 1 2 3 4 5 6 7) (4 3 2) simpleGrading (1 1 1));"
    (tmp_path / "blockMeshDict").write_text(f"FoamFile {{ class dictionary; }}\n{corners}\n{blocks}\n")
    assert read_grid(tmp_path / "blockMeshDict").shapes == ((5, 4, 3),)
    assert layout_of(tmp_path / "blockMeshDict") is None


def test_files_that_are_damaged_are_refused_or_left_to_reading(tmp_path):
    write_grid(frame(), tmp_path / "grid.xyz", {"encoding": "fortran"})
    data = (tmp_path / "grid.xyz").read_bytes()
    (tmp_path / "short.xyz").write_bytes(data[:-8])
    assert layout_of(tmp_path / "short.xyz") is None
    (tmp_path / "empty.cgns").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(FormatError, match="damaged"):
        layout_of(tmp_path / "empty.cgns")


def test_a_sparse_file_of_a_billion_nodes_is_not_read(tmp_path):
    shapes = np.full((1000, 3), 100, np.int32)
    with (tmp_path / "sparse.xyz").open("wb") as stream:
        stream.write(struct.pack("<i", len(shapes)) + shapes.tobytes())
        stream.truncate(4 + shapes.nbytes + 24 * 10**9)
    assert os.stat(tmp_path / "sparse.xyz").st_blocks * 512 < 10**6
    found = layout_of(tmp_path / "sparse.xyz")
    assert found is not None
    assert found.n_nodes == 10**9
    assert found.n_face_nodes == 1000 * (100**3 - 98**3)
