"""Displacement tables in all their forms give the same surface data."""

import dataclasses

import h5py
import meshio
import numpy as np
import pytest
import vtk_witness
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as npst
from vtkmodules.vtkCommonCore import vtkPoints
from vtkmodules.vtkCommonDataModel import vtkCellArray, vtkPolyData
from vtkmodules.vtkIOLegacy import vtkPolyDataWriter
from vtkmodules.vtkIOXML import vtkXMLPolyDataWriter

from meshdeform_core.boundary.tables import SurfaceData
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import write_grid
from meshdeform_formats.displacement import read_displacement, write_displacement

RNG = np.random.default_rng(0)
POINTS, MOVES = RNG.normal(size=(8, 3)), RNG.normal(size=(8, 3))
ROWS = np.hstack([POINTS, MOVES])


def check(data, triangles=(), points=POINTS, moves=MOVES):
    assert isinstance(data, SurfaceData)
    for found, expected in ((data.points, points), (data.displacement, moves)):
        np.testing.assert_array_equal(found, expected)
        assert found.dtype == np.float64
        assert found.flags.c_contiguous
    assert data.triangles.dtype == np.int64
    assert data.triangles.shape[1] == 3
    assert {tuple(sorted(t)) for t in data.triangles.tolist()} == {tuple(sorted(t)) for t in triangles}


def text(rows, separator):
    return "".join(separator.join(map(repr, row)) + "\n" for row in rows.tolist())


@pytest.mark.parametrize(
    ("separator", "header", "suffix"),
    [(",", "", ".csv"), (", ", "x y z dx dy dz\n", ".CSV"), (";", "# by hand\n\n", ".txt"), ("\t", "", ".tsv"),
     (" ", "x y z dx dy dz\n", ".dat"), ("   ", "", ".dat")],
)  # fmt: skip
def test_text_by_order(tmp_path, separator, header, suffix):
    path = tmp_path / f"table{suffix}"
    path.write_text(header + text(ROWS, separator))
    check(read_displacement(path))
    assert read_displacement(path).label == f"table{suffix}"
    assert not read_displacement(path).plane


HEADERS = [
    "x,y,z,dx,dy,dz",
    "X,Y,Z,UX,UY,UZ",
    "X [mm],Y [mm],Z [mm],U1 [mm],U2 [mm],U3 [mm]",
    "X (m),Y (m),Z (m),U1 (tip),U2 (tip),U3 (tip)",
    '"Points:0","Points:1","Points:2","displacement:0","displacement:1","displacement:2"',
    "Points_0,Points_1,Points_2,Displacement_0,Displacement_1,Displacement_2",
    "CoordinateX,CoordinateY,CoordinateZ,DisplacementX,DisplacementY,DisplacementZ",
    "x-coordinate,y-coordinate,z-coordinate,x-displacement,y-displacement,z-displacement",
    "coords_x,coords_y,coords_z,u_x,u_y,u_z",
    "x,y,z,Delta x,Delta y,Delta z",
]


@pytest.mark.parametrize("header", HEADERS)
@pytest.mark.parametrize("order", [[0, 1, 2, 3, 4, 5], [4, 2, 0, 5, 1, 3]])
def test_columns_by_name(tmp_path, header, order):
    names = header.split(",")
    path = tmp_path / "a.csv"
    path.write_text(",".join(names[i] for i in order) + "\r\n" + text(ROWS[:, order], ",").replace("\n", "\r\n"))
    check(read_displacement(path))


def test_other_columns_and_comments_do_not_matter(tmp_path):
    rows = "".join(f"p{i},{x!r},{y!r},{z!r},{a!r},0.5,{b!r},{c!r} # here\n" for i, (x, y, z, a, b, c) in
                   enumerate(ROWS.tolist()))  # fmt: skip
    (tmp_path / "a.csv").write_text("\ufeffname,x,y,z,dx,pressure,dy,dz\n# units: m\n\n" + rows, encoding="utf-8")
    check(read_displacement(tmp_path / "a.csv"))


@pytest.mark.parametrize("separator", [",", ";", " "])
def test_blank_lines_and_quoted_numbers(tmp_path, separator):
    """Lines of blanks, indented comments, and numbers in quotation marks, as spreadsheets write them."""
    rows = ["", "x y z dx dy dz", "   ", "1 2 3 4 5 6", "\t ", "  # hence", '"2" "2" "3" "4" "5" "6.5"', "  "]
    (tmp_path / "a.csv").write_text(
        "\n".join(row.replace(" ", separator) if "x" in row or "2" in row else row for row in rows)
    )
    table = read_displacement(tmp_path / "a.csv")
    np.testing.assert_array_equal(table.points, [[1, 2, 3], [2, 2, 3]])
    np.testing.assert_array_equal(table.displacement, [[4, 5, 6], [4, 5, 6.5]])


