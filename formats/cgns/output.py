"""Write CGNS files: a grid that came from one as a copy of it in which only the coordinates change, others as new ones.

The reader leaves existing fields in the file; fields of such a grid are new ones and become flow solutions.
"""

from __future__ import annotations

import dataclasses
import math
import os
import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from dataclasses import field as dataclass_field
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import Field, FloatArray, Grid, Shape
from meshdeform_core.grid.planes import block_extents
from meshdeform_core.numerics.arrays import extent

from ..files import replacing_by_all
from ..planes import Output, Stored, split, write_outputs
from .hdf5 import (
    DATA,
    LINK,
    LINK_FILE,
    characters,
    external_links,
    has_other_names,
    hdf5_errors,
    hdf5_output,
    own_group,
    place_of,
    put_node,
    reserve_dataset,
    write_hdf5,
)
from .new_nodes import boundary_nodes, connectivity_nodes, family_names, family_nodes
from .tree import NewNode, Node, data_type_of, is_adf, make, unique_names
from .zone import Base, Zone, base_and_zones, naming, opened_cgns


@dataclass
class Places:
    """Where the values go for which the file ``path`` has room: coordinates by the number of the block, fields by their
    number in the grid; a list with every component."""

    path: Path
    coordinates: dict[int, list[Stored]] = dataclass_field(default_factory=dict)
    fields: dict[int, list[Stored]] = dataclass_field(default_factory=dict)

    def room(self, found: list[Stored], name: str, dims: Sequence[int], kind: np.dtype[Any], shape: Shape) -> Node:
        """An array without values; writing it adds its place to ``found``.

        The place is that of a block of this ``shape``, which has an index axis that a zone in the plane lacks.
        """

        def placed(start: int, size: int) -> None:
            found.append(Stored.within_rind(self.path, kind, shape, start, size=size))

        return NewNode(name, Path(), name, "DataArray_t", data_type_of(kind), tuple(dims), kind, placed=placed)


# The version of the standard that defines everything written here.
_LIBRARY_VERSION = 3.2
# Locations of fields and their names; those of faces follow from the axis across them.
_LOCATIONS = {"node": "Vertex", "cell": "CellCenter", "iface": "", "jface": "", "kface": ""}


def write_new(grid: Grid, path: Path, precision: str) -> None:
    """Write ``grid`` as a CGNS file with one base: zones, boundary conditions, families, connections, fields.

    Names are cut to 32 characters and made unique. Fields (IBLANK, VTK arrays) become flow solutions at the nodes or
    cells. A grid in the plane z = 0 has two coordinates; a 2-D base cannot hold patches on the plane itself.
    """
    # The first rank alone does not know them.
    low, high = extent(grid.points)
    dimension = 3 if grid.dimension == 3 or low[2] or high[2] else 2

    def begin(partial: Path) -> Places:
        places = Places(partial)
        with hdf5_errors(path, "write"):
            write_hdf5(_new_tree(grid, dimension, np.dtype(precision), places), partial)
        return places

    write_completed(grid, path, begin)


def write_completed(grid: Grid, path: Path, begin: Callable[[Path], Places]) -> None:
    """Write a file with ``begin``, on the first rank, and then, on all of them, the values for which it leaves room."""
    with replacing_by_all(path, grid.points) as partial:
        places = grid.nodes.ranks.on_first(lambda: begin(partial))
        outputs = [Output.of_coordinates(grid, block, arrays) for block, arrays in places.coordinates.items()]
        for number, arrays in places.fields.items():
            field = grid.fields[number]
            ni, nj, nk = field.values.shape[:3]
            outputs.append(Output.of_values(field.block, (ni, nj, nk), field.own, arrays))
        write_outputs(grid, outputs)


