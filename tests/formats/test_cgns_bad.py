"""CGNS files, HDF5 and ADF, that cannot be used: each is refused with what, where and what to do; variants of ADF."""

from dataclasses import replace

import h5py
import numpy as np
import pytest
from cases import constant
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
    values,
    write_hdf5,
    zone,
    zone_bc,
)

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, set_up
from meshdeform_core.errors import CaseError, FormatError
from meshdeform_formats import read_grid
from meshdeform_formats.cgns.adf import read_adf
from meshdeform_formats.cgns.tree import Node

SHAPE = (4, 3, 5)


def good() -> N:
    return zone("z", box(*SHAPE))


def with_coordinates(*arrays: N, rind: list[int] | None = None) -> N:
    planes = [N("Rind", "Rind_t", np.array(rind, np.int32))] if rind else []
    grid = N("GridCoordinates", "GridCoordinates_t", None, [*planes, *arrays])
    return replace(good(), children=[N("ZoneType", "ZoneType_t", "Structured"), grid])


def array(name: str, dtype: str = "f8", shape: tuple[int, ...] = SHAPE) -> N:
    return N(name, "DataArray_t", np.zeros(shape, dtype))


def sized(*sizes: int, dtype: str = "i4") -> N:
    values = np.array([sizes, np.subtract(sizes, 1), np.zeros(len(sizes))]).T.astype(dtype)
    return replace(good(), data=values)


def boundary(points: object, *more: N, point_set: str = "PointRange") -> N:
    return zone("z", box(*SHAPE), zone_bc(bc("wall", "BCWall", points, *more, point_set=point_set)))


def connected(node: N) -> N:
    return zone("z", box(*SHAPE), connectivity(node))


def overset(*kinds: str) -> N:
    types = [[N("GridConnectivityType", "GridConnectivityType_t", kind)] if kind else [] for kind in kinds]
    children = [N(f"g{i}", "GridConnectivity_t", "b", kind) for i, kind in enumerate(types)]
    return tree(zone("a", box(3, 3, 3), connectivity(*children)), zone("b", box(3, 3, 3)))


OTHER_CELLS = replace(good(), data=np.array([SHAPE, (3, 2, 5), (0, 0, 0)], "i4").T)
AT_FACES, AT_ENDS = (N("GridLocation", "GridLocation_t", f"{letter}FaceCenter") for letter in ("I", ""))
X, Y, Z = array("CoordinateX"), array("CoordinateY"), array("CoordinateZ")
RADIUS, THETA = array("CoordinateR"), array("CoordinateTheta")
JOIN = one_to_one("join", "z", [[1, 1, 1], [1, 3, 5]], [[4, 1, 1], [4, 3, 5]])


def joined(child: N) -> N:
    return connected(replace(JOIN, children=[*JOIN.children, child]))


