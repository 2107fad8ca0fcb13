"""Cell measures for commands: their names, and the cells that they are computed for."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from meshdeform_core.grid import Grid
    from meshdeform_core.quality.fields import CellFields

MEASURES = (
    "f_skew", "scaled_jacobian", "jacobian", "relative_jacobian", "volume", "volume_ratio", "aspect_ratio",
    "growth_ratio", "non_orthogonality_deg", "skewness", "wall_normal_deviation_deg", "first_cell_height_ratio",
    "interface_kink_deg", "interface_spacing_jump", "wall_distance", "displacement",
)  # fmt: skip
"""Defined in ``meshdeform_core.quality.fields``; repeated because ``--help`` must not load compiled loops."""


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
    original = original.with_patches_of(grid)
    return CellFields(grid, find_topology(original), original)
