"""Binary variants are recognised and read, whoever wrote them; what is no Plot3D grid is refused with what was found,
what was expected, and where.
"""

import itertools
import struct
from pathlib import Path

import numpy as np
import pytest
from plot3d_witness import ENCODINGS, ascii_file, binary_file, fortran_record, sample_blocks, sample_iblank

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import Grid
from meshdeform_formats import plot3d, read_grid
from meshdeform_formats.plot3d import ascii as plot3d_ascii

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
        ((5, 4, 1), False, 1, {"precision": "float64", "dimension": 2}),
        ((1, 5, 4), False, 1, {"precision": "float32", "multiblock": False}),
        ((1, 5, 4), False, 0, {"precision": "float32", "multiblock": False}),
        ((1, 5, 4), True, 1, {"precision": "float32", "multiblock": False}),
    ],
)
def test_the_values_tell_plane_grids_from_flat_blocks(tmp_path, shape, with_iblank, z, variant):
    """[1, ni, nj] begins a 2-D file of one block as well as a 3-D file of (1, ni, nj); the sizes can agree."""
    blocks, iblank = sample_blocks([shape], variant["precision"]), sample_iblank([shape]) if with_iblank else None
    blocks[0][..., 2] = z * blocks[0][..., 2] + 0.0  # no zeros with a sign
    check(plot3d.read(put(tmp_path, binary_file(blocks, iblank, encoding="binary", **variant))), blocks, iblank)


def test_three_arrays_or_three_planes_must_be_chosen(tmp_path):
    blocks = sample_blocks([(4, 5, 3)])
    one = r"little-endian Fortran \(4-byte markers\) .* 3-D with one record per array with 1 block \(4x5x3\)"
    two = one.replace("array", "plane")
    for records in ("array", "plane"):
        path = put(tmp_path, binary_file(blocks, encoding="fortran", records=records))
        with pytest.raises(FormatError, match=rf"by options: records=array \({one}\) or records=plane \({two}\)$"):
            plot3d.read(path)
        check(plot3d.read(path, records=records), blocks)


BLOCKS = sample_blocks([(3, 4, 5), (2, 3, 4)])
FORTRAN = binary_file(BLOCKS, encoding="fortran", byte_order="big")
STREAM = binary_file(BLOCKS, encoding="binary")
TEXT, MANY = ascii_file(BLOCKS), ascii_file(4 * sample_blocks([(2, 2, 2)]))


def ints(*values: int, order: str = "<") -> bytes:
    return struct.pack(f"{order}{len(values)}i", *values)


def header(*sizes: int, count: int = 1) -> bytes:
    return fortran_record(ints(count)) + fortran_record(ints(*sizes))


def changed(content: bytes, position: int, new: bytes) -> bytes:
    return content[:position] + new + content[position + len(new) :]


def record(data: np.ndarray) -> bytes:
    return fortran_record(data.tobytes())


BINARY = {
    "truncated Fortran": (
        FORTRAN[:-40],
        r"big-endian Fortran \(4-byte markers\) float64 multi-block 3-D with 2 blocks \(3x4x5, 2x3x4\): "
        rf"the file should have {len(FORTRAN)} bytes but has {len(FORTRAN) - 40}: truncated by 40; "
        r"record 4 at byte \d+ declares 576 bytes of data and 540 follow",
    ),
    "a line of nodes": (binary_file(sample_blocks([(5, 1, 1)]), encoding="fortran"), "at least 2 nodes along two ind"),
    "truncated between records": (FORTRAN[: -576 - 8], "truncated by 584; record 4 is missing"),
    "truncated header": (FORTRAN[:30], "fits no variant of Plot3D|is not a Plot3D grid"),
    "truncated stream": (STREAM[:-8], f"C binary float64.*should have {len(STREAM)} bytes.*truncated by 8"),
    "bytes behind the stream": (STREAM + bytes(12), "12 too many"),
    "records too many": (FORTRAN + 2 * fortran_record(bytes(8), ">"), "32 too many; record 5 is surplus"),
    "wrong marker behind a record": (changed(FORTRAN, len(FORTRAN) - 4, ints(575, order=">")), "576 before.*575 after"),
    "wrong marker before a record": (changed(FORTRAN, 44, ints(1439, order=">")), "record 3 at byte 44"),
    "last subrecord of none": (changed(FORTRAN, len(FORTRAN) - 4, ints(-576, order=">")), "576 before.*-576 after"),
    "no last subrecord": (changed(FORTRAN, len(FORTRAN) - 584, ints(-576, order=">")), "record 4 lacks its last"),
    "more blocks than records": (header(2, 3, 4, 2, 3, 4, count=2) + record(np.ones(72)), "record 4 is missing"),
    "more blocks than sizes": (header(2, 3, 4, count=2) + record(np.ones(72)), r"\[2, 2, 3, 4.*not a block count"),
    "no nodes": (header(2, 0, 4) + record(np.ones(1)), r"its header \[1, 2, 0, 4, .*is not a block count"),
    "absurd sizes": (header(2000000000, 2000000000, 2000000000) + record(np.ones(72)), r"its header \[1, 2000000000"),
    "a solution file": (header(2, 3, 4) + record(np.ones(4)) + record(np.ones(120)), "record 3 holds 32 bytes where"),
    "only zeros": (bytes(1000), "is not a Plot3D grid: its first numbers are not a block count"),
    "random bytes": (b"\0" + np.random.default_rng(5).bytes(999), "fits no variant of Plot3D|is not a Plot3D grid"),
}