@pytest.mark.parametrize(
    ("root", "message"),
    [
        (N("", "", None, tree().children[:1]), "no CGNSBase_t node"),
        (tree(), "the base Base has no zones"),
        (tree(good(), cell=1), "cell dimension 1 and physical dimension 3"),
        (tree(good(), cell=3, physical=2), "cell dimension 3 and physical dimension 2"),
        (tree(zone("u", box(2, 2, 2), kind="Unstructured"), good()), r"1 of 2 zones .* is 'u' \(Unstructured\)"),
        (tree(good(), cell=2), r"/Base/z holds 3 x 3 I4 values; expected 2 x 3 integers"),
        (tree(sized(4, 3, 5, dtype="f8")), "holds 3 x 3 R8 values; expected 3 x 3 integers"),
        (tree(OTHER_CELLS), r"zone z has \[4, 3, 5\] nodes but \[3, 2, 5\] cells; expected one cell less"),
        (tree(zone("z", box(4, 1, 1))), "4 x 1 x 1 nodes: it is a curve in the base Base, whose zones are volumes"),
        (tree(good(), zone("s", box(4, 3, 1))), "zone s has 4 x 3 x 1 nodes: it is a surface in the base Base, whose"),
        (tree(sized(4, 0, 5)), r"zone z has \[4, 0, 5\] nodes"),
        (tree(sized(4, 3, 6)), r"CoordinateX of zone z has \(4, 3, 5\) values; the zone has \(4, 3, 6\) nodes"),
        (tree(good().without("GridCoordinates")), "zone z has no GridCoordinates_t"),
        (tree(replace(good(), children=[replace(good()["GridCoordinates"], name=f"Grid#{n}") for n in (1, 2)])),
         "has only Grid#1, Grid#2; expected its original grid, GridCoordinates"),
        (tree(with_coordinates(X, Z)), "has the coordinates CoordinateX, CoordinateZ; expected"),
        (tree(with_coordinates(RADIUS, THETA, Z)), "cylindrical .* converted to Cartesian"),
        (tree(with_coordinates(X, Y, array("CoordinateZ", "i4"))), "holds 4 x 3 x 5 I4 values; expected R4 or R8"),
        (tree(with_coordinates(X, Y, array("CoordinateZ", shape=(4, 3)))), r"CoordinateZ .* has \(4, 3\) values"),
        (tree(with_coordinates(X, Y, Z, rind=[1, 0, 0, 0, 0, 0])), r"has \(5, 3, 5\) nodes \(with rind\)"),
        (tree(with_coordinates(X, Y, Z, rind=[-1, 0, 0, 0, 0, 1])), "rind planes; expected none or more"),
        (tree(with_coordinates(X, Y, Z, rind=[0, 0])), "Rind holds 2 I4 values; expected 6 integers"),
        (tree(boundary([[1, 1, 1], [1, 3, 6]])), r"PointRange has the index \[1, 3, 6\]; zone z ends at \[4, 3, 5\]"),
        (tree(boundary([[0, 1, 1], [0, 3, 5]])), r"has the index \[0, 1, 1\]"),
        (tree(boundary([[1, 1, 1], [1, 3, 5]], AT_FACES)), r"wall/PointRange has .* \[4, 2, 4\]"),
        (tree(boundary([[1, 1, 5], [4, 3, 5]], AT_ENDS)), r"has the index \[4, 3, 5\]; zone z ends at \[3, 2, 5\]"),
        (tree(boundary([[1, 1, 1], [9, 1, 1]], point_set="PointList")), r"PointList has the index \[9, 1, 1\]"),
        (tree(boundary([[1, 1, 1]] * 3)), "holds 3 x 3 I4 values; expected 3 x 2 integers"),
        (tree(connected(JOIN.without("PointRangeDonor"))), "the connection /Base/z/.*/join has no PointRangeDonor"),
        (tree(joined(N("Transform", "x", np.ones(2, "i4")))), "expected 3 integers"),
        (tree(joined(periodic([0] * 4, [0] * 3, [0] * 3))), r"holds \(4,\) float32 values; expected 2 or 3 real num"),
    ],
)  # fmt: skip
def test_refused_with_the_reason(tmp_path, root, message):
    path = write_hdf5(tmp_path / "grid.cgns", root)
    with pytest.raises(FormatError, match=message) as refusal:
        read_grid(path)
    assert str(path) in str(refusal.value)


# Overset is what a connectivity is that does not say (SIDS 8.4).
@pytest.mark.parametrize("kinds", [("Overset",), ("", "Overset")])
def test_overset_zones_are_deformed_only_as_components(tmp_path, kinds):
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", overset(*kinds)))
    assert grid.overset
    specs = (BoundarySpec("all", ("*",), Kind.MOVING, None, constant(0.1, 0, 0)),)
    with pytest.raises(CaseError, match=r"2 blocks are connected by overset \(Chimera\) connectivity only"):
        set_up(grid, Case(specs))
    assert len(set_up(grid, Case(specs, components={"one": ["a"], "two": ["b"]})).undeformed.components) == 2


