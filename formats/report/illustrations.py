"""The pictures of a report: a cut and the worst place, before and after, in one window and one scale of colours."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from meshdeform_core.boundary import Kind
from meshdeform_core.deform import Setup
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.quality import InvalidCell

from ..picture import STYLE, Facets, draw, plane_facets
from .page import Figure

Window = tuple[float, float, float, float]
_ROOM = 0.6
_CELLS_SHOWN = 12


@dataclass(frozen=True)
class Illustrations:
    """Pictures of one deformation, and small ones of the levels of a series with the files that they lead to."""

    figures: tuple[Figure, ...] = ()
    thumbnails: tuple[tuple[Figure, str], ...] = ()


Illustrate = Callable[[], Illustrations]


def deformation_figures(setup: Setup, after: Grid, invalid: Sequence[InvalidCell]) -> Illustrations:
    """The grid around the moving walls and around its worst cells, coloured by f_skew."""
    layer = _layer(after, invalid)
    cuts = [plane_facets(grid, setup.topology, 2, layer, "f_skew") for grid in (setup.grid, after)]
    whole = _window([_moving_nodes(setup, grid.points) for grid in (setup.grid, after)], _ROOM)
    worst = _worst_window(cuts[1], invalid)
    plane = "the grid" if after.dimension == 2 else f"the grid plane k = {layer + 1}"
    return Illustrations(
        (
            _pair("Around the moving walls", f"Cells of {plane}, coloured by f_skew.", cuts, whole),
            _pair("The worst cells", f"A close-up of {plane} where f_skew is smallest.", cuts, worst),
        )
    )


def _layer(grid: Grid, invalid: Sequence[InvalidCell]) -> int:
    return invalid[0].ijk[2] - 1 if invalid and grid.dimension == 3 else 0


def _moving_nodes(setup: Setup, points: FloatArray) -> FloatArray:
    moving = np.flatnonzero(setup.boundary.kind == Kind.MOVING)
    return np.asarray(points[setup.topology.first[moving]])


def _window(parts: Sequence[FloatArray], room: float) -> Window:
    """Left, right, bottom, top of the points seen along z, with room around them."""
    low = np.min([p.min(axis=0) for p in parts], axis=0)[:2]
    high = np.max([p.max(axis=0) for p in parts], axis=0)[:2]
    grow = room * float((high - low).max())
    low, high = low - grow, high + grow
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def _worst_window(cut: Facets, invalid: Sequence[InvalidCell]) -> Window:
    worst = cut.corners[int(np.argmin(cut.values))]
    size = float(np.ptp(worst, axis=0).max()) * _CELLS_SHOWN
    center = np.array(invalid[0].center) if invalid else worst.mean(axis=0)
    return _window([center[None] - size, center[None] + size], 0.0)


def _pair(title: str, caption: str, cuts: Sequence[Facets], window: Window) -> Figure:
    before, after = (_png(cut, window) for cut in cuts)
    return Figure(title, caption, after, before)


def _png(cut: Facets, window: Window, dpi: int = 150) -> bytes:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context(STYLE):
        figure, axes = plt.subplots(figsize=(7.0, 5.0), layout="constrained")
        collection = draw(axes, cut, view="z", limits=(0.0, 1.0))
        axes.set(xlim=window[:2], ylim=window[2:])
        figure.colorbar(collection, ax=axes, label="f_skew", shrink=0.8, pad=0.02)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=dpi)
        plt.close(figure)
    return stream.getvalue()


def level_thumbnails(
    setup: Setup, levels: Sequence[tuple[int, str, str]], read: Callable[[int], FloatArray]
) -> Illustrations:
    """A small picture around the moving walls for some levels of a series.

    Parameters
    ----------
    levels : number, caption and file name of each
    read : gives the coordinates (n_nodes, 3) of a level
    """
    points = {number: read(number) for number, _, _ in levels}
    window = _window([_moving_nodes(setup, x) for x in points.values()], _ROOM)
    shown = []
    for number, caption, file in levels:
        cut = plane_facets(setup.grid.moved(points[number]), setup.topology, 2, 0, "f_skew")
        shown.append((Figure(caption, caption, _png(cut, window, 70)), file))
    return Illustrations(thumbnails=tuple(shown))