ASCII = {
    "truncated text": (TEXT[: TEXT.rindex(" ")], r"ASCII multi-block 3-D with 2 blocks.*should have 259 numbers.*by 1"),
    "numbers behind": (MANY + "1.0 2.0\n", r"with 4 blocks \(2x2x2, 2x2x2, 2x2x2, ...\): .* has 111: 2 too many"),
    "a comment": ("# a grid\n" + TEXT, r"line 1: found '#' where a Plot3D text has a number"),
    "two numbers grown together": ("1 2 2 1\n0.5\n1.234567-12.3456789 3 4", "line 3: found '1.234567-12.3456789'"),
    "null value first": (",2 2 1 1.0", "line 1: no number before a comma"),
    "null value over lines": ("1\n2 2 1\n1.0,\n  ,2.0 3.0", "line 4: no number before a comma"),
    "slash": ("1\n2 2 1\n1.0 2.0 /", "line 3: found '/'"),
    "absurd repeat count": ("1\n2 2 1\n999999999999*1.0", "line 1: from here on repeat counts give 1000000000003"),
    "underscores": ("1\n2 2 1\n1_0 2", "line 3: found '1_0'"),
    "sizes that are no integers": ("1\n2.5 2 1\n" + "1.0 " * 12, "no variant|not a Plot3D grid"),
    "absurd size": ("1\n99999 99999 99999\n1.5 2.5", "fits no variant|is not a Plot3D grid"),
    "nothing but blanks": (" \n\t\n", "is not a Plot3D grid"),
}
for bad in ("1.5", "3e9"):
    text = ascii_file(BLOCKS, [np.full(b.shape[:3], 1) for b in BLOCKS]).replace(" 1 1 1 1", f" 1 1 {bad} 1")
    ASCII[f"iblank of {bad}"] = text, f"for IBLANK values, but one of them is {float(bad):g}".replace("+", r"\+")


@pytest.mark.parametrize("name", BINARY | ASCII)
def test_bad_files(tmp_path, name):
    content, message = (BINARY | ASCII)[name]
    path = tmp_path / "bad.xyz"
    path.write_bytes(content.encode("latin1") if isinstance(content, str) else content)
    with pytest.raises((FormatError, GridError), match=message) as caught:
        read_grid(path)
    assert str(path) in str(caught.value)


def test_the_line_is_right_behind_many_pieces(tmp_path, monkeypatch):
    monkeypatch.setattr(plot3d_ascii, "_PIECE", 100)
    path = tmp_path / "bad.xyz"
    for end, message in (("3.5 what\n" + "1.5\n" * 10, "found 'what'"), (" ,2.5", "no number before a comma; null")):
        path.write_text("1\n10 10 10\n" + "1.5 2.5,\n" * 700 + end)
        with pytest.raises(FormatError, match=f"line 703: {message}"):
            plot3d.read(path)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"encodin": "ascii"}, r"Plot3D: unknown option 'encodin'; did you mean 'encoding'\?; known are: encoding by"),
        ({"byte_order": "bigg"}, r"unknown byte_order = 'bigg'; did you mean 'big'\?; known are: little big"),
        ({"markers": 5}, "unknown markers = '5'"),
        ({"encoding": "ascii", "dimension": 3}, r"with encoding=ascii with dimension=3; without these options it is b"),
    ],
)
def test_options_that_cannot_be(tmp_path: Path, options, message):
    path = tmp_path / "grid.xyz"
    path.write_bytes(FORTRAN)
    with pytest.raises(FormatError, match=message):
        plot3d.read(path, **options)


SHEET, PLAIN = sample_blocks([(40, 30, 1)]), {"encoding": "binary", "dimension": 2}
STRANGE = {
    # Truncated to two of its three float64 coordinates, a 3-D file has the size of a 2-D one of float64.
    "cut": binary_file(SHEET, encoding="binary", multiblock=False)[: 8 + 16 * 1200],
    "blanked by far blocks": binary_file(SHEET, [np.full((40, 30, 1), -200_000)], **PLAIN),
    "huge": binary_file([1e35 * SHEET[0], SHEET[0][:2, :2]], **PLAIN),
}


@pytest.mark.parametrize("name", STRANGE)
def test_a_size_that_fits_by_accident_is_not_enough(tmp_path, name):
    path = tmp_path / "cut.xyz"
    path.write_bytes(STRANGE[name])
    for options in ({}, {"dimension": "2"}):
        with pytest.raises(FormatError, match=r"size of .* 2-D .*blocks? \(40x30.*\), but \d+% of the numbers would"):
            plot3d.read(path, **options)
    assert plot3d.read(path, encoding="binary").shapes[0] == (40, 30, 1)