def test_overset_beside_other_connectivity_is_an_ordinary_grid(tmp_path):
    grid = read_grid(write_hdf5(tmp_path / "grid.cgns", overset("Overset", "Abutting1to1")))
    assert not grid.overset
    said = "connectivity is kept in the file but not used; coincident nodes stay joined"
    assert grid.notes == (f"Overset {said}: a/g0", f"Abutting1to1 {said}: a/g1")
    alone = read_grid(write_hdf5(tmp_path / "one.cgns", tree(connected(N("holes", "OversetHoles_t")))))
    assert (alone.overset, alone.notes) == (False, (f"Overset {said}: z/holes",))


def no_base(file):
    for name in list(file):
        del file[name]
    file["displacement"] = np.zeros((5, 3))


def older_library(file):
    file[" version"] = np.zeros(33, np.int8)


def never_written(file):
    for name in "XYZ":
        group = file[f"Base/left/GridCoordinates/Coordinate{name}"]
        del group[" data"]
        group.create_dataset(" data", shape=(50000, 30000, 40000), dtype="f8", chunks=(64, 64, 64))
    file["Base/left/ data"][...] = np.array([[40000, 30000, 50000], [39999, 29999, 49999], [0, 0, 0]])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (no_base, "is HDF5 but not CGNS: /displacement"),
        (older_library, r"before 3\.0"),
        (never_written, "declares .* values; only 0 bytes are stored"),
        (lambda file: h5py.h5g.create(file["Base"].id, b"l\xfcft"), r"the name b'l\\xfcft' in /Base is not UTF-8"),
    ],
)
def test_hdf5_that_cannot_be_used(tmp_path, change, message):
    path = write_hdf5(tmp_path / "grid.cgns", two_zones())
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(FormatError, match=message):
        read_grid(path)


NOWHERE = ("gone.cgns", "/Base/somewhere")


def without_target(*path):
    """Two zones with boundary conditions, families and connections; the node at ``path`` is a dangling link."""
    root = two_zones()
    node = root["Base"]
    for name in path[:-1]:
        node = node[name]
    node.children[[child.name for child in node.children].index(path[-1])] = N(path[-1], "", link=NOWHERE)
    return root


def paths(node, above=()):
    for child in node.children:
        yield (*above, child.name)
        yield from paths(child, (*above, child.name))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    return read_grid(write_hdf5(tmp_path_factory.mktemp("whole") / "whole.cgns", two_zones()))


@pytest.mark.parametrize("path", list(paths(two_zones()["Base"])), ids="/".join)
def test_whatever_belongs_to_the_grid_is_missed(tmp_path, path, whole):
    """Any node behind a dangling link is missed, unless the grid is the same without it."""
    file = write_hdf5(tmp_path / "a.cgns", without_target(*path))
    try:
        grid = read_grid(file)
    except FormatError as error:
        assert "is a broken link to gone.cgns:/Base/somewhere" in str(error)  # noqa: PT017
        return
    assert (grid.names, grid.patches, grid.connections) == (whole.names, whole.patches, whole.connections)
    np.testing.assert_array_equal(grid.points, whole.points)


def test_a_missing_solution_is_noted(tmp_path):
    root = two_zones()
    root["Base"]["left"].children.append(N("FlowSolution#1", "", link=NOWHERE))
    grid = read_grid(write_hdf5(tmp_path / "a.cgns", root))
    assert "broken links are kept as they are: left/FlowSolution#1 -> gone.cgns:/Base/somewhere" in grid.notes


def assert_same(node: Node, expected: N) -> None:
    """Names, labels, order, values."""
    assert [child.name for child in node.children] == [child.name for child in expected.children]
    for found, wanted in zip(node.children, expected.children, strict=True):
        assert found.label == wanted.label
        if wanted.data is not None:
            assert found.dims == values(wanted.data).shape
            np.testing.assert_array_equal(found.data(), values(wanted.data))
        else:
            assert found.data_type == "MT"
        assert_same(found, wanted)


