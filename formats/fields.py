"""Cell quality measures and the displacement as fields of a grid, for visualisation in other programs."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from meshdeform_core.errors import CaseError, FormatError, suggestion
from meshdeform_core.grid import Field, Grid
from meshdeform_core.parallel import empty
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields

from .grids import FORMATS

WITH_FIELDS = (*(suffix for entry in FORMATS.values() if entry.fields for suffix in entry.suffixes), ".vtu")
"""Suffixes of formats that hold fields."""
INVALID, DISPLACEMENT, ALL = "invalid", "displacement", "all"

_CELLS = 1 << 17
_KNOWN = (*CELL_MEASURES, INVALID, ALL)


def check_fields(names: Sequence[str], target: Path, compared: bool) -> None:
    """Refuse impossible fields before anything is computed.

    Parameters
    ----------
    target : the output file or, for a series, a name with its suffix
    compared : whether there is an undeformed grid
    """
    for name in names:
        if name not in _KNOWN:
            near = suggestion(name, _KNOWN) or f"; known are {', '.join(_KNOWN)}"
            raise CaseError(f"--field {name!r} is unknown{near}")
        if name in CELL_MEASURES and CELL_MEASURES[name].from_reference and not compared:
            raise CaseError(f"--field {name} needs the undeformed grid; give --reference")
    if names and target.suffix.lower() not in WITH_FIELDS:
        raise FormatError(
            f"{target.suffix} files cannot hold fields; choose one of {' '.join(WITH_FIELDS)}, or omit --field"
        )


def with_fields(cells: CellFields, names: Sequence[str]) -> Grid:
    """The grid of ``cells`` with fields, which replace existing ones of the same names.

    Measures and ``invalid`` (0 or 1) are cell values, ``displacement`` is a vector at the nodes; ``all`` are the
    measures available for the grid: those at walls require walls, comparing ones an undeformed grid.
    """
    grid = cells.grid
    if not names:
        return grid
    compared, walls = cells.reference is not None, len(cells.walls) > 0
    able = [n for n, m in CELL_MEASURES.items() if (compared or not m.from_reference) and (walls or not m.of_walls)]
    wanted = list(dict.fromkeys(each for name in names for each in ([*able, INVALID] if name == ALL else [name])))
    kept = (field for field in grid.fields if field.name not in wanted)
    return dataclasses.replace(grid, fields=(*kept, *(f for name in wanted for f in _fields(cells, name))))


def _fields(cells: CellFields, name: str) -> Iterator[Field]:
    grid = cells.grid
    if name == DISPLACEMENT and cells.reference is not None:
        moved = grid.nodes.combined(np.subtract, cells.reference.points)
        for block, shape in enumerate(grid.shapes):
            yield Field(name, "node", block, grid.spread(grid.in_planes(block, moved), shape[0]))
        return
    shapes = [grid.own_shape(block, shape) for block, shape in enumerate(grid.cell_shapes)]
    ends = [0, *itertools.accumulate(map(math.prod, shapes))]
    found = empty([ends[-1]], np.int32 if name == INVALID else np.float32)
    with cells.ready(name):
        for block, shape in enumerate(shapes):
            values, start = found[ends[block] : ends[block + 1]].reshape(shape), grid.planes(block).start
            # A few layers at a time, as intermediate arrays take several times the memory of the result.
            layers = max(1, _CELLS // (shape[1] * shape[2])) if grid.dimension == 3 else max(1, shape[0])
            for first in range(0, shape[0], layers):
                last = min(first + layers, shape[0])
                some = slice(start + first, start + last), slice(0, shape[1]), slice(0, shape[2])
                values[first:last] = cells.bad(block, some) if name == INVALID else cells.values(name, block, some)
    for block, shape in enumerate(shapes):
        values = found[ends[block] : ends[block + 1]].reshape(shape)
        yield Field(name, "cell", block, grid.spread(values, grid.cell_shapes[block][0]))
