"""VTK files of its own writers and of third parties read by us, ours read by VTK, damaged and foreign ones refused."""

import numpy as np
import pytest
import vtk_witness
from vtkmodules import vtkCommonCore

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FileFormat, Grid
from meshdeform_formats import read_grid, vtk, write_grid

SHAPE = (3, 4, 5)


@pytest.fixture
def rng():
    return np.random.default_rng(0)


def rich_grid(rng, dtype=np.float64):
    """A VTK grid with every kind of array, and those arrays."""
    points = rng.normal(size=(*SHAPE, 3)).astype(dtype)
    grid = vtk_witness.structured_grid(points, origin=(2, -1, 0))
    cells = tuple(n - 1 for n in SHAPE)
    arrays = {
        ("node", "pressure"): (rng.normal(size=SHAPE), "Scalars", ()),
        ("node", "velocity"): (rng.normal(size=(*SHAPE, 3)).astype(np.float32), "Vectors", ("u", "v", "w")),
        ("node", "normal"): (rng.normal(size=(*SHAPE, 3)).astype(np.float32), "Normals", ()),
        ("node", "stress of %"): (rng.normal(size=(*SHAPE, 9)), "Tensors", ()),
        ("node", "iblank"): (rng.integers(-3, 3, SHAPE).astype(np.int32), None, ()),
        ("node", "vtkGhostType"): (rng.integers(0, 3, SHAPE).astype(np.uint8), None, ()),
        ("cell", "number"): (rng.integers(0, 2**62, cells), "Scalars", ()),
        ("cell", "pair"): (rng.normal(size=(*cells, 2)), None, ()),
        ("cell", "small"): (rng.integers(-9, 9, cells).astype(np.int16), None, ()),
    }
    for (location, name), (values, role, components) in arrays.items():
        attributes = grid.GetPointData() if location == "node" else grid.GetCellData()
        vtk_witness.add_array(attributes, name, values, role, components)
    vtk_witness.add_array(grid.GetFieldData(), "TimeValue", np.array([0.25]))
    return grid, points, arrays


def check(grid, points, arrays):
    assert grid.shapes == (SHAPE,)
    np.testing.assert_array_equal(grid.block(0), points)
    assert grid.precision == points.dtype.name
    fields = {(f.location, f.name): f for f in grid.fields}
    assert fields.keys() == arrays.keys()
    for key, (values, *_) in arrays.items():
        np.testing.assert_array_equal(fields[key].values, values)
        assert fields[key].values.dtype == values.dtype
        assert fields[key].values.flags.c_contiguous


XML_VARIANTS = [
    (encoding, compression, ("UInt32", "UInt64")[(number + other) % 2], ("little", "big")[number % 2])
    for number, encoding in enumerate(("ascii", "binary", "appended", "appended-base64"))
    for other, compression in enumerate(map(str.upper, vtk_witness.COMPRESSIONS))
]


@pytest.mark.parametrize(("encoding", "compression", "header", "byte_order"), XML_VARIANTS)
def test_every_variant_of_vts(tmp_path, rng, encoding, compression, header, byte_order):
    vts, points, arrays = rich_grid(rng, np.float32 if byte_order == "big" else np.float64)
    vtk_witness.write_xml(tmp_path / "grid.dat", vts, encoding, compression, header, byte_order == "big")
    grid = read_grid(tmp_path / "grid.dat")
    check(grid, points, arrays)
    assert grid.format.options == {
        "kind": "vts",
        "encoding": encoding,
        "compression": "none" if encoding == "ascii" else compression.lower(),
        "byte_order": byte_order,
        "header_type": header,
    }


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("version", [42, 51])
def test_legacy_files(tmp_path, rng, binary, version):
    vtk, points, arrays = rich_grid(rng)
    vtk_witness.write_legacy(tmp_path / "grid.xyz", vtk, binary, version)
    grid = read_grid(tmp_path / "grid.xyz")
    assert grid.format.options == {"kind": "legacy", "encoding": "binary" if binary else "ascii"}
    if not binary:
        # VTK's writer has cut the numbers; what counts is what it reads itself.
        witness, values = vtk_witness.read(tmp_path / "grid.xyz")
        points = np.ascontiguousarray(witness)
        arrays = {key: (values[key], role, components) for key, (_, role, components) in arrays.items()}
    # VTK writes DIMENSIONS, which lose the origin.
    check(grid, points, arrays)


