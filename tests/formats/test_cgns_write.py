"""Writing a grid that came from CGNS: only the coordinates change, checked with h5py and cgnscheck."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from cgns_witness import (
    AdfWriter,
    N,
    assert_cgnscheck_finds_no_error,
    box,
    connectivity,
    differences,
    listing,
    one_to_one,
    periodic,
    tree,
    two_zones,
    words,
    write_hdf5,
    zone,
)

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, Grid
from meshdeform_formats import read_grid, write_grid

WING, AIRFOIL = "717_wl_L2.cgns", "nak_a_141.cgns"


def moved(grid: Grid) -> Grid:
    """Every node moved by a smooth function of its position: shared nodes stay shared."""
    x, y, z = grid.points.T
    return grid.moved(np.stack([x + 0.01 * y, 1.5 * y + 0.1 * x, z * np.pi], axis=1))


def full_file() -> N:
    """A file with much that is not coordinates: solutions in time, units, descriptors, unusual names."""
    units = N("DimensionalUnits", "DimensionalUnits_t", words("Kilogram", "Meter", "Second", "Kelvin", "Radian"))
    solution = N(
        "FlowSolution", "FlowSolution_t", None, [N("Density", "DataArray_t", np.arange(60.0).reshape(4, 3, 5))]
    )
    pointers = N("FlowSolutionPointers", "DataArray_t", words("FlowSolution"))
    iterative = N("ZoneIterativeData", "ZoneIterativeData_t", None, [pointers])
    motion = periodic([0, 0, 0], [0, 0, 0], [0, 2, 0])
    across = connectivity(one_to_one("per", "z 2", [[1, 1, 1], [4, 1, 5]], [[1, 3, 1], [4, 3, 5]], None, motion))
    first = zone("z 2", box(4, 3, 5), solution, iterative, across)
    second = zone("a", box(3, 3, 5, (3, 0, 0)), N("Ordinal", "Ordinal_t", np.array([7], np.int64)), dtype="f4")
    steps = N("BaseIterativeData", "BaseIterativeData_t", np.array([1], np.int32))
    state = N("Reference", "ReferenceState_t", None, [N("Note", "Descriptor_t", "free stream")])
    root = tree(first, second, more=[units, N("DataClass", "DataClass_t", "Dimensional"), steps, state])
    root.children.append(
        N("Other base", "CGNSBase_t", np.array([2, 2], np.int32), [zone("flat", box(3, 3, 1)[:, :, 0, :2])])
    )
    return root


@pytest.mark.parametrize(("packing", "track"), [({}, True), ({"compression": "gzip", "chunks": True}, False)])
def test_only_the_coordinates_change(tmp_path, packing, track):
    source = write_hdf5(tmp_path / "in.cgns", full_file(), dataset=packing, track=track)
    write_grid(read_grid(source), tmp_path / "out.cgns")
    assert listing(source) == listing(tmp_path / "out.cgns")
    grid = moved(read_grid(source))
    assert write_grid(grid, tmp_path / "out.cgns").label == "cgns (container=HDF5, precision=mixed), float32"
    others = differences(source, tmp_path / "out.cgns", lambda entry: entry[1] == " data" and "/Coordinate" in entry[0])
    assert others == []
    again = read_grid(tmp_path / "out.cgns")
    np.testing.assert_array_equal(again.block(0), grid.block(0))
    np.testing.assert_array_equal(again.block(1), grid.block(1).astype(np.float32))
    assert (again.names, again.patches, again.connections) == (grid.names, grid.patches, grid.connections)
    write_grid(grid, source)
    assert listing(source) == listing(tmp_path / "out.cgns")


@pytest.mark.parametrize("shared", ["CoordinateY", "CoordinateY/ data"])
@pytest.mark.parametrize("options", [{}, {"precision": "float32"}])
def test_coordinates_that_are_stored_once_for_two_zones(tmp_path, shared, options):
    """HDF5 can give an array several names; one written for two zones would hold the coordinates of the last one."""
    source = write_hdf5(tmp_path / "in.cgns", tree(zone("left", box(4, 3, 5)), zone("right", box(4, 3, 5))))
    with h5py.File(source, "r+") as file:
        left, right = (file[f"Base/{name}/GridCoordinates"] for name in ("left", "right"))
        del right[shared]
        right[shared] = left[shared]
    grid = read_grid(source)
    points = grid.points.copy()
    points[60:, 1] += np.arange(60.0)
    write_grid(grid.moved(points), tmp_path / "out.cgns", options)
    np.testing.assert_allclose(read_grid(tmp_path / "out.cgns").points, points, rtol=1e-6)


def test_cells_of_a_zone_of_one_plane_in_a_base_of_three_axes(tmp_path):
    grid = read_grid(write_hdf5(tmp_path / "in.cgns", tree(zone("thin", box(4, 3, 1)))))
    values = replace(grid, fields=(Field("skew", "cell", 0, np.ones((3, 2, 1))),))
    with pytest.raises(FormatError, match=r"thin is one plane of nodes .* neither cells nor faces for the cell .* 'sk"):
        write_grid(values, tmp_path / "out.cgns")
    assert not (tmp_path / "out.cgns").exists()
    values = replace(grid, fields=(Field("speed", "node", 0, np.ones((4, 3, 1))),))
    write_grid(values, tmp_path / "out.cgns")
    with h5py.File(tmp_path / "out.cgns") as file:
        assert file["Base/thin/FlowSolutionVertex/speed/ data"].shape == (1, 3, 4)


@pytest.mark.parametrize("precision", ["float32", "float64"])
@pytest.mark.parametrize("packing", [{}, {"compression": "gzip", "compression_opts": 7, "shuffle": True}])
def test_precision_on_request(tmp_path, precision, packing):
    source = write_hdf5(tmp_path / "in.cgns", full_file(), dataset=packing)
    grid = moved(read_grid(source))
    write_grid(grid, tmp_path / "out.cgns")
    written = write_grid(grid, tmp_path / "out.cgns", {"precision": precision})
    assert written.label == f"cgns (container=HDF5), {precision}"
    again = read_grid(tmp_path / "out.cgns")
    np.testing.assert_array_equal(again.points, grid.points.astype(precision))
    assert again.format == written
    with h5py.File(tmp_path / "out.cgns") as file:
        node = file["Base/z 2/GridCoordinates/CoordinateY"]
        assert node.attrs["type"] == {"float32": b"R4", "float64": b"R8"}[precision]
        assert node[" data"].compression == packing.get("compression")
        assert list(file["Base/z 2/GridCoordinates"]) == ["CoordinateX", "CoordinateY", "CoordinateZ"]


def test_rind_planes_and_bounding_box(tmp_path):
    whole = box(5, 4, 5)
    arrays = [N(f"Coordinate{'XYZ'[c]}", "DataArray_t", whole[..., c]) for c in range(3)]
    rind = N("Rind", "Rind_t", np.array([1, 0, 0, 1, 0, 0], np.int32))
    own = whole[1:, :3]
    bounds = np.stack([own.min(axis=(0, 1, 2)), own.max(axis=(0, 1, 2))], axis=1)
    inner = zone("z", own)
    coordinates = N("GridCoordinates", "GridCoordinates_t", bounds, [rind, *arrays])
    bounded = replace(inner, children=[inner["ZoneType"], coordinates])
    undeformed = read_grid(write_hdf5(tmp_path / "in.cgns", tree(zone("a", box(2, 2, 2, (9, 0, 0))), bounded)))
    grid = moved(undeformed)
    for precision in ("float64", "float32"):
        # The first copy has the bounds of the file; they are not those of the second.
        for level in (undeformed, grid):
            write_grid(level, tmp_path / "out.cgns", {"precision": precision})
        with h5py.File(tmp_path / "out.cgns") as file:
            group = file["Base/z/GridCoordinates"]
            stored = np.stack([group[f"Coordinate{c}/ data"][()].T for c in "XYZ"], axis=-1)
            box_stored = group[" data"][()]
        expected = whole.copy()
        expected[1:, :3] = own = grid.block(1)
        np.testing.assert_array_equal(stored, expected.astype(precision))
        np.testing.assert_array_equal(box_stored, [own.min(axis=(0, 1, 2)), own.max(axis=(0, 1, 2))])


def linked_case(folder: Path, write: Callable[[Path, N], Path]) -> Path:
    """A zone of its own, one whose coordinates are the first's, one whose coordinates lie in another file."""
    (folder / "mesh").mkdir()
    whole, other = zone("own", box(3, 3, 3)), "mesh/other.cgns"
    shortcut = N("shortcut", "", link=("", "/Base/far/ZoneType"))
    write(folder / other, tree(zone("far", box(3, 3, 3)), more=[shortcut]))
    links = {"inner": ("", "/Base/own/GridCoordinates"), "outer": (other, "/Base/far/GridCoordinates")}
    kind = N("ZoneType", "ZoneType_t", "Structured")
    linked = [
        replace(whole, name=name, children=[N("GridCoordinates", "", link=link), kind]) for name, link in links.items()
    ]
    more = [
        N("Note", "", link=(other, "/CGNSLibraryVersion")),
        N("Whole base", "", link=(other, "/Base")),
        N("ReferenceState", "", link=("no/such.cgns", "/Base")),
        N("Here", "", link=("", "/Base/own/ZoneType")),
    ]
    return write(folder / "in.cgns", tree(whole, *linked, more=more))


