"""Cell quality measures and the displacement as fields of a grid, for visualisation in other programs."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from meshdeform_core.errors import CaseError, FormatError, suggestion
from meshdeform_core.grid import Field, Grid
from meshdeform_core.quality.fields import CELL_MEASURES, CellFields

from .grids import FORMATS

WITH_FIELDS = (*FORMATS["vtk"].suffixes, *FORMATS["cgns"].suffixes, ".vtu", ".xdmf")
"""Suffixes of formats that hold fields."""
INVALID, DISPLACEMENT, ALL = "invalid", "displacement", "all"


_KNOWN = (*CELL_MEASURES, INVALID, ALL)


def check_fields(names: Sequence[str], target: Path, compared: bool) -> None:
    """Refuse impossible fields before anything is computed.

    Parameters
    ----------
    target : the output file or, for a series, a name with its suffix
    compared : whether there is an undeformed grid

    Raises
    ------
    CaseError, FormatError
        When a name is unknown or needs the undeformed grid, or when files of this format cannot hold fields.
    """
    for name in names:
        if name not in _KNOWN:
            raise CaseError(
                f"--field {name!r} is unknown{suggestion(name, _KNOWN) or '; known are ' + ', '.join(_KNOWN)}"
            )
        if name in CELL_MEASURES and CELL_MEASURES[name].from_reference and not compared:
            raise CaseError(f"--field {name} needs the undeformed grid; give --reference")
    if names and target.suffix.lower() not in WITH_FIELDS:
        raise FormatError(
            f"{target.suffix} files cannot hold fields; choose one of {' '.join(WITH_FIELDS)}, or omit --field"
        )


def with_fields(cells: CellFields, names: Sequence[str]) -> Grid:
    """The grid of ``cells`` with fields, which replace existing ones of the same names.

    Measures and ``invalid`` (0 or 1) are cell values, ``displacement`` is a vector at the nodes; ``all`` are those that
    exist for the grid: measures at walls need walls, comparing ones an undeformed grid.
    """
    grid = cells.grid
    if not names:
        return grid
    wanted = list(dict.fromkeys(each for name in names for each in (_all(cells) if name == ALL else [name])))
    kept = (field for field in grid.fields if field.name not in wanted)
    return dataclasses.replace(grid, fields=(*kept, *(f for name in wanted for f in _fields(cells, name))))


def _all(cells: CellFields) -> list[str]:
    compared, walls = cells.reference is not None, len(cells.walls) > 0
    measured = [
        name
        for name, measure in CELL_MEASURES.items()
        if (compared or not measure.from_reference) and (walls or not measure.of_walls)
    ]
    return [*measured, INVALID]


def _fields(cells: CellFields, name: str) -> Iterator[Field]:
    grid = cells.grid
    for block in range(grid.n_blocks):
        if name == DISPLACEMENT and cells.reference is not None:
            yield Field(name, "node", block, grid.block(block) - cells.reference.block(block))
            continue
        if name == INVALID:
            values = cells.bad(block, cells.whole(block)).astype(np.int32)
        else:
            values = cells.values(name, block, cells.whole(block)).astype(np.float32)
        yield Field(name, "cell", block, values)
