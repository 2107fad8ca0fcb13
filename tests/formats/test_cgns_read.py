"""Reading CGNS: third-party grids against their oracle, everything else against files of an independent writer."""

import itertools

import h5py
import numpy as np
import pytest
from cgns_witness import (
    AdfWriter,
    N,
    bc,
    box,
    connectivity,
    one_to_one,
    periodic,
    tree,
    two_zones,
    words,
    write_hdf5,
    zone,
    zone_bc,
)
from h5py import h5d, h5p, h5s, h5t
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Connection, Side, Window
from meshdeform_formats import read_grid, write_grid
from meshdeform_formats.cgns.boundary import windows_of_nodes
from meshdeform_formats.cgns.zone import opened_cgns


@pytest.mark.parametrize("before", [0, 512, 1024, 8192])
def test_two_zones(tmp_path, before):
    """Also behind a user block of HDF5."""
    path = write_hdf5(tmp_path / "grid.cgns", two_zones())
    path.write_bytes(bytes(before) + path.read_bytes())
    grid = read_grid(path)
    assert grid.names == ("left", "right")
    assert grid.shapes == ((4, 3, 5), (3, 3, 5))
    np.testing.assert_array_equal(grid.block(0), box(4, 3, 5))
    assert [(p.name, p.family, p.bc_type) for p in grid.patches] == [
        ("body", "Wing", "BCWallViscous"),
        ("top", "Base/Wing", "BCWall"),  # FamilySpecified: what the family says
        ("body", "", "BCFarfield"),
    ]
    assert grid.patches[1].windows == (Window(0, Side.KMAX, (0, 0), (3, 2)),)
    right, left = grid.connections
    assert right == Connection("to right", 0, (3, 0, 0), (3, 2, 4), 1, (0, 0, 0), (0, 2, 4), (1, 2, 3))
    assert left.donor_block == 0  # donor "Base/left"
    assert left.transform == (1, 2, 3)  # no Transform


@pytest.mark.parametrize("track", [True, False])
def test_zones_come_in_file_order(tmp_path, track):
    names = ["zone 10", "b", "zone 2", "a"]
    root = tree(*(zone(name, box(2, 2, 2)) for name in names))
    assert read_grid(write_hdf5(tmp_path / "grid.cgns", root, track=track)).names == tuple(names)
    assert read_grid(AdfWriter().write(tmp_path / "grid.adf", root)).names == tuple(names)


@pytest.mark.parametrize("physical", [2, 3])
def test_bases_of_two_index_axes(tmp_path, physical):
    points = box(4, 3, 1)[:, :, 0, :physical]
    flat = zone(
        "flat",
        points,
        zone_bc(
            bc("wall", "BCWall", [[1, 1], [4, 1]]),
            bc("out", "BCOutflow", [[4, 1], [4, 2], [4, 3]], point_set="PointList"),
        ),
        connectivity(one_to_one("cut", "flat", [[1, 1], [1, 3]], [[4, 3], [4, 1]], [1, -2])),
    )
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(flat, cell=2, physical=physical)))
    assert grid.dimension == 2
    assert grid.shapes == ((4, 3, 1),)
    np.testing.assert_array_equal(grid.block(0)[:, :, 0, :physical], points)
    assert physical == 3 or not grid.points[:, 2].any()
    write_grid(grid, tmp_path / "flat.cgns")
    if physical == 2:
        with pytest.raises(FormatError, match=r"only x and y \(physical dimension 2\), but nodes have moved out of"):
            write_grid(grid.moved(grid.points - [0, 0, 1e-9]), tmp_path / "bent.cgns")
    assert [patch.windows for patch in grid.patches] == [
        (Window(0, Side.JMIN, (0, 0), (3, 0)),),
        (Window(0, Side.IMAX, (0, 0), (2, 0)),),
    ]
    assert grid.connections == (Connection("cut", 0, (0, 0, 0), (0, 2, 0), 0, (3, 2, 0), (3, 0, 0), (1, -2, 3)),)


