"""The parts of a grid other than coordinates: block sizes and sides, windows, patches, connections, fields, format."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import IntEnum
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..numerics.arrays import BoolArray, IntArray, spans
from ..parallel import WholeGridNeeded

Shape = tuple[int, int, int]
_AXES = np.repeat(np.arange(3), 2)
_TANGENTIAL = np.array([[1, 2], [1, 2], [0, 2], [0, 2], [0, 1], [0, 1]])


class Side(IntEnum):
    """The six faces of a block; ``side // 2`` is the index axis, ``side % 2`` is 1 at its far end."""

    IMIN = 0
    IMAX = 1
    JMIN = 2
    JMAX = 3
    KMIN = 4
    KMAX = 5

    @property
    def axis(self) -> int:
        """Index axis (0, 1, 2) that is constant on this face."""
        return self.value // 2

    @property
    def tangential(self) -> tuple[int, int]:
        """The two index axes that vary on this face, ascending."""
        first, second = (a for a in range(3) if a != self.axis)
        return first, second

    def layer(self, counts: Sequence[int]) -> int:
        """Index of this face along its axis in a block with ``counts`` nodes or cells along i, j, k."""
        return (counts[self.axis] - 1) * (self.value % 2)

    def into(self, other: Side) -> int:
        """Axis, from 1, along which a step out of this face leads into the block of ``other``; negative: backwards."""
        return (other.axis + 1) * (-1 if self.value % 2 == other.value % 2 else 1)

    @property
    def label(self) -> str:
        """Name as written in case files and reports: ``imin`` ... ``kmax``."""
        return self.name.lower()


class Planes(NamedTuple):
    """The planes of nodes first <= k < last of a block."""

    block: int
    first: int
    last: int


@dataclass(frozen=True)
class Window:
    """A rectangle of nodes on one face of one block.

    ``low`` and ``high`` are the first and last node (0-based, both inclusive) along ``side.tangential``.
    In a 2-D grid one of the two tangential extents is the single plane (low = high = 0).
    """

    block: int
    side: Side
    low: tuple[int, int]
    high: tuple[int, int]

    @property
    def ranges(self) -> str:
        """As in a case file, 1-based and inclusive: ``1:65,1:33``."""
        return ",".join(f"{a + 1}:{b + 1}" for a, b in zip(self.low, self.high, strict=True))


@dataclass(frozen=True)
class Patch:
    """A named boundary region as the file declares it.

    ``family`` groups patches (CGNS FamilyName, else empty); ``bc_type`` is the boundary condition as the file names it
    (``BCWallViscous``, ``viscous_solid``, ...), or empty.
    """

    name: str
    windows: tuple[Window, ...]
    family: str = ""
    bc_type: str = ""


@dataclass(frozen=True)
class Periodicity:
    """Rigid motion that maps this side of a periodic connection onto its donor side.

    ``rotation_angle`` are degrees about the x, y and z axes in turn through ``rotation_center`` (CGNS convention),
    ``translation`` is in grid length units.
    """

    rotation_center: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rotation_angle: tuple[float, float, float] = (0.0, 0.0, 0.0)
    translation: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Connection:
    """A one-to-one block connection as the file declares it (checked against the coordinates, never trusted).

    ``begin`` and ``end`` are 0-based inclusive node indices (i, j, k) in ``block``; ``donor_begin`` is the donor node
    that corresponds to ``begin``. ``transform`` is the CGNS short form: entry ``a`` is the signed, 1-based donor axis
    that runs along axis ``a``; the donor of ``begin + n`` is ``donor_begin + T n``.
    """

    name: str
    block: int
    begin: Shape
    end: Shape
    donor_block: int
    donor_begin: Shape
    donor_end: Shape
    transform: tuple[int, int, int]
    periodic: Periodicity | None = None


class OwnPlanes:
    """Values (ni, nj, nk, ...) of a block of a grid in parts, of which this rank holds those in its own planes i.

    Attributes
    ----------
    own : (n, nj, nk, ...), none on ranks without nodes of the block
    shape : of the values on all ranks
    """

    def __init__(self, own: NDArray[Any], count: int):
        self.own, self.shape = own, (count, *own.shape[1:])

    @property
    def dtype(self) -> Any:
        return self.own.dtype

    @property
    def ndim(self) -> int:
        return self.own.ndim

    def __array__(self, *_: Any, **__: Any) -> Any:
        """Refuse numpy operations on the values of all ranks."""
        raise WholeGridNeeded("an operation on all values of a field")


@dataclass(frozen=True)
class Field:
    """Values from the file other than coordinates (IBLANK, VTK arrays), written back unchanged.

    ``location`` is ``"node"``, ``"cell"``, or for the faces across an index axis ``"iface"``, ``"jface"``, ``"kface"``;
    ``values`` has the block's node, cell or face shape, with a trailing component axis for vectors; of a grid in parts
    every rank has its :class:`OwnPlanes`.
    """

    name: str
    location: str
    block: int
    values: NDArray[Any]

    @property
    def own(self) -> NDArray[Any]:
        """The values that this rank holds: all of them unless the grid is in parts."""
        return self.values.own if isinstance(self.values, OwnPlanes) else self.values

    @property
    def blanks(self) -> bool:
        """Whether it is the IBLANK array of a block."""
        return self.location == "node" and self.name.lower() == "iblank"


