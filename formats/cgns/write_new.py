"""Write a grid that did not come from a CGNS file as a new one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from meshdeform_core.grid import Field, Grid
from meshdeform_core.parallel import ranks_of

from ..files import replacing_by_all
from ..planes import Stored, write_coordinates
from .new_boundary import boundary_nodes, family_names, family_nodes
from .new_connectivity import connectivity_nodes
from .storage.hdf5 import hdf5_errors
from .storage.hdf5_write import write_hdf5
from .storage.names import unique_names
from .storage.tree import Node, data_type_of, make

Places = dict[int, list[tuple[int, np.dtype[Any]]]]
"""Offset and type of the coordinate arrays, by the number of the block."""
# The version of the standard that defines everything written here.
_LIBRARY_VERSION = 3.2
_LOCATIONS = {
    "node": "Vertex",
    "cell": "CellCenter",
    "iface": "IFaceCenter",
    "jface": "JFaceCenter",
    "kface": "KFaceCenter",
}


def write_new(grid: Grid, path: Path, precision: str) -> None:
    """Write ``grid`` as a CGNS file with one base: zones, boundary conditions, families, connections, fields.

    Names are cut to 32 characters and made unique. Fields (IBLANK, VTK arrays) become flow solutions at the nodes or
    cells. A grid in the plane z = 0 has two coordinates; a 2-D base cannot hold patches on the plane itself.
    """
    write_completed(grid, path, lambda partial: _begin(grid, path, partial, precision))


def write_completed(grid: Grid, path: Path, begin: Callable[[Path], Places]) -> None:
    """Write a file with ``begin``, on the first rank, and then, on all of them, the coordinates for which it leaves
    room."""
    with replacing_by_all(path, grid.points) as partial:
        places = ranks_of(grid.points).on_first(lambda: begin(partial))
        arrays = {}
        for block, found in places.items():
            ni, nj, _ = grid.shapes[block]
            arrays[block] = [Stored(partial, kind, (nj, ni), start, ni * nj * kind.itemsize) for start, kind in found]
        write_coordinates(grid, arrays)


def _begin(grid: Grid, path: Path, partial: Path, precision: str) -> Places:
    """Write everything but the coordinates; returns the places of the arrays of every block."""
    starts: list[list[int]] = [[] for _ in grid.shapes]
    with hdf5_errors(path, "write"):
        write_hdf5(_tree(grid, precision, starts), partial)
    return {block: [(start, np.dtype(precision)) for start in found] for block, found in enumerate(starts)}


def _tree(grid: Grid, precision: str, starts: list[list[int]]) -> Node:
    dimension = 2 if grid.dimension == 2 and not grid.points[:, 2].any() else 3
    names = unique_names(grid.names, "Zone")
    families = family_names(grid, names)
    conditions, connectivity = boundary_nodes(grid, families), connectivity_nodes(grid, names)
    zones = []
    for block, name in enumerate(names):
        shape = np.array([n for n in grid.shapes[block] if n > 1], np.int32)
        children = [
            make("ZoneType", "ZoneType_t", "Structured"),
            _coordinates(shape.tolist(), dimension, precision, starts[block]),
            *solution_nodes(grid, block, shape.tolist()),
            *conditions[block],
            *connectivity[block],
        ]
        zones.append(make(name, "Zone_t", np.stack([shape, shape - 1, 0 * shape], axis=1), children))
    sizes = np.array([grid.dimension, dimension], np.int32)
    base = make("Base", "CGNSBase_t", sizes, [*zones, *family_nodes(grid, families)])
    version = make("CGNSLibraryVersion", "CGNSLibraryVersion_t", np.array([_LIBRARY_VERSION], np.float32))
    return make("", "", None, [version, base])


def _coordinates(shape: Sequence[int], dimension: int, precision: str, starts: list[int]) -> Node:
    """Coordinate arrays of a zone, still without values; writing them appends their offsets to ``starts``."""
    kind = np.dtype(precision)
    names = ("CoordinateX", "CoordinateY", "CoordinateZ")[:dimension]
    arrays = [
        Node(name, Path(), name, "DataArray_t", data_type_of(kind), tuple(shape), kind, placed=starts.append)
        for name in names
    ]
    return make("GridCoordinates", "GridCoordinates_t", None, arrays)


def solution_nodes(grid: Grid, block: int, shape: Sequence[int]) -> list[Node]:
    """Flow solutions of a block, one for each location of its fields: nodes, cells, and the faces across each axis.

    ``shape`` are the nodes of the zone along its index axes (two or three). Fields of types that CGNS lacks are
    omitted; vectors become nameX, nameY, nameZ.
    """
    solutions = []
    for location, word in _LOCATIONS.items():
        fields = [
            f for f in grid.fields if f.block == block and f.location == location and f.values.dtype.kind in "biuf"
        ]
        if not fields:
            continue
        size, word = _located(location, word, shape, grid.shapes[block])
        arrays = [array for field in fields for array in _components(field, size)]
        names = unique_names((name for name, _ in arrays), "Field", ["GridLocation"])
        nodes = [make(name, "DataArray_t", values) for name, (_, values) in zip(names, arrays, strict=True)]
        location_node = make("GridLocation", "GridLocation_t", word)
        solutions.append(make(f"FlowSolution{word}", "FlowSolution_t", None, [location_node, *nodes]))
    return solutions


def _located(location: str, word: str, shape: Sequence[int], nodes: Sequence[int]) -> tuple[list[int], str]:
    """Values of a field on the index axes of the zone, without the flat one of a 2-D block, and the CGNS name of their
    location."""
    if location == "node":
        return list(shape), word
    size = [n - 1 for n in shape]
    if location != "cell":
        axis = "ijk".index(location[0])
        if 1 in nodes[:axis]:
            axis -= 1
        size[axis] += 1
        word = f"{'IJK'[axis]}FaceCenter"
    return size, word


def _components(field: Field, shape: Sequence[int]) -> list[tuple[str, NDArray[Any]]]:
    """Scalar arrays (*shape) of a field, in a type of CGNS."""
    values = field.values
    if values.dtype.kind != "f":
        values = values.astype(np.int64 if values.dtype.itemsize > 4 or values.dtype == np.uint32 else np.int32)
    elif values.dtype not in (np.float32, np.float64):
        values = values.astype(np.float64)
    if values.ndim == 3:
        return [(field.name, values.reshape(shape))]
    flat = values.reshape(*shape, -1)
    count = flat.shape[-1]
    suffixes = "XYZ"[:count] if count <= 3 else [str(i + 1) for i in range(count)]
    return [(f"{field.name}{suffix}", flat[..., i]) for i, suffix in enumerate(suffixes)]
