"""Text as Fortran's list-directed input understands it."""

import itertools
from pathlib import Path

import numpy as np
import pytest
from plot3d_witness import ascii_file, sample_blocks, sample_iblank

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import plot3d, read_grid, write_grid
from meshdeform_formats.plot3d import ascii as plot3d_ascii


def put(folder: Path, text: str) -> Path:
    path = folder / "grid.unknown"
    path.write_bytes(text.encode())
    return path


@pytest.mark.parametrize("dimension", [2, 3])
def test_every_text_variant_is_recognised(tmp_path, dimension):
    shapes = [(3, 4, 1), (2, 5, 1)] if dimension == 2 else [(3, 4, 5), (2, 3, 2)]
    for multiblock, with_iblank in itertools.product((True, False), (True, False)):
        used = shapes if multiblock else shapes[:1]
        blocks, iblank = sample_blocks(used), sample_iblank(used) if with_iblank else None
        grid = plot3d.read(put(tmp_path, ascii_file(blocks, iblank, multiblock, dimension)))
        for index, block in enumerate(blocks):
            np.testing.assert_array_equal(grid.block(index), block)
        assert [f.values.tolist() for f in grid.fields] == [flags.tolist() for flags in iblank or []]
        expected = {"encoding": "ascii", "multiblock": multiblock, "dimension": dimension, "iblank": with_iblank}
        assert grid.format.options == expected


def read_one_block(folder: Path, header: str, values: str) -> list[float]:
    """Coordinates of a 2 x 2 x 1 block in the order of the file."""
    grid = plot3d.read(put(folder, header + values))
    assert grid.shapes == ((2, 2, 1),)
    return [float(x) for c in range(3) for x in grid.block(0)[..., c].ravel(order="F")]


VALUES = [-1.0, 0.5, 2.0, 0.003, 4.0, 5.0, 6.0, 7.0, 0.25, 0.25, 0.25, 8e9]


@pytest.mark.parametrize(
    "values",
    [
        "-1.0 0.5 2.0 0.003 4 5 6 7 .25 .25 .25 8e9",
        "-1.,.5,2.,3.E-3,\n4.,5.,6.,7.\n0.25,0.25,0.25,8E+09,\n",
        "-1.0 , 0.5\t,\t2.0,3d-3\r\n4 5 6 7\r\n.25 .25 .25 8d9\r\n",
        "-1.0D+00 0.5D0 +2.0d00 3.0D-003 4 5 6 7 3*.25 8.0D+09",
        "-1.0 5.0-1 2.0+0 0.3-002 4.0 5.0 6.0 7.0 3*0.25 0.8+010",
        "-1 0.5 2 3e-3 4 5 6 7 1*.25 2*0.25E+00 8Q9",
        "-1\n0.5\n2\n3e-3\n4\n5\n6\n7\n3*0.25\n\n\n8.00000000000000000000e9\n\n",
        "-0001.0 00.5 2 0.00300 4.0000 5 6 7 003*25.0E-02 80000.E5   ",
        "-1 +.5 +2 +3e-3 4 5 6 7 3*+.25 +8e+9",
    ],
)
@pytest.mark.parametrize(
    "header",
    ["1\n2 2 1\n", "\ufeff1,2,2,1,", "1*1 2*2 1 ", "\t1\t2*2\t1\t", "\r\n 1\r\n\r\n2, 2, 1\r\n", "2,2,1\n", "2*2\n1\n"],
)
def test_spellings_of_the_same_numbers(tmp_path, header, values):
    assert read_one_block(tmp_path, header, values) == VALUES


@pytest.mark.parametrize("piece", [1, 7, 64, 1000])
def test_numbers_survive_any_cut_of_the_text(tmp_path, monkeypatch, piece):
    monkeypatch.setattr(plot3d_ascii, "_PIECE", piece)
    values = " -1.0D+00, 0.5\n,2.0 ,\t3*4.25\r\n 1.5-101  7,\n"
    path = put(tmp_path, values)
    with path.open("rb") as stream:
        numbers = plot3d_ascii.read_numbers(stream, path)
    assert numbers.tolist() == [-1.0, 0.5, 2.0, 4.25, 4.25, 4.25, 1.5e-101, 7.0]


def test_nan_and_infinity_are_left_to_the_caller(tmp_path):
    numbers = read_one_block(tmp_path, "1 2 2 1 ", "NaN Infinity -inf +Infinity 4 5 6 7 8 9 10 11")
    assert np.isnan(numbers[0])
    assert numbers[1:4] == [np.inf, -np.inf, np.inf]


@pytest.mark.parametrize("number", ["{:g}", "{:.3f}"])
@pytest.mark.parametrize("flags", [True, False])
def test_the_way_of_writing_proves_iblank_or_nothing(tmp_path, number, flags):
    """[1, 3, 4] begins a plane grid with IBLANK and a flat one in space; where all real numbers have a dot it shows."""
    rng = np.random.default_rng(0)
    x, y = rng.integers(0, 9, (2, 12)).astype(float) + 0.5 * (rng.random((2, 12)) < 0.3)
    last = ["1", "10*-1", "0"] if flags else [number.format(z) for z in rng.integers(0, 2, 12).astype(float)]
    text = " ".join(["1 3 4", *map(number.format, x), *map(number.format, y), *last])
    (tmp_path / "a.fmt").write_text(text + "\n" * 99)
    if number == "{:g}":
        with pytest.raises(FormatError, match=r"can be read in 2 ways.*dimension=2, iblank=true.*dimension=3"):
            read_grid(tmp_path / "a.fmt")
        assert plot3d.read(tmp_path / "a.fmt", dimension=3).shapes == ((1, 3, 4),)
        assert plot3d.read(tmp_path / "a.fmt", dimension="2").shapes == ((3, 4, 1),)
    else:
        assert read_grid(tmp_path / "a.fmt").shapes == (((3, 4, 1),) if flags else ((1, 3, 4),))


def test_what_we_write_is_never_taken_for_the_other(tmp_path):
    points = np.zeros((3, 4, 1, 3))
    points[..., 0], points[..., 1] = np.arange(3)[:, None, None], np.arange(4)[:, None]
    iblank = Field("iblank", "node", 0, np.ones((3, 4, 1), np.int32))
    options = {"encoding": "ascii", "dimension": 2}
    write_grid(Grid.from_blocks([points], fields=(iblank,)), tmp_path / "a.fmt", options)
    grid = read_grid(tmp_path / "a.fmt")
    assert grid.format.options["iblank"]
    np.testing.assert_array_equal(grid.block(0), points)
    flat = sample_blocks([(1, 3, 4)])[0]
    flat[..., 2] = 2.0
    write_grid(Grid.from_blocks([flat]), tmp_path / "flat.fmt", {"encoding": "ascii", "multiblock": False})
    np.testing.assert_array_equal(plot3d.read(tmp_path / "flat.fmt").block(0), flat)
