"""A CGNS file as a tree of nodes, the same for both containers (ADF and HDF5).

Every node has a name, a label (its type in the standard, ``Zone_t``), a data type (``R8``, ``MT`` for none), the
dimensions of its data with the fastest index first, and children in file order. Children and data are read on first
access. Source: CGNS SIDS File Mapping Manual.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.errors import FormatError

from ..text import distinct

NAME_LENGTH = 32
# Real trees are about ten levels deep; a file with deeper nesting is damaged or malicious.
MAXIMUM_DEPTH = 64
# A longer chain of links is circular (the CGNS library has the same limit).
_MOST_LINKS = 100

# Labels of nodes whose names the standard prescribes (some followed by a number); others are the user's choice.
_PRESCRIBED = {
    *("AdditionalFamilyName_t", "BaseIterativeData_t", "DataConversion_t", "DimensionalUnits_t", "FamilyBC_t"),
    *("FamilyName_t", "GridConnectivityProperty_t", "GridConnectivityType_t", "GridCoordinates_t", "GridLocation_t"),
    *("Periodic_t", "Rind_t", "ZoneBC_t", "ZoneGridConnectivity_t", "ZoneType_t"),
}
# Beginnings of names of nodes of which nothing is read.
_UNREAD = (
    *("Axisymmetry", "BaseIterativeData", "CGNSLibraryVersion", "ConvergenceHistory", "DataClass", "Descriptor"),
    *("DimensionalUnits", "FlowEquationSet", "FlowSolution", "GlobalConvergenceHistory", "Gravity", "Information"),
    *("IntegralData", "ReferenceState", "RotatingCoordinates", "UserDefinedData"),
)

# The two-letter data types in memory.
DTYPES: dict[str, np.dtype[Any]] = {
    "B1": np.dtype(np.uint8),
    "C1": np.dtype(np.int8),
    "I4": np.dtype(np.int32),
    "I8": np.dtype(np.int64),
    "U4": np.dtype(np.uint32),
    "U8": np.dtype(np.uint64),
    "R4": np.dtype(np.float32),
    "R8": np.dtype(np.float64),
    "X4": np.dtype(np.complex64),
    "X8": np.dtype(np.complex128),
}


def is_adf(path: Path) -> bool:
    """Whether a file begins like an ADF file."""
    try:
        with path.open("rb") as stream:
            return b"ADF Database Version" in stream.read(32)
    except OSError as error:
        raise FormatError(f"cannot read {path}: {error.strerror or error}") from error


@dataclass(frozen=True)
class Link:
    """Target of a link node: a node path in another file, or in its own file if ``file`` is empty."""

    file: str
    path: str

    def __str__(self) -> str:
        return f"{self.file}:{self.path}" if self.file else self.path


@dataclass(eq=False)
class Node:
    """One node. ``target`` is the node itself or, for a link, the node it points to.

    Containers derive from it and override the ``fetch_`` methods, ``require_stored`` and ``place``.

    Attributes
    ----------
    file, path : where it is stored
    dtype : of the stored values (byte order included), ``None`` without data
    """

    name: str
    file: Path = Path()
    path: str = ""
    label: str = ""
    data_type: str = "MT"
    dims: tuple[int, ...] = ()
    dtype: np.dtype[Any] | None = None
    link: Link | None = None

    def fetch_children(self) -> Iterable[Node]:
        return ()

    def fetch_values(self) -> NDArray[Any]:
        """The values of shape ``dims``, possibly a view of the file."""
        return np.empty(0, np.uint8)

    def fetch_target(self) -> Node | None:
        """The node, possibly a link itself, to which a link leads; ``None`` if there is none."""
        return None

    def require_stored(self) -> None:
        """Raise FormatError when less is stored than ``dims`` declare, before memory is allocated."""

    def place(self) -> int | None:
        """Offset of the values in ``file``, if they are stored contiguously and unchanged."""
        return None

    @cached_property
    def children(self) -> tuple[Node, ...]:
        """Children in file order, without following links."""
        return tuple(self.fetch_children())

    @property
    def target(self) -> Node:
        """The node with label, data and children; an empty node for a link that is broken or circular."""
        # Not cached: a node that refers to itself would be freed late, and with it an open file.
        return self if self.link is None else self.followed

    @cached_property
    def followed(self) -> Node:
        """The node to which this link leads in the end."""
        node: Node | None = self
        # What a link finds that leads through itself.
        self.__dict__["followed"] = nothing = Node(self.name, self.file, self.path)
        for _ in range(_MOST_LINKS):
            if node is None or node.link is None:
                return node or nothing
            node = node.fetch_target()
        return nothing

    @property
    def dangling(self) -> bool:
        """Whether it is a link whose target cannot be found."""
        return self.link is not None and not self.target.label

    def child(self, name: str) -> Node | None:
        """The child of that name, with links followed, which must not be broken; ``None`` if there is none."""
        child = self.target.by_name.get(name)
        if child is not None:
            child.require_target()
        return child and child.target

    def labelled(self, label: str) -> list[Node]:
        """Children of that label in file order, under their names here (links are not followed).

        A broken link that could be one of them, by the names that the standard prescribes, is refused.
        """
        for child in self.target.broken_links:
            prescribed = child.name.startswith(label.removesuffix("_t"))
            if prescribed if label in _PRESCRIBED else not child.name.startswith(_UNREAD):
                child.require_target()
        return list(self.target.by_label.get(label, ()))

    @cached_property
    def broken_links(self) -> tuple[Node, ...]:
        """The children whose targets cannot be found."""
        return tuple(child for child in self.children if child.dangling)

    # Cached for files of thousands of zones, each of which looks up the units of the base.
    @cached_property
    def by_name(self) -> dict[str, Node]:
        """The first child of every name."""
        return {child.name: child for child in reversed(self.children)}

    @cached_property
    def by_label(self) -> dict[str, list[Node]]:
        """The children of every label, in file order."""
        found: dict[str, list[Node]] = {}
        for child in self.children:
            found.setdefault(child.target.label, []).append(child)
        return found

    def require_target(self) -> None:
        """Refuse a broken link: its target would be missing without any message."""
        if self.dangling:
            raise FormatError(
                f"{self.path} is a broken link to {self.link}; put that file next to this one, or "
                "remove the link from the file"
            )

    @property
    def contents(self) -> str:
        """Description of the data for messages, e.g. ``3 x 2 R8 values``."""
        node = self.target
        return f"{' x '.join(map(str, node.dims))} {node.data_type} values" if node.dims else "no values"

    def data(self) -> NDArray[Any]:
        """The node's values of shape ``dims``, fastest index first; possibly a view of the file."""
        return self.target.fetch_values()

    def text(self) -> str:
        """Character data as one string without trailing blanks; empty without data."""
        return decoded(self.data().tobytes(order="F"))

    def words(self) -> list[str]:
        """Character data of several strings of ``dims[0]`` characters each."""
        raw = self.data().tobytes(order="F")
        width = max(self.target.dims[0], 1) if self.target.dims else 1
        return [decoded(raw[at : at + width]) for at in range(0, len(raw), width)]

    def integers(self, *dims: int) -> NDArray[np.int64]:
        """Integer data of exactly these dimensions; ``-1`` stands for any size."""
        found = self.target
        fits = len(found.dims) == len(dims) and all(n in (-1, m) for n, m in zip(dims, found.dims, strict=True))
        if not fits or found.dtype is None or found.dtype.kind not in "iu" or found.data_type == "C1":
            wanted = " x ".join("n" if n < 0 else str(n) for n in dims)
            raise FormatError(
                f"{self.path} holds {self.contents}; expected {wanted} integers (I4 or I8), which the CGNS standard "
                f"requires here"
            )
        return found.data().astype(np.int64)


