"""All levels of a moving grid in one CGNS file, as a time-dependent grid according to SIDS section 11.

Each zone keeps its undeformed GridCoordinates and has one additional GridCoordinates_t (and FlowSolution_t, if there
are fields) per level, to which ZoneIterativeData_t points; BaseIterativeData_t has the times.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import h5py
import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, FloatArray, Grid, Shape
from meshdeform_core.parallel import ranks_of

from ..files import replacing_by_all
from ..hdf5_output import hdf5_output
from ..planes import Stored, write_outputs
from . import format as cgns
from .file import Notes, opened_cgns
from .hdf5 import hdf5_errors
from .hdf5_write import own_group, put_node
from .tree import Node, make, name_list, room
from .write_new import Places, fields_by_place, outputs_of, solution_nodes
from .zone import Zone, find_base, structured_zones


class _Common(NamedTuple):
    """What the levels have in common: grid and fields but for their values, file, type of the coordinates, numbers of
    the fields."""

    grid: Grid
    path: Path
    kind: np.dtype[Any]
    numbers: Mapping[tuple[int, str], list[int]]


def require_steady(grid: Grid) -> None:
    """Refuse a grid from a CGNS file that already holds a series."""
    if grid.path is None or grid.format is None or grid.format.name != "cgns":
        return
    with opened_cgns(grid.path) as root:
        found = find_base(root, Notes()).node.labelled("BaseIterativeData_t")
    if found:
        raise FormatError(
            f"{grid.path} already holds a series ({found[0].name}); one file cannot hold two: "
            f"write one file per level, or start from a file with one grid"
        )


def write_series(
    grid: Grid, path: Path, variant: FileFormat, times: Sequence[float], level: Callable[[int], Grid]
) -> None:
    """Write the undeformed ``grid`` and its levels, replacing ``path`` as a whole or leaving it unchanged.

    Parameters
    ----------
    level : ``level(n)`` has the coordinates at ``times[n]`` and the fields that belong to them, alike for all levels;
        one is held at a time. Called on all ranks

    Raises
    ------
    FormatError
        When the grid's original file is missing or has changed, or the new one cannot be written.
    """
    with replacing_by_all(path, grid.points) as partial:
        cgns.write(grid, partial, variant)
        places = _begin(level(0), path, partial, variant.precision, times)
        for number in range(1, len(times)):
            _write_level(level(number), partial, places[number])


def _begin(first: Grid, path: Path, partial: Path, precision: str, times: Sequence[float]) -> list[Places]:
    """Make room for all levels and write the first; returns the places of their values."""
    places = ranks_of(first.points).on_first(lambda: _add_levels(first, path, partial, precision, times))
    _write_level(first, partial, places[0])
    return places


def _write_level(level: Grid, path: Path, places: Places) -> None:
    write_outputs(level, outputs_of(level, path, places))


def _add_levels(grid: Grid, path: Path, partial: Path, precision: str, times: Sequence[float]) -> list[Places]:
    """Make room for all levels, whose fields are those of ``grid``; returns the places of their values."""
    with opened_cgns(partial) as root:
        base = find_base(root, Notes())
        zones = structured_zones(base, Notes())
    places = [Places({}, {}) for _ in times]
    common = _Common(grid, partial, np.dtype(precision), fields_by_place(grid))
    with hdf5_errors(path, "write"), hdf5_output(partial, "r+") as file:
        group = own_group(file, base.node)
        groups = [own_group(group, zone.node) for zone in zones]
        pointers = [_add_level(groups, zones, common, n, each) for n, each in enumerate(places)]
        for block, own in enumerate(groups):
            names = {key: [found[block][key] for found in pointers] for key in pointers[0][block]}
            arrays = [make(key, "DataArray_t", name_list(words)) for key, words in names.items()]
            put_node(own, make("ZoneIterativeData", "ZoneIterativeData_t", None, arrays))
        put_node(group, _iterations(times))
        put_node(group, make("SimulationType", "SimulationType_t", "TimeAccurate"))
    return places


def read_level(grid: Grid, path: Path, number: int) -> FloatArray:
    """Coordinates (n_nodes, 3) of a level that :func:`write_series` has written; ``grid`` is the undeformed one.

    Raises
    ------
    FormatError
        When the file has no such level.
    """
    points = grid.points.copy()
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file, opened_cgns(path) as root:
        base = find_base(root, Notes())
        for block, zone in enumerate(structured_zones(base, Notes())):
            name = f"{base.node.name}/{zone.node.name}/GridCoordinates#{number + 1}"
            if name not in file:
                raise FormatError(f"{path} has no level {number}: {name} is missing")
            target = grid.block(block, points)
            for axis, node in enumerate(zone.coordinates):
                target[..., axis] = file[name][node.name][" data"][()].T.reshape(grid.shapes[block])
    return points


def _add_level(
    groups: Sequence[h5py.Group], zones: Sequence[Zone], common: _Common, number: int, places: Places
) -> list[dict[str, str]]:
    """Add the nodes of one level; returns their names by the pointer of ZoneIterativeData_t, for each zone."""
    pointers = []
    for block, (group, zone) in enumerate(zip(groups, zones, strict=True)):
        arrays = _coordinates(zone, common, common.grid.shapes[block], places.coordinates.setdefault(block, []))
        nodes = {"GridCoordinatesPointers": make(f"GridCoordinates#{number + 1}", "GridCoordinates_t", None, arrays)}
        for solution in solution_nodes(common.grid, block, zone.counts, common.numbers, places.fields):
            # The standard has one pointer; solutions at other locations than the first are found by theirs.
            key = "FlowSolutionPointers" if "FlowSolutionPointers" not in nodes else f"{solution.name}Pointers"
            nodes[key] = make(f"{solution.name}#{number + 1}", solution.label, None, solution.children)
        for node in nodes.values():
            put_node(group, node)
        pointers.append({key: node.name for key, node in nodes.items()})
    return pointers


def _coordinates(zone: Zone, common: _Common, shape: Shape, places: list[Stored]) -> list[Node]:
    """Coordinate arrays of a zone, without values; writing them appends their places, as of a block of this shape:
    a block in the plane has an index axis that its zone may lack."""
    counts, kind = zone.counts, common.kind

    def placed(start: int, size: int) -> None:
        places.append(Stored.within_rind(common.path, kind, shape, start, size=size))

    names = (node.name for node in zone.coordinates)
    return [room(name, counts, kind, placed) for name in names]


def _iterations(times: Sequence[float]) -> Node:
    arrays = [
        make("TimeValues", "DataArray_t", np.array(times, np.float64)),
        make("IterationValues", "DataArray_t", np.arange(1, len(times) + 1, dtype=np.int32)),
    ]
    return make("BaseIterativeData", "BaseIterativeData_t", np.array([len(times)], np.int32), arrays)