TYPES = {
    "Bit": "uint8", "Char": "int8", "SignedChar": "int8", "UnsignedChar": "uint8", "Short": "int16", "IdType": "int64",
    "UnsignedInt": "uint32", "LongLong": "int64", "UnsignedLongLong": "uint64", "Float": "float32",
}  # fmt: skip


@pytest.mark.parametrize("name", ["xml", "binary", "ascii"])
def test_all_types_of_numbers(tmp_path, rng, name):
    vtk = vtk_witness.structured_grid(rng.normal(size=(3, 3, 3, 3)))
    numbers = rng.integers(0, 2, (3, 3, 3))
    for kind in TYPES:
        array = getattr(vtkCommonCore, f"vtk{kind}Array")()
        array.SetName(kind)
        for number in numbers.swapaxes(0, 2).ravel().tolist():
            array.InsertNextValue(chr(number) if kind == "Char" else number)
        vtk.GetPointData().AddArray(array)
    if name == "xml":
        vtk_witness.write_xml(tmp_path / "a", vtk)
    else:
        vtk_witness.write_legacy(tmp_path / "a", vtk, binary=name == "binary")
    fields = {f.name: f.values for f in read_grid(tmp_path / "a").fields}
    for kind, dtype in TYPES.items():
        np.testing.assert_array_equal(fields[kind], numbers)
        # VTK writes ids to binary legacy files as 4 bytes.
        assert fields[kind].dtype == ("int32" if (kind, name) == ("IdType", "binary") else dtype)


def test_global_ids_and_text(tmp_path, rng):
    vts = vtk_witness.structured_grid(rng.normal(size=(2, 2, 2, 3)))
    numbers = np.arange(8).reshape(2, 2, 2)
    vtk_witness.add_array(vts.GetPointData(), "ids", numbers, "GlobalIds")
    vtk_witness.add_text(vts.GetFieldData(), "50 % mine", "somebody", "x" * 100)
    for path, write in ((tmp_path / "a.vts", vtk_witness.write_xml), (tmp_path / "a.vtk", vtk_witness.write_legacy)):
        write(path, vts)
        grid = read_grid(path)
        np.testing.assert_array_equal(grid.fields[0].values, numbers)
        assert grid.notes == (("the text array '50 % mine' is not kept",) if path.suffix == ".vtk" else ())
    vtk_witness.write_legacy(tmp_path / "a.vtk", vts, binary=False)
    np.testing.assert_array_equal(read_grid(tmp_path / "a.vtk").fields[0].values, numbers)


def test_old_sections_of_legacy_files(tmp_path):
    text = """# vtk DataFile Version 2.0
by hand
ascii
dataset STRUCTURED_GRID
FIELD FieldData 2
NULL_ARRAY
TIME 1 1 double
0.5
dimensions 2 2 1
points 4 int
0 0 0 1 0 0
0 1 0 1 1 0

POINT_DATA 4
COLOR_SCALARS colour 3
0 0.5 1 0 0 0 1 1 1 0.25 0.25 0.25
LOOKUP_TABLE rainbow 1
0 0 1 1
SCALARS flag bit
LOOKUP_TABLE default
1 0 0 1
SCALARS pair int 2
LOOKUP_TABLE default
1 2 3 4 5 6 7 8
TEXTURE_COORDINATES map 2 float
0 0 1 0 0 1 1 1
CELL_DATA 1
VECTORS flow double
1 2
3
GLOBAL_IDS id vtkIdType
9000000000"""
    (tmp_path / "a.vtk").write_text(text)
    grid = read_grid(tmp_path / "a.vtk")
    np.testing.assert_array_equal(grid.block(0)[:, :, 0, :2], [[[0, 0], [0, 1]], [[1, 0], [1, 1]]])
    fields = {f.name: f for f in grid.fields}
    assert fields["colour"].values[1, 0, 0].tolist() == [0, 0, 0]
    assert fields["colour"].values[0, 0, 0].tolist() == [0, 128, 255]
    assert fields["flag"].values.ravel().tolist() == [1, 0, 0, 1]
    assert fields["flow"].values.tolist() == [[[[1, 2, 3]]]]
    assert fields["id"].values.item() == 9_000_000_000
    assert fields["map"].values[1, 0, 0].tolist() == [1, 0]
    assert fields["pair"].values[:, :, 0].tolist() == [[[1, 2], [5, 6]], [[3, 4], [7, 8]]]
    assert "lookup table 'rainbow'" in grid.notes[1]
    assert "no line end" in grid.notes[0]