def located(location: str) -> N:
    return N("GridLocation", "GridLocation_t", location)


@pytest.mark.parametrize("shape", [(4, 3, 5), (4, 3, 2), (4, 5, 1), (2, 5, 1)])
@pytest.mark.parametrize("location", ["Vertex", "FaceCenter", "own", "Element"])
@pytest.mark.parametrize("form", ["Range", "List"])
def test_rectangles_on_all_sides_by_nodes_or_faces_as_ranges_or_lists(tmp_path, form, location, shape):
    """Also of zones of one layer of cells, whose faces all have the index 1 across it, and of those in the plane."""
    axes, windows, conditions = 3 - (shape[2] == 1), [], []
    for side in (side for side in Side if side.axis < axes):
        last = [shape[axis] - 1 for axis in side.tangential]
        low = [int(n == 4) for n in last]
        windows.append((Window(0, side, (low[0], low[1]), (last[0], last[1])),))
        spans = {side.axis: [side.layer(shape)]}
        for axis, first, end in zip(side.tangential, low, last, strict=True):
            spans[axis] = range(first, end + 1) if location == "Vertex" else range(first, max(end, 1))
        points = np.array(list(itertools.product(*(spans[axis] for axis in range(3)))))[:, :axes] + 1
        listed = [points[-1], points[0]] if form == "Range" else points
        word = {"own": "IJK"[side.axis] + "FaceCenter", "FaceCenter": (None, None, "EdgeCenter", "FaceCenter")[axes]}
        at = [] if location == "Element" else [located(word.get(location, location))]
        kind = "Element" if location == "Element" else "Point"
        conditions.append(bc(side.label, "BCWall", listed, *at, point_set=kind + form))
    points = box(*shape) if axes == 3 else box(*shape)[:, :, 0]
    root = tree(zone("z", points, zone_bc(*conditions)), cell=axes)
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    assert [patch.windows for patch in grid.patches] == windows
    assert grid.notes == ()


@pytest.mark.parametrize(
    ("condition", "note"),
    [
        (bc("odd", "BCWall", [[1, 1, 1], [1, 1, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[2, 1, 1], [2, 3, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[1, 1, 1], [4, 3, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[2, 2, 2]], point_set="PointList"), "cover no part"),
        (bc("odd", "BCWall", [[1, 1, 1], [1, 1, 4]], located("FaceCenter")), "cover no part"),
        (bc("odd", "BCWall", [[1, 1, 1], [1, 2, 4]], located("CellCenter")), "located at CellCenter are not used"),
        (N("odd", "BC_t", "BCWall"), "without a point set are not used: z/odd"),
    ],
)
def test_conditions_that_are_no_faces_are_noted(tmp_path, condition, note):
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(zone("z", box(4, 3, 5), zone_bc(condition)))))
    assert grid.patches == ()
    assert any(note in line for line in grid.notes)


def test_points_left_over_are_noted(tmp_path):
    nodes = [*(np.argwhere(np.ones((4, 3, 1))) + 1).tolist(), [2, 2, 2], [1, 1, 2]]
    condition = bc("wall", "BCWall", nodes, point_set="PointList")
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(zone("z", box(4, 3, 5), zone_bc(condition)))))
    assert len(grid.patches) == 1
    assert grid.notes == ("listed points that belong to no part of a block face are not used: z/wall (2)",)


def test_additional_family_names(tmp_path):
    latin = np.frombuffer("Flügel".encode("latin-1"), np.int8)
    names = [N("FamilyName", "FamilyName_t", latin), N("Other", "AdditionalFamilyName_t", "b")]
    conditions = [bc(f"bc{n}", "BCWall", [[1, 1, 1], [1, 2, 2]], *names[n:]) for n in range(2)]
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(zone("z", box(2, 2, 2), zone_bc(*conditions)))))
    assert [patch.family for patch in grid.patches] == ["Flügel", "b"]


