"""Read CGNS trees in HDF5: a node is a group, its data the dataset `` data``, name, label and type are attributes.

A link is a group of type ``LK`` with a soft or external HDF5 link `` link`` and the texts `` path`` and `` file``.
Dimensions are stored in reverse, because HDF5 counts the slowest index first. Source: CGNS SIDS File Mapping Manual,
HDF5 mapping, and output of the public CGNS library.

Files of hundreds of zones have tens of thousands of nodes, for which h5py's high-level interface takes twice as long as
the calls used here, and these several times as long as :mod:`.headers`, which reads most of them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5, h5a, h5ac, h5d, h5g, h5l, h5o, h5p, h5s, h5t
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from ...files import reason_of
from .headers import Headers, Member
from .tree import DTYPES, Link, Node, decoded

# Members of a group that are no child nodes; CGNS names never begin with a blank.
DATA = " data"
_DATA = DATA.encode()
LINK = " link"
LINK_PATH = " path"
LINK_FILE = " file"
_OLD_VERSION = b" version"
# Deflate cannot compress more; a dataset that declares more was never written or is damaged.
_MAXIMUM_COMPRESSION = 1100
_FEW_BYTES = 1024
# Headers take ten times these bytes in memory. Zones are read one after the other, so that a small cache is as fast.
_CACHE_BYTES = 2 << 20
# A longer chain of links is circular (the CGNS library has the same limit).
_MAXIMUM_LINKS = 100
# Longer than any text attribute of a node, which have 32 characters.
_TEXT = h5t.C_S1.copy()
_TEXT.set_size(256)
_TEXT_DTYPE = _TEXT.dtype
# The types in most files, which are recognised in a fraction of the time that h5py takes to describe a type.
_NATIVE = {name: h5t.py_create(dtype) for name, dtype in DTYPES.items()}
_NATIVE_TYPES = {DTYPES[name]: kind for name, kind in _NATIVE.items()}


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


@dataclass(frozen=True)
class _Parent:
    """The parent of nodes, a group of ``file``; ``headers`` if its members may be read without the library."""

    file: Path
    path: str
    group: Callable[[], h5g.GroupID]
    headers: Headers | None = None


@contextmanager
def opened_hdf5(path: Path) -> Iterator[Node]:
    """Root node of a CGNS file in HDF5; children and data can be read while the context lasts."""
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file, path.open("rb") as stream:
        file.id.set_mdc_config(_small_cache(file))
        root = h5g.open(file.id, b"/")
        if _OLD_VERSION in root:
            raise FormatError(
                f"{path} was written by a CGNS library before 3.0, which stored dimensions in another order; "
                f"open and save it once with cgnsupdate or a current CGNS library"
            )
        headers = Headers(stream)
        parent = _Parent(path, "", lambda: root, headers if headers.usual and file.driver == "sec2" else None)
        yield Node("", path, "", expand=lambda: _children(parent, _in_order(root)))
        if not headers.all_right():
            raise OSError("the checksum of a header is wrong")


def _small_cache(file: h5py.File) -> h5ac.CacheConfig:
    """Settings that let the library cache the headers of hundreds of nodes, but not of all."""
    config = file.id.get_mdc_config()
    config.set_initial_size, config.initial_size = True, _CACHE_BYTES
    config.min_size = config.max_size = _CACHE_BYTES
    return config


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


def _children(parent: _Parent, members: Iterable[Member]) -> Iterator[Node]:
    for _, name, address in members:
        text = _name(name, parent.file, parent.path)
        path = f"{parent.path}/{text}"
        if address is None:
            group = parent.group()
            link = Link(*(_name(part, parent.file, path) for part in _destination(group, name)))
            yield Node(text, parent.file, path, data_type="LK", link=link, follow=partial(_follow, group, name, 1))
        else:
            known = _known(parent, text, path, address)
            yield known or _node(h5o.open(parent.group(), name), parent.file, path, parent.headers)


def _known(parent: _Parent, name: str, path: str, address: int) -> Node | None:
    """The node with the header at this address; ``None`` if the library must read it."""
    headers = parent.headers
    group = headers.group(address) if headers else None
    if headers is None or group is None:
        return None
    data_type = decoded(group.data_type).upper()
    node = Node(name, parent.file, path, decoded(group.label), data_type)
    data = [member.address for member in group.members if member.name == _DATA and data_type != "MT"]
    if data:
        array = None if data[0] is None else headers.array(data[0])
        if array is None:
            return None
        node.dims, node.dtype = array.shape[::-1], array.dtype
        node.read, node.place = lambda: headers.values(array).T, lambda: array.place
    members = [member for member in group.members if not member.name.startswith(b" ")]
    if members:
        own = _Parent(parent.file, path, lambda: h5o.open(parent.group(), name.encode()), headers)
        node.expand = lambda: _children(own, members)
    return node if data_type not in ("", "LK") else None


def _name(raw: bytes, file: Path, parent: str) -> str:
    try:
        return raw.decode()
    except UnicodeDecodeError as error:
        raise FormatError(f"{file}: the name {raw!r} in {parent or '/'} is not UTF-8; rename it") from error


def _in_order(group: h5g.GroupID) -> list[Member]:
    """The links to child nodes in creation order.

    By the attribute ``order`` if HDF5 did not track creation.
    """
    found: list[Member] = []

    def add(name: bytes, info: h5l.LinkInfo) -> None:
        if not name.startswith(b" "):
            found.append(Member(info.corder, name, info.u if info.type == h5l.TYPE_HARD else None))

    tracked = group.get_create_plist().get_link_creation_order() & h5p.CRT_ORDER_TRACKED
    group.links.iterate(add, idx_type=h5.INDEX_CRT_ORDER if tracked else h5.INDEX_NAME, info=True)
    if tracked:
        return found
    members = h5py.Group(group)
    orders = [int(np.ravel(members[each.name].attrs.get("order", 0))[0]) for each in found]
    return sorted(each._replace(order=order) for each, order in zip(found, orders, strict=True))


def _destination(group: h5g.GroupID, name: bytes) -> tuple[bytes, bytes]:
    """File and path of the target of an HDF5 link."""
    value = group.links.get_val(name)
    return value if isinstance(value, tuple) else (b"", value)


def _node(
    group: h5g.GroupID | h5d.DatasetID, file: Path, path: str, headers: Headers | None = None, links: int = 0
) -> Node:
    """The node of a group that was reached through ``links`` links."""
    try:
        label, data_type = attribute(group, b"label"), attribute(group, b"type").upper()
    except KeyError:
        label = data_type = ""
    if not data_type or not isinstance(group, h5g.GroupID):
        raise FormatError(
            f"{file} is HDF5 but not CGNS: {path} is not a group with the attributes label and type, "
            f"which every CGNS node has"
        )
    name = path.rsplit("/", 1)[-1]
    if data_type == "LK":
        link = Link(_hidden_text(group, LINK_FILE), _hidden_text(group, LINK_PATH))
        follow = partial(_follow, group, LINK.encode(), links + 1)
        return Node(name, file, path, data_type="LK", link=link, follow=follow)
    node = Node(name, file, path, label, data_type)
    members = group.get_num_objs()
    dataset = _dataset(group) if data_type != "MT" and members else None
    if dataset:
        members -= 1
        known = _NATIVE.get(data_type)
        native = known is not None and dataset.get_type().equal(known)
        node.dims, node.dtype = dataset.shape[::-1], DTYPES[data_type] if native else dataset.dtype
        _set_values(node, group, dataset, native)
    if members:
        parent = _Parent(file, path, lambda: group, headers)
        node.expand = lambda: _children(parent, _in_order(group))
    return node


def _dataset(group: h5g.GroupID) -> h5d.DatasetID | None:
    try:
        return h5d.open(group, _DATA)
    except KeyError:
        if group.links.exists(_DATA):
            raise
        return None


def _set_values(node: Node, group: h5g.GroupID, dataset: h5d.DatasetID, native: bool) -> None:
    """Let a node provide the values of its ``dataset``; ``native``: of one of the types in memory."""
    assert node.dtype is not None
    size = math.prod(node.dims) * node.dtype.itemsize
    # Known only of a single range of bytes in the file itself.
    place: int | None = dataset.get_offset()
    stored = size <= dataset.get_storage_size()
    whole = place is not None and stored
    node.place = (lambda: place) if whole and native else partial(_place, group)
    values = _few_values(dataset, node.dims, node.dtype, whole) if stored and 0 < size <= _FEW_BYTES else None
    if values is not None:
        node.read = lambda: values.T
        return
    node.read = (lambda: _values(group)) if node.dims else node.read
    if not whole:
        node.require = partial(_require_stored, group, node.file, node.path)


def _few_values(
    dataset: h5d.DatasetID, dims: tuple[int, ...], dtype: np.dtype[Any], whole: bool
) -> NDArray[Any] | None:
    """The values of a small array that is stored in the file itself, which take less memory than an open group of the
    library (some 10 kB); ``None`` for other arrays, whose errors are reported when they are read.

    ``whole``: as a single range of bytes.
    """
    if not whole:
        layout = dataset.get_create_plist()
        if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
            return None
    try:
        values = np.empty(dims[::-1], dtype)
        dataset.read(h5s.ALL, h5s.ALL, values, _NATIVE_TYPES.get(dtype))
    except (OSError, RuntimeError, KeyError, ValueError, TypeError):
        return None
    return values


def _follow(group: h5g.GroupID, name: bytes, links: int) -> Node | None:
    if links > _MAXIMUM_LINKS:
        return None
    try:
        target = h5o.open(group, name)
    except (KeyError, OSError):  # HDF5 raises these for broken links
        return None
    place = h5py.Group(target)
    return _node(target, Path(place.file.filename), place.name, links=links)


def external_targets(path: Path) -> list[Path]:
    """The files that the external links of a file lead to, unless they are broken."""
    names: list[bytes] = []
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file:
        root = h5g.open(file.id, b"/")
        root.links.visit(lambda name, info: names.append(name) if info.type == h5l.TYPE_EXTERNAL else None, info=True)
        found = [node.target for node in (_follow(root, name, 1) for name in names) if node is not None]
        return [target.file for target in found if target.label]


def _require_stored(group: h5g.GroupID, file: Path, path: str) -> None:
    dataset = h5d.open(group, _DATA)
    layout = dataset.get_create_plist()
    if layout.get_layout() == h5d.VIRTUAL or layout.get_external_count():
        raise FormatError(
            f"{file}: the values of {path} lie in other files (virtual or external HDF5 dataset); merge them"
        )
    stored = dataset.get_storage_size()
    if math.prod(dataset.shape) * dataset.dtype.itemsize > stored * _MAXIMUM_COMPRESSION:
        raise FormatError(
            f"{file}: {path} declares {dataset.shape} {dataset.dtype} values; only {stored} bytes are stored"
        )


def _place(group: h5g.GroupID) -> int | None:
    return place_of(h5d.open(group, _DATA))


def place_of(dataset: h5d.DatasetID) -> int | None:
    """Offset of an array in its file; ``None`` if it is stored in pieces, compressed, or not at all."""
    layout = dataset.get_create_plist()
    plain = layout.get_layout() == h5d.CONTIGUOUS and not layout.get_external_count()
    if not plain or not dataset.get_type().equal(h5t.py_create(dataset.dtype)):
        return None
    place: int | None = dataset.get_offset()
    return place


def _values(group: h5g.GroupID) -> NDArray[Any]:
    dataset = h5d.open(group, _DATA)
    values = np.empty(dataset.shape, dataset.dtype)
    dataset.read(h5s.ALL, h5s.ALL, values)
    return values.T


def _hidden_text(group: h5g.GroupID, name: str) -> str:
    if name.encode() not in group:
        return ""
    return decoded(h5py.Group(group)[name][()].tobytes())