@dataclass(eq=False)
class NewNode(Node):
    """A node in memory, to be written.

    Of one with ``placed`` instead of a ``value`` only type and ``dims`` are known: when it is written, ``placed`` is
    called with the offset and the number of the bytes for its values, so that these can be written later.
    """

    value: NDArray[Any] | None = None
    members: Sequence[Node] = ()
    placed: Callable[[int, int], object] | None = None

    def fetch_children(self) -> Iterable[Node]:
        return self.members

    def fetch_values(self) -> NDArray[Any]:
        return np.empty(0, np.uint8) if self.value is None else self.value


def make(name: str, label: str, value: str | NDArray[Any] | None = None, members: Sequence[Node] = ()) -> Node:
    """A node in memory; ``value`` is text or an array (fastest index first)."""
    node = NewNode(name, label=label, members=members)
    if value is not None:
        node.value = np.frombuffer(value.encode(), np.int8) if isinstance(value, str) else value
        node.dims, node.dtype, node.data_type = node.value.shape, node.value.dtype, data_type_of(node.value.dtype)
    return node


def data_type_of(dtype: np.dtype[Any]) -> str:
    """The CGNS name of a type in memory, e.g. ``R8``."""
    for name, known in DTYPES.items():
        if known == dtype.newbyteorder("="):
            return name
    raise FormatError(f"CGNS has no data type for {dtype}")


def decoded(raw: bytes) -> str:
    """Text up to the first NUL without trailing blanks. Old files hold Latin-1, new ones UTF-8."""
    raw = raw.split(b"\0", 1)[0].rstrip()
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")


def unique_names(names: Iterable[str], otherwise: str, taken: Iterable[str] = ()) -> tuple[str, ...]:
    """The names as CGNS allows them: without slashes, cut to 32 bytes, numbered where they repeat each other or
    ``taken`` ones. ``otherwise`` replaces empty names."""
    cut = (name.replace("/", "_").strip().encode()[:NAME_LENGTH].decode(errors="ignore") for name in names)
    return distinct((name.strip(". ") or otherwise for name in cut), taken, NAME_LENGTH)