def _new_tree(grid: Grid, dimension: int, kind: np.dtype[Any], places: Places) -> Node:
    names = unique_names(grid.names, "Zone")
    families = family_names(grid, names)
    conditions, connectivity = boundary_nodes(grid, families), connectivity_nodes(grid, names)
    numbers = fields_by_place(grid)
    zones = []
    for block, name in enumerate(names):
        shape = np.array([n for n in grid.shapes[block] if n > 1], np.int32)
        found = places.coordinates.setdefault(block, [])
        arrays = [places.room(found, f"Coordinate{letter}", shape.tolist(), kind, grid.shapes[block])
                  for letter in "XYZ"[:dimension]]  # fmt: skip
        children = [
            make("ZoneType", "ZoneType_t", "Structured"),
            make("GridCoordinates", "GridCoordinates_t", None, arrays),
            *solution_nodes(grid, block, shape.tolist(), numbers, places),
            *conditions[block],
            *connectivity[block],
        ]
        zones.append(make(name, "Zone_t", np.stack([shape, shape - 1, 0 * shape], axis=1), children))
    sizes = np.array([grid.dimension, dimension], np.int32)
    base = make("Base", "CGNSBase_t", sizes, [*zones, *family_nodes(grid, families)])
    version = make("CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([_LIBRARY_VERSION], np.float32))
    return make("", "", None, [version, base])


def fields_by_place(grid: Grid) -> Mapping[tuple[int, str], list[int]]:
    """Numbers of the fields at every location of every block; those of types that CGNS lacks are omitted."""
    found: dict[tuple[int, str], list[int]] = {}
    for number, field in enumerate(grid.fields):
        if field.values.dtype.kind in "biuf":
            found.setdefault((field.block, field.location), []).append(number)
    return found


def solution_nodes(
    grid: Grid, block: int, shape: Sequence[int], numbers: Mapping[tuple[int, str], list[int]], places: Places
) -> list[Node]:
    """Flow solutions of a block, one for each location of its fields: nodes, cells, and the faces across each axis.

    They are without values; writing them appends the places of these to ``places``. ``shape`` are the nodes of the zone
    along its index axes (two or three), ``numbers`` those of the fields. Vectors become nameX, nameY, nameZ.
    """
    solutions, nodes = [], grid.shapes[block]
    # The index axes of the zone: a base of two lacks the flat one.
    axes = [axis for axis, n in enumerate(nodes) if n > 1 or len(shape) == 3]
    for location in (each for each in _LOCATIONS if (block, each) in numbers):
        # Nodes are counted along all axes, faces along that across them.
        by_node = [
            location == "node" or (location.endswith("face") and "ijk"[axis] == location[0]) for axis in range(3)
        ]
        size = [nodes[axis] - (not by_node[axis]) for axis in axes]
        word = _LOCATIONS[location] or f"{'IJK'[axes.index('ijk'.index(location[0]))]}FaceCenter"
        if 0 in size:
            raise FormatError(
                f"{grid.names[block]} is one plane of nodes in a base of three index axes, in which CGNS has neither "
                f"cells nor faces for the {location} field {grid.fields[numbers[block, location][0]].name!r}; write to "
                f"VTK, or leave the field out"
            )
        expected = tuple(n if by_node[axis] else max(n - 1, 1) for axis, n in enumerate(nodes))
        arrays = []
        for number in numbers[block, location]:
            name, shape_of_values = grid.fields[number].name, grid.fields[number].values.shape
            if shape_of_values[:3] != expected:
                found = f"has shape {shape_of_values}; expected {expected}, followed by its components"
                raise FormatError(f"{location} field {name!r} of {grid.names[block]} {found}")
            count, components = math.prod(shape_of_values[3:]), [""]
            if len(shape_of_values) > 3:
                components = list("XYZ"[:count]) if count <= 3 else [str(n) for n in range(1, count + 1)]
            arrays += [(number, f"{name}{component}") for component in components]
        names = unique_names((name for _, name in arrays), "Field", ["GridLocation"])
        members = [make("GridLocation", "GridLocation_t", word)]
        for name, (number, _) in zip(names, arrays, strict=True):
            field, own = grid.fields[number], places.fields.setdefault(number, [])
            members.append(places.room(own, name, size, _stored_type(field), field.values.shape[:3]))
        solutions.append(make(f"FlowSolution{word}", "FlowSolution_t", None, members))
    return solutions


def _stored_type(field: Field) -> np.dtype[Any]:
    """The type of CGNS for the values of a field."""
    kind: np.dtype[Any] = field.values.dtype
    if kind.kind != "f":
        return np.dtype(np.int64 if kind.itemsize > 4 or kind == np.uint32 else np.int32)
    return kind.newbyteorder("=") if kind.itemsize in (4, 8) else np.dtype(np.float64)


Boxes = Callable[[], tuple[FloatArray, FloatArray]]
"""Returns the lowest and highest coordinates (n_blocks, 3) of blocks."""


def write_copy(grid: Grid, path: Path, precision: str | None) -> None:
    """Copy the CGNS file of ``grid`` to ``path`` with the grid's coordinates, in ``precision`` or that of each array.

    All other nodes, attributes, links and their order are kept; an ADF file becomes HDF5. With the coordinates, links
    to them become arrays of this file, relative names of linked files are adapted to a new folder, and bounding boxes
    stored with the coordinates are updated.
    """
    source = grid.path
    if source is None or not source.is_file():
        raise FormatError(f"cannot write {path}: {source}, whose other contents are to be copied, no longer exists")
    boxes = cache(lambda: block_extents(grid))
    if grid.nodes.divided:
        # The first rank alone cannot find them.
        boxes()
    write_completed(grid, path, lambda partial: _prepared_copy(grid, source, path, partial, precision, boxes))


@lru_cache(maxsize=8)
def _plain_copies(source: Path, state: tuple[int, int, int]) -> dict[object, tuple[int, dict[int, list[Stored]]]]:
    """Of a file, while it is unchanged: the dimension of its base and the places of its coordinates, for copies that
    differ in the values of these only, such as the levels of a series; by what else a copy depends on."""
    return {}


def _prepared_copy(grid: Grid, source: Path, path: Path, partial: Path, precision: str | None, boxes: Boxes) -> Places:
    """Write everything but the values of nodes, cells and faces; returns the places of these."""
    state = source.stat()
    plain = _plain_copies(source, (state.st_ino, state.st_size, state.st_mtime_ns))
    which, numbers = (grid.names, grid.shapes, precision, path.parent.resolve()), fields_by_place(grid)
    if which in plain and not numbers and (plain[which][0] == 3 or not any(end[:, 2].any() for end in boxes())):
        with hdf5_errors(path, "write"):
            shutil.copyfile(source, partial)
        known = plain[which][1].items()
        return Places(partial, {b: [dataclasses.replace(each, path=partial) for each in own] for b, own in known})
    with opened_cgns(source) as root:
        with naming(source):
            base, zones = _same_zones(root, grid, source, boxes)
        with hdf5_errors(path, "write"):
            if is_adf(source):
                write_hdf5(root, partial)
            else:
                shutil.copyfile(source, partial)
            with hdf5_output(partial, "r+") as (file, written):
                _adapt_links(file, source.parent, path.parent)
                group = own_group(file, base.node)
                owns = [own_group(group, zone.node) for zone in zones]
                places = Places(partial)
                for block, (parent, zone) in enumerate(zip(owns, zones, strict=True)):
                    group = own_group(parent, zone.grid)
                    arrays = (own_group(group, node) for node in zone.coordinates)
                    datasets = [_writable(each, precision, zone.counts) for each in arrays]
                    _place_coordinates(grid, block, zone, datasets, places)
                    if zone.grid.target.dims == (len(zone.coordinates), 2):
                        # GridCoordinates_t may hold the lowest and highest coordinates (SIDS 7.1).
                        box = np.array([end[block] for end in boxes()])
                        group[DATA][...] = box[:, : len(zone.coordinates)]
                    for solution in solution_nodes(grid, block, zone.counts, numbers, places):
                        # One with the same arrays, from an earlier run, is replaced.
                        own = solution.label, {child.name for child in solution.children}
                        found = ((old.name, old.target) for old in zone.node.target.children)
                        others = [name for name, old in found if (old.label, {n.name for n in old.children}) != own]
                        (name,) = unique_names([solution.name], solution.name, others)
                        put_node(parent, dataclasses.replace(solution, name=name))
    # Others hold values that are the same by chance: compressed coordinates, bounding boxes, fields.
    only_values = len(places.coordinates) == len(zones) and not (numbers or any(z.grid.target.dims for z in zones))
    if only_values and not written.changed and not is_adf(source):
        plain[which] = base.dimension, places.coordinates
    return places


def _place_coordinates(grid: Grid, block: int, zone: Zone, datasets: Sequence[h5py.Dataset], places: Places) -> None:
    """Note the places of the coordinates of a zone; compressed ones are filled."""
    starts = [place_of(each.id, each.dtype) for each in datasets]
    found = [
        Stored.within_rind(places.path, each.dtype, each.shape[::-1], at, zone.core, each.id.get_storage_size())
        for at, each in zip(starts, datasets, strict=True)
        if at is not None
    ]
    if len(found) == len(datasets):
        places.coordinates[block] = found
        return
    arrays = split(grid.block(block), np.dtype(float), len(datasets))
    for dataset, values in zip(datasets, arrays, strict=True):
        dataset[zone.core[::-1]] = values.reshape(zone.counts[::-1]).astype(dataset.dtype, copy=False)


def _same_zones(root: Node, grid: Grid, source: Path, boxes: Boxes) -> tuple[Base, list[Zone]]:
    """The zones of the source file, which must be those from which the grid was read."""
    base, zones = base_and_zones(root)
    if tuple(zone.name for zone in zones) != grid.names or tuple(zone.shape for zone in zones) != grid.shapes:
        raise FormatError(
            f"{source} has changed since the grid was read: its zones are now "
            f"{', '.join(f'{zone.name} {zone.shape}' for zone in zones[:4])}{' ...' if len(zones) > 4 else ''}; "
            f"read it again, or write to another format"
        )
    if base.dimension == 2 and any(end[:, 2].any() for end in boxes()):
        raise FormatError(
            f"{source} stores only x and y (physical dimension 2), but nodes have moved out of the plane z = 0"
        )
    return base, zones


def _writable(group: h5py.Group, precision: str | None, counts: tuple[int, ...]) -> h5py.Dataset:
    """The coordinate dataset, recreated if its precision changes or if it belongs to another node, too. Old values are
    copied only if some of them remain: rind values in addition to the nodes ``counts`` of the zone."""
    dataset = group[DATA]
    stored = dataset.dtype.newbyteorder("=")
    dtype = stored if precision is None else np.dtype(precision)
    if dtype == stored and not has_other_names(dataset):
        return dataset
    shape, chunks = dataset.shape, dataset.chunks
    kept = ("chunks", "compression", "compression_opts", "shuffle", "fletcher32")
    packing = {name: getattr(dataset, name) for name in kept}
    values = dataset[()].astype(dtype) if shape != counts[::-1] else None
    del group[DATA]
    group.attrs.modify("type", np.bytes_(data_type_of(dtype)))
    if values is None and chunks is None:
        reserve_dataset(group.id, DATA, shape, dtype)
        return group[DATA]
    return group.create_dataset(DATA, shape, dtype, data=values, **packing)


def _adapt_links(file: h5py.File, old: Path, new: Path) -> None:
    """Adapt external links with relative names from the folder ``old`` to the folder ``new``."""
    if old.resolve() == new.resolve():
        return
    for name in (raw.decode() for raw in external_links(file)):
        link = file.get(name, getlink=True)
        target = old / link.filename
        if os.path.isabs(link.filename) or not target.exists():
            continue
        filename = os.path.relpath(target.resolve(), new.resolve())
        parent, _, own_name = name.rpartition("/")
        group = file[parent or "/"]
        del group[own_name]
        group[own_name] = h5py.ExternalLink(filename, link.path)
        if own_name == LINK and LINK_FILE in group:
            del group[LINK_FILE]
            group[LINK_FILE] = characters(filename)
