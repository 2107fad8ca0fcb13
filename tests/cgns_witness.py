"""A small writer of CGNS files with plain h5py and struct, independent of the code under test.

A tree is nested :class:`N`; data are strings or arrays with the fastest index first, as the CGNS standard lists them.
"""

from __future__ import annotations

import itertools
import re
import shutil
import struct
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5g, h5p, h5t

TYPES = {"i1": "C1", "u1": "B1", "i4": "I4", "i8": "I8", "u4": "U4", "u8": "U8", "f4": "R4", "f8": "R8"}


@dataclass
class N:
    """A node; ``link`` is (file, path)."""

    name: str
    label: str
    data: Any = None
    children: list[N] = field(default_factory=list)
    link: tuple[str, str] | None = None

    def __getitem__(self, path: str) -> N:
        node = self
        for name in path.split("/"):
            node = next(child for child in node.children if child.name == name)
        return node

    def without(self, *names: str) -> N:
        return replace(self, children=[child for child in self.children if child.name not in names])


def values(data: Any) -> np.ndarray:
    return np.frombuffer(data.encode(), np.int8) if isinstance(data, str) else np.asarray(data)


# --- HDF5 ---------------------------------------------------------------------------------------------------------


def write_hdf5(path: Path, root: N, *, dataset: dict[str, Any] | None = None, track: bool = True) -> Path:
    """``dataset`` are keywords for multi-dimensional datasets (chunks, compression); ``track`` creation order."""
    with h5py.File(path, "w", track_order=track, libver=("earliest", "v108")) as file:
        _attributes(file, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        file[" format"] = np.frombuffer(b"IEEE_LITTLE_32\0", np.int8)
        file[" hdf5version"] = np.frombuffer(b"HDF5 Version 1.10.8".ljust(33, b"\0"), np.int8)
        for order, child in enumerate(root.children):
            _write(file, child, dataset or {}, track, order)
    return path


def _attributes(group: h5py.Group, name: str, label: str, kind: str) -> None:
    for key, text, length in (("name", name, 33), ("label", label, 33), ("type", kind, 3)):
        group.attrs.create(key, np.array(text.encode(), f"S{length}"))


def _write(parent: h5py.Group, node: N, dataset: dict[str, Any], track: bool, order: int) -> None:
    # A group that tracks the creation of links alone: for the oldest libraries its header has version 1.
    links, creation = h5p.create(h5p.LINK_CREATE), h5p.create(h5p.GROUP_CREATE)
    links.set_char_encoding(h5t.CSET_UTF8)
    creation.set_link_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED if track else 0)
    group = h5py.Group(h5g.create(parent.id, node.name.encode(), links, creation))
    if not track:
        group.attrs["order"] = order
    if node.link:
        _attributes(group, node.name, "", "LK")
        file, target = node.link
        group[" link"] = h5py.ExternalLink(file, target) if file else h5py.SoftLink(target)
        group[" path"] = np.frombuffer(target.encode() + b"\0", np.int8)
        if file:
            group[" file"] = np.frombuffer(file.encode() + b"\0", np.int8)
        return
    array = None if node.data is None else values(node.data)
    _attributes(group, node.name, node.label, "MT" if array is None else TYPES[array.dtype.str[1:]])
    group.attrs["flags"] = np.array([1], np.int32)
    if array is not None:
        group.create_dataset(" data", data=np.ascontiguousarray(array.T), **(dataset if array.ndim > 1 else {}))
    for place, child in enumerate(node.children):
        _write(group, child, dataset, track, place)


# --- ADF ----------------------------------------------------------------------------------------------------------


