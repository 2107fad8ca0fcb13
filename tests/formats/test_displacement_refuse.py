"""Displacement tables that are none: each refused with what was found and where."""

import dataclasses
import re
import struct

import h5py
import meshio
import numpy as np
import pytest

from meshdeform_core.errors import FormatError, GridError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import write_grid
from meshdeform_formats.displacement import read_displacement

POINTS = np.arange(12.0).reshape(4, 3)
ROW = "1 2 3 4 5 6\n"

TEXTS = {
    "": "is empty",
    "# nothing\n": "has no rows of numbers",
    "x,y,z,dx,dy,dz\n": "has no rows of numbers below the header 'x,y,z,dx,dy,dz'",
    "1 2 3 4 5\n": "line 1: found 5 columns without names; expected 6 (x y z dx dy dz) or 4 (x y dx dy) or 3 (number",
    ROW + "\n# c\n1 2 3 4 5\n": "line 4: found 5 columns; expected 6 as before",
    ROW + "2 2 3 4 5 6 7\n": "line 2: found 7 columns; expected 6 as before",
    ROW + "2 2 3 4 5 six\n": "line 2: 'six' is not a number",
    ROW + "2 2 3 4 5 1.0D+00\n": "line 2: '1.0D+00' is not a number",
    ROW + "2 2 3 4 5 6_0\n": "line 2: '6_0' is not a number",
    ROW + "2 2 3 4 5 \u0666\n": "line 2: '\u0666' is not a number",
    "1,2,3,4,5,6\n2,2,3,,5,6\n": "line 2: '' is not a number",
    "x y z dx dy dz n\n1 2 3 4 5 6 a\n2 3 4 5\n": "line 3: found 4 columns; expected 7 as before",
    "x y z dx dy dz n\n1 2 3 4 5 b a\n": "line 2: 'b' is not a number",
    ROW + "# c\n2 2 3 4 5 nan\n": "line 3: the displacement (4, 5, nan) is not finite (1 such row)",
    ROW + "-inf 2 3 4 5 6\n": "line 2: the point (-inf, 2, 3) is not finite",
    "1 2 3 1e-12 0 0\n1 2 3 2e-12 0 0\n": "the point (1, 2, 3) has two displacements, (1e-12, 0, 0) in line 1",
    "x y z dx\n1 2 3 4\n": "expected a name for each of 4 columns, x y z (or x y) and dx dy dz (or dx dy) among them",
    ROW + "2 2 3 4 5 6\n\n1 2 3 4 5 7\n": "(4, 5, 6) in line 1 and (4, 5, 7) in line 4; keep one of them",
    "x[m] y[m] z[m] dx[mm] dy[mm] dz[mm]\n" + ROW: "lengths in m, mm; expected all in the grid's unit",
    "x y z(m) dx dy dz(Inch)\n" + ROW: "lengths in inch, m; expected all in the grid's unit",
    "a b c d e f\n" + ROW: "expected a name for each of 6 columns, x y z (or x y) and dx dy dz (or dx dy) among them",
    "x y z p q r\n" + ROW: "found 'x' 'y' 'z' 'p' 'q' 'r'",
    "1,5;2,5;3,0;4,0;5,0;6,0\n" * 2: "found '1,5' '2,5'",
    "x;y;z;dx;dy;dz\n0,5;0;0;0;0;0\n": "'0,5' is not a number; decimal commas are not read",
}


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_wrong_texts(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, encoding="utf-8")
    with pytest.raises(FormatError) as error:
        read_displacement(tmp_path / "a.csv")
    assert str(error.value).startswith(str(tmp_path / "a.csv"))
    assert TEXTS[text] in str(error.value)


@pytest.mark.parametrize(("name", "data", "message"), [
    ("a.csv", "größe".encode("latin-1"), "is not UTF-8 text"),
    ("none.csv", None, r"cannot read .*none\.csv: No such file"),
    ("", None, "it is a folder; expected a file"),
    ("a.table", ROW.encode(), r"a file with suffix \.table is not a displacement table; expected text \(\.csv"),
    ("a.xyz", b"not a grid", "Plot3D"),
    ("a.pvtu", b'<VTKFile type="PPolyData"></VTKFile>', "index of a parallel data set; expected its pieces merged"),
    ("a.csv", b"x,y,z,dx [m],dx,dy\n0,0,0,1,2,3\n", r"a\.csv: a .* the same component: 'dx \[m\]' 'dx'$"),
])  # fmt: skip
def test_other_files(tmp_path, name, data, message):
    if data is not None:
        (tmp_path / name).write_bytes(data)
    with pytest.raises(FormatError, match=message):
        read_displacement(tmp_path / name)


