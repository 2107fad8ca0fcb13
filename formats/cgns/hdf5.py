"""CGNS trees in HDF5: a node is a group, its data the dataset `` data``, name, label and type are attributes.

A link is a group of type ``LK`` with a soft or external HDF5 link `` link`` and the texts `` path`` and `` file``.
Dimensions are stored in reverse, because HDF5 counts the slowest index first. Trees are written as by the CGNS library.
Source: CGNS SIDS File Mapping Manual, HDF5 mapping, and output of the public CGNS library.

Files of hundreds of zones have tens of thousands of nodes, for which h5py's high-level interface takes twice as long as
the calls used here. Nodes keep no open group, which takes some 10 kB of memory, but their path.
"""

from __future__ import annotations

import io
import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5, h5a, h5d, h5f, h5g, h5i, h5l, h5o, h5p, h5s, h5t
from numpy.typing import NDArray

from meshdeform_core import interruption
from meshdeform_core.errors import FormatError

from ..files import reason_of
from .tree import DTYPES, MAXIMUM_DEPTH, NAME_LENGTH, Link, NewNode, Node, decoded

# Members of a group that are no child nodes; CGNS names never begin with a blank.
DATA, LINK, LINK_PATH, LINK_FILE = " data", " link", " path", " file"
_OLD_VERSION = b" version"
# Deflate cannot compress more; a dataset that declares more was never written or is damaged.
_MAXIMUM_COMPRESSION = 1100
# Headers take ten times these bytes in memory. Zones are read one after the other, so that a small cache is as fast.
_CACHE_BYTES = 2 << 20


def _text_type(length: int) -> tuple[h5t.TypeStringID, np.dtype[Any]]:
    """A type of text in a file and in memory: asking for the latter takes as long as writing a value of it."""
    kind = h5t.C_S1.copy()
    kind.set_size(length + 1)
    return kind, kind.dtype


_NAMED, _TYPED = _text_type(NAME_LENGTH), _text_type(2)
# Longer than any text attribute of a node.
_TEXT, _TEXT_DTYPE = _text_type(255)
# The types in most files, which are recognised in a fraction of the time that h5py takes to describe a type.
_TYPES = {dtype: h5t.py_create(dtype) for dtype in DTYPES.values()}


@contextmanager
def hdf5_errors(path: Path, action: str) -> Iterator[None]:
    """Turn errors of the HDF5 library into a FormatError about ``path``; ``action`` is ``read`` or ``write``."""
    try:
        yield
    # A damaged file makes h5py raise ValueError and TypeError as well.
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        if isinstance(error, OSError) and error.errno:
            raise FormatError(f"cannot {action} {path}: {reason_of(error)}") from error
        hint = "it is damaged, truncated or open in another program" if action == "read" else "is the disk full?"
        raise FormatError(f"cannot {action} {path} as HDF5: {hint} ({str(error).strip()})") from error


@contextmanager
def opened_hdf5(path: Path) -> Iterator[Node]:
    """Root node of a CGNS file in HDF5; children and data can be read while the context lasts."""
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file:
        # The library caches the headers of hundreds of nodes, but not of all.
        cache = file.id.get_mdc_config()
        cache.set_initial_size, cache.initial_size = True, _CACHE_BYTES
        cache.min_size = cache.max_size = _CACHE_BYTES
        file.id.set_mdc_config(cache)
        root = h5g.open(file.id, b"/")
        if _OLD_VERSION in root:
            raise FormatError(
                f"{path} was written by a CGNS library before 3.0, which stored dimensions in another order; "
                f"open and save it once with cgnsupdate or a current CGNS library"
            )
        yield _Hdf5Node("", path, root=root, has_members=True)


def external_targets(path: Path) -> list[Path]:
    """The files that the external links of a file lead to, unless they are broken."""
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file:
        found = [_linked(h5g.open(file.id, b"/"), name) for name in external_links(file)]
        return [node.file for node in found if node and node.target.label]


def external_links(file: h5py.File) -> list[bytes]:
    """The paths of all external links in an open file."""
    names: list[bytes] = []
    root = h5g.open(file.id, b"/")
    root.links.visit(lambda name, info: names.append(name) if info.type == h5l.TYPE_EXTERNAL else None, info=True)
    return names


