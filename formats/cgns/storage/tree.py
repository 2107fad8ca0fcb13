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

NAME_LENGTH = 32
# Real trees are about ten levels deep; a file with deeper nesting is damaged or malicious.
MAXIMUM_DEPTH = 64

# Names of nodes that the standard prescribes (some followed by a number); others are the user's choice.
_PRESCRIBED = {
    label: label.removesuffix("_t")
    for label in (
        *("AdditionalFamilyName_t", "BaseIterativeData_t", "DataConversion_t", "DimensionalUnits_t", "FamilyBC_t"),
        *("FamilyName_t", "GridConnectivityProperty_t", "GridConnectivityType_t", "GridCoordinates_t"),
        *("GridLocation_t", "Periodic_t", "Rind_t", "ZoneBC_t", "ZoneGridConnectivity_t", "ZoneType_t"),
    )
}
# Other siblings of zones and families, and of boundary conditions, with telling names.
_BESIDE_ZONES = (
    *("Axisymmetry", "BaseIterativeData", "ConvergenceHistory", "DataClass", "Descriptor", "DimensionalUnits"),
    *("FlowEquationSet", "FlowSolution", "GlobalConvergenceHistory", "Gravity", "IntegralData", "ReferenceState"),
    *("RotatingCoordinates", "UserDefinedData", "Information"),
)
_OTHERS = {
    "CGNSBase_t": ("CGNSLibraryVersion",),
    "Zone_t": _BESIDE_ZONES,
    "Family_t": _BESIDE_ZONES,
    "BC_t": ("DataClass", "Descriptor", "DimensionalUnits", "ReferenceState", "UserDefinedData"),
}

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


@dataclass(frozen=True)
class Link:
    """Target of a link node: a node path in another file, or in its own file if ``file`` is empty."""

    file: str
    path: str

    def __str__(self) -> str:
        return f"{self.file}:{self.path}" if self.file else self.path


def _no_data() -> NDArray[Any]:
    return np.empty(0, np.uint8)


def _nothing() -> None:
    return None


@dataclass(eq=False)
class Node:
    """One node. ``target`` is the node itself or, for a link, the node it points to.

    ``dtype`` is the type of the stored values (byte order included), ``None`` without data. ``read``, ``expand`` and
    ``follow`` fetch the data, the children and the link's target from the container; ``require`` raises FormatError
    when less is stored than ``dims`` declare, before memory is allocated. ``place`` is the offset of the values in
    ``file``, if they are stored contiguously and unchanged. For a node of which only type and ``dims`` are known,
    ``placed`` is called with that offset, and the bytes there are for the values, when the node is written, so that
    these can be written later.
    """

    name: str
    file: Path
    path: str
    label: str = ""
    data_type: str = "MT"
    dims: tuple[int, ...] = ()
    dtype: np.dtype[Any] | None = None
    link: Link | None = None
    read: Callable[[], NDArray[Any]] = _no_data
    require: Callable[[], object] = _nothing
    expand: Callable[[], Iterable[Node]] = tuple
    follow: Callable[[], Node | None] = _nothing
    place: Callable[[], int | None] = _nothing
    placed: Callable[[int, int], object] | None = None
    _following: bool = False

    @cached_property
    def children(self) -> tuple[Node, ...]:
        """Children in file order, without following links."""
        found = tuple(self.expand())
        # What it holds to fetch them, like an open group of the library, is no longer needed; copies need the children.
        self.expand = lambda: found
        return found

    @property
    def target(self) -> Node:
        """The node with label, data and children; an empty node for a link that is broken or circular."""
        # Not cached: a node that refers to itself would be freed late, and with it an open group of the library.
        return self if self.link is None else self._followed

    @cached_property
    def _followed(self) -> Node:
        if self._following:
            return self._empty()
        self._following = True
        found = self.follow()
        return found.target if found else self._empty()

    def _empty(self) -> Node:
        return Node(self.name, self.file, self.path)

    @property
    def dangling(self) -> bool:
        """Whether it is a link whose target cannot be found."""
        return self.link is not None and not self.target.label

    def child(self, name: str) -> Node | None:
        """The child of that name, with links followed; ``None`` if there is none.

        Raises
        ------
        FormatError
            When it is a broken link.
        """
        child = self.target._by_name.get(name)
        if child is None:
            return None
        child.require_target()
        return child.target

    def labelled(self, label: str) -> list[Node]:
        """Children of that label in file order, under their names here (links are not followed).

        Raises
        ------
        FormatError
            When a broken link could be one of them.
        """
        for child in self.target.broken_links:
            if _may_be(child.name, label):
                child.require_target()
        return list(self.target._by_label.get(label, ()))

    @cached_property
    def broken_links(self) -> tuple[Node, ...]:
        """The children whose targets cannot be found."""
        return tuple(child for child in self.children if child.link and child.dangling)

    # Cached for files of thousands of zones, each of which looks up the units of the base.
    @cached_property
    def _by_name(self) -> dict[str, Node]:
        """The first child of every name."""
        return {child.name: child for child in reversed(self.children)}

    @cached_property
    def _by_label(self) -> dict[str, list[Node]]:
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
        return describe(self.target.dims, self.target.data_type)

    def data(self) -> NDArray[Any]:
        """The node's values of shape ``dims``, fastest index first; possibly a view of the file."""
        return self.target.read()

    def text(self) -> str:
        """Character data as one string without trailing blanks; empty without data."""
        return decoded(self.data().tobytes(order="F"))

    def words(self) -> list[str]:
        """Character data of several strings of ``dims[0]`` characters each."""
        raw = self.data().tobytes(order="F")
        width = max(self.target.dims[0], 1) if self.target.dims else 1
        return [decoded(raw[at : at + width]) for at in range(0, len(raw), width)]

    def integers(self, *dims: int) -> NDArray[np.int64]:
        """Integer data of exactly these dimensions; ``-1`` stands for any size.

        Raises
        ------
        FormatError
            When the node has other data.
        """
        found = self.target
        fits = len(found.dims) == len(dims) and all(n in (-1, m) for n, m in zip(dims, found.dims, strict=True))
        if not fits or found.dtype is None or found.dtype.kind not in "iu" or found.data_type == "C1":
            wanted = " x ".join("n" if n < 0 else str(n) for n in dims)
            raise FormatError(
                f"{self.path} holds {self.contents}; expected {wanted} integers (I4 or I8), which the CGNS standard "
                f"requires here"
            )
        return found.data().astype(np.int64)