def surface(path, data, kind=None):
    meshio.Mesh(POINTS, [("triangle", [[0, 1, 2]])], data).write(path, file_format=kind)


@pytest.mark.parametrize(("data", "message"), [
    ({}, "found none"), ({"p": POINTS[:, 0].copy()}, "found p scalar"),
    ({"a": POINTS, "b": POINTS}, r"found a \(3,\), b \(3,\)"),
    ({"disp": POINTS * np.nan}, r"row 1: the displacement \(nan, nan, nan\) is not finite \(4 such rows\)"),
])  # fmt: skip
@pytest.mark.parametrize("suffix", [".vtu", ".xdmf"])
def test_surfaces_without_a_displacement(tmp_path, data, message, suffix):
    surface(tmp_path / f"a{suffix}", data)
    with pytest.raises(FormatError, match=message):
        read_displacement(tmp_path / f"a{suffix}")


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf", ".med", ".tec"])
def test_truncated_surfaces(tmp_path, capfd, suffix):
    surface(tmp_path / f"a{suffix}", {f"disp_{axis}": POINTS[:, i].copy() for i, axis in enumerate("xyz")})
    assert len(read_displacement(tmp_path / f"a{suffix}").triangles) == 1
    data = (tmp_path / f"a{suffix}").read_bytes()
    capfd.readouterr()
    for length in range(20, len(data) - 1, max(len(data) // 20, 1)):
        (tmp_path / f"a{suffix}").write_bytes(data[:length])
        with pytest.raises(FormatError, match=f"a{suffix}"):
            read_displacement(tmp_path / f"a{suffix}")
    assert capfd.readouterr().out == ""


POLYGONS = """# vtk DataFile Version 3.0
surface
ASCII
DATASET POLYDATA
POINTS 4 double
0 0 0 1 0 0 0 1 0 1 1 0
POLYGONS {cells}
POINT_DATA 4
VECTORS disp double
0 0 1 0 0 2 0 0 3 0 0 4
"""

CELLS = {
    "2 8\n3 0 1 2 3 1 3 2": [[0, 1, 2], [1, 3, 2]],
    "2 9\n4 0 1 2 3 3 1 3 2": [[0, 1, 2], [0, 2, 3], [1, 3, 2]],
    "2 3\nOFFSETS int\n0 3\nCONNECTIVITY int\n0 1 2": [[0, 1, 2]],
    "0 0\n": [],
    "1 4\n3 0 1 4": "triangles refer to points 0 to 4 of 4",
    "2 8\n3 0 1 2 4 1 3 2": "line 8: POLYGONS: the 8 entries are not 2 cells",
    "2 9\n3 0 1 2 3 1 3 2": "something that is not a number",
    "2 3\nOFFSETS int\n0 2\nCONNECTIVITY int\n0 1 2": "the offsets of the cells do not ascend from 0 to 3",
    "2 3\nOFFSETS int\n0 3\n0 1 2": "expected 'CONNECTIVITY type' of POLYGONS, found '0 1 2'",
}


@pytest.mark.parametrize("cells", CELLS, ids=range(len(CELLS)))
def test_polygons(tmp_path, cells):
    (tmp_path / "a.vtk").write_text(POLYGONS.format(cells=cells))
    if isinstance(CELLS[cells], list):
        assert read_displacement(tmp_path / "a.vtk").triangles.tolist() == CELLS[cells]
    else:
        with pytest.raises(FormatError, match=re.escape(CELLS[cells])):
            read_displacement(tmp_path / "a.vtk")


def unstructured(types="5", offsets="3", connectivity="0 1 2", n=3):
    words = {"types": ("UInt8", types), "offsets": ("Int64", offsets), "connectivity": ("Int64", connectivity)}
    cells = "".join(f'<DataArray type="{t}" Name="{n}" format="ascii">{w}</DataArray>' for n, (t, w) in words.items())
    points, moves = (
        f'<DataArray type="Float64" Name="{name}" NumberOfComponents="3" format="ascii">{" 0 1 2" * n}</DataArray>'
        for name in ("Points", "U")
    )
    return (
        '<VTKFile type="UnstructuredGrid" byte_order="LittleEndian"><UnstructuredGrid>'
        f'<Piece NumberOfPoints="{n}" NumberOfCells="1"><PointData>{moves}</PointData><Points>{points}</Points>'
        f"<Cells>{cells}</Cells></Piece></UnstructuredGrid></VTKFile>"
    )


FAN, STRIP = [[0, 1, 2], [0, 2, 3], [0, 3, 4]], [[0, 1, 2], [1, 2, 3], [2, 3, 4]]
KINDS = {3: (2, []), 5: (3, FAN[:1]), 22: (6, FAN[:1]), 34: (7, FAN[:1]), 9: (4, FAN[:2]), 23: (8, FAN[:2]),
         28: (9, FAN[:2]), 7: (5, FAN), 6: (5, STRIP), 10: (4, [])}  # fmt: skip


@pytest.mark.parametrize("kind", KINDS)
def test_cells_of_vtk_become_triangles_of_their_corners(tmp_path, kind):
    n, triangles = KINDS[kind]
    (tmp_path / "a.vtu").write_text(unstructured(kind, n, " ".join(map(str, range(n))), n))
    assert read_displacement(tmp_path / "a.vtu").triangles.tolist() == triangles


@pytest.mark.parametrize(("cell", "message"), [
    ({"types": "9"}, "has cells with fewer nodes than corners"), ({"types": "five"}, "cannot read"),
    ({"types": "99"}, "cells of type 99, which VTK does not have"), ({"offsets": "7"}, "cannot read|do not ascend"),
    ({"connectivity": "0 1 7"}, "triangles refer to points 0 to 7 of 3"),
])  # fmt: skip
def test_wrong_cells(tmp_path, capfd, cell, message):
    (tmp_path / "a.vtu").write_text(unstructured(**cell))
    with pytest.raises(FormatError, match=message):
        read_displacement(tmp_path / "a.vtu")
    assert capfd.readouterr() == ("", "")


OBJECT = np.array([{}], dtype=object)


@pytest.mark.parametrize(("arrays", "message"), [
    (np.zeros((3, 5)), r"holds float64 numbers of shape \(3, 5\); expected \(n, 6\) or \(n, 4\)"),
    (np.zeros((3, 4), dtype=complex), r"holds complex128 numbers of shape \(3, 4\); expected"),
    (OBJECT, "allow_pickle=False"),
    ({"points": POINTS, "shift": POINTS}, r"found points \(4, 3\), shift \(4, 3\)"),
    ({"points": POINTS, "displacement": POINTS[:3]}, "has 4 points but 3 displacements"),
    ({"points": POINTS[:0], "displacement": POINTS[:0]}, "has no points with displacements"),
    ({"points": POINTS, "displacement": POINTS, "triangles": [[0, 1, 9]]}, "triangles refer to points 0 to 9 of 4"),
    ({"points": POINTS, "displacement": OBJECT}, "allow_pickle=False"),
    ({"points": POINTS, "displacement": POINTS, "triangles": [[0.0, 1.5, 2.0]]}, "expected row numbers of points"),
])  # fmt: skip
def test_wrong_arrays(tmp_path, arrays, message):
    path = tmp_path / ("a.npz" if isinstance(arrays, dict) else "a.npy")
    np.savez(path, **arrays) if isinstance(arrays, dict) else np.save(path, arrays, allow_pickle=True)
    with pytest.raises(FormatError, match=message):
        read_displacement(path)


def test_wrong_hdf5(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["a/points"] = file["b/points"] = POINTS
        file["b/shift"] = POINTS
    with pytest.raises(FormatError, match=r"found /: none; /a: points \(4, 3\); /b: points \(4, 3\), shift \(4, 3\)"):
        read_displacement(tmp_path / "a.h5")
    with h5py.File(tmp_path / "a.h5", "a") as file:
        file["a/disp"] = file["b/disp"] = POINTS
    with pytest.raises(FormatError, match="has displacements in several groups, /a /b; expected one"):
        read_displacement(tmp_path / "a.h5")


def test_a_grid_with_two_displacements_of_a_node(tmp_path):
    blocks = [np.stack(np.meshgrid([b, b + 1.0], [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1) for b in (0, 1)]
    fields = tuple(Field("disp", "node", b, np.full((2, 2, 2, 3), float(b))) for b in (0, 1))
    grid = Grid.from_blocks(blocks, ["left", "right"], fields=fields)
    write_grid(grid, tmp_path / "a.vtm")
    with pytest.raises(FormatError, match=r"in left \(2, 1, 1\) and \(1, 1, 1\) in right \(1, 1, 1\)"):
        read_displacement(tmp_path / "a.vtm")
    bad = np.where(np.arange(16)[:, None] == 3, np.nan, grid.points)
    write_grid(dataclasses.replace(grid, points=bad), tmp_path / "a.vtm")
    with pytest.raises(GridError, match="not finite"):
        read_displacement(tmp_path / "a.vtm")


GMSH = """$MeshFormat
2.2 0 8
$EndMeshFormat
$Nodes
4
1 0 0 0
2 1 0 0
3 1 1 0
4 0 1 0
$EndNodes
$Elements
4
1 2 2 0 1 1 2 3
2 2 2 0 1 2 3 4
3 2 2 0 1 2 3 4
4 2 2 0 1 1 3 4
$EndElements
$NodeData
1
"displacement"
1
0.0
3
0
3
4
1 0 0 1
2 0 0 1
3 0 0 1
4 0 0 1
$EndNodeData
"""
NODES_4 = """$Nodes
1 4 1 4
2 1 0 4
1
2
3
4
0 0 0
1 0 0
1 1 0
0 1 0
$EndNodes
$Elements
1 1 1 1
2 1 2 1
1 1 2 3
$EndElements
"""


@pytest.mark.parametrize(("old", "new", "message"), [
    ("2 2 2 0 1 2 3 4", "2 2   0 1 2 3 4", "does not have the nodes of its type"),
    ("1 1 2 3", "1 1 2 0", "does not have the nodes of its type"),
    *(("3 1 1 0\n", f"{number} 1 1 0\n", "different whole numbers") for number in ("2.5", "2", "0")),
    ("3 0 0 1\n4", "4 0 0 1\n3", "in the order of \\$Nodes"), ("4 0 0 1\n", "", "reshape"),
    ("$EndNodeData", "$EndNodeData\n" + GMSH[GMSH.index("$NodeData") :], "have the same name"),
])  # fmt: skip
@pytest.mark.parametrize("version", [2, 4])
def test_what_meshio_would_misread_of_gmsh(tmp_path, old, new, message, version):
    if version == 4 and "type" in message:
        return
    path = tmp_path / "a.msh"
    text, change = GMSH, (old, new)
    if version == 4:
        text = GMSH[: GMSH.index("$Nodes")].replace("2.2", "4.1") + NODES_4 + GMSH[GMSH.index("$NodeData") :]
        change = tuple(re.sub(r"(\S+) 1 1 0\n", r"\1\n", each) for each in change)
    path.write_text(text)
    assert len(read_displacement(path).points) == 4
    path.write_text(text.replace(*change, 1))
    with pytest.raises(FormatError, match=message):
        read_displacement(path)


def test_binary_data_of_gmsh_out_of_order(tmp_path):
    for name in ("gmsh22", "gmsh"):
        surface(tmp_path / "a.msh", {"displacement": POINTS}, name)
        assert len(read_displacement(tmp_path / "a.msh").points) == 4
        data = (tmp_path / "a.msh").read_bytes()
        head, mark, rest = data.rpartition(b"$NodeData")
        swapped = rest.replace(struct.pack("i", 2), b"????").replace(struct.pack("i", 3), struct.pack("i", 2))
        (tmp_path / "a.msh").write_bytes(head + mark + swapped.replace(b"????", struct.pack("i", 3)))
        with pytest.raises(FormatError):
            read_displacement(tmp_path / "a.msh")


AVS = "4 2 3 0 0\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 1 1 0\n1 1 tri 1 2 3\n2 1 tri 2 4 3\n1 3\ndisplacement, m\n"


def test_a_surface_of_avs(tmp_path):
    (tmp_path / "a.avs").write_text(AVS + "4 0 0 4\n2 0 0 2\n3 0 0 3\n1 0 0 1\n")
    found = read_displacement(tmp_path / "a.avs")
    np.testing.assert_array_equal(found.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_array_equal(found.displacement, [[0, 0, n] for n in (1, 2, 3, 4)])
    assert found.triangles.tolist() == [[0, 1, 2], [1, 3, 2]]


BAD_AVS = [
    ("2 4 3", "2 4", "a cell does not have the corners of its type"),
    ("4 0 0 4\n", "", "not one row for each node"),
    ("4 0 0 4", "5 0 0 4", "not one row for each node"),
    ("4 0 0 4", "3 0 0 4", "not one row for each node"),
    ("4 1 1 0", "3 1 1 0", "not one row for each node"),
    ("4 0 0 4", "4 0 0", "not 3 values with different names in"),
    ("4 0 0 4", "4 0 0 4 5", "not 3 values with different"),
    ("1 3\nd", "3 1 1 1\na, m\na, m\nd", "different names in"),
    ("0 0 4\n", "0 0 4\n5 5\n6 6\n", "2 lines follow that its first line does not"),
    ("2 3 0 0", "x 3 0 0", "invalid literal"),
]


@pytest.mark.parametrize(("old", "new", "message"), BAD_AVS)
def test_what_meshio_would_misread_of_avs(tmp_path, old, new, message):
    (tmp_path / "a.avs").write_text((AVS + "1 0 0 1\n2 0 0 2\n3 0 0 3\n4 0 0 4\n").replace(old, new, 1))
    with pytest.raises(FormatError, match=f"cannot read .*a.avs as avsucd: .*{message}"):
        read_displacement(tmp_path / "a.avs")