def test_links_survive_and_linked_coordinates_become_local(tmp_path):
    source = linked_case(tmp_path, write_hdf5)
    grid = read_grid(source)
    np.testing.assert_array_equal(grid.points, np.tile(box(3, 3, 3).reshape(-1, 3), (3, 1)))
    assert any("linked from another file" in note for note in grid.notes)
    points = grid.points + np.repeat([1.0, 2.0, 3.0], 27)[:, None]  # zones that shared coordinates part
    untouched = listing(source), listing(tmp_path / "mesh" / "other.cgns")
    (tmp_path / "results" / "deep").mkdir(parents=True)
    for out in (tmp_path / "out.cgns", tmp_path / "results" / "deep" / "out.cgns"):
        write_grid(grid.moved(points), out)
        np.testing.assert_array_equal(read_grid(out).points, points)
        with h5py.File(out) as file:
            assert list(file["Base"])[:3] == [" data", "own", "inner"]
            assert list(file["Base/inner"]) == [" data", "GridCoordinates", "ZoneType"]
            assert file["Base/outer/GridCoordinates"].attrs["type"] == b"MT"
            assert file["Base/outer/GridCoordinates"].attrs["label"] == b"GridCoordinates_t"
            assert " link" not in file["Base/outer/GridCoordinates"]
            link = file["Base/Note"].get(" link", getlink=True)
            assert file["Base/Note/ link"].attrs["name"] == b"CGNSLibraryVersion"
            assert file["Base/Note/ file"][()].tobytes().rstrip(b"\0").decode() == link.filename
            assert file["Base/ReferenceState"].get(" link", getlink=True).filename == "no/such.cgns"
            assert file["Base/Here"].get(" link", getlink=True).path == "/Base/own/ZoneType"
    assert (listing(source), listing(tmp_path / "mesh" / "other.cgns")) == untouched