@dataclass(eq=False, kw_only=True)
class _Hdf5Node(Node):
    """A node below the group ``root`` of its file; of a link, ``link_place`` is that of the HDF5 link."""

    root: h5g.GroupID
    has_members: bool = False
    offset: int | None = None
    link_place: bytes = b""

    def fetch_children(self) -> Iterator[Node]:
        if not self.has_members:
            return
        group = h5o.open(self.root, self.path.encode() or b"/")
        for raw, hard in _in_order(group):
            name = _name(raw, self.file, self.path)
            path = f"{self.path}/{name}"
            if hard:
                yield _node(self.root, h5o.open(group, raw), name, self.file, path)
            else:
                link = group.links.get_val(raw)
                place = link if isinstance(link, tuple) else (b"", link)
                words = Link(*(_name(part, self.file, path) for part in place))
                yield _Hdf5Node(
                    name, self.file, path, data_type="LK", link=words, root=self.root, link_place=path.encode()
                )

    def fetch_values(self) -> NDArray[Any]:
        if not self.dims:
            return super().fetch_values()
        self.require_stored()
        values = np.empty(self.dims[::-1], self.dtype)
        self._dataset().read(h5s.ALL, h5s.ALL, values, _TYPES.get(values.dtype))
        return values.T

    def fetch_target(self) -> Node | None:
        return _linked(self.root, self.link_place)

    def require_stored(self) -> None:
        if self.offset is not None or not self.dims:
            return
        dataset = self._dataset()
        layout = dataset.get_create_plist()
        if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
            raise FormatError(
                f"{self.file}: the values of {self.path} lie in other files (virtual or external HDF5 dataset); merge "
                f"them"
            )
        stored = dataset.get_storage_size()
        if math.prod(dataset.shape) * dataset.dtype.itemsize > stored * _MAXIMUM_COMPRESSION:
            raise FormatError(
                f"{self.file}: {self.path} declares {dataset.shape} {dataset.dtype} values; only {stored} bytes are "
                f"stored"
            )

    def place(self) -> int | None:
        return self.offset

    def _dataset(self) -> h5d.DatasetID:
        return h5d.open(self.root, f"{self.path}/{DATA}".encode())


def _node(root: h5g.GroupID, group: h5g.GroupID, name: str, file: Path, path: str) -> Node:
    """The node of a group."""
    try:
        label, data_type = attribute(group, b"label"), attribute(group, b"type").upper()
    except KeyError:
        label = data_type = ""
    if not data_type or not isinstance(group, h5g.GroupID):
        raise FormatError(
            f"{file} is HDF5 but not CGNS: {path} is not a group with the attributes label and type, "
            f"which every CGNS node has"
        )
    if data_type == "LK":
        link = Link(_hidden_text(group, LINK_FILE), _hidden_text(group, LINK_PATH))
        place = f"{path}/{LINK}".encode()
        return _Hdf5Node(name, file, path, data_type="LK", link=link, root=root, link_place=place)
    members = group.get_num_objs()
    node = _Hdf5Node(name, file, path, label, data_type, root=root, has_members=members > 0)
    if data_type != "MT" and members and group.links.exists(DATA.encode()):
        dataset = h5d.open(group, DATA.encode())
        node.has_members = members > 1
        node.dims, node.dtype = dataset.shape[::-1], DTYPES.get(data_type)
        if node.dtype is not None:
            node.offset = place_of(dataset, node.dtype)
        if node.offset is None:
            node.dtype = dataset.dtype
            node.offset = place_of(dataset, node.dtype)
    return node


def place_of(dataset: h5d.DatasetID, dtype: np.dtype[Any]) -> int | None:
    """Offset of an array of ``dtype`` in its file; ``None`` if it is stored in pieces, compressed, in other files, not
    at all, or as other bytes than in memory."""
    if not dataset.get_type().equal(_TYPES.get(dtype) or h5t.py_create(dtype)):
        return None
    place: int | None = dataset.get_offset()
    return place if math.prod(dataset.shape) * dtype.itemsize <= dataset.get_storage_size() else None


