"""All levels of a moving grid in one CGNS file, as a time-dependent grid according to SIDS section 11.

Each zone keeps its undeformed GridCoordinates and has one additional GridCoordinates_t (and FlowSolution_t, if there
are fields) per level, to which ZoneIterativeData_t points; BaseIterativeData_t has the times.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from pathlib import Path

import h5py
import numpy as np

from meshdeform_core.errors import FormatError
from meshdeform_core.grid import FileFormat, FloatArray, Grid

from ..files import replacing_by_all
from ..hdf5_output import hdf5_output
from ..planes import write_outputs
from . import format as cgns
from .file import Notes, opened_cgns
from .hdf5 import hdf5_errors
from .hdf5_write import own_group, put_node
from .tree import make, name_list
from .write_new import Places, fields_by_place, outputs_of, solution_nodes
from .zone import base_and_zones, find_base


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

    Raises FormatError when the grid's original file is missing or has changed, or the new one cannot be written.
    """
    with replacing_by_all(path, grid.points) as partial:
        cgns.write(grid, partial, variant)
        current = level(0)
        add_levels = functools.partial(_add_levels, current, path, partial, variant.precision, times)
        places = grid.nodes.on_first(add_levels)
        # Each level is gone before the next one is made.
        del add_levels
        for number, own in enumerate(places):
            if number:
                current = level(number)
            write_outputs(current, outputs_of(current, own))
            del current


def _add_levels(grid: Grid, path: Path, partial: Path, precision: str, times: Sequence[float]) -> list[Places]:
    """Make room for all levels, whose fields are those of ``grid``; returns the places of their values."""
    with opened_cgns(partial) as root:
        base, zones = base_and_zones(root)
    places = [Places(partial) for _ in times]
    numbers, kind = fields_by_place(grid), np.dtype(precision)
    pointers: list[dict[str, list[str]]] = [{} for _ in zones]
    with hdf5_errors(path, "write"), hdf5_output(partial, "r+") as file:
        group = own_group(file, base.node)
        groups = [own_group(group, zone.node) for zone in zones]
        for number, own in enumerate(places, start=1):
            for block, zone in enumerate(zones):
                arrays = own.coordinate_arrays(grid, block, [node.name for node in zone.coordinates], zone.counts, kind)
                solutions = solution_nodes(grid, block, zone.counts, numbers, own)
                nodes = {
                    "GridCoordinatesPointers": make(f"GridCoordinates#{number}", "GridCoordinates_t", None, arrays)
                }
                for solution in solutions:
                    # The standard has one pointer; solutions at other locations than the first are found by theirs.
                    key = "FlowSolutionPointers" if "FlowSolutionPointers" not in nodes else f"{solution.name}Pointers"
                    nodes[key] = make(f"{solution.name}#{number}", solution.label, None, solution.children)
                for key, node in nodes.items():
                    put_node(groups[block], node)
                    pointers[block].setdefault(key, []).append(node.name)
        for parent, names in zip(groups, pointers, strict=True):
            arrays = [make(key, "DataArray_t", name_list(words)) for key, words in names.items()]
            put_node(parent, make("ZoneIterativeData", "ZoneIterativeData_t", None, arrays))
        numbering = np.arange(1, len(times) + 1, dtype=np.int32)
        arrays = [
            make("TimeValues", "DataArray_t", np.array(times, np.float64)),
            make("IterationValues", "DataArray_t", numbering),
        ]
        put_node(group, make("BaseIterativeData", "BaseIterativeData_t", numbering[-1:], arrays))
        put_node(group, make("SimulationType", "SimulationType_t", "TimeAccurate"))
    return places


def read_level(grid: Grid, path: Path, number: int) -> FloatArray:
    """Coordinates (n_nodes, 3) of a level that :func:`write_series` has written; ``grid`` is the undeformed one.

    Raises FormatError when the file has no such level.
    """
    points = grid.points.copy()
    with hdf5_errors(path, "read"), h5py.File(path, "r") as file, opened_cgns(path) as root:
        base, zones = base_and_zones(root)
        for block, zone in enumerate(zones):
            name = f"{base.node.name}/{zone.node.name}/GridCoordinates#{number + 1}"
            if name not in file:
                raise FormatError(f"{path} has no level {number}: {name} is missing")
            target = grid.block(block, points)
            for axis, node in enumerate(zone.coordinates):
                target[..., axis] = file[name][node.name][" data"][()].T.reshape(grid.shapes[block])
    return points