@pytest.mark.parametrize("version", ["A02011", "A01xxx", "B02012"])
@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("chunks", [1, 4])
def test_every_variant_gives_the_tree_that_was_written(tmp_path, version, order, chunks):
    expected = two_zones()
    root = read_adf(AdfWriter(version, order, chunks).write(tmp_path / "grid.adf", expected))
    assert_same(root, expected)


@pytest.mark.parametrize("kind", ["i1", "u1", "i4", "i8", "u4", "u8", "f4", "f8"])
@pytest.mark.parametrize(("long", "order"), [(8, "<"), (4, ">")])
def test_data_types(tmp_path, kind, long, order):
    root = N("", "", None, [N("values", "DataArray_t", np.arange(24).reshape(2, 3, 4).astype(kind))])
    read = read_adf(AdfWriter("A02011", order, 3, long).write(tmp_path / "a.adf", root))
    assert_same(read, root)


@pytest.mark.parametrize("write", [AdfWriter().write, write_hdf5], ids=["ADF", "HDF5"])
@pytest.mark.parametrize(
    "link",
    [
        ("missing.cgns", "/Base/x"),
        ("", "/Base/nothing"),
        ("", "/Base/z/GridCoordinates"),
        ("grid.cgns", "/Base/z/GridCoordinates/CoordinateX"),
        ("notes.txt", "/"),
    ],
)
def test_links_that_lead_nowhere_or_to_themselves_are_named(tmp_path, link, write):
    (tmp_path / "notes.txt").write_text("no grid")
    broken = replace(good(), children=[good()["ZoneType"], N("GridCoordinates", "", link=link)])
    path = tmp_path / "grid.cgns"
    write(path, tree(broken))
    with pytest.raises(FormatError, match=r"/Base/z/GridCoordinates is a broken link to "):
        read_grid(path)


@pytest.mark.parametrize(("below", "message"), [("", "/Base/l0 is a broken link"), ("/x", "chain of too many links")])
def test_a_chain_of_thousands_of_links_is_refused(tmp_path, below, message):
    links = [N(f"l{i}", "", link=("", f"/Base/l{i + 1}{below}")) for i in range(2000)]
    AdfWriter().write(tmp_path / "grid.adf", tree(N("l2000", "Zone_t"), more=links))
    with pytest.raises(FormatError, match=message):
        read_grid(tmp_path / "grid.adf")


def walk(node: Node) -> None:
    for child in node.children:
        child.data()
        walk(child)


def test_nodes_nested_without_end_are_refused(tmp_path):
    node = N("deepest", "X_t")
    for _ in range(100):
        node = N("in", "X_t", None, [node])
    root = read_adf(AdfWriter().write(tmp_path / "deep.adf", N("", "", None, [node])))
    with pytest.raises(FormatError, match="nested more than 64 deep"):
        walk(root)


def put(at: int, new: bytes, place: str = ""):
    """Bytes of the file, or of a node of it, are others."""

    def change(writer: AdfWriter) -> None:
        begin = at + (writer.places[place] if place else 0)
        writer.file[begin : begin + len(new)] = new

    return change


def loop(writer: AdfWriter) -> None:
    """The first child of the base becomes the base itself."""
    table = bytes(writer.file[writer.places["/Base"] + 84 :][:12])
    at = int(table[:8], 16) * 4096 + int(table[8:], 16) + 16 + 32
    writer.file[at : at + 12] = writer.pointer(writer.places["/Base"])


def repeat_a_name(writer: AdfWriter) -> None:
    """CoordinateY of the left zone becomes a second CoordinateX, in its header and in its parent's table."""
    begin, end = writer.places["/Base/left/GridCoordinates"], writer.places["/Base/left/ZoneBC"]
    writer.file[begin:end] = writer.file[begin:end].replace(b"CoordinateY", b"CoordinateX")


