"""Nodes of CGNS files read from the bytes of their headers, against the same nodes read by the HDF5 library."""

import struct
from pathlib import Path
from typing import Any
from unittest import mock

import h5py
import numpy as np
import pytest
from cgns_witness import N, connectivity, one_to_one, tree, two_zones, write_hdf5, zone
from h5py import h5d, h5g, h5o, h5p, h5s, h5t
from hypothesis import given, settings
from hypothesis import strategies as st

from meshdeform_core.errors import MeshDeformError
from meshdeform_formats.cgns.storage import hdf5
from meshdeform_formats.cgns.storage.checksum import Checksums, lookup3
from meshdeform_formats.cgns.storage.hdf5 import opened_hdf5
from meshdeform_formats.cgns.storage.headers import Headers
from meshdeform_formats.cgns.storage.tree import Node

TYPES = ("i4", "i8", "u4", "u8", "f4", "f8", "i1", "u1")


def contents(node: Node) -> tuple[Any, ...]:
    """All that is known of a node and of those below it."""
    node.require()
    data = node.data() if node.link is None else np.empty(0)
    children = [contents(child) for child in node.children]
    place = node.place()
    return (
        node.name, node.path, node.label, node.data_type, node.dims, str(node.dtype), str(node.link), node.dangling,
        place, data.shape, data.dtype.str, data.tobytes(order="F"), children,
    )  # fmt: skip


def through_headers(path: Path) -> tuple[Any, ...]:
    with opened_hdf5(path) as root:
        return contents(root)


def through_library(path: Path) -> tuple[Any, ...]:
    with mock.patch.object(hdf5, "_known", return_value=None):
        return through_headers(path)


def outcome(read: Any, path: Path) -> Any:
    try:
        return read(path)
    except MeshDeformError as error:
        return type(error)


def nodes(depth: int) -> st.SearchStrategy[N]:
    arrays = st.builds(
        lambda kind, shape, first: (np.arange(np.prod(shape)).reshape(shape) + first).astype(kind),
        st.sampled_from(TYPES),
        st.lists(st.integers(1, 4), min_size=1, max_size=3),
        st.integers(0, 100),
    )
    data = st.none() | arrays | st.text("abcäß", min_size=1, max_size=40)
    below = st.lists(nodes(depth - 1), max_size=11, unique_by=lambda node: node.name) if depth else st.just([])
    text = st.text(st.characters(codec="utf-8", exclude_characters="/\0 ."), min_size=1, max_size=8)
    return st.builds(N, text, text, data, below)


@given(nodes(2), st.sampled_from(["earliest", "v108"]), st.booleans())
@settings(max_examples=25, deadline=None)
def test_trees_are_those_of_the_library(tmp_path_factory, node, oldest, track):
    # More than eight members or attributes are stored elsewhere.
    path = write_hdf5(tmp_path_factory.mktemp("t") / "a.cgns", N("", "", None, [node]), track=track, oldest=oldest)
    assert through_headers(path) == through_library(path)


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
@pytest.mark.parametrize("dataset", [{}, {"chunks": True}, {"compression": "gzip"}, {"fillvalue": 1.0}])
def test_grids_are_those_of_the_library(tmp_path, oldest, dataset):
    links = [N("far", "Zone_t", None, link=("", "/Base/left")), N("gone", "Zone_t", None, link=("no.cgns", "/Base"))]
    path = write_hdf5(tmp_path / "a.cgns", tree(two_zones()["Base/left"], more=links), oldest=oldest, dataset=dataset)
    assert through_headers(path) == through_library(path)


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
def test_common_nodes_do_not_need_the_library(tmp_path, oldest):
    path = write_hdf5(tmp_path / "grid.cgns", two_zones(), oldest=oldest)
    with mock.patch.object(hdf5, "_node", side_effect=AssertionError):
        assert len(through_headers(path)[-1]) == 2


def test_third_party_nodes_do_not_need_the_library(third_party):
    path = third_party / "717_wl_L2_hdf5.cgns"
    expected = through_library(path)
    with mock.patch.object(hdf5, "_node", side_effect=AssertionError):
        assert through_headers(path) == expected


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
def test_damaged_headers_are_read_as_by_the_library_or_refused(tmp_path, oldest):
    root = tree(zone("z", np.zeros((2, 2, 2, 3)), connectivity(one_to_one("c", "z", [[1, 1]] * 3, [[1, 1]] * 3))))
    path, damaged = write_hdf5(tmp_path / "grid.cgns", root, oldest=oldest), tmp_path / "damaged.cgns"
    raw, whole = path.read_bytes(), through_library(path)
    with h5py.File(path) as file:
        groups = [file[name] for name in ("Base/z", "Base/z/ZoneType", "Base/z/ZoneType/ data")]
        places = [h5o.get_info(group.id).addr for group in groups]
    for at in sorted({at for place in places for at in range(place, place + 160, 3)}):
        damaged.write_bytes(raw[:at] + bytes([raw[at] ^ 1 << at % 8]) + raw[at + 1 :])
        found, expected = outcome(through_headers, damaged), outcome(through_library, damaged)
        # Of version 1, which has no checksums, the library refuses some fields that nobody needs.
        assert found == expected or (oldest == "earliest" and isinstance(expected, type) and found == whole), at


