"""Structured zones of a CGNS base: their sizes and coordinate arrays."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FloatArray, Shape
from meshdeform_core.wording import listed

from ..planes import Stored, merge
from .tree import Node, is_adf

_COORDINATES = ("CoordinateX", "CoordinateY", "CoordinateZ")
_FLOATS = (np.dtype(np.float32), np.dtype(np.float64))
_LENGTH = 1  # position of the length among the units of DimensionalUnits_t


@contextmanager
def opened_cgns(path: Path) -> Iterator[Node]:
    """Root node of a CGNS file; the tree can be read while the context lasts."""
    # A file is of one kind and needs the reader of this kind only.
    if is_adf(path):
        from .adf import read_adf

        yield read_adf(path)
    else:
        from .hdf5 import opened_hdf5

        with opened_hdf5(path) as root:
            yield root


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Prefix messages about the file's tree with its name."""
    try:
        yield
    except FormatError as error:
        message = str(error)
        raise FormatError(message if str(path) in message else f"{path}: {message}") from error
    except RecursionError as error:
        raise FormatError(f"{path} has a chain of too many links") from error


class Notes:
    """Remarks for ``Grid.notes``; the same remark about several nodes becomes one line."""

    def __init__(self) -> None:
        # The places of each remark, in order and without repetition.
        self._places: dict[str, dict[str, None]] = {}

    def add(self, remark: str, place: str) -> None:
        self._places.setdefault(remark, {})[place] = None

    def lines(self) -> tuple[str, ...]:
        """One line per remark, e.g. ``rind planes are ...: zone 1, zone 2 ... and 7 more``."""
        return tuple(f"{remark}: {listed(places)}" for remark, places in self._places.items())


@dataclass(frozen=True)
class Base:
    """A CGNSBase_t: ``cell_dimension`` index axes in each zone, ``dimension`` coordinates at each node."""

    node: Node
    cell_dimension: int
    dimension: int


@dataclass(frozen=True)
class Zone:
    """A structured zone.

    ``shape`` are its nodes without rind, with one node along k when the base has two index axes; ``core`` selects
    them in the coordinate arrays, whose axes run i, j(, k); ``counts`` are the nodes along each index axis of the base.
    """

    name: str
    node: Node
    shape: Shape
    grid: Node
    coordinates: tuple[Node, ...]
    core: tuple[slice, ...]
    counts: tuple[int, ...]

    def places(self) -> list[Stored] | None:
        """Offsets of the coordinates; ``None`` if they are compressed or in pieces."""
        found = []
        for node in (each.target for each in self.coordinates):
            place = node.place()
            if place is None or node.dtype is None:
                return None
            found.append(Stored.within_rind(node.file, node.dtype, node.dims, place, self.core))
        return found

    def read(self, block: FloatArray) -> None:
        """Fill ``block`` of shape ``(ni, nj, nk, 3)`` with the coordinates; missing components become zero."""
        count = len(self.coordinates)
        merge(block, (node.data()[self.core].T for node in self.coordinates), count)
        block[..., count:] = 0.0


def base_and_zones(root: Node, notes: Notes | None = None) -> tuple[Base, list[Zone]]:
    """The first base that has zones, and these in file order; other bases are noted."""
    notes = notes or Notes()
    bases = root.labelled("CGNSBase_t")
    if not bases:
        raise FormatError("there is no CGNSBase_t node; expected a CGNS file with one base that contains the zones")
    chosen, nodes = next(((base, found) for base in bases if (found := base.labelled("Zone_t"))), (bases[0], []))
    if not nodes:
        raise FormatError(f"the base {chosen.name} has no zones; expected at least one structured Zone_t")
    for node in bases:
        if node is not chosen:
            notes.add(f"the grid is the base {chosen.name}; other bases are kept as they are", node.name)
    cell_dimension, dimension = (int(n) for n in chosen.integers(2))
    if cell_dimension not in (2, 3) or dimension not in (2, 3) or cell_dimension > dimension:
        raise FormatError(
            f"the base {chosen.name} has cell dimension {cell_dimension} and physical dimension {dimension}; "
            f"a block-structured grid has 2 or 3 of each, and at least as many coordinates as index axes"
        )
    base = Base(chosen, cell_dimension, dimension)
    # Files older than ZoneType_t contain only structured zones.
    types = [next((kind.text() for kind in node.labelled("ZoneType_t")), "Structured") for node in nodes]
    others = [(node.name, kind) for node, kind in zip(nodes, types, strict=True) if kind != "Structured"]
    if others:
        raise FormatError(
            f"{len(others)} of {len(nodes)} zones are not Structured; the first is {others[0][0]!r} ({others[0][1]}); "
            f"only block-structured grids can be deformed: export a grid of Structured zones"
        )
    for node in (base.node, *nodes):
        for child in node.target.broken_links:
            notes.add("broken links are kept as they are", f"{node.name}/{child.name} -> {child.link}")
    zones = [_zone(node, base, notes) for node in nodes]
    # Refuse curves, and surfaces together with volumes; a base with only surfaces is a plane grid.
    flat = [base.cell_dimension - sum(count > 1 for count in zone.counts) for zone in zones]
    for zone, missing in zip(zones, flat, strict=True):
        if missing and (base.cell_dimension - missing != 2 or not all(flat)):
            what = ("a surface", "a curve", "a point")[missing + 2 - base.cell_dimension]
            kind = "volumes" if base.cell_dimension == 3 else "surfaces"
            raise FormatError(
                f"zone {zone.name} has {' x '.join(map(str, zone.counts))} nodes: it is {what} in the base "
                f"{base.node.name}, whose zones are {kind} (cell dimension {base.cell_dimension}); expected at least 2 "
                f"nodes along each index, and curves and surfaces in a base of their own"
            )
    return base, zones


