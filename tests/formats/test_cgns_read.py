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
from grids import joined_nodes

from meshdeform_core.grid import Connection, Side, Window
from meshdeform_formats import read_grid, write_grid

WING, WING_HDF5, AIRFOIL = "717_wl_L2.cgns", "717_wl_L2_hdf5.cgns", "nak_a_141.cgns"


@pytest.mark.parametrize("name", [WING, WING_HDF5, AIRFOIL])
def test_third_party_connections_join_coincident_nodes(third_party, name):
    grid = read_grid(third_party / name)
    assert grid.connections
    for connection in grid.connections:
        own, donor = joined_nodes(grid, connection)
        np.testing.assert_array_equal(own, donor)


def test_two_zones(tmp_path):
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", two_zones()))
    assert grid.names == ("left", "right")
    assert grid.shapes == ((4, 3, 5), (3, 3, 5))
    np.testing.assert_array_equal(grid.block(0), box(4, 3, 5))
    assert [(p.name, p.family, p.bc_type) for p in grid.patches] == [
        ("body", "Wing", "BCWallViscous"),
        ("top", "Wing", "BCWall"),  # FamilySpecified: what the family says
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
    assert [patch.windows for patch in grid.patches] == [
        (Window(0, Side.JMIN, (0, 0), (3, 0)),),
        (Window(0, Side.IMAX, (0, 0), (2, 0)),),
    ]
    assert grid.connections == (Connection("cut", 0, (0, 0, 0), (0, 2, 0), 0, (3, 2, 0), (3, 0, 0), (1, -2, 3)),)


def located(location: str) -> N:
    return N("GridLocation", "GridLocation_t", location)


def face_list(axis: int, plane: int, shape: tuple[int, int, int]) -> np.ndarray:
    """1-based indices of all faces of one plane of a block of ``shape`` nodes."""
    spans = [range(1, n) if a != axis else [plane] for a, n in enumerate(shape)]
    return np.array(list(itertools.product(*spans)))


KMAX = (Window(0, Side.KMAX, (0, 0), (3, 2)),)
IMIN = (Window(0, Side.IMIN, (0, 0), (2, 4)),)


@pytest.mark.parametrize(
    ("condition", "windows"),
    [
        (bc("x", "BCWall", [[1, 1, 5], [4, 3, 5]]), KMAX),
        (bc("x", "BCWall", [[4, 3, 5], [1, 1, 5]]), KMAX),
        (bc("x", "BCWall", [[1, 1, 5], [3, 2, 5]], located("FaceCenter")), KMAX),
        (bc("x", "BCWall", [[1, 1, 5], [3, 2, 5]], located("KFaceCenter")), KMAX),
        (bc("x", "BCWall", [[1, 1, 1], [1, 2, 4]], located("IFaceCenter")), IMIN),
        (bc("x", "BCWall", [[1, 1, 1], [1, 2, 4]], point_set="ElementRange"), IMIN),
        (bc("x", "BCWall", [[1, 1, 2], [1, 2, 3]], located("FaceCenter")), (Window(0, Side.IMIN, (0, 1), (2, 3)),)),
        (bc("x", "BCWall", np.add(np.argwhere(np.ones((4, 3, 1))), [1, 1, 5]), point_set="PointList"), KMAX),
        (bc("x", "BCWall", face_list(2, 5, (4, 3, 5)), located("KFaceCenter"), point_set="PointList"), KMAX),
        (bc("x", "BCWall", face_list(2, 5, (4, 3, 5)), located("FaceCenter"), point_set="PointList"), KMAX),
        (bc("x", "BCWall", face_list(0, 1, (4, 3, 5)), point_set="ElementList"), IMIN),
    ],
)
def test_point_sets(tmp_path, condition, windows):
    root = tree(zone("z", box(4, 3, 5), zone_bc(condition)))
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    assert grid.patches[0].windows == windows
    assert grid.notes == ()


def test_face_centres_of_a_single_layer_of_cells(tmp_path):
    """Every face has k = 1, but the layer is not the face."""
    condition = bc("wall", "BCWall", [[1, 1, 1], [1, 2, 1]], located("FaceCenter"))
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(zone("z", box(4, 3, 2), zone_bc(condition)))))
    assert grid.patches[0].windows == (Window(0, Side.IMIN, (0, 0), (2, 1)),)