def test_a_header_in_a_comment(tmp_path):
    np.savetxt(tmp_path / "a.txt", ROWS[:, [3, 4, 5, 0, 1, 2]], fmt="%.17g", header="dx dy dz x y z")
    check(read_displacement(tmp_path / "a.txt"))
    np.savetxt(tmp_path / "a.txt", ROWS, fmt="%.17g", header="six columns of numbers for you")
    check(read_displacement(tmp_path / "a.txt"))


@pytest.mark.parametrize(
    ("header", "columns"), [("", [0, 1, 3, 4]), ("x,y,dx,dy\n", [0, 1, 3, 4]), ("x,y,z,dx,dy\n", [0, 1, 2, 3, 4])]
)
def test_plane_text(tmp_path, header, columns):
    (tmp_path / "a.csv").write_text(header + text(ROWS[:, columns], ","))
    data = read_displacement(tmp_path / "a.csv")
    check(data, points=POINTS * [1, 1, 2 in columns], moves=MOVES * [1, 1, 0])
    assert data.plane


def test_arrays(tmp_path):
    np.save(tmp_path / "a.npy", ROWS)
    check(read_displacement(tmp_path / "a.npy"))
    np.save(tmp_path / "a.npy", np.asfortranarray(ROWS.astype(">f8")))
    check(read_displacement(tmp_path / "a.npy"))
    np.savez(tmp_path / "a.npz", Points=POINTS, U=MOVES, triangles=[[0, 1, 2], [3, 3, 4]])
    check(read_displacement(tmp_path / "a.npz"), [(0, 1, 2)])
    np.savez_compressed(tmp_path / "a.npz", **dict(zip(("x", "y", "z", "dx", "dy", "dz"), ROWS.T, strict=True)))
    check(read_displacement(tmp_path / "a.npz"))


@pytest.mark.parametrize("group", ["", "step/"])
def test_hdf5(tmp_path, group):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file[f"{group}coordinates"], file[f"{group}Displacement"] = POINTS, MOVES
        file["other/time"] = 0.5
        file.attrs["title"] = "x"
    check(read_displacement(tmp_path / "a.h5"))


CELLS = [("triangle", [[0, 1, 2], [5, 6, 7]]), ("quad", [[1, 2, 3, 4]]), ("line", [[0, 5]])]
TRIANGLES = [(0, 1, 2), (5, 6, 7), (1, 2, 3), (1, 3, 4)]


@pytest.mark.parametrize("suffix", [".vtu", ".vtk", ".xdmf", ".med", ".msh"])
@pytest.mark.parametrize("name", ["Displacement", "U", "anything"])
def test_surfaces_of_meshio(tmp_path, suffix, name):
    data = {name: MOVES, "pressure": MOVES[:, 0].copy()}
    if name != "anything":
        data["Velocity"] = 2 * MOVES
    kind = "gmsh22" if suffix == ".msh" else suffix[1:]
    meshio.Mesh(POINTS, CELLS, data).write(tmp_path / f"a{suffix}", file_format=kind)
    check(read_displacement(tmp_path / f"a{suffix}"), TRIANGLES)


def test_components_as_scalars(tmp_path):
    data = {f"displacement_{axis}": MOVES[:, i].copy() for i, axis in enumerate("xyz")}
    meshio.Mesh(POINTS, CELLS[:1], data).write(tmp_path / "a.vtu")
    check(read_displacement(tmp_path / "a.vtu"), TRIANGLES[:2])
    # Text is tried as Tecplot when it says so.
    meshio.Mesh(POINTS, CELLS[:1], {"displacement": MOVES}).write(tmp_path / "a.dat", file_format="tecplot")
    check(read_displacement(tmp_path / "a.dat"), TRIANGLES[:2])


def cell_array(*cells):
    array = vtkCellArray()
    for cell in cells:
        array.InsertNextCell(len(cell), cell)
    return array


@pytest.fixture
def polydata():
    surface = vtkPolyData()
    nodes = vtkPoints()
    nodes.SetData(vtk_witness.numpy_to_vtk(POINTS, deep=True))
    surface.SetPoints(nodes)
    surface.SetPolys(cell_array([0, 1, 2], [1, 2, 3, 4], [0, 2, 4, 6, 7]))
    surface.SetStrips(cell_array([3, 4, 5, 6]))
    surface.SetLines(cell_array([0, 1]))
    surface.SetVerts(cell_array([6]))
    vtk_witness.add_array(surface.GetPointData(), "disp", MOVES)
    vtk_witness.add_array(surface.GetPointData(), "normals", MOVES)
    vtk_witness.add_array(surface.GetCellData(), "displacement", np.zeros((6, 3)))
    return surface