def _may_be(name: str, label: str) -> bool:
    """Whether a node of that name can have that label, according to the names that the standard prescribes."""
    own = _PRESCRIBED.get(label)
    return name.startswith(own) if own else not name.startswith(_OTHERS.get(label, ()))


def make(
    name: str,
    label: str,
    value: str | NDArray[Any] | None = None,
    children: Sequence[Node] = (),
    dtype: np.dtype[Any] | None = None,
) -> Node:
    """A node in memory; ``value`` is an array (fastest index first), stored as ``dtype`` or unchanged."""
    if value is None:
        return Node(name, Path(), name, label, expand=lambda: children)
    array = np.frombuffer(value.encode(), np.int8) if isinstance(value, str) else value
    stored = dtype or array.dtype
    data_type = data_type_of(stored)
    return Node(name, Path(), name, label, data_type, array.shape, stored, read=lambda: array, expand=lambda: children)


def name_list(names: Sequence[str]) -> NDArray[np.int8]:
    """Names as a CGNS list: characters (32, n), padded with blanks."""
    text = "".join(name.ljust(NAME_LENGTH) for name in names)
    return np.frombuffer(text.encode(), np.int8).reshape(len(names), NAME_LENGTH).T


def data_type_of(dtype: np.dtype[Any]) -> str:
    """The CGNS name of a type in memory, e.g. ``R8``."""
    for name, known in DTYPES.items():
        if known == dtype.newbyteorder("="):
            return name
    raise FormatError(f"CGNS has no data type for {dtype}")


def describe(dims: tuple[int, ...], data_type: str) -> str:
    """Description of data, see :attr:`Node.contents`."""
    return f"{' x '.join(str(n) for n in dims)} {data_type} values" if dims else "no values"


def decoded(raw: bytes) -> str:
    """Text up to the first NUL without trailing blanks. Old files hold Latin-1, new ones UTF-8."""
    raw = raw.split(b"\0", 1)[0].rstrip()
    try:
        return raw.decode()
    except UnicodeDecodeError:
        return raw.decode("latin-1")
