"""Every binary variant is recognised and read: files written with struct, gfortran and by others."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from plot3d_witness import ENCODINGS, binary_file, fortran_record, sample_blocks, sample_iblank

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Grid
from meshdeform_formats import plot3d

SHAPES_3D = [(3, 4, 5), (2, 3, 2)]
SHAPES_2D = [(3, 4, 1), (2, 5, 1)]


def put(folder: Path, content: bytes) -> Path:
    path = folder / "grid.unknown"
    path.write_bytes(content)
    return path


def check(grid: Grid, blocks: list[np.ndarray], iblank: list[np.ndarray] | None = None) -> None:
    assert grid.shapes == tuple(block.shape[:3] for block in blocks)
    for index, block in enumerate(blocks):
        np.testing.assert_array_equal(grid.block(index), block)
    fields = {field.block: field for field in grid.fields}
    assert set(fields) == (set(range(len(blocks))) if iblank else set())
    for index, field in fields.items():
        assert (field.name, field.location, field.values.dtype) == ("iblank", "node", np.int32)
        np.testing.assert_array_equal(field.values, iblank[index])


@pytest.mark.parametrize("encoding", ENCODINGS, ids=lambda e: "-".join(map(str, e.values())))
@pytest.mark.parametrize("byte_order", ["little", "big"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("dimension", [2, 3])
def test_every_binary_variant_is_recognised_and_written_alike(tmp_path, encoding, byte_order, precision, dimension):
    for multiblock, with_iblank in itertools.product((True, False), (True, False)):
        shapes = (SHAPES_2D if dimension == 2 else SHAPES_3D)[: 2 if multiblock else 1]
        blocks, iblank = sample_blocks(shapes, precision), sample_iblank(shapes) if with_iblank else None
        variant = {**encoding, "byte_order": byte_order, "multiblock": multiblock, "dimension": dimension}
        path = put(tmp_path, binary_file(blocks, iblank, precision=precision, **variant))
        grid = plot3d.read(path)
        check(grid, blocks, iblank)
        assert grid.format.precision == precision
        # A 2-D block is one plane: the same record either way.
        one_plane = {"records": "block"} if dimension == 2 and encoding.get("records") == "plane" else {}
        assert grid.format.options == {**variant, "iblank": with_iblank, **one_plane}
        assert grid.path == path
        again = Grid.from_blocks(blocks, fields=grid.fields)
        again_path, options = tmp_path / "again.x", {**variant, "precision": precision, "iblank": with_iblank}
        plot3d.write(again, again_path, plot3d.variant(again, again_path, options))
        assert again_path.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("order", ["<", ">"])
def test_block_sizes_may_stand_in_one_record_each(tmp_path, order):
    blocks = sample_blocks([(3, 4, 5), (2, 3, 4), (4, 3, 2)])
    content = fortran_record(np.array([3], order + "i4").tobytes(), order)
    for block in blocks:
        content += fortran_record(np.array(block.shape[:3], order + "i4").tobytes(), order)
    for block in blocks:
        content += fortran_record(block.astype(order + "f8").T.tobytes(), order)
    check(plot3d.read(put(tmp_path, content)), blocks)


@pytest.mark.parametrize("longest", [1, 37, 64, 1000])
def test_records_split_into_subrecords_are_joined(tmp_path, longest):
    blocks = sample_blocks(SHAPES_3D)
    content = fortran_record(np.array([2], "<i4").tobytes())
    content += fortran_record(np.array([b.shape[:3] for b in blocks], "<i4").tobytes())
    content += b"".join(fortran_record(block.T.tobytes(), longest=longest) for block in blocks)
    grid = plot3d.read(put(tmp_path, content))
    check(grid, blocks)
    assert grid.format.options["markers"] == 4


@pytest.mark.parametrize(
    ("shape", "with_iblank", "z", "variant"),
    [
        ((5, 4, 1), True, 1, {"precision": "float32", "dimension": 2}),
        ((5, 4, 1), True, 1, {"precision": "float64", "dimension": 2}),
        ((5, 4, 1), False, 1, {"precision": "float64", "dimension": 2}),
        ((1, 5, 4), False, 1, {"precision": "float32", "multiblock": False}),
        ((1, 5, 4), False, 0, {"precision": "float32", "multiblock": False}),
        ((1, 5, 4), True, 1, {"precision": "float32", "multiblock": False}),
    ],
)
def test_the_values_tell_plane_grids_from_flat_blocks(tmp_path, shape, with_iblank, z, variant):
    """[1, ni, nj] begins a 2-D file of one block as well as a 3-D file of (1, ni, nj); the sizes can agree."""
    blocks, iblank = sample_blocks([shape], variant["precision"]), sample_iblank([shape]) if with_iblank else None
    blocks[0][..., 2] *= z
    check(plot3d.read(put(tmp_path, binary_file(blocks, iblank, encoding="binary", **variant))), blocks, iblank)


def test_three_arrays_or_three_planes_must_be_chosen(tmp_path):
    blocks = sample_blocks([(4, 5, 3)])
    for records in ("array", "plane"):
        path = put(tmp_path, binary_file(blocks, encoding="fortran", records=records))
        with pytest.raises(FormatError, match=r"can be read in 2 ways.*records=array.*records=plane"):
            plot3d.read(path)
        check(plot3d.read(path, records=records), blocks)


def test_options_force_a_reading(tmp_path):
    blocks = sample_blocks(SHAPES_3D)
    path = put(tmp_path, binary_file(blocks, encoding="fortran", byte_order="big"))
    check(plot3d.read(path, encoding="fortran", byte_order="big", markers="4", multiblock="true", dimension=3), blocks)
    with pytest.raises(FormatError, match=r"with byte_order=little; without these options it is big-endian Fortran"):
        plot3d.read(path, byte_order="little")
