"""Write CGNS trees in HDF5 as the CGNS library would; :mod:`.hdf5` describes the layout."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5o, h5p, h5s, h5t
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from ..hdf5_output import hdf5_output
from .hdf5 import DATA, LINK, LINK_FILE, LINK_PATH, attribute
from .tree import DTYPES, MAXIMUM_DEPTH, NAME_LENGTH, NewNode, Node

_FORMAT = " format"
_VERSION = " hdf5version"


def _text_type(length: int) -> h5t.TypeStringID:
    kind = h5t.C_S1.copy()
    kind.set_size(length + 1)
    return kind


def _timeless() -> h5p.PropDCID:
    """Creation properties of datasets without time stamps, so that equal grids yield equal files."""
    properties = h5p.create(h5p.DATASET_CREATE)
    properties.set_obj_track_times(False)
    return properties


_NAME, _TYPE = _text_type(NAME_LENGTH), _text_type(2)
# Asking the library for a type takes as long as writing a value of it.
_NAMED, _TYPED = (_NAME, _NAME.dtype), (_TYPE, _TYPE.dtype)
_KINDS = {dtype: h5t.py_create(dtype, logical=True) for dtype in DTYPES.values()}
_SCALAR, _ONE = h5s.create(h5s.SCALAR), h5s.create_simple((1,))
_FLAGS = np.ones(1, np.int32)
_TIMELESS = _timeless()
# Groups track the order in which their members are created.
_ORDERED = h5p.create(h5p.GROUP_CREATE)
_ORDERED.set_link_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
_ORDERED.set_obj_track_times(False)


def write_hdf5(tree: Node, path: Path) -> None:
    """Write a whole tree as a new CGNS file in HDF5, as the CGNS library would.

    Links within the file remain links. The target of a link to another file is copied into the new file, because HDF5
    links may be unable to reach it; if it is missing, the link is kept.
    """
    with hdf5_output(path, "w", libver=("earliest", "v108"), track_order=True) as file:
        root = h5g.open(file.id, b"/")
        _describe(root, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        file[_FORMAT] = characters(f"IEEE_{sys.byteorder.upper()}_32")
        version = f"HDF5 Version {h5py.version.hdf5_version}"
        file[_VERSION] = np.frombuffer(version.encode().ljust(NAME_LENGTH + 1, b"\0"), np.int8)
        for child in tree.children:
            _write(root, child, tree.file, 0)


def own_group(parent: h5py.Group, node: Node) -> h5py.Group:
    """The group of ``node`` in a file being written. A link is replaced by its target, in the same position, and so is
    one of several names of a group (HDF5 calls them hard links).

    Coordinates that are to change must not belong to another file or zone.
    """
    hard = isinstance(parent.get(node.name, getlink=True), h5py.HardLink)
    group = parent[node.name] if hard else None
    if group is None or has_other_names(group):
        del parent[node.name]
        _write(parent.id, node, Path(), 0)
        group = parent[node.name]
    if attribute(group.id, b"type") == "LK":
        for name in [name for name in group if name.startswith(" ")]:
            del group[name]
        for key, text in (("label", node.target.label), ("type", node.target.data_type)):
            group.attrs.modify(key, np.bytes_(text))
        _fill_group(group.id, node.target, Path(), 0)
    return group


def has_other_names(found: h5py.Group | h5py.Dataset) -> bool:
    """Whether a group or an array has several names in its file, so that a change under one shows under all."""
    return bool(h5o.get_info(found.id).rc > 1)


def put_node(parent: h5py.Group, node: Node) -> None:
    """Add a node to a file being written, replacing any node of the same name."""
    # Whether there is a link of this name, wherever it points.
    if parent.id.links.exists(node.name.encode()):
        del parent[node.name]
    _write(parent.id, node, Path(), 0)


def _write(parent: h5g.GroupID, node: Node, home: Path, depth: int) -> None:
    if depth > MAXIMUM_DEPTH:
        raise FormatError(
            f"{home}: nodes are nested more than {MAXIMUM_DEPTH} deep at {node.path}; a link forms a loop"
        )
    group = h5g.create(parent, node.name.encode(), gcpl=_ORDERED)
    keep = node.link is not None and (node.dangling or (node.file == home and not node.link.file))
    content = node if keep else node.target
    _describe(group, node.name, content.label, content.data_type)
    h5a.create(group, b"flags", h5t.NATIVE_INT32, _ONE).write(_FLAGS, h5t.NATIVE_INT32)
    if keep:
        assert node.link is not None
        file, path = node.link.file, node.link.path
        if file:
            group.links.create_external(LINK.encode(), file.encode(), path.encode())
        else:
            group.links.create_soft(LINK.encode(), b"/" + path.lstrip("/").encode())
        write_dataset(group, LINK_PATH, characters(path))
        if file:
            write_dataset(group, LINK_FILE, characters(file))
    else:
        _fill_group(group, content, home, depth)


def _fill_group(group: h5g.GroupID, node: Node, home: Path, depth: int) -> None:
    if isinstance(node, NewNode) and node.placed:
        node.placed(*reserve_dataset(group, DATA, node.dims[::-1], DTYPES[node.data_type]))
    elif node.dims:
        write_dataset(group, DATA, np.ascontiguousarray(node.data().T, dtype=DTYPES.get(node.data_type)))
    for child in node.children:
        _write(group, child, home, depth + 1)


def write_dataset(group: h5g.GroupID, name: str, values: NDArray[Any]) -> None:
    """Create a dataset of ``values``, which must be C-contiguous."""
    kind = _KINDS.get(values.dtype) or h5t.py_create(values.dtype, logical=True)
    dataset = h5d.create(group, name.encode(), kind, h5s.create_simple(values.shape), dcpl=_TIMELESS)
    dataset.write(h5s.ALL, h5s.ALL, values, kind)


def reserve_dataset(group: h5g.GroupID, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int]:
    """Create a dataset whose values will be written to the file itself; returns the place of the first byte and
    the number of bytes."""
    properties = _timeless()
    properties.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5d.FILL_TIME_NEVER)
    dataset = h5d.create(group, name.encode(), _KINDS[dtype], h5s.create_simple(shape), properties)
    return int(dataset.get_offset()), int(dataset.get_storage_size())


def _describe(group: h5g.GroupID, name: str, label: str, data_type: str) -> None:
    texts = (b"name", name, _NAMED), (b"label", label, _NAMED), (b"type", data_type, _TYPED)
    for key, text, (kind, dtype) in texts:
        h5a.create(group, key, kind, _SCALAR).write(np.array(text.encode(), dtype=dtype), kind)


def characters(text: str) -> NDArray[np.int8]:
    """Text in the form that CGNS stores with a link, with a final NUL."""
    return np.frombuffer(text.encode() + b"\0", np.int8)
