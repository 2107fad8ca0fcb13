"""Files of VTK's own writers, and third-party files, read by us."""

import numpy as np
import pytest
import vtk_witness
from vtkmodules import vtkCommonCore

from meshdeform_formats import read_grid

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
    (encoding, compression, ("UInt32", "UInt64")[(number + other) % 2])
    for number, encoding in enumerate(("ascii", "binary", "appended", "appended-base64"))
    for other, compression in enumerate(map(str.upper, vtk_witness.COMPRESSIONS))
    if encoding != "ascii" or compression == "NONE"
]


@pytest.mark.parametrize(("encoding", "compression", "header"), XML_VARIANTS)
def test_every_variant_of_vts(tmp_path, rng, encoding, compression, header):
    vts, points, arrays = rich_grid(rng)
    vtk_witness.write_xml(tmp_path / "grid.dat", vts, encoding, compression, header)
    grid = read_grid(tmp_path / "grid.dat")
    check(grid, points, arrays)
    assert grid.format.options == {
        "kind": "vts",
        "encoding": encoding,
        "compression": compression.lower(),
        "byte_order": "little",
        "header_type": header,
    }


def test_big_endian_vts_of_single_precision(tmp_path, rng):
    vts, points, arrays = rich_grid(rng, np.float32)
    vtk_witness.write_xml(tmp_path / "grid.vts", vts, big_endian=True)
    grid = read_grid(tmp_path / "grid.vts")
    check(grid, points, arrays)
    assert grid.format.options["byte_order"] == "big"


@pytest.mark.parametrize("binary", [True, False])
@pytest.mark.parametrize("version", [42, 51])
def test_legacy_files(tmp_path, rng, binary, version):
    vtk, points, arrays = rich_grid(rng)
    vtk_witness.write_legacy(tmp_path / "grid.xyz", vtk, binary, version)
    grid = read_grid(tmp_path / "grid.xyz")
    assert grid.format.options == {"kind": "legacy", "encoding": "binary" if binary else "ascii"}
    if not binary:
        # VTK's writer has cut the numbers; what counts is what it reads itself.
        witness, values, _ = vtk_witness.read(tmp_path / "grid.xyz")
        points = np.ascontiguousarray(witness)
        arrays = {key: (values[key], role, components) for key, (_, role, components) in arrays.items()}
    # VTK writes DIMENSIONS, which lose the origin.
    check(grid, points, arrays)


TYPES = {
    "Bit": "uint8",
    "Char": "int8",
    "SignedChar": "int8",
    "UnsignedChar": "uint8",
    "Short": "int16",
    "UnsignedInt": "uint32",
    "LongLong": "int64",
    "UnsignedLongLong": "uint64",
    "IdType": "int64",
    "Float": "float32",
}


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
    vtk_witness.add_text(vts.GetFieldData(), "author", "somebody", "x" * 100)
    for path, write in ((tmp_path / "a.vts", vtk_witness.write_xml), (tmp_path / "a.vtk", vtk_witness.write_legacy)):
        write(path, vts)
        grid = read_grid(path)
        np.testing.assert_array_equal(grid.fields[0].values, numbers)
        assert grid.notes == (("the text array 'author' is not kept",) if path.suffix == ".vtk" else ())
    vtk_witness.write_legacy(tmp_path / "a.vtk", vts, binary=False)
    np.testing.assert_array_equal(read_grid(tmp_path / "a.vtk").fields[0].values, numbers)


def test_old_sections_of_legacy_files(tmp_path):
    text = """# vtk DataFile Version 2.0
by hand
ascii
dataset STRUCTURED_GRID
FIELD FieldData 1
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
    assert "lookup table 'rainbow'" in grid.notes[1]
    assert "no line end" in grid.notes[0]