POLYGONS = [(0, 1, 2), (1, 2, 3), (1, 3, 4), (0, 2, 4), (0, 4, 6), (0, 6, 7), (3, 4, 5), (4, 5, 6)]


def written(writer, surface, path):
    writer.SetInputData(surface)
    writer.SetFileName(str(path))
    assert writer.Write()
    return read_displacement(path)


@pytest.mark.parametrize("compression", [0, 1])
@pytest.mark.parametrize("mode", [0, 1, 2])
def test_vtp(tmp_path, polydata, compression, mode):
    writer = vtkXMLPolyDataWriter()
    writer.SetCompressorType(compression)
    writer.SetDataMode(mode)
    check(written(writer, polydata, tmp_path / "a.vtp"), POLYGONS)


@pytest.mark.parametrize("version", [42, 51])
def test_legacy_polydata(tmp_path, polydata, version):
    writer = vtkPolyDataWriter()
    writer.SetFileVersion(version)
    writer.SetFileTypeToBinary()
    check(written(writer, polydata, tmp_path / "a.vtk"), POLYGONS)
    for clear in (polydata.SetPolys, polydata.SetStrips, polydata.SetLines, polydata.SetVerts):
        clear(None)
    check(written(writer, polydata, tmp_path / "a.vtk"))
    check(written(vtkXMLPolyDataWriter(), polydata, tmp_path / "a.vtp"))


GRID = Grid.from_blocks([RNG.normal(size=(2, 3, 2, 3)), RNG.normal(size=(2, 2, 2, 3))])


def test_a_structured_grid_with_displacement_is_a_table(tmp_path):
    moves = RNG.normal(size=(20, 3))
    fields = (
        Field("Displacement", "node", 0, moves[:12].reshape(2, 3, 2, 3)),
        Field("Displacement", "node", 1, moves[12:].reshape(2, 2, 2, 3)),
    )
    write_grid(dataclasses.replace(GRID, fields=fields), tmp_path / "a.vtm")
    data = read_displacement(tmp_path / "a.vtm")
    np.testing.assert_array_equal(data.points, GRID.points)
    np.testing.assert_array_equal(data.displacement, moves)
    # Two triangles for each of 10 and 6 face quads.
    assert data.triangles.shape == (32, 3)
    # Without displacements in all blocks a grid is the deformed position.
    for name in ("a.vtm", "a.xyz", "a.cgns"):
        write_grid(dataclasses.replace(GRID, fields=fields[:1] if name == "a.vtm" else ()), tmp_path / name)
        grid = read_displacement(tmp_path / name)
        assert isinstance(grid, Grid)
        np.testing.assert_array_equal(grid.points, GRID.points)


def test_a_structured_surface_with_components(tmp_path):
    x, y = np.meshgrid([0.0, 1.0, 2.0], [0.0, 1.0], indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1)[:, :, None]
    fields = tuple(Field(f"disp_{axis}", "node", 0, points[..., i] + i) for i, axis in enumerate("xyz"))
    write_grid(Grid.from_blocks([points], fields=fields), tmp_path / "a.vtk")
    data = read_displacement(tmp_path / "a.vtk")
    np.testing.assert_array_equal(data.displacement, data.points + np.arange(3))
    corners = data.points[data.triangles]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    assert area.tolist() == [0.5] * 4


finite = st.floats(-1e99, 1e99)


@settings(max_examples=15, deadline=None)
@given(rows=npst.arrays(float, st.tuples(st.integers(1, 6), st.just(6)), elements=finite, fill=st.nothing()))
@pytest.mark.parametrize("suffix", [".csv", ".npz"])
def test_write_and_read(tmp_path_factory, suffix, rows):
    # Points that differ by rounding are one point.
    places = np.round(rows[:, :3] / max(np.abs(rows[:, :3]).max(), 1e-300) / 1e-13)
    rows = rows[np.unique(places, axis=0, return_index=True)[1]]
    triangles = np.array([[0, 0, 0]]) if len(rows) < 3 else np.array([[0, 1, 2]])
    data = SurfaceData(rows[:, :3], rows[:, 3:], triangles, "memory")
    path = tmp_path_factory.mktemp("table") / f"a{suffix}"
    write_displacement(path, data)
    again = read_displacement(path)
    np.testing.assert_array_equal(again.points, data.points)
    np.testing.assert_array_equal(again.displacement, data.displacement)
    assert len(again.triangles) == (suffix == ".npz" and len(rows) >= 3)