def sector(angle: float) -> np.ndarray:
    """A sector of a disk about the x axis, from 0 to ``angle`` degrees along k."""
    axes = np.linspace(0, 1, 3), np.linspace(0, 2, 3), np.radians(np.linspace(0, angle, 4))
    x, r, phi = np.meshgrid(*axes, indexing="ij")
    return np.stack([x, r * np.cos(phi), r * np.sin(phi)], axis=-1)


def degrees(word: str) -> N:
    return N("DimensionalUnits", "DimensionalUnits_t", words("Kilogram", "Null", "Second", "Kelvin", word))


@pytest.mark.parametrize(
    ("stored", "inner", "base", "noted"),
    [
        (5.0, "Degree", None, None),
        (5.0, None, "Degree", None),
        (np.radians(5.0), "Radian", "Degree", None),
        (np.radians(5.0), None, None, "radians"),
        (5.0, None, None, "degrees"),
        (5.0, "Null", None, "degrees"),
    ],
)
def test_periodic_angles_are_degrees_whatever_their_unit(tmp_path, stored, inner, base, noted):
    motion = periodic([0, 0, 0], [stored, 0, 0], [0, 0, 0], *([degrees(inner)] if inner else []))
    sides = connectivity(one_to_one("to kmax", "z", [[1, 1, 1], [3, 3, 1]], [[1, 1, 4], [3, 3, 4]], None, motion))
    root = tree(zone("z", sector(5.0), sides), more=[degrees(base)] if base else [])
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    found = grid.connections[0].periodic
    assert found.rotation_angle == pytest.approx((5.0, 0.0, 0.0), rel=1e-6)
    assert (found.rotation_center, found.translation) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    said = f"periodic angles without a unit are read as {noted}, which matches the coordinates: to kmax"
    assert grid.notes == ((said,) if noted else ())


@pytest.mark.parametrize(
    ("own", "donor", "transform", "name"),
    [
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 4]], [1, 2, 3], "right"),
        ([[4, 1, 1], [4, 3, 6]], [[1, 1, 1], [1, 3, 6]], [1, 2, 3], "right"),
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 1, 3], "right"),
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 2, 3], "elsewhere"),
    ],
)
def test_connections_that_do_not_fit_are_noted(tmp_path, own, donor, transform, name):
    wrong = connectivity(one_to_one("wrong", name, own, donor, transform))
    root = tree(zone("left", box(4, 3, 5), wrong), zone("right", box(3, 3, 5, (3, 0, 0))))
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    assert grid.connections == ()
    assert grid.notes == ("connections that do not match their zones are not used: left/wrong",)


def test_what_else_a_file_holds_is_noted(tmp_path):
    units = N("DimensionalUnits", "DimensionalUnits_t", words("Kilogram", "Millimeter", "Second", "Kelvin", "Degree"))
    first = zone("z", box(3, 3, 3), N("GridCoordinates#2", "GridCoordinates_t"))
    first["GridCoordinates/CoordinateY"].children.append(N("DataConversion", "DataConversion_t", np.array([2.0, 1.0])))
    root = tree(first, more=[units])
    root.children.append(N("Second", "CGNSBase_t", np.array([3, 3], np.int32)))
    notes = read_grid(write_hdf5(tmp_path / "grid.cgns", root)).notes
    assert "the length unit in the file is: Millimeter" in notes
    assert any("DataConversion" in note and "z/CoordinateY" in note for note in notes)
    assert any("additional grids" in note and "z/GridCoordinates#2" in note for note in notes)
    assert any("the grid is the base Base" in note and "Second" in note for note in notes)


@pytest.mark.parametrize("kind", ["variable length", "characters", "blank padded"])
def test_attributes_of_other_writers(tmp_path, kind):
    path = write_hdf5(tmp_path / "grid.cgns", two_zones())

    def rewrite(name: str, node: h5py.Group | h5py.Dataset) -> None:
        for key in ("name", "label", "type") if isinstance(node, h5py.Group) else ():
            text = node.attrs[key].decode()
            del node.attrs[key]
            if kind == "variable length":
                node.attrs[key] = text
            elif kind == "characters":
                node.attrs[key] = np.frombuffer(text.encode().ljust(33, b"\0"), "S1")
            else:
                node.attrs[key] = np.bytes_(text.ljust(33))

    with h5py.File(path, "r+") as file:
        file.visititems(rewrite)
    grid = read_grid(path)
    assert grid.names == ("left", "right")
    write_grid(grid, tmp_path / "out.cgns")
    np.testing.assert_array_equal(read_grid(tmp_path / "out.cgns").points, grid.points)