def attribute(group: h5g.GroupID, name: bytes) -> str:
    """A text attribute; writers differ in string type and padding."""
    stored = h5a.open(group, name)
    shape = stored.shape
    if shape == ():
        value = np.empty((), _TEXT_DTYPE)
        try:
            stored.read(value, _TEXT)
            return decoded(value.item())
        except OSError:
            # Text of variable length, or a number.
            pass
    value = np.empty(shape, stored.dtype)
    stored.read(value)
    return decoded(value[()].encode() if isinstance(value[()], str) else np.asarray(value[()]).tobytes())


def _in_order(group: h5g.GroupID) -> list[tuple[bytes, bool]]:
    """Names of the child nodes, in the order of creation, and whether each is in the group itself, not linked.

    By the attribute ``order`` if HDF5 did not track creation.
    """
    found: list[tuple[bytes, bool]] = []

    def add(name: bytes, info: h5l.LinkInfo) -> None:
        if not name.startswith(b" "):
            found.append((name, info.type == h5l.TYPE_HARD))

    tracked = group.get_create_plist().get_link_creation_order() & h5p.CRT_ORDER_TRACKED
    group.links.iterate(add, idx_type=h5.INDEX_CRT_ORDER if tracked else h5.INDEX_NAME, info=True)
    if tracked:
        return found
    members = h5py.Group(group)
    return sorted(found, key=lambda each: int(np.ravel(members[each[0]].attrs.get("order", 0))[0]))


def _linked(root: h5g.GroupID, place: bytes) -> Node | None:
    """The node to which an HDF5 link leads; ``None`` if it is broken."""
    try:
        target, words = h5o.open(root, place), root.links.get_val(place)
    except (KeyError, OSError):
        return None
    raw = words[1] if isinstance(words, tuple) else words
    # The path as it was followed grows with every turn through links that form a loop.
    path = (raw if raw.startswith(b"/") else h5i.get_name(target)).rstrip(b"/").decode()
    file = h5i.get_file_id(target)
    return _node(h5g.open(file, b"/"), target, path.rsplit("/", 1)[-1], Path(h5f.get_name(file).decode()), path)


def _name(raw: bytes, file: Path, parent: str) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise FormatError(f"{file}: the name {raw!r} in {parent or '/'} is not UTF-8; rename it") from error


def _hidden_text(group: h5g.GroupID, name: str) -> str:
    if name.encode() not in group:
        return ""
    return decoded(h5py.Group(group)[name][()].tobytes())


_SCALAR, _ONE = h5s.create(h5s.SCALAR), h5s.create_simple((1,))
_FLAGS = np.ones(1, np.int32)
# Datasets without time stamps, so that equal grids yield equal files.
_TIMELESS = h5p.create(h5p.DATASET_CREATE)
_TIMELESS.set_obj_track_times(False)
# Groups track the order in which their members are created.
_ORDERED = h5p.create(h5p.GROUP_CREATE)
_ORDERED.set_link_creation_order(h5p.CRT_ORDER_TRACKED | h5p.CRT_ORDER_INDEXED)
_ORDERED.set_obj_track_times(False)


def write_hdf5(tree: Node, path: Path) -> None:
    """Write a whole tree as a new CGNS file in HDF5, as the CGNS library would.

    Links within the file remain links. The target of a link to another file is copied into the new file, because HDF5
    links may be unable to reach it; if it is missing, the link is kept.
    """
    with hdf5_output(path, "w", libver=("earliest", "v108"), track_order=True) as (file, _):
        root = h5g.open(file.id, b"/")
        _describe(root, "HDF5 MotherNode", "Root Node of HDF5 File", "MT")
        file[" format"] = characters(f"IEEE_{sys.byteorder.upper()}_32")
        version = f"HDF5 Version {h5py.version.hdf5_version}"
        file[" hdf5version"] = np.frombuffer(version.encode().ljust(NAME_LENGTH + 1, b"\0"), np.int8)
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
        _write_dataset(group, LINK_PATH, characters(path))
        if file:
            _write_dataset(group, LINK_FILE, characters(file))
    else:
        _fill_group(group, content, home, depth)


def _fill_group(group: h5g.GroupID, node: Node, home: Path, depth: int) -> None:
    if isinstance(node, NewNode) and node.placed:
        node.placed(*reserve_dataset(group, DATA, node.dims[::-1], DTYPES[node.data_type]))
    elif node.dims:
        _write_dataset(group, DATA, np.ascontiguousarray(node.data().T, dtype=DTYPES.get(node.data_type)))
    for child in node.children:
        _write(group, child, home, depth + 1)