@pytest.mark.parametrize(
    ("condition", "note"),
    [
        (bc("odd", "BCWall", [[1, 1, 1], [1, 1, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[2, 1, 1], [2, 3, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[1, 1, 1], [4, 3, 5]]), "cover no part of a block face are not used: z/odd"),
        (bc("odd", "BCWall", [[2, 2, 2]], point_set="PointList"), "cover no part"),
        (bc("odd", "BCWall", [[1, 1, 1], [1, 1, 4]], located("FaceCenter")), "cover no part"),
        (
            bc("odd", "BCWall", [[1, 1, 1], [1, 2, 4]], located("CellCenter")),
            "located at CellCenter are not used: z/odd",
        ),
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
    names = [N("FamilyName", "FamilyName_t", "a"), N("Other", "AdditionalFamilyName_t", "b")]
    conditions = [bc(f"bc{n}", "BCWall", [[1, 1, 1], [1, 2, 2]], *names[n:]) for n in range(2)]
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", tree(zone("z", box(2, 2, 2), zone_bc(*conditions)))))
    assert [patch.family for patch in grid.patches] == ["a", "b"]


def ring_sector(angle: float) -> np.ndarray:
    """A sector of a ring about the x axis, from 0 to ``angle`` degrees along k."""
    x, r, phi = np.meshgrid(
        np.linspace(0, 1, 3), np.linspace(1, 2, 3), np.radians(np.linspace(0, angle, 4)), indexing="ij"
    )
    return np.stack([x, r * np.cos(phi), r * np.sin(phi)], axis=-1)


def degrees(word: str) -> N:
    return N("DimensionalUnits", "DimensionalUnits_t", words("Kilogram", "Meter", "Second", "Kelvin", word))


@pytest.mark.parametrize(
    ("stored", "inner", "base", "noted"),
    [
        (5.0, "Degree", None, None),
        (np.radians(5.0), "Radian", None, None),
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
    root = tree(zone("z", ring_sector(5.0), sides), more=[degrees(base)] if base else [])
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    found = grid.connections[0].periodic
    assert found.rotation_angle == pytest.approx((5.0, 0.0, 0.0), rel=1e-6)
    assert (found.rotation_center, found.translation) == ((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    assert any("read as" in note for note in grid.notes) == (noted is not None)
    assert noted is None or any(f"read as {noted}" in note for note in grid.notes)


@pytest.mark.parametrize(
    ("own", "donor", "transform", "name"),
    [
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 4]], [1, 2, 3], "right"),
        ([[4, 1, 1], [4, 3, 9]], [[1, 1, 1], [1, 3, 9]], [1, 2, 3], "right"),
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 1, 3], "right"),
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 0, 3], "right"),
        ([[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 2, 3], "elsewhere"),
    ],
)
def test_connections_that_do_not_fit_are_noted(tmp_path, own, donor, transform, name):
    wrong = connectivity(one_to_one("wrong", name, own, donor, transform))
    root = tree(zone("left", box(4, 3, 5), wrong), zone("right", box(3, 3, 5, (3, 0, 0))))
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", root))
    assert grid.connections == ()
    assert grid.notes == ("connections that do not match their zones are not used: left/wrong",)


def general(name: str, kind: str | None) -> N:
    children = [N("PointList", "IndexArray_t", np.ones((3, 1), np.int32))]
    if kind:
        children.append(N("GridConnectivityType", "GridConnectivityType_t", kind))
    return N(name, "GridConnectivity_t", "right", children)


@pytest.mark.parametrize("kind", ["Abutting1to1", "Abutting"])
def test_other_connectivity_is_noted(tmp_path, kind):
    root = tree(
        zone("left", box(4, 3, 5), connectivity(general("g", kind), general("h", "Overset"))),
        zone("right", box(3, 3, 5, (3, 0, 0))),
    )
    notes = read_grid(write_hdf5(tmp_path / "grid.cgns", root)).notes
    assert any(f"{kind} connectivity is kept in the file but not used" in n and "left/g" in n for n in notes)
    assert any("Overset connectivity is kept" in n and "left/h" in n for n in notes)


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


def test_the_first_of_several_conditions_of_a_family_counts(tmp_path):
    twice = [N("FamilyBC", "FamilyBC_t", "BCWall"), N("FamilyBC 2", "FamilyBC_t", "BCFarfield")]
    condition = N("top", "BC_t", "FamilySpecified", [
        N("PointRange", "IndexRange_t", np.array([[1, 2], [1, 2], [2, 2]], np.int32)),
        N("FamilyName", "FamilyName_t", "Wing"),
    ])  # fmt: skip
    root = tree(
        zone("z", box(2, 2, 2), N("ZoneBC", "ZoneBC_t", None, [condition])),
        more=[N("Wing", "Family_t", None, twice)],
    )
    (patch,) = read_grid(write_hdf5(tmp_path / "grid.cgns", root)).patches
    assert patch.bc_type == "BCWall"
