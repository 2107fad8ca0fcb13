"""Pictures of grids for users of the library, by the code that the command line draws with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality.difference import require_same_blocks
from meshdeform_formats.picture import PlotOptions, Subject, page_figure, picture

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import Figure


def plot(grid: Grid, reference: Grid | None, title: str | None, options: PlotOptions) -> Figure:
    """See :meth:`meshdeform.Grid.plot`."""
    name = grid.path.name if grid.path else ""
    return page_figure(picture(_subject(grid, reference), options, name if title is None else title))


def pyvista_blocks(grid: Grid, reference: Grid | None, measures: Sequence[str]) -> pyvista.MultiBlock:
    """See :meth:`meshdeform.Grid.to_pyvista`."""
    import pyvista

    cells = _subject(grid, reference)
    blocks = pyvista.MultiBlock()
    for number, name in enumerate(grid.names):
        block = pyvista.StructuredGrid(*np.moveaxis(grid.block(number), 3, 0))
        for field in grid.fields:
            data = {"node": block.point_data, "cell": block.cell_data}.get(field.location)
            if field.block == number and data is not None:
                # VTK counts the first index fastest; vectors have a trailing axis.
                data[field.name] = field.values.reshape(-1, *field.values.shape[3:], order="F")
        for measure in measures:
            block.cell_data[measure] = cells.values(measure, number, cells.whole(number)).ravel(order="F")
        blocks.append(block, name)
    return blocks


def _subject(grid: Grid, reference: Grid | None) -> Subject:
    if reference is None:
        return Subject(grid, find_topology(grid))
    require_same_blocks(grid, reference)
    reference = reference.with_patches_of(grid)
    return Subject(grid, find_topology(reference), reference)
