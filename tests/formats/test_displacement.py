"""Displacement tables in all their forms give the same surface data."""

import dataclasses

import h5py
import meshio
import numpy as np
import pytest
import vtk_witness
from hypothesis import Phase, given, settings
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


HEADERS = [
    "x,y,z,dx,dy,dz", "X,Y,Z,UX,UY,UZ", "coords_x,coords_y,coords_z,u_x,u_y,u_z", "x,y,z,Delta x,Delta y,Delta z",
    "X [mm],Y [mm],Z [mm],U1 [mm],U2 [mm],U3 [mm]", "X (m),Y (m),Z (m),U1 (tip),U2 (tip),U3 (tip)",
    "Points:0,Points:1,Points:2,displacement:0,displacement:1,displacement:2",
    "Points_0,Points_1,Points_2,Displacement_0,Displacement_1,Displacement_2",
    "CoordinateX,CoordinateY,CoordinateZ,DisplacementX,DisplacementY,DisplacementZ",
    "x-coordinate,y-coordinate,z-coordinate,x-displacement,y-displacement,z-displacement",
]  # fmt: skip


@settings(max_examples=100, deadline=None, phases=[Phase.generate])
@given(data=st.data())
def test_text_with_columns_by_order_or_name(tmp_path_factory, data):
    """Any separator, a header in the first line or in a comment, more columns, plane tables, quotation marks."""

    def pick(*choices):
        return data.draw(st.sampled_from(choices))

    place, separator = pick("none", "line", "comment"), pick(",", " , ", ";", " ", "\t")
    columns = pick([0, 1, 2, 3, 4, 5], [0, 1, 3, 4], [0, 1, 3] if place == "none" else [0, 1, 2, 3, 4])
    header, cells = ["six", "columns", "for", "you", "to", "read"], [[*map(repr, row)] for row in ROWS.tolist()]
    if place != "none":
        header = pick(*HEADERS).split(",")
        columns = data.draw(st.permutations(columns))
        if data.draw(st.booleans()):
            header, columns = [*header, "pressure"], [6, *columns]
            cells = [[*row, "0.5" if place == "comment" else "p1"] for row in cells]
    quote = pick("", '"')
    remark, end = pick("", " # here"), pick("\n", "\r\n")
    rows = [separator.join(quote + row[n] + quote for n in columns) + remark for row in cells]
    # Those in a comment may be separated by blanks, whatever separates the numbers.
    between = pick(separator, " ") if place == "comment" else separator
    names = [header[n] if between.strip() else header[n].replace(" ", "") for n in columns]
    first = between.join(quote + name + quote for name in names)
    lines = [first] if place == "line" else ["# " + first]
    noise = pick([], ["", "   ", "\t "], ["# hence, and so on", "  # x y z dx dy dz"])
    lines += [*(noise if place == "line" else []), rows[0], *noise, *rows[1:], *noise]
    path = tmp_path_factory.mktemp("text") / f"table{pick('.csv', '.CSV', '.txt', '.tsv', '.dat')}"
    path.write_text(pick("", "\ufeff") + end.join([*lines, ""]), encoding="utf-8", newline="")
    found = read_displacement(path)
    check(found, points=POINTS * [1, 1, 2 in columns], moves=MOVES * [n in columns for n in (3, 4, 5)])
    assert (found.label, found.plane) == (path.name, 4 in columns and 5 not in columns)
    assert found.numbered == (place == "none" and 5 not in columns)


def test_arrays(tmp_path):
    np.save(tmp_path / "a.npy", ROWS)
    check(read_displacement(tmp_path / "a.npy"))
    np.save(tmp_path / "a.npy", np.asfortranarray(ROWS.astype(">f8")))
    check(read_displacement(tmp_path / "a.npy"))
    np.savez(tmp_path / "a.npz", Points=POINTS, U=MOVES, triangles=[[0, 1, 2], [3, 3, 4]])
    check(read_displacement(tmp_path / "a.npz"), [(0, 1, 2)])
    np.savez_compressed(tmp_path / "a.npz", **dict(zip(("x", "y", "z", "dx", "dy", "dz"), ROWS.T, strict=True)))
    check(read_displacement(tmp_path / "a.npz"))
    # Few zeros may be compressed as much as they can be.
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((1000, 3)), displacement=np.zeros((1000, 3)))
    assert not read_displacement(tmp_path / "a.npz").displacement.any()


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


def test_a_surface_of_tecplot(tmp_path):
    """Text is tried as Tecplot when it says so."""
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
    shaped = moves[:12].reshape(2, 3, 2, 3), moves[12:].reshape(2, 2, 2, 3)
    fields = tuple(Field("Displacement", "node", b, shaped[b]) for b in (0, 1))
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
