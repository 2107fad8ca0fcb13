"""Every variant on request: written as a witness writes it, and read back."""

from pathlib import Path

import numpy as np
import pytest
from plot3d_witness import binary_file, sample_blocks, sample_iblank

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, Grid
from meshdeform_formats import plot3d, write_grid
from meshdeform_formats.plot3d import binary as plot3d_binary


def make_grid(blocks: list[np.ndarray], iblank: list[np.ndarray] | None = None, **rest) -> Grid:
    fields = tuple(Field("iblank", "node", index, flags) for index, flags in enumerate(iblank or []))
    return Grid.from_blocks(blocks, fields=fields, **rest)


def write(grid: Grid, path: Path, **options) -> FileFormat:
    chosen = plot3d.variant(grid, path, options)
    plot3d.write(grid, path, chosen)
    return chosen


def test_float64_text_is_exact(tmp_path):
    bits = np.random.default_rng(4).integers(0, 2**64, (20, 17, 19, 3), dtype=np.uint64).view(np.float64)
    block = np.where(np.isfinite(bits), bits, 0.0)
    block[0, 0, 0] = 5e-324, 2.2250738585072014e-308, 1.7976931348623157e308
    write(make_grid([block]), tmp_path / "a.fmt")
    assert np.array_equal(plot3d.read(tmp_path / "a.fmt").block(0), block)


TEXT = {"encoding": "ascii"}
FORTRAN = {"encoding": "fortran", "byte_order": "little", "markers": 4, "records": "block"}
SUFFIXES = {".fmt": (TEXT, 3), ".P2DFMT": (TEXT, 2), ".p2d": (FORTRAN, 2), ".xyz": (FORTRAN, 3), ".bin": (FORTRAN, 3)}


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_the_suffix_decides_for_grids_from_elsewhere(suffix):
    grid = make_grid(sample_blocks([(3, 4, 1)]), format=FileFormat("cgns", "float32"))
    chosen, (expected, dimension) = plot3d.variant(grid, Path(f"a{suffix}"), {}), SUFFIXES[suffix]
    assert chosen.options == expected | {"dimension": dimension, "multiblock": True, "iblank": False}
    assert chosen.precision == "float64"


def test_a_grid_keeps_its_own_variant(tmp_path):
    own = {"encoding": "fortran", "byte_order": "big", "markers": 8, "records": "array", "precision": "float32"}
    blocks, iblank = sample_blocks([(3, 4, 5)]), sample_iblank([(3, 4, 5)])
    write(make_grid(blocks, iblank), tmp_path / "a.x", **own, multiblock="false")
    grid = plot3d.read(tmp_path / "a.x")
    write_grid(grid, tmp_path / "b.xyz")
    assert (tmp_path / "b.xyz").read_bytes() == (tmp_path / "a.x").read_bytes()
    assert write_grid(grid, tmp_path / "b.fmt").options["encoding"] == "ascii"
    assert write_grid(plot3d.read(tmp_path / "b.fmt"), tmp_path / "b.p3dbin").options["encoding"] == "fortran"
    changed = write_grid(grid, tmp_path / "c.x", {"encoding": "binary", "iblank": "false"})
    plain = {"multiblock": False, "dimension": 3, "iblank": False}
    assert changed.options == {"encoding": "binary", "byte_order": "big", **plain}
    back = plot3d.read(tmp_path / "c.x")
    assert np.array_equal(back.points, grid.points)
    assert back.fields == ()
    assert write_grid(back, tmp_path / "d.bin") == back.format


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_iblank_is_written_when_carried_or_asked_for(tmp_path, encoding):
    shapes = [(3, 4, 5), (2, 3, 2)]
    flags = sample_iblank(shapes)
    fields = (Field("IBlank", "node", 1, flags[1].astype(np.float64)), Field("iblank", "cell", 0, np.ones((2, 3, 4))))
    grid = Grid.from_blocks(sample_blocks(shapes), fields=fields)
    write(grid, tmp_path / "a.x", encoding=encoding)
    back = plot3d.read(tmp_path / "a.x")
    assert (back.fields[0].values == 1).all()
    assert np.array_equal(back.fields[1].values, flags[1])
    write(make_grid(sample_blocks(shapes)), tmp_path / "b.x", iblank="true", encoding=encoding)
    made = plot3d.read(tmp_path / "b.x").fields
    assert [field.values.shape for field in made] == [field.values.shape for field in back.fields]
    assert all((field.values == 1).all() for field in made)
    write(grid, tmp_path / "c.x", iblank=False)
    assert plot3d.read(tmp_path / "c.x").fields == ()


@pytest.mark.parametrize(
    ("shape", "options", "message"),
    [
        ((3, 4, 5), {"dimension": 2}, r"as 2-D: block1 has 3x4x5 nodes.*use dimension=3"),
        ((3, 4, 5), {"multiblock": "false"}, "without block count: the grid has 2 blocks; use multiblock=true"),
        ((3, 4, 5), {"encoding": "ascii", "byte_order": "big"}, "byte_order does not apply to encoding=ascii.*binary"),
        ((3, 4, 5), {"encoding": "binary", "markers": 8}, "markers does not apply to encoding=binary.*fortran"),
    ],
)
def test_what_cannot_be_written(shape, options, message):
    grid = make_grid(sample_blocks([shape, shape]))
    with pytest.raises(FormatError, match=message):
        plot3d.variant(grid, Path("a.x"), options)


def test_values_that_a_variant_cannot_hold(tmp_path):
    wrong = make_grid(sample_blocks([(3, 4, 5)]), [np.ones((3, 4, 9))])
    with pytest.raises(FormatError, match=r"block1 has \(3, 4, 5\) nodes but IBLANK values \(3, 4, 9\)"):
        plot3d.variant(wrong, tmp_path / "a.x", {})
    block = sample_blocks([(3, 4, 5)])[0]
    block[0, 0, 0, 1] = -1e39
    with pytest.raises(FormatError, match=r"as float32: a coordinate is 1e\+39; use precision=float64"):
        plot3d.variant(make_grid([block]), tmp_path / "a.x", {"precision": "float32"})
    block = sample_blocks([(3, 4, 1)])[0]
    block[1, 2, 0, 2] = -1e-3
    path = tmp_path / "a.p2dfmt"
    with pytest.raises(FormatError, match=r"as 2-D: block1 has z from -0.001 to 0"):
        plot3d.variant(make_grid([block]), path, {})
    with pytest.raises(FormatError, match="as 2-D"):
        plot3d.write(make_grid([block]), path, FileFormat("plot3d", options={"encoding": "ascii", "dimension": 2}))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("longest", [1, 7, 100, 1439, 1440])
def test_long_records_become_subrecords(tmp_path, monkeypatch, longest):
    monkeypatch.setattr(plot3d_binary, "LONGEST_SUBRECORD", longest)
    blocks = sample_blocks([(3, 4, 5), (2, 3, 2)])
    write(make_grid(blocks), tmp_path / "a.x")
    content = (tmp_path / "a.x").read_bytes()
    assert int.from_bytes(content[:4], "little", signed=True) == (4 if longest >= 4 else -longest)
    assert np.array_equal(plot3d.read(tmp_path / "a.x").block(1), blocks[1])
    write(make_grid(blocks), tmp_path / "b.x", markers=8)
    assert (tmp_path / "b.x").read_bytes() == binary_file(blocks, encoding="fortran", markers=8)