@pytest.mark.parametrize("link", ["zones", "coordinates"])
def test_zones_and_coordinates_of_other_files(tmp_path, link):
    """As links of CGNS, and as plain ones of HDF5."""
    write_hdf5(tmp_path / "other.cgns", two_zones())
    untouched = listing(tmp_path / "other.cgns")
    links = [N(name, "", link=("other.cgns", f"/Base/{name}")) for name in ("right", "left")]
    source = write_hdf5(tmp_path / "in.cgns", tree(*links) if link == "zones" else two_zones())
    if link == "coordinates":
        with h5py.File(source, "r+") as file:
            del file["Base/left/GridCoordinates"]
            file["Base/left/GridCoordinates"] = h5py.ExternalLink("other.cgns", "/Base/left/GridCoordinates")
    grid = moved(read_grid(source))
    assert grid.names == (("right", "left") if link == "zones" else ("left", "right"))
    write_grid(grid, tmp_path / "out.cgns")
    assert listing(tmp_path / "other.cgns") == untouched
    (tmp_path / "other.cgns").unlink()
    again = read_grid(tmp_path / "out.cgns")
    np.testing.assert_array_equal(again.points, grid.points)
    assert (again.names, again.patches, again.connections) == (grid.names, grid.patches, grid.connections)


def test_coordinates_in_a_virtual_dataset_are_refused(tmp_path):
    """Writing them would change the other file."""
    write_hdf5(tmp_path / "other.cgns", two_zones())
    source = write_hdf5(tmp_path / "in.cgns", two_zones())
    with h5py.File(source, "r+") as file:
        group = file["Base/left/GridCoordinates/CoordinateX"]
        layout = h5py.VirtualLayout(group[" data"].shape, "f8")
        layout[...] = h5py.VirtualSource(str(tmp_path / "other.cgns"), group.name + "/ data", group[" data"].shape)
        del group[" data"]
        group.create_virtual_dataset(" data", layout)
    with pytest.raises(FormatError, match="lie in other files"):
        read_grid(source)


