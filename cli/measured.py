"""A grid and, if one is named, the undeformed grid to compare it with."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_core.quality.fields import CellFields


def measured(grid: Grid, reference: Path | None) -> CellFields:
    """The cells of ``grid`` for measuring, compared with the file ``reference`` if it is given; boundaries that this
    file lacks are taken from the grid.

    Raises
    ------
    GridError
        When the two have different blocks.
    """
    from meshdeform_core.grid.topology import find_topology
    from meshdeform_core.quality.difference import require_same_blocks
    from meshdeform_core.quality.fields import CellFields
    from meshdeform_formats import read_grid

    if reference is None:
        return CellFields(grid, find_topology(grid))
    original = read_grid(reference)
    require_same_blocks(grid, original)
    if not original.patches:
        original = dataclasses.replace(original, patches=grid.patches)
    return CellFields(grid, find_topology(original), original)
