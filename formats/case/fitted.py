"""The wall that a displacement table fits, for a template of a case file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.boundary.tables.fitting import fit_table
from meshdeform_core.boundary.tables.matching import AUTOMATIC, Matching, Nodes, SurfaceData
from meshdeform_core.boundary.tables.transfer import transfer
from meshdeform_core.errors import CaseError
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import Topology

from ..displacement import read_displacement

_ROOM = 1.05
_SMALLEST = 1e-9
"""Smallest tolerance relative to the size of the wall, so that rounding in the table does not matter."""


@dataclass(frozen=True)
class FittedTable:
    """A table, the names of the surfaces that it moves, and a match and tolerance that cover all their nodes."""

    file: str
    surfaces: tuple[str, ...]
    match: str
    tolerance: float


def fitted_table(grid: Grid, topology: Topology, path: Path, name: str) -> FittedTable:
    """Find the wall that the table ``path`` fits; ``name`` is the file's name as the case file will have it.

    Raises
    ------
    CaseError, FormatError, MotionError
        When the file is not a table of points, or its points lie on no wall.
    """
    data = read_displacement(path)
    if not isinstance(data, SurfaceData):
        raise CaseError(
            f"{path} is a grid with deformed positions, which needs no matching; expected a displacement table. Use it "
            f'in a case: motion = [{{ file = "{name}" }}]'
        )
    fit = fit_table(grid, topology, data, Matching(AUTOMATIC, partial=True))
    quads = np.concatenate([surface.quads for surface in fit.surfaces])
    nodes = Nodes.of_quads(grid, topology, quads)
    matched = transfer(data, fit.matching, nodes)
    size = float(np.linalg.norm(np.ptp(nodes.points, axis=0)))
    reach = max(_ROOM * float(matched.distance.max()), _SMALLEST * size)
    return FittedTable(name, tuple(s.name for s in fit.surfaces), matched.how, _rounded_up(reach))


def _rounded_up(value: float) -> float:
    """The value, rounded up to two significant digits."""
    unit = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / unit) * unit:.3g}")