POINTS = np.random.default_rng(0).normal(size=(2, 3, 2, 3))
GRID = Grid.from_blocks([POINTS], fields=(Field("f", "node", 0, np.arange(12.0).reshape(2, 3, 2)),))


@pytest.mark.parametrize("name", ["a.vtk", "a.vts", "a.vtm"])
@pytest.mark.parametrize("options", [{}, {"encoding": "ascii"}], ids=["binary", "ascii"])
def test_truncated_files_are_never_taken_for_complete(tmp_path, capfd, name, options):
    write_grid(GRID, tmp_path / name, options)
    data = (tmp_path / name).read_bytes()
    # Past the last value only white space, closing tags or, without any, digits of the last number can be missing.
    end = data.rstrip().rfind(b" ") if name == "a.vtk" else data.rfind(b"</VTKFile>")
    for length in [*range(60, end, max(end // 40, 1)), end - 1]:
        (tmp_path / name).write_bytes(data[:length])
        try:
            grid = read_grid(tmp_path / name)
        except FormatError:
            continue
        # A legacy file has no end mark: cut off between two sections it is complete, but for the later one.
        assert name == "a.vtk"
        assert not grid.fields
        if not options or data[length - 1 : length + 1].isspace():
            np.testing.assert_array_equal(grid.points, GRID.points)
        else:
            assert "no line end" in grid.notes[0]
            np.testing.assert_array_equal(grid.points.ravel()[:-1], GRID.points.ravel()[:-1])
    assert capfd.readouterr() == ("", "")


def header(kind="STRUCTURED_GRID", rest=""):
    return f"# vtk DataFile Version 3.0\ntitle\nASCII\nDATASET {kind}\n{rest}"


SQUARE = "DIMENSIONS 2 2 1\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 1 1 0\n"

LEGACY = {
    "# vtk DataFile Version 3.0\ntitle\nTEXT\n": "line 3: expected ASCII or BINARY, found 'TEXT'",
    "# vtk DataFile Version 3.0\ntitle\nASCII\nPOINTS 3 float\n": "line 4: expected 'DATASET kind', found 'POINTS 3",
    header("POLYDATA"): "is a polygon surface (DATASET POLYDATA); expected a structured grid",
    header("UNSTRUCTURED_GRID"): "is an unstructured grid (DATASET UNSTRUCTURED_GRID); expected a structured grid",
    header(rest=""): "has no DIMENSIONS",
    header(rest="DIMENSIONS 2 2 1\n"): "has no POINTS",
    header(rest="DIMENSIONS 3.7 2 1\n"): "expected 3 whole numbers",
    header(rest="DIMENSIONS 0 2 1\nPOINTS 0 float\n"): "is an empty grid: 0 x 2 x 1 nodes",
    header(rest="DIMENSIONS 2 3 1\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 1 1 0\n"): "has 4 points; its DIMENSIONS",
    header(rest="DIMENSIONS 2 2 1\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 1\n1.0\n"): "expected 12 values, found 11",
    header(rest="DIMENSIONS 2 2 1\nPOINTS 4 float\n0 0 0 1 0 0 0 1\nCELL_DATA 1\n"): "something that is not a number",
    header(rest="DIMENSIONS 2 2 1\nPOINTS 4 float\n0 0 0 1 0 0 0 1 0 1 5E-\n0\n"): "something that is not a number",
    header(rest="DIMENSIONS 2 2 1\nPOINTS 4 half\n"): "line 6: POINTS: unknown type 'half'; known are char",
    header(rest="DIMENSIONS 2 2 1\nPOINTS -4 float\n"): "line 6: expected a number, found '-4'",
    header(rest="DIMENSIONS 2 2 1\nPOINTS 999999999999 float\n1"): "need 5999999999993 bytes, 1 are left",
    header(rest=SQUARE + "POINT_DATA 4\nSCALARS p float\n1 2 3 4\n"): "expected 'LOOKUP_TABLE name' after SCALARS",
    header(rest=SQUARE + "POINT_DATA 4\nVECTORS v float\n1 2 3\n"): "array 'v': 12 values need 23 bytes, 6 are left",
    header(rest=SQUARE + "POINT_DATA 3\nSCALARS p float\nLOOKUP_TABLE t\n1 2 3\n"): "node array 'p' has 3 values",
    header(rest=SQUARE + "POINT_DATA 4\nFIELD f 1\np 1 4\n1 2 3 4\n"): "expected 'name components tuples type'",
    header(rest=SQUARE + "PIXELS 4\n"): "expected a section of a VTK file, found 'PIXELS 4'",
    header("RECTILINEAR_GRID", "DIMENSIONS 2 1 1\n"): "is a rectilinear grid; save it as a structured grid",
}  # fmt: skip


@pytest.mark.parametrize("text", LEGACY, ids=range(len(LEGACY)))
def test_wrong_legacy_files(tmp_path, text):
    (tmp_path / "a.vtk").write_text(text)
    with pytest.raises(FormatError) as error:
        read_grid(tmp_path / "a.vtk")
    assert str(error.value).startswith(f"{tmp_path / 'a.vtk'}")
    assert LEGACY[text] in str(error.value)


EXTREMES = np.array([0.1, 5e-324, -0.0, 1.7976931348623157e308, 1 / 3, -123456.789012345678, np.nan, np.inf])


def block(shape):
    return np.random.default_rng(0).normal(size=(*shape, 3))


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
    witness, arrays = vtk_witness.read(tmp_path / name)
    assert witness.dtype == precision
    assert np.ascontiguousarray(witness, dtype=float).tobytes() == grid.points.tobytes()
    np.testing.assert_array_equal(arrays["node", "f"], field.values)


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
        Field("large", "node", 0, np.full(shape, 2**64 - 1, np.uint64)),
        Field("iblank", "node", 0, rng.integers(-1, 2, shape).astype(">i4")),
        Field("100 % mine", "cell", 0, rng.normal(size=(2, 3, 1))),
        Field("flag", "cell", 0, rng.integers(0, 2, (2, 3, 1)).astype(bool)),
    )
    grid = Grid.from_blocks([block(shape)], fields=fields)
    write_grid(grid, tmp_path / name, options)
    points, arrays = vtk_witness.read(tmp_path / name)
    np.testing.assert_array_equal(points, grid.block(0))
    assert len(arrays) == len(fields)
    for field in fields:
        np.testing.assert_array_equal(arrays[field.location, field.name], field.values)


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
        ("a.vts", {"encodin": "ascii"}, "'encodin'; did you mean 'encoding'?; known are: encoding precision"),
        ("a.vts", {"encoding": "binary"}, "unknown encoding = 'binary'; known are"),
        ("a.vts", {"precision": "float16"}, "known are: float32 float64"),
        ("a.vtk", {"encoding": "appended"}, "known are: binary ascii"),
    ],
)
def test_unknown_options(tmp_path, name, options, message):
    with pytest.raises(FormatError) as error:
        write_grid(Grid.from_blocks([block((2, 2, 2))]), tmp_path / name, options)
    assert message in str(error.value)
    with pytest.raises(FormatError, match=r"holds one block, the grid has 2; write a \.vtm"):
        write_grid(Grid.from_blocks([block((2, 2, 2)), block((2, 3, 2))]), tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ([Field("f", "node", 0, np.zeros((2, 2, 3)))], r"has shape \(2, 2, 3\); expected \(2, 2, 2\)"),
        ([Field("f", "cell", 0, np.zeros((2, 2, 2)))], r"cell field 'f' of block1 has shape"),
        ([Field("f", "node", 0, np.zeros((2, 2, 2, 3, 3)))], r"expected \(2, 2, 2\) and at most one more axis"),
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