def odd_arrays():
    """Types of numbers and creation properties by which six values are stored."""
    short, shifted = h5t.STD_I32LE.copy(), h5t.STD_I32LE.copy()
    short.set_precision(16)
    shifted.set_precision(16)
    shifted.set_offset(8)
    compact, early, pieces = (h5p.create(h5p.DATASET_CREATE) for _ in range(3))
    compact.set_layout(h5d.COMPACT)
    early.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    pieces.set_chunk((1, 3))
    kinds = (h5t.IEEE_F64BE, None), (short, None), (shifted, None), (h5t.STD_I64LE, None), (h5t.IEEE_F64LE, compact)
    return *kinds, (h5t.IEEE_F64LE, early), (h5t.IEEE_F64LE, pieces)


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
def test_odd_arrays_have_the_values_that_h5py_finds(tmp_path, oldest):
    path = tmp_path / "odd.cgns"
    with h5py.File(path, "w", track_order=True, libver=(oldest, "v108")) as file:
        for number, (kind, layout) in enumerate(odd_arrays()):
            group = file.create_group(f"n{number}", track_order=True)
            group.attrs["label"], group.attrs["type"] = np.array(b"DataArray_t", "S33"), np.array(b"R8", "S3")
            stored = h5d.create(group.id, b" data", kind, h5s.create_simple((2, 3)), layout)
            stored.write(h5s.ALL, h5s.ALL, np.arange(6.0).reshape(2, 3))
    with opened_cgns(path) as root:
        assert len(root.children) == 7
        for node in root.children:
            node.require_stored()
            np.testing.assert_array_equal(node.data(), np.arange(6).reshape(2, 3).T)
            if (place := node.place()) is not None:
                raw = np.fromfile(path, node.dtype, 6, offset=place)
                np.testing.assert_array_equal(raw, np.arange(6))
        assert [node.place() is not None for node in root.children] == [True, False, False, True, False, True, False]


def quads_of(window: Window, shape: tuple[int, int, int]) -> set[tuple[int, int, int]]:
    """Quads of a window as (side, a, b); across the plane of a 2-D block there is one."""
    a, b = window.side.tangential
    spans = [
        range(low, high) if shape[axis] > 1 else range(1)
        for axis, low, high in zip((a, b), window.low, window.high, strict=True)
    ]
    return {(int(window.side), i, j) for i in spans[0] for j in spans[1]}


@pytest.mark.parametrize("shape", [(4, 3, 5), (2, 3, 4), (4, 5, 1)])
@settings(max_examples=25)
@given(data=st.data())
def test_nodes_give_the_quads_whose_corners_are_all_listed(shape, data):
    member = data.draw(arrays(bool, shape))
    nodes = data.draw(st.permutations(np.argwhere(member).tolist()))
    windows, unused = windows_of_nodes(shape, 0, np.array(nodes, np.int64).reshape(-1, 3))
    expected, used = set(), np.zeros(shape, bool)
    for side in Side:
        if shape[side.axis] == 1:
            continue
        face = np.moveaxis(member, side.axis, 0)[-1 if side % 2 else 0]
        seen = np.moveaxis(used, side.axis, 0)[-1 if side % 2 else 0]
        spans = [range(max(n - 1, 1)) for n in face.shape]
        for i in spans[0]:
            for j in spans[1]:
                if face[i : i + 2, j : j + 2].all():
                    expected.add((int(side), i, j))
                    seen[i : i + 2, j : j + 2] = True
    # Each of them is in one window.
    assert sorted(quad for window in windows for quad in quads_of(window, shape)) == sorted(expected)
    assert unused == (member & ~used).sum()