class AdfWriter:
    """Lay out an ADF file of version A (hexadecimal) or B (binary) in either byte order.

    ``chunks`` cuts the data of every array into that many pieces; ``long`` is the size of I8 in bytes.
    """

    def __init__(self, version: str = "A02011", order: str = "<", chunks: int = 1, long: int = 8) -> None:
        self.version, self.order, self.chunks, self.long = version, order, chunks, long
        self.file = bytearray(186 + 80 + 246)
        self.places: dict[str, int] = {}

    def write(self, path: Path, root: N) -> Path:
        self._node(replace(root, name="ADF MotherNode", label="Root Node of ADF File"), 266, "")
        self.file += b"\0" * (-len(self.file) % 4096)
        nowhere = self.pointer(4096)
        self.file[186:266] = b"fCbt" + 6 * nowhere + b"Fcte"
        date = b"Sat Nov 21 02:00:00 2026".ljust(28)
        what = b"\xc0\xa8\xa3\xa9ADF Database Version " + self.version.encode() + b">"
        sizes = b"%02X" * 6 % (1, 2, 4, self.long, 4, 8) + b"08" * 6
        letters = (b"L" if self.order == "<" else b"B") + b"B"
        pointers = self.pointer(266) + self.pointer(len(self.file)) + self.pointer(186) + nowhere
        head = what.ljust(32) + b"AdF0" + date + b"AdF1" + date + b"AdF2" + letters + b"AdF3" + sizes + b"AdF4"
        self.file[:186] = head + pointers + b"AdF5"
        path.write_bytes(self.file)
        return path

    def pointer(self, at: int) -> bytes:
        block, offset = divmod(at, 4096)
        binary = self.version[0] == "B"
        return struct.pack(self.order + "QI", block, offset) if binary else b"%08X%04X" % (block, offset)

    def _append(self, length: int) -> int:
        self.file += b"\0" * length
        return len(self.file) - length

    def _node(self, node: N, at: int, path: str) -> None:
        self.places[path or "/"] = at
        table = self._table(node, path) if node.children else self.pointer(4096)
        array, kind = self._stored(node)
        dims = np.zeros(12, np.uint64)
        dims[: array.ndim if kind != "MT" else 0] = array.shape
        stored_dims = dims.astype(self.order + "u8").tobytes() if self.version[0] == "B" else b"%08X" * 12 % tuple(dims)
        n_chunks, chunks = self._data(array) if kind != "MT" else (0, self.pointer(4096))
        self.file[at : at + 246] = (
            b"NoDe"
            + node.name.encode().ljust(32)
            + ("" if node.link else node.label).encode().ljust(32)
            + b"%08X%08X" % (len(node.children), len(node.children))
            + table
            + kind.encode().ljust(32)
            + b"%02X" % (array.ndim if kind != "MT" else 0)
            + stored_dims
            + b"%04X" % n_chunks
            + chunks
            + b"TaiL"
        )

    def _table(self, node: N, path: str) -> bytes:
        count = len(node.children)
        table = self._append(4 + 12 + 44 * count + 4)
        self.file[table : table + 4] = b"SNTb"
        self.file[table + 4 : table + 16] = self.pointer(table + 16 + 44 * count)
        self.file[table + 16 + 44 * count : table + 20 + 44 * count] = b"snTE"
        for index, child in enumerate(node.children):
            at = self._append(246)
            entry = table + 16 + 44 * index
            self.file[entry : entry + 44] = child.name.encode().ljust(32) + self.pointer(at)
            self._node(child, at, f"{path}/{child.name}")
        return self.pointer(table)

    def _stored(self, node: N) -> tuple[np.ndarray, str]:
        if node.link:
            separator = " " if self.version.startswith("A01") else ">"
            return values(separator.join(node.link)), "LK"
        if node.data is None:
            return np.empty(0), "MT"
        array = values(node.data)
        kind = TYPES[array.dtype.newbyteorder("<").str[1:]]
        width = self.long if kind in ("I8", "U8") else array.dtype.itemsize
        return array.astype(f"{self.order}{array.dtype.kind}{width}"), kind

    def _data(self, array: np.ndarray) -> tuple[int, bytes]:
        raw, width = array.tobytes(order="F"), array.dtype.itemsize
        count = min(self.chunks, array.size)
        cuts = [width * (array.size * i // count) for i in range(count + 1)]
        pieces = [raw[begin:end] for begin, end in itertools.pairwise(cuts)]
        ends = [self._chunk(piece) for piece in pieces]
        if count == 1:
            return 1, self.pointer(ends[0][0])
        table = self._append(20 + 24 * count)
        entries = b"".join(self.pointer(begin) + self.pointer(end) for begin, end in ends)
        tag = self.pointer(table + 16 + len(entries))
        self.file[table:] = b"DCtb" + tag + entries + b"dcTE"
        return count, self.pointer(table)

    def _chunk(self, piece: bytes) -> tuple[int, int]:
        at = self._append(20 + len(piece))
        end = at + 16 + len(piece)
        self.file[at:] = b"DaTa" + self.pointer(end) + piece + b"dEnD"
        return at, end


# --- trees --------------------------------------------------------------------------------------------------------


def tree(*zones: N, cell: int = 3, physical: int = 3, more: list[N] | None = None) -> N:
    """A file with one base."""
    base = N("Base", "CGNSBase_t", np.array([cell, physical], np.int32), [*zones, *(more or [])])
    return N("", "", None, [N("CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([3.3], np.float32)), base])


def zone(name: str, points: np.ndarray, *more: N, dtype: str = "f8", kind: str = "Structured") -> N:
    """A zone with coordinates ``(ni, nj(, nk), dimension)`` and further children."""
    sizes = np.array(points.shape[:-1], np.int32)
    arrays = [N(f"Coordinate{'XYZ'[c]}", "DataArray_t", points[..., c].astype(dtype)) for c in range(points.shape[-1])]
    children = [N("ZoneType", "ZoneType_t", kind), N("GridCoordinates", "GridCoordinates_t", None, arrays), *more]
    return N(name, "Zone_t", np.stack([sizes, sizes - 1, 0 * sizes], axis=1), children)


def box(ni: int, nj: int, nk: int, origin: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
    """Slightly curved lattice points of a box with unit spacing; neighbours share their nodes bit for bit."""
    i, j, k = np.meshgrid(*(np.arange(n) + o for n, o in zip((ni, nj, nk), origin, strict=True)), indexing="ij")
    return np.stack([i + 0.1 * np.sin(j + k), j + 0.1 * np.cos(i), k + 0.05 * i * j], axis=-1)


def zone_bc(*conditions: N) -> N:
    return N("ZoneBC", "ZoneBC_t", None, list(conditions))


def bc(name: str, kind: str, points: Any, *more: N, point_set: str = "PointRange") -> N:
    """A boundary condition; ``points`` is 1-based, one row per point."""
    label = "IndexRange_t" if point_set.endswith("Range") else "IndexArray_t"
    indices = np.asarray(points, np.int32).T
    return N(name, "BC_t", kind, [N(point_set, label, indices), *more])


def connectivity(*nodes: N) -> N:
    return N("ZoneGridConnectivity", "ZoneGridConnectivity_t", None, list(nodes))


def one_to_one(name: str, donor: str, own: Any, other: Any, transform: Any = None, *more: N) -> N:
    children = [
        N("PointRange", "IndexRange_t", np.asarray(own, np.int32).T),
        N("PointRangeDonor", "IndexRange_t", np.asarray(other, np.int32).T),
    ]
    if transform is not None:
        children.append(N("Transform", '"int[IndexDimension]"', np.asarray(transform, np.int32)))
    return N(name, "GridConnectivity1to1_t", donor, [*children, *more])


def words(*texts: str) -> np.ndarray:
    """Strings of 32 characters, as in DimensionalUnits_t."""
    return np.frombuffer("".join(t.ljust(32) for t in texts).encode(), np.int8).reshape(-1, 32).T


def periodic(center: Any, angle: Any, translation: Any, *units: N) -> N:
    named = {"RotationCenter": center, "RotationAngle": angle, "Translation": translation}
    arrays = [N(name, "DataArray_t", np.asarray(data, np.float32)) for name, data in named.items()]
    motion = N("Periodic", "Periodic_t", None, [*arrays, *units])
    return N("GridConnectivityProperty", "GridConnectivityProperty_t", None, [motion])


def two_zones() -> N:
    """Two boxes side by side along i, joined one to one, with named walls and a family."""
    wall = N("FamilyName", "FamilyName_t", "Wing")
    left = zone(
        "left",
        box(4, 3, 5),
        zone_bc(
            bc("body", "BCWallViscous", [[1, 1, 1], [1, 3, 5]], wall),
            bc("top", "FamilySpecified", [[1, 1, 5], [4, 3, 5]], replace(wall, data="Base/Wing")),
        ),
        connectivity(one_to_one("to right", "right", [[4, 1, 1], [4, 3, 5]], [[1, 1, 1], [1, 3, 5]], [1, 2, 3])),
    )
    right = zone(
        "right",
        box(3, 3, 5, (3, 0, 0)),
        zone_bc(bc("body", "BCFarfield", [[3, 1, 1], [3, 3, 5]])),
        connectivity(one_to_one("to left", "Base/left", [[1, 1, 1], [1, 3, 5]], [[4, 1, 1], [4, 3, 5]])),
    )
    return tree(left, right, more=[N("Wing", "Family_t", None, [N("FamilyBC", "FamilyBC_t", "BCWall")])])


def listing(path: Path) -> list[tuple[Any, ...]]:
    """Everything in an HDF5 file in creation order: groups, attributes with their types, datasets, links."""
    found: list[tuple[Any, ...]] = []

    def visit(group: h5py.Group, path: str) -> None:
        for key in sorted(group.attrs):
            attribute, value = group.attrs.get_id(key), np.asarray(group.attrs[key]).tobytes()
            kind = attribute.get_type()
            found.append((path, key, attribute.shape, kind.get_class(), kind.get_size(), value))
        for name in group:
            link = group.get(name, getlink=True)
            if not isinstance(link, h5py.HardLink):
                found.append((path, name, type(link).__name__, *vars(link).values()))
            elif isinstance(data := group[name], h5py.Dataset):
                packing = data.chunks, data.compression
                found.append((path, name, data.shape, data.dtype.str, *packing, data[()].tobytes()))
            else:
                found.append((path, name))
                visit(group[name], f"{path}/{name}")

    with h5py.File(path, "r") as file:
        visit(file, "")
    return found


def differences(a: Path, b: Path, ignore: Callable[[tuple[Any, ...]], bool]) -> list[tuple[Any, ...]]:
    """Entries of the two listings that differ, except those to ``ignore``."""
    first, second = listing(a), listing(b)
    assert [entry[:2] for entry in first] == [entry[:2] for entry in second]
    return [x for x, y in zip(first, second, strict=True) if x != y and not ignore(x)]


def assert_cgnscheck_finds_no_error(path: Path) -> None:
    """Let the CGNS library's own tool judge a file, where it is installed.

    Up to version 3.4 it expects as many values at the faces of a zone as at its nodes, unlike ``cg_sol_size`` of the
    same library and the standard.
    """
    if shutil.which("cgnscheck") is None:
        return
    report = subprocess.run(["cgnscheck", str(path)], capture_output=True, text=True, timeout=60, check=True).stdout
    assert "checking complete" in report
    mistaken = re.compile(r'(checking solution field "[^"]*")\nERROR:bad dimension values$', re.MULTILINE)
    sections = re.split(r"^ *(?=checking )(?!checking solution field)", report, flags=re.MULTILINE)
    at_faces = re.compile(r'checking solution "FlowSolution[IJK]FaceCenter(#\d+)?"')
    judged = [mistaken.sub(r"\1", each) if at_faces.match(each) else each for each in sections]
    assert not [each for each in judged if "ERROR" in each]
