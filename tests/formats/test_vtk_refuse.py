"""Damaged and foreign VTK files: each refused with a message, none misread, none printed about by VTK."""

import numpy as np
import pytest

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import read_grid, write_grid

POINTS = np.random.default_rng(0).normal(size=(2, 3, 2, 3))
GRID = Grid.from_blocks([POINTS], fields=(Field("f", "node", 0, np.arange(12.0).reshape(2, 3, 2)),))

VARIANTS = [
    ("a.vtk", {"encoding": "ascii"}),
    ("a.vtk", {"encoding": "binary"}),
    ("a.vts", {"encoding": "ascii"}),
    ("a.vts", {}),
    ("a.vtm", {}),
]


@pytest.mark.parametrize(("name", "options"), VARIANTS)
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
        if options["encoding"] == "binary" or data[length - 1 : length + 1].isspace():
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
    header("UNSTRUCTURED_GRID"): "is an unstructured grid",
    header("FIELD"): "is field data",
    header("HYPER_TREE"): "is another kind of data set (DATASET HYPER_TREE)",
    header(rest=""): "has no DIMENSIONS",
    header(rest="DIMENSIONS 2 2\n"): "line 5: DIMENSIONS: expected 3 whole numbers, found '2 2'",
    header(rest="DIMENSIONS 2 2 x\n"): "expected 3 whole numbers, found '2 2 x'",
    header(rest="DIMENSIONS 2 2 1\n"): "has no POINTS",
    header(rest="DIMENSIONS nan 2 1\n"): "expected 3 whole numbers",
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
