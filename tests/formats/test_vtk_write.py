"""What we write, read back by us and by VTK's and meshio's readers."""

import numpy as np
import pytest
import vtk_witness

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, Grid
from meshdeform_formats import read_grid, vtk, write_grid

EXTREMES = np.array([0.1, 5e-324, -0.0, 1.7976931348623157e308, 1 / 3, -123456.789012345678])


def block(shape, seed=0):
    return np.random.default_rng(seed).normal(size=(*shape, 3))


@pytest.mark.parametrize("name", ["a.vts", "a.vtk"])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_ascii_is_exact(tmp_path, name, precision):
    values = np.resize(EXTREMES, 24) if precision == "float64" else np.resize([0.1, 1e-45, 3.4e38, 1 / 3], 24)
    values = values.astype(precision)
    points = np.resize(np.array([0.1, 1e-30, -0.0, 7e29, 1 / 3, -123456.789012345678, 5], precision), 72)
    points = points.reshape(2, 3, 4, 3).astype(float)
    field = Field("f", "node", 0, values.reshape(2, 3, 4))
    grid = Grid.from_blocks([points], fields=(field,), format=FileFormat("plot3d", precision))
    write_grid(grid, tmp_path / name, {"encoding": "ascii"})
    again = read_grid(tmp_path / name)
    assert again.points.tobytes() == grid.points.tobytes()
    assert again.fields[0].values.tobytes() == field.values.tobytes()
    witness, arrays, _ = vtk_witness.read(tmp_path / name)
    assert witness.dtype == precision
    assert np.ascontiguousarray(witness, dtype=float).tobytes() == grid.points.tobytes()
    assert np.ascontiguousarray(arrays["node", "f"]).tobytes() == field.values.tobytes()


@pytest.mark.parametrize("options", [{"encoding": "ascii"}, {}], ids=["ascii", "binary"])
@pytest.mark.parametrize("name", ["a.vts", "a.vtk"])
def test_vtk_reads_what_we_write(tmp_path, name, options):
    shape = (3, 4, 2)
    rng = np.random.default_rng(1)
    fields = (
        Field("p", "node", 0, rng.normal(size=shape)),
        Field("v", "node", 0, rng.normal(size=(*shape, 3)).astype("f4")),
        Field("t", "node", 0, rng.normal(size=(*shape, 9))),
        Field("map", "node", 0, rng.normal(size=(*shape, 2))),
        Field("iblank", "node", 0, rng.integers(-1, 2, shape).astype(">i4")),
        Field("100 % mine", "cell", 0, rng.normal(size=(2, 3, 1))),
        Field("flag", "cell", 0, rng.integers(0, 2, (2, 3, 1)).astype(bool)),
    )
    grid = Grid.from_blocks([block(shape)], fields=fields)
    write_grid(grid, tmp_path / name, options)
    points, arrays, _ = vtk_witness.read(tmp_path / name)
    np.testing.assert_array_equal(points, grid.block(0))
    assert len(arrays) == len(fields)
    for field in fields:
        np.testing.assert_array_equal(arrays[field.location, field.name], field.values)


@pytest.mark.parametrize("name", ["SampleStructGrid.vtk", "StructuredGrid.vts"])
def test_third_party_data_survive(third_party, tmp_path, name):
    grid = read_grid(third_party / name)
    target = tmp_path / name
    write_grid(grid, target)
    points, arrays, _ = vtk_witness.read(third_party / name)
    again, kept, _ = vtk_witness.read(target)
    assert again.dtype == points.dtype
    np.testing.assert_array_equal(again, points)
    assert kept.keys() == arrays.keys()
    for key, values in arrays.items():
        assert kept[key].dtype == values.dtype
        np.testing.assert_array_equal(kept[key], values)


def test_variant_follows_the_input_only_for_the_same_kind(tmp_path):
    grid = Grid.from_blocks([block((2, 2, 2))])
    write_grid(grid, tmp_path / "a.vts", {"encoding": "ascii", "precision": "float32"})
    own = read_grid(tmp_path / "a.vts")
    assert vtk.variant(own, tmp_path / "b.vts", {}).options["encoding"] == "ascii"
    other = vtk.variant(own, tmp_path / "b.vtk", {})
    assert (dict(other.options), other.precision) == ({"kind": "legacy", "encoding": "binary"}, "float32")
    assert vtk.variant(grid, tmp_path / "b.vts", {}).label == "vtk (kind=vts, encoding=appended), float64"


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "a.vts",
            {"encodin": "ascii"},
            "unknown option 'encodin'; did you mean 'encoding'?; known are: encoding precision",
        ),
        ("a.vts", {"encoding": "binary"}, "unknown encoding = 'binary'; known are"),
        ("a.vts", {"precision": "float16"}, "known are: float32 float64"),
        ("a.vtk", {"compression": "zlib"}, "known are: encoding precision"),
        ("a.vtk", {"encoding": "appended"}, "known are: binary ascii"),
    ],
)
def test_unknown_options(tmp_path, name, options, message):
    with pytest.raises(FormatError) as error:
        write_grid(Grid.from_blocks([block((2, 2, 2))]), tmp_path / name, options)
    assert message in str(error.value)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.vts", "a.vtk"])
def test_several_blocks_need_a_vtm(tmp_path, name):
    grid = Grid.from_blocks([block((2, 2, 2)), block((2, 3, 2))])
    with pytest.raises(FormatError, match=r"holds one block, the grid has 2; write a \.vtm"):
        write_grid(grid, tmp_path / name)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ([Field("f", "node", 0, np.zeros((2, 2, 3)))], r"has shape \(2, 2, 3\); expected \(2, 2, 2\)"),
        ([Field("f", "cell", 0, np.zeros((2, 2, 2)))], r"cell field 'f' of block1 has shape"),
        ([Field("f", "node", 0, np.zeros((2, 2, 2), complex))], "is of type complex128"),
        ([Field("f", "node", 0, np.zeros((2, 2, 2), "f2"))], "is of type float16"),
        ([Field("f", "node", 0, np.zeros((2, 2, 2)))] * 2, "exists twice"),
    ],
)
@pytest.mark.parametrize("name", ["a.vts", "a.vtk", "a.vtm"])
def test_fields_that_cannot_be_stored(tmp_path, fields, message, name):
    grid = Grid.from_blocks([block((2, 2, 2))], fields=tuple(fields))
    with pytest.raises(FormatError, match=message):
        write_grid(grid, tmp_path / name)
    assert not list(tmp_path.iterdir())
