"""The ADF container: all its variants, links, and every kind of damage."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cgns_witness import AdfWriter, N, box, tree, two_zones, zone

from meshdeform_core.errors import FormatError
from meshdeform_formats import read_grid
from meshdeform_formats.cgns.adf import read_adf
from meshdeform_formats.cgns.tree import Node


def assert_same(node: Node, expected: N, order: str = "<") -> None:
    """The tree read equals the tree written: names, labels, order, values."""
    assert [child.name for child in node.children] == [child.name for child in expected.children]
    for found, wanted in zip(node.children, expected.children, strict=True):
        assert found.label == wanted.label
        if wanted.data is not None:
            data = np.frombuffer(wanted.data.encode(), np.int8) if isinstance(wanted.data, str) else wanted.data
            assert found.dims == data.shape
            np.testing.assert_array_equal(found.data(), data)
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
    values = np.arange(24).reshape(2, 3, 4).astype(kind)
    root = N("", "", None, [N("values", "DataArray_t", values)])
    node = read_adf(AdfWriter("A02011", order, 3, long).write(tmp_path / "a.adf", root)).children[0]
    np.testing.assert_array_equal(node.data(), values)


@pytest.mark.parametrize(
    "link",
    [
        ("missing.adf", "/Base/x"),
        ("", "/Base/nothing"),
        ("", "/Base/zone/GridCoordinates"),
        ("grid.adf", "/Base/zone/GridCoordinates/CoordinateX"),
        ("notes.txt", "/"),
    ],
)
def test_links_that_lead_nowhere_or_to_themselves_are_named(tmp_path, link):
    (tmp_path / "notes.txt").write_text("no grid")
    whole = zone("zone", box(2, 2, 2))
    broken = replace(whole, children=[whole["ZoneType"], N("GridCoordinates", "", link=link)])
    AdfWriter().write(tmp_path / "grid.adf", tree(broken))
    with pytest.raises(FormatError, match=r"/Base/zone/GridCoordinates is a broken link to "):
        read_grid(tmp_path / "grid.adf")


@pytest.mark.parametrize(("below", "message"), [("", "/Base/l0 is a broken link"), ("/x", "chain of too many links")])
def test_a_chain_of_thousands_of_links_is_refused(tmp_path, below, message):
    links = [N(f"l{i}", "", link=("", f"/Base/l{i + 1}{below}")) for i in range(2000)]
    AdfWriter().write(tmp_path / "grid.adf", tree(N("l2000", "Zone_t"), more=links))
    with pytest.raises(FormatError, match=message):
        read_grid(tmp_path / "grid.adf")


def walk(node: Node) -> None:
    """Read everything under a node."""
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


def corrupted(tmp_path: Path, change) -> Path:
    """An ADF file in which ``change(writer)`` has altered bytes."""
    writer = AdfWriter()
    path = writer.write(tmp_path / "bad.adf", two_zones())
    change(writer)
    path.write_bytes(writer.file)
    return path


def put(at: int, new: bytes):
    def change(writer: AdfWriter) -> None:
        writer.file[at : at + len(new)] = new

    return change


def put_in_node(place: str, offset: int, new: bytes):
    def change(writer: AdfWriter) -> None:
        at = writer.places[place] + offset
        writer.file[at : at + len(new)] = new

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
        (put(28, b">"), "ADF version"),
        (put(100, b"C"), "format 'C'"),
        (put(100, b"N"), "format 'N'"),
        (put(110, b"08"), "char, short, int, long, float and double of"),
        (put(106, b"zz"), "hexadecimal"),
        (put(134, b"FFFFFFFF0000"), "probably truncated"),
        (put(134, b"000000000000"), "expected a node"),
        (put(142, b"FFFF"), "should be at byte 65535"),
        (put_in_node("/Base", 0, b"XXXX"), "expected a node"),
        (put_in_node("/Base", 242, b"Tail"), "expected a node"),
        (put_in_node("/Base", 4, b"B/se"), "impossible name 'B/se'"),
        (put_in_node("/Base", 4, b"Bose"), "lists a child 'Base' whose own name is 'Bose'"),
        (put_in_node("/Base", 68, b"FFFFFFFF"), "4294967295 children; its table has room for 3"),
        (put_in_node("/Base", 68, b"-0000001"), "hexadecimal"),
        (put_in_node("/Base", 84, b"000000000000"), "expected SNTb at byte 0"),
        (put_in_node("/Base", 128, b"0D"), "13 dimensions"),
        (put_in_node(X, 130, b"7FFFFFFF"), r"has \(2147483647, 3, 5\) values"),
        (put_in_node(X, 226, b"0000"), "declares 4 x 3 x 5 R8 values but none are stored"),
        (put_in_node(X, 226, b"0005"), "expected DCtb"),
        (put_in_node(X, 230, b"000000000000"), "expected DaTa at byte 0"),
        (put_in_node(X, 96, b"R9"), "holds 4 x 3 x 5 R9 values; expected R4 or R8"),
        (put_in_node("/Base/left/ZoneType", 96, b"QQ"), "data type 'QQ'; known are"),
        (loop, "belongs to two parents"),
        (repeat_a_name, "two children named 'CoordinateX'"),
    ],
)
def test_damaged_files_are_refused_with_the_reason(tmp_path, change, message):
    with pytest.raises(FormatError, match=message):
        read_grid(corrupted(tmp_path, change))


@pytest.mark.parametrize(
    ("count", "message"),
    [(b"0002", "declares 480 bytes of data; 240 are stored"), (b"0009", "9 data chunks; more than its table holds")],
)
def test_damaged_number_of_data_chunks(tmp_path, count, message):
    writer = AdfWriter(chunks=4)
    path = writer.write(tmp_path / "bad.adf", two_zones())
    at = writer.places[X] + 226
    writer.file[at : at + 4] = count
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