def _zone(node: Node, base: Base, notes: Notes) -> Zone:
    sizes, cells, _ = node.integers(base.cell_dimension, 3).T
    if (sizes < 1).any():
        raise FormatError(f"zone {node.name} has {sizes.tolist()} nodes; expected at least one along each index")
    if (cells != sizes - 1).any():
        raise FormatError(
            f"zone {node.name} has {sizes.tolist()} nodes but {cells.tolist()} cells; expected one cell less along "
            f"each index, {(sizes - 1).tolist()}: one of the two must be wrong"
        )
    grids = node.labelled("GridCoordinates_t")
    grid = next((each for each in grids if each.name == "GridCoordinates"), grids[0] if len(grids) == 1 else None)
    if grid is None:
        found = f"only {', '.join(each.name for each in grids)}" if grids else "no GridCoordinates_t"
        raise FormatError(f"zone {node.name} has {found}; expected its original grid, GridCoordinates")
    for each in grids:
        if each is not grid:
            notes.add("additional grids of a zone (at other times) are kept as they are", f"{node.name}/{each.name}")
    # Planes around the zone's own nodes, at the low and high end of each index.
    rind = np.zeros((base.cell_dimension, 2), np.int64)
    for planes in grid.labelled("Rind_t")[:1]:
        rind = planes.integers(2 * base.cell_dimension).reshape(-1, 2)
    if (rind < 0).any():
        raise FormatError(f"zone {node.name} has {rind.tolist()} rind planes; expected none or more at each end")
    if rind.any():
        notes.add("rind planes are not part of the grid and keep their coordinates in the file", node.name)
    core = tuple(slice(int(low), int(low + n)) for (low, _), n in zip(rind, sizes, strict=True))
    stored = tuple(int(n) for n in sizes + rind.sum(axis=1))
    coordinates = _coordinates(grid, base.dimension, stored, node.name)
    for linked in (node, grid, *coordinates):
        if linked.link and linked.link.file:
            notes.add(
                "coordinates linked from another file become part of the written file", f"{node.name} ({linked.link})"
            )
    unit = declared_unit((*coordinates[:1], grid, node, base.node), _LENGTH)
    if unit not in ("", "Null", "UserDefined"):
        notes.add("the length unit in the file is", unit)
    for array in coordinates:
        if array.labelled("DataConversion_t"):
            notes.add("coordinates have a DataConversion; they are used as stored", f"{node.name}/{array.name}")
    counts = tuple(int(n) for n in sizes)
    ni, nj, nk = (*counts, 1)[:3]
    return Zone(node.name, node, (ni, nj, nk), grid, coordinates, core, counts)


def _coordinates(grid: Node, dimension: int, stored: tuple[int, ...], zone: str) -> tuple[Node, ...]:
    arrays = {node.name: node for node in grid.labelled("DataArray_t")}
    wanted = _COORDINATES[:dimension]
    if any(name not in arrays for name in wanted):
        found = ", ".join(arrays) or "nothing"
        other = {"CoordinateR", "CoordinateTheta", "CoordinatePhi", "CoordinateXi"} & set(arrays)
        hint = "; cylindrical and other curvilinear coordinates must be converted to Cartesian first" if other else ""
        raise FormatError(f"zone {zone} has the coordinates {found}; expected {', '.join(wanted)}{hint}")
    nodes = tuple(arrays[name] for name in wanted)
    for node in nodes:
        array = node.target
        if array.dtype is None or array.dtype.newbyteorder("=") not in _FLOATS:
            raise FormatError(f"{node.name} of zone {zone} holds {array.contents}; expected R4 or R8")
        if array.dims != stored:
            raise FormatError(
                f"{node.name} of zone {zone} has {array.dims} values; the zone has {stored} nodes (with rind)"
            )
        array.require_stored()
    return nodes


def declared_unit(places: Sequence[Node], position: int) -> str:
    """The unit at a position of the words of DimensionalUnits_t; the innermost declaration counts (SIDS 4.3)."""
    for place in places:
        for units in place.labelled("DimensionalUnits_t"):
            names = units.words()
            return names[position] if len(names) > position else ""
    return ""