X = "/Base/left/GridCoordinates/CoordinateX"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (put(32, b"AdfX"), "tags"),
        (put(25, b"C"), "ADF version C02011; known are"),
        (put(100, b"N"), "format 'N'"),
        (put(112, b"10"), r"char, short, int, long, float and double of \[1, 2, 4, 16, 4, 8\] bytes"),
        (put(110, b"08"), "char, short, int, long, float and double of"),
        (put(106, b"zz"), "hexadecimal"),
        (put(134, b"FFFFFFFF0000"), "probably truncated"),
        (put(142, b"FFFF"), "should be at byte 65535"),
        (put(0, b"XXXX", "/Base"), "expected a node"),
        (put(242, b"Tail", "/Base"), "expected a node"),
        (put(4, b"B/se", "/Base"), "impossible name 'B/se'"),
        (put(4, b"Bose", "/Base"), "lists a child 'Base' whose own name is 'Bose'"),
        (put(68, b"FFFFFFFF", "/Base"), "4294967295 children; its table has room for 3"),
        (put(68, b"-0000001", "/Base"), "hexadecimal"),
        (put(84, b"000000000000", "/Base"), "expected SNTb at byte 0"),
        (put(128, b"0D", "/Base"), "13 dimensions"),
        (put(130, b"7FFFFFFF", X), r"has \(2147483647, 3, 5\) values"),
        (put(226, b"0000", X), "declares 4 x 3 x 5 R8 values but none are stored"),
        (put(226, b"0005", X), "expected DCtb"),
        (put(230, b"000000000000", X), "expected DaTa at byte 0"),
        (put(96, b"R9", X), "holds 4 x 3 x 5 R9 values; expected R4 or R8"),
        (put(96, b"QQ", "/Base/left/ZoneType"), "data type 'QQ'; known are"),
        (loop, "belongs to two parents"),
        (repeat_a_name, "two children named 'CoordinateX'"),
        (put(226, b"0002", X), "declares 480 bytes of data; 240 are stored"),
        (put(226, b"0009", X), "9 data chunks; more than its table holds"),
    ],
)
def test_damaged_files_are_refused_with_the_reason(tmp_path, change, message):
    writer = AdfWriter(chunks=4 if "chunks" in message or "480" in message else 1)
    path = writer.write(tmp_path / "bad.adf", two_zones())
    change(writer)
    path.write_bytes(writer.file)
    with pytest.raises(FormatError, match=message):
        read_grid(path)


def test_overlapping_data_chunks_are_refused(tmp_path):
    writer = AdfWriter(chunks=4)
    huge = N("", "", None, [N("values", "DataArray_t", np.zeros(4000))])
    path = writer.write(tmp_path / "bad.adf", huge)
    at = writer.places["/values"] + 230
    table = int(writer.file[at : at + 8], 16) * 4096 + int(writer.file[at + 8 : at + 12], 16)
    entry = bytes(writer.file[table + 16 : table + 40])
    writer.file += b"DCtb" + writer.pointer(len(writer.file) + 16 + 24 * 60000) + entry * 60000 + b"dcTE"
    writer.file[at - 4 : at + 12] = b"%04X" % 60000 + writer.pointer(len(writer.file) - 20 - 24 * 60000)
    path.write_bytes(writer.file)
    with pytest.raises(FormatError, match="overlap"):
        read_adf(path).children[0].data()


def test_truncated_anywhere(tmp_path):
    raw = AdfWriter(chunks=2).write(tmp_path / "whole.adf", two_zones()).read_bytes()
    content = len(raw.rstrip(b"\0"))
    path = tmp_path / "short.adf"
    for length in [0, 1, 25, 31, 185, 186, 300, *range(512, content, 397), content - 1]:
        path.write_bytes(raw[:length])
        with pytest.raises(FormatError, match=r"short\.adf"):
            walk(read_adf(path))
