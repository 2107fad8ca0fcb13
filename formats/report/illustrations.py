"""The pictures of a report: a cut and the worst cells, before and after, with common window and colour scale."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Result, Setup
from meshdeform_core.grid import FloatArray, Grid

from ..picture.overview import moved_walls, plane_around, quality_planes, worst_cells
from ..picture.page import Choice, Page, page_png
from ..picture.subject import Subject, worst_cell
from .tables import Figure


def deformation_figures(result: Result) -> list[Figure]:
    """The moving walls, a plane around them and the worst cells, before and after."""
    setup, after, invalid = result.setup, result.grid, result.assessment.invalid
    old = Subject(setup.grid, setup.topology, original=setup.original)
    new = Subject(after, setup.topology, setup.grid, original=old)
    caption = "A plane through the grid, coloured by f_skew."
    figures = [Figure("Around the walls", caption, _png(after, quality_planes(old, new)))]
    block, cell = worst_cell(new, "f_skew")
    more = ", and of other invalid cells" if invalid else ""
    caption = f"A close-up of cell {setup.grid.label(block, cell)}, where f_skew is smallest{more}."
    figures.append(Figure("The worst cells", caption, _png(after, worst_cells(old, new, block, cell))))
    moving = np.flatnonzero(setup.boundary.quad_kind == Kind.MOVING)
    if after.dimension == 3 and moving.size:
        page = moved_walls(old, new, moving)
        if page is not None:
            caption = "The moving walls, coloured by their displacement."
            figures.insert(0, Figure("The moving walls", caption, _png(after, page)))
    return figures


def _png(grid: Grid, page: Page, **size: Any) -> bytes:
    """A page as PNG, drawn by the first of the ranks that hold the grid."""
    return grid.nodes.on_first(lambda: page_png(page, **size))


def level_thumbnails(
    setup: Setup, levels: Sequence[tuple[int, str, str]], read: Callable[[int], FloatArray]
) -> list[Figure]:
    """A small picture around the moving walls for some levels of a series.

    Parameters
    ----------
    levels : number, caption and file name of each
    read : gives the coordinates (n_nodes, 3) of a level
    """
    # One level at a time is in memory.
    moving = setup.topology.first[np.flatnonzero(setup.boundary.kind == Kind.MOVING)]
    around = np.concatenate([read(number)[moving] for number, _, _ in levels])
    shown = []
    for number, caption, file in levels:
        subject = Subject(setup.grid.moved(read(number)), setup.topology, setup.grid, original=setup.original)
        page = plane_around(subject, around, Choice(limits=(0.0, 1.0)))
        shown.append(Figure(caption, caption, _png(subject.grid, page, width=4.2, dpi=90), file))
    return shown