def test_other_superblocks_are_left_to_the_library(tmp_path):
    write_hdf5(tmp_path / "grid.cgns", two_zones())
    moved = tmp_path / "moved.cgns"
    with h5py.File(moved, "w", userblock_size=512, track_order=True) as file, h5py.File(tmp_path / "grid.cgns") as old:
        for name in old:
            old.copy(name, file)
    with moved.open("rb") as stream:
        assert not Headers(stream).usual
    assert len(through_headers(moved)[-1]) == 2


def odd_arrays(file: h5py.File) -> None:
    """Arrays in forms that CGNS libraries do not write: layouts, types of numbers, types stored elsewhere."""
    short, shifted, shared = h5t.STD_I32LE.copy(), h5t.STD_I32LE.copy(), h5t.IEEE_F64LE.copy()
    short.set_precision(16)
    shifted.set_precision(16)
    shifted.set_offset(8)
    shared.commit(file.id, b" type")
    compact, early = h5p.create(h5p.DATASET_CREATE), h5p.create(h5p.DATASET_CREATE)
    compact.set_layout(h5d.COMPACT)
    early.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    early.set_fill_value(np.array(3.0))
    kinds = (h5t.IEEE_F64BE, None), (short, None), (shifted, None), (shared, None), (h5t.IEEE_F64LE, compact)
    for number, (kind, layout) in enumerate((*kinds, (h5t.IEEE_F64LE, early))):
        group = file.create_group(f"n{number}", track_order=True)
        group.attrs["label"], group.attrs["type"] = np.array(b"DataArray_t", "S33"), np.array(b"R8", "S3")
        stored = h5d.create(group.id, b" data", kind, h5s.create_simple((2, 3)), layout)
        if layout is not early:
            stored.write(h5s.ALL, h5s.ALL, np.arange(6.0).reshape(2, 3))


@pytest.mark.parametrize("oldest", ["earliest", "v108"])
def test_odd_arrays_are_those_of_the_library(tmp_path, oldest):
    with h5py.File(tmp_path / "odd.cgns", "w", track_order=True, libver=(oldest, "v108")) as file:
        odd_arrays(file)
    found = through_headers(tmp_path / "odd.cgns")
    assert found == through_library(tmp_path / "odd.cgns")
    assert len(found[-1]) == 6


@pytest.mark.parametrize("order", [2**31 + 1, 2**63 + 1, 0])
def test_numbers_of_creation_are_those_of_the_library(tmp_path, order):
    """Large ones, negative ones, and the same number twice."""
    children = [N(name, "Family_t") for name in ("one", "two", "six")]
    path = write_hdf5(tmp_path / "a.cgns", N("", "", None, [N("top", "CGNSBase_t", None, children)]))
    raw = path.read_bytes()
    link = struct.pack("<BBQBB", 1, 0x14, 1, 1, 3) + b"two"
    assert raw.count(link) == 1
    path.write_bytes(raw.replace(link, link[:2] + struct.pack("<Q", order) + link[10:]))
    assert through_headers(path) == through_library(path)


def test_addresses_outside_of_the_file(tmp_path):
    path = write_hdf5(tmp_path / "grid.cgns", two_zones())
    size = path.stat().st_size
    with path.open("rb") as stream:
        headers = Headers(stream)
        for address in (0, size - 1, size, size + 1, 2**63, 2**64 - 1):
            assert headers.group(address) is None
            assert headers.array(address) is None


def test_hash_of_a_sentence():
    """The values of driver5 in Jenkins' lookup3.c."""
    text = np.frombuffer(b"Four score and seven years ago", np.uint8)
    assert lookup3(np.stack([text, text])).tolist() == [0x17770551] * 2


def test_checksums_of_the_library(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w", libver="v108") as file:
        for length in range(40):
            file.create_group("x" * (length + 1)).attrs["a" * (length + 1)] = length
        places = [h5o.get_info(h5g.open(file.id, name.encode())).addr for name in file]
    raw, right, wrong = (tmp_path / "a.h5").read_bytes(), Checksums(), Checksums()
    for at in places:
        # Signature, version, flags, times, size of the messages in a byte.
        assert raw[at : at + 5] == b"OHDR\2"
        head = 7 + 16 * bool(raw[at + 5] & 0x20)
        piece = raw[at : at + head + raw[at + head - 1] + 4]
        right.add(piece)
        wrong.add(piece[:9] + bytes([piece[9] ^ 1]) + piece[10:])
    assert right.all_right()
    assert not wrong.all_right()