def _write_dataset(group: h5g.GroupID, name: str, values: NDArray[Any]) -> None:
    """Create a dataset of ``values``, which must be C-contiguous."""
    kind = _TYPES.get(values.dtype) or h5t.py_create(values.dtype, logical=True)
    dataset = h5d.create(group, name.encode(), kind, h5s.create_simple(values.shape), dcpl=_TIMELESS)
    dataset.write(h5s.ALL, h5s.ALL, values, kind)


def reserve_dataset(group: h5g.GroupID, name: str, shape: tuple[int, ...], dtype: np.dtype[Any]) -> tuple[int, int]:
    """Create a dataset whose values will be written to the file itself; returns the place of the first byte and
    the number of bytes."""
    properties = _TIMELESS.copy()
    properties.set_alloc_time(h5d.ALLOC_TIME_EARLY)
    properties.set_fill_time(h5d.FILL_TIME_NEVER)
    dataset = h5d.create(group, name.encode(), _TYPES[dtype], h5s.create_simple(shape), properties)
    return int(dataset.get_offset()), int(dataset.get_storage_size())


def _describe(group: h5g.GroupID, name: str, label: str, data_type: str) -> None:
    texts = (b"name", name, _NAMED), (b"label", label, _NAMED), (b"type", data_type, _TYPED)
    for key, text, (kind, dtype) in texts:
        h5a.create(group, key, kind, _SCALAR).write(np.array(text.encode(), dtype=dtype), kind)


def characters(text: str) -> NDArray[np.int8]:
    """Text in the form that CGNS stores with a link, with a final NUL."""
    return np.frombuffer(text.encode() + b"\0", np.int8)


# --- output that survives a full disk

# The HDF5 library cannot close a file whose last bytes it failed to write: it prints errors, keeps the file open, and
# may crash the process at exit. It therefore writes through an object that reports no failure to the library; the first
# failure is recorded, later writes are dropped, and the failure is raised when the file is closed.

_BUFFER = 1 << 20


@contextmanager
def hdf5_output(path: Path, mode: str, **options: Any) -> Iterator[tuple[h5py.File, Unfailing]]:
    """An HDF5 file open for writing, and its bytes: ``mode`` is ``w`` or ``r+``, ``options`` those of ``h5py.File``.

    Raises OSError at the end of the block, if anything could not be written. Raises FormatError when the library failed
    for another reason.
    """
    raw = Unfailing(path, "w+" if mode == "w" else mode)
    # The library writes the headers of thousands of nodes one by one, mostly in ascending order.
    sink = io.BufferedRandom(raw, _BUFFER)
    try:
        # An exception from a signal handler must not pass through the library either.
        with interruption.deferred(), h5py.File(sink, mode, **options) as file:
            yield file, raw
    except (OSError, RuntimeError, KeyError, ValueError, TypeError) as error:
        raise raw.failure or error from error
    finally:
        # A file that could not be closed comes first; h5py identifies it by the object that it was opened with.
        for left in h5f.get_obj_ids(h5f.OBJ_ALL, h5f.OBJ_FILE):
            if left.valid and left.name == repr(sink).encode():
                h5py.File(left).close()
        sink.close()
    if raw.failure is not None:
        raise raw.failure


class Unfailing(io.FileIO):
    """After an error of the system, ``failure``, nothing more is written; ``changed``: other bytes than before were."""

    failure: OSError | None = None
    changed = False

    def write(self, data: Any) -> int:
        if not self.changed:
            at = self.tell()
            self.changed = super().read(len(data)) != data
            self.seek(at)
        if self.failure is None and interruption.requested() is None:
            try:
                return super().write(data)
            except OSError as error:
                self.failure = error
        self.seek(len(data), os.SEEK_CUR)
        return len(data)

    def readinto(self, buffer: Any) -> int:
        """Bytes that were not written are zeros."""
        count = super().readinto(buffer)
        if self.failure is not None:
            buffer[count:] = bytes(len(buffer) - count)
        return count if self.failure is None else len(buffer)

    def truncate(self, size: int | None = None) -> int:
        if self.failure is None:
            try:
                return super().truncate(size)
            except OSError as error:
                self.failure = error
        return self.tell() if size is None else size