@pytest.mark.parametrize("version", ["A02011", "A01xxx", "B02012"])
def test_links_of_adf_files(tmp_path, version):
    """HDF5 cannot follow links into ADF files: they are resolved, links inside the file stay."""
    source = linked_case(tmp_path, AdfWriter(version, chunks=3).write)
    (tmp_path / "results").mkdir()
    np.testing.assert_array_equal(read_grid(source).points, np.tile(box(3, 3, 3).reshape(-1, 3), (3, 1)))
    grid = moved(read_grid(source))
    write_grid(grid, tmp_path / "results" / "out.cgns")
    np.testing.assert_array_equal(read_grid(tmp_path / "results" / "out.cgns").points, grid.points)
    with h5py.File(tmp_path / "results" / "out.cgns") as file:
        far = file["Base/Whole base/far/GridCoordinates/CoordinateX/ data"][()].T
        np.testing.assert_array_equal(far, box(3, 3, 3)[..., 0])
        assert file["Base/Whole base/shortcut/ data"][()].tobytes() == b"Structured"
        assert file["Base/ReferenceState"].get(" link", getlink=True).filename == "no/such.cgns"
        assert file["Base/Here"].get(" link", getlink=True).path == "/Base/own/ZoneType"


def test_files_linked_in_a_circle(tmp_path):
    inner = tree(zone("z", box(3, 3, 3)), more=[N("back", "", link=("a.adf", "/Base"))])
    outer = tree(zone("z", box(3, 3, 3)), more=[N("there", "", link=("b.adf", "/Base"))])
    AdfWriter().write(tmp_path / "b.adf", inner)
    source = AdfWriter().write(tmp_path / "a.adf", outer)
    with pytest.raises(FormatError, match=r"nested more than 64 deep .* a link forms a loop"):
        write_grid(read_grid(source), tmp_path / "out.cgns")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.adf", "b.adf"]


@pytest.mark.parametrize(("version", "order", "chunks"), [("A02011", "<", 1), ("A02011", ">", 3), ("B02012", ">", 2)])
def test_adf_becomes_hdf5_as_the_witness_writes_it(tmp_path, version, order, chunks):
    grid = read_grid(AdfWriter(version, order, chunks).write(tmp_path / "in.adf", full_file()))
    write_grid(grid, tmp_path / "out.cgns")
    known = write_hdf5(tmp_path / "known.cgns", full_file())
    assert differences(known, tmp_path / "out.cgns", lambda entry: entry[1] == " hdf5version") == []
    assert_cgnscheck_finds_no_error(tmp_path / "out.cgns")


def test_source_that_is_gone_or_changed(tmp_path):
    source = write_hdf5(tmp_path / "in.cgns", two_zones())
    grid = read_grid(source)
    write_grid(grid, tmp_path / "out.cgns")
    (tmp_path / "out.cgns").unlink()
    write_hdf5(source, tree(zone("left", box(4, 3, 5)), zone("right", box(4, 3, 5))))
    with pytest.raises(FormatError, match=r"in\.cgns has changed since .*: its zones are now left \(4, 3, 5\)"):
        write_grid(grid, tmp_path / "out.cgns")
    source.unlink()
    with pytest.raises(FormatError, match="no longer exists"):
        write_grid(grid, tmp_path / "out.cgns")
    assert list(tmp_path.iterdir()) == []