@dataclass(frozen=True)
class FileFormat:
    """Format and variant of a grid's file, so that it can be written the same way.

    ``name`` is a key of ``meshdeform_formats.FORMATS``; ``precision`` is the coordinate type in the file
    (``"float32"`` or ``"float64"``); ``options`` are the variant's own switches (byte order, record markers, ...).
    """

    name: str
    precision: str = "float64"
    options: Mapping[str, Any] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def label(self) -> str:
        """One line of text, e.g. ``plot3d (encoding=fortran, iblank=false), float64``."""
        words = ", ".join(
            f"{key}={str(value).lower() if isinstance(value, bool) else value}" for key, value in self.options.items()
        )
        return f"{self.name} ({words}), {self.precision}" if words else f"{self.name}, {self.precision}"


def strides_of(shapes: IntArray) -> IntArray:
    """Steps in flat index along i, j, k (n, 3) in blocks of these shapes (n, 3)."""
    return np.stack([shapes[:, 1] * shapes[:, 2], shapes[:, 2], np.ones(len(shapes), dtype=np.int64)], axis=1)


@dataclass(frozen=True)
class SideLattice:
    """The sides of all blocks, numbered ``6 * block + side``.

    Node (u, v) of a side, counted along ``side.tangential``, is ``origin + u * stride[0] + v * stride[1]``.

    Attributes
    ----------
    origin : (6 n_blocks,) flat index of the first node
    stride : (6 n_blocks, 2)
    nodes : (6 n_blocks, 2) number of nodes along both axes
    depth : (6 n_blocks,) number of nodes from the side to the opposite one
    inward : (6 n_blocks,) step from a node of the side to the next one inside the block
    has_quads : (6 n_blocks,) false for the two sides that are the plane of a 2-D block
    corner_steps : (6 n_blocks, 2) in u and v from the first to the last corner of a quad, 0 along a single node
    """

    origin: IntArray
    stride: IntArray
    nodes: IntArray
    depth: IntArray
    inward: IntArray
    has_quads: BoolArray
    corner_steps: IntArray

    @classmethod
    def of(cls, shapes: Sequence[tuple[int, int, int]], offsets: IntArray) -> SideLattice:
        """The sides of blocks of these shapes whose first nodes have the flat indices ``offsets``."""
        size = np.array(shapes, dtype=np.int64)
        strides = strides_of(size)
        far = np.arange(6) % 2
        across, along = strides[:, _AXES], size[:, _AXES]
        nodes = size[:, _TANGENTIAL].reshape(-1, 2)
        return cls(
            (np.asarray(offsets)[: len(size), None] + far * (along - 1) * across).ravel(),
            strides[:, _TANGENTIAL].reshape(-1, 2),
            nodes,
            along.ravel(),
            (np.where(far == 1, -1, 1) * across).ravel(),
            along.ravel() > 1,
            np.minimum(nodes - 1, 1),
        )

    def at(self, side: IntArray | int, u: IntArray, v: IntArray) -> IntArray:
        """Flat indices of nodes (u, v) of sides, arrays of any common shape."""
        return np.asarray(self.origin[side] + u * self.stride[side, 0] + v * self.stride[side, 1])

    def corners(self, side: IntArray, u: IntArray, v: IntArray) -> IntArray:
        """Flat indices (n, 4) of the corners of quads (u, v) of sides (n,), around each; in 2-D each end twice."""
        du, dv = self.corner_steps[side].T
        return np.stack([self.at(side, *at) for at in ((u, v), (u + du, v), (u + du, v + dv), (u, v + dv))], axis=1)

    def all_nodes(self, sides: IntArray) -> tuple[IntArray, IntArray, IntArray, IntArray]:
        """All nodes of ``sides``, side after side: the side, u, v and flat index of each."""
        side, local = spans(self.nodes[sides].prod(axis=1))
        side = sides[side]
        u, v = np.divmod(local, self.nodes[side, 1])
        return side, u, v, self.at(side, u, v)


class BlockSizes:
    """Numbers that follow from the shapes of blocks, ``(ni, nj, nk)`` in nodes, and from the format of their file."""

    shapes: tuple[Shape, ...]
    format: FileFormat | None

    @cached_property
    def offsets(self) -> IntArray:
        """Flat index of each block's first node; one more entry than blocks."""
        return np.concatenate([[0], np.cumsum(np.prod(self.shapes, axis=1, dtype=np.int64))]).astype(np.int64)

    @property
    def n_blocks(self) -> int:
        return len(self.shapes)

    @property
    def n_nodes(self) -> int:
        """Block nodes; coincident nodes of different blocks count once per block."""
        return int(self.offsets[-1])

    @property
    def n_face_nodes(self) -> int:
        """Nodes on block faces; coincident nodes count as in :attr:`n_nodes`."""
        inside = np.maximum(np.array(self.shapes, dtype=np.int64) - 2, 0)
        return self.n_nodes - int(inside.prod(axis=1).sum())

    @cached_property
    def cell_shapes(self) -> tuple[Shape, ...]:
        """Cells of each block along i, j, k; the single plane of a 2-D block counts as one."""
        return tuple((max(a - 1, 1), max(b - 1, 1), max(c - 1, 1)) for a, b, c in self.shapes)

    @property
    def n_cells(self) -> int:
        return int(self.cell_offsets[-1])

    @cached_property
    def cell_offsets(self) -> IntArray:
        """Number of each block's first cell; one more entry than blocks."""
        return np.concatenate([[0], np.cumsum(np.prod(self.cell_shapes, axis=1, dtype=np.int64))])

    @property
    def dimension(self) -> int:
        """2 if every block is one plane of nodes, else 3."""
        return 2 if 1 in self.shapes[0] else 3

    @property
    def precision(self) -> str:
        """Floating point type of the grid's file; float64 for grids made in memory."""
        return self.format.precision if self.format else "float64"
