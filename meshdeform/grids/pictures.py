"""Pictures of grids for users of the library, by the code that the command line draws with."""

from __future__ import annotations

from typing import TYPE_CHECKING

from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality.difference import require_same_blocks
from meshdeform_formats.picture import Choice, PlotOptions, Subject, page_figure, picture

if TYPE_CHECKING:
    import pyvista
    from matplotlib.figure import Figure


def plot(grid: Grid, reference: Grid | None, title: str | None, options: PlotOptions) -> Figure:
    """See :meth:`meshdeform.Grid.plot`."""
    request, subject = options.request(), _subject(grid, reference)
    return page_figure(picture(subject, request, _title(grid) if title is None else title))


def view(grid: Grid, reference: Grid | None, metric: str, log: bool) -> pyvista.Plotter:
    """See :meth:`meshdeform.Grid.view`."""
    from meshdeform_formats.picture.viewer import scene

    return scene(_subject(grid, reference), Choice(metric, logarithmic=log), _title(grid))


def _title(grid: Grid) -> str:
    return grid.path.name if grid.path else ""


def _subject(grid: Grid, reference: Grid | None) -> Subject:
    if reference is None:
        return Subject(grid, find_topology(grid))
    require_same_blocks(grid, reference)
    reference = reference.with_patches_of(grid)
    return Subject(grid, find_topology(reference), reference)
