"""Figures like the paper's: grids coloured by f_skew, all with one colour map, several panels per figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from meshdeform_core.grid import FloatArray, Grid
from meshdeform_core.grid.topology import Topology
from meshdeform_core.quality.fields import CellFields
from meshdeform_formats.files import replacing
from meshdeform_formats.picture.page import INVALID_COLOUR, SEQUENTIAL, STYLE

from .experiment import Outcome, Trial

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import QuadMesh

_LINES = 30
Zoom = tuple[float, float, float, float]


@dataclass(frozen=True)
class Panel:
    """One grid of a figure: the trial's key (``undeformed`` for the start), title and window (left to top)."""

    key: str
    title: str
    zoom: Zoom | None = None


@dataclass(frozen=True)
class Figure:
    """A figure of the paper: panels in columns, their height a fraction of their width.

    ``low`` is the lower end of the colour range, ``unit`` that of the axes; ``middle`` draws the plane y = 0 of a 3-D
    grid instead of its first k plane.
    """

    name: str
    columns: int
    panels: tuple[Panel, ...]
    low: float = 0.0
    unit: str = "-"
    height: float = 1.0
    middle: bool = False


_AIRFOIL: Zoom = (-0.75, 0.75, -0.75, 0.75)
_WIDE: Zoom = (-12.5, 12.5, -12.5, 12.5)
_EDGE: Zoom = (-0.06, 0.06, 0.42, 0.54)
_PLATE: Zoom = (-3.6, 8.6, -6.6, 6.6)

FIGURES: dict[str, tuple[Figure, ...]] = {
    "table2": (
        Figure("fig01-square-tfi", 2, (Panel("undeformed", "undeformed"), Panel("tfi", "TFI"))),
        Figure("fig02-square-rbf", 3, tuple(
            Panel(f"{key}{end}", f"{name}{', greedy' if end == '-greedy' else ''}")
            for end in ("-direct", "-greedy")
            for key, name in (("wc0", "W $C^0$"), ("wc2", "W $C^2$"), ("c1", "CTPS $C^1$"))
        )),
        Figure("fig03-square-tps", 2, (
            Panel("tps-coarse", "TPS, 21 x 21 nodes"), Panel("tps-direct", "TPS, fine grid"),
        )),
        Figure("fig04-square-idw", 3, (
            Panel("idw-none", "IDW without rotation"), Panel("idw-division-25", "25 division steps"),
            Panel("idw-marching-25", "25 marching steps"),
        )),
    ),
    "table3": (
        Figure("fig05-airfoil-tfi", 2, (Panel("tfi", "TFI", _WIDE), Panel("tfi", "TFI, near field", _AIRFOIL))),
        Figure("fig06-airfoil-wc0", 2, (
            Panel("wc0", "W $C^0$", _AIRFOIL), Panel("wc0", "W $C^0$, trailing edge", _EDGE),
        )),
        Figure("fig07-airfoil-rbf", 3, tuple(
            Panel(key, name, zoom) for zoom in (_WIDE, _AIRFOIL)
            for key, name in (("wc2", "W $C^2$"), ("c1", "CTPS $C^1$"), ("tps", "TPS"))
        )),
        Figure("fig08-09-airfoil-ctps", 2, tuple(
            Panel(key, name, zoom) for zoom in (_WIDE, _AIRFOIL)
            for key, name in (("c2a", "CTPS $C^2_a$"), ("c2b", "CTPS $C^2_b$"))
        )),
        Figure("fig10-airfoil-idw", 3, (
            Panel("idw-auto", "IDW, α by eq. 18", _WIDE), Panel("idw-auto", "near field", _AIRFOIL),
            Panel("idw-auto", "trailing edge", _EDGE),
        )),
    ),
    "table4": (
        Figure("fig12-splitter-plate", 3, tuple(
            Panel(key, key.upper(), _PLATE)
            for key in ("tfi-tfi", "rbf-rbf", "idw-idw", "rbf-tfi", "idw-rbf", "idw-tfi")
        ), low=0.5),
    ),
    "table5": (
        Figure("fig15-hemisphere", 2, (
            Panel("undeformed", "undeformed", (-0.3, 0.3, 0.0, 0.3)),
            Panel("default", "IDW-TFI", (-0.3, 0.3, 0.0, 0.3)),
            Panel("default", "top of the membrane", (-0.03, 0.03, 0.065, 0.105)),
            Panel("default", "junction with the plate", (0.067, 0.097, 0.0, 0.02)),
        ), low=0.5, unit="m", height=0.6, middle=True),
    ),
    "figB": (
        Figure("fig17-beam", 2, (
            Panel("one-centre", "one step, origin at the centre"),
            Panel("one-corner", "one step, origin at the corner"),
            Panel("marching-corner", "25 time steps"), Panel("division-corner", "25 division steps"),
            Panel("lie-corner", "lie (ours)"), Panel("undeformed", "undeformed"),
        ), low=0.5, height=0.55),
    ),
}  # fmt: skip
"""Figures of each table, by the keys of its rows."""


class Gallery:
    """Keeps the planes needed by the figures while a table is computed, then draws them."""

    def __init__(self, table: str, folder: Path):
        self._figures, self._folder = FIGURES.get(table, ()), folder
        self._wanted = {panel.key for figure in self._figures for panel in figure.panels}
        self._middle = any(figure.middle for figure in self._figures)
        self._planes: dict[str, list[Plane]] = {}

    def keep(self, trial: Trial, outcome: Outcome) -> None:
        """Remember the planes of a deformed grid, and of the first undeformed one."""
        grid, topology = outcome.setup.grid, outcome.setup.topology
        if trial.key in self._wanted:
            self._planes[trial.key] = planes_of(grid.moved(outcome.points), topology, grid, self._middle)
        if "undeformed" in self._wanted - self._planes.keys():
            self._planes["undeformed"] = planes_of(grid, topology, grid, self._middle)

    def write(self) -> list[str]:
        """Write the figures; returns their file names."""
        from matplotlib import pyplot as plt

        plt.switch_backend("Agg")
        for figure in self._figures:
            panels = [panel for panel in figure.panels if panel.key in self._planes]
            rows = -(-len(panels) // figure.columns)
            size = 3.3 * figure.columns + 0.6, (2.9 * figure.height + 0.55) * rows
            with plt.rc_context(STYLE):
                whole, axes = plt.subplots(rows, figure.columns, figsize=size, layout="constrained", squeeze=False)
                for place, panel, letter in zip(axes.flat, panels, "abcdefghi", strict=False):
                    part = self._planes[panel.key]
                    every = -(-max(max(skew.shape) + 1 for _, skew in part) // _LINES)
                    cells = draw_planes(place, part, figure.low, every)
                    if panel.zoom:
                        place.set(xlim=panel.zoom[:2], ylim=panel.zoom[2:])
                    place.set_xlabel(f"x [{figure.unit}]", labelpad=1)
                    place.set_ylabel(f"{'z' if figure.middle else 'y'} [{figure.unit}]", labelpad=1)
                    place.set_title(f"({letter}) {panel.title}", fontsize=9)
                for place in axes.flat[len(panels) :]:
                    place.set_axis_off()
                bar = whole.colorbar(cells, ax=axes, label="$f_{skew}$ [-]", shrink=0.8, aspect=30, pad=0.015)
                bar.outline.set_linewidth(0.5)
                with replacing(self._folder / f"{figure.name}.png") as partial:
                    whole.savefig(partial, format="png", dpi=110)
                plt.close(whole)
        return [f"{figure.name}.png" for figure in self._figures]


Plane = tuple[FloatArray, FloatArray]
"""Nodes (na, nb, 2) of a plane of a block, and f_skew of its cells, NaN where they are invalid."""


def planes_of(grid: Grid, topology: Topology, undeformed: Grid, middle: bool = False) -> list[Plane]:
    """The whole of a 2-D grid; the first k plane of a 3-D grid, or its ``middle`` plane, y = 0 before it moved."""
    cells, tiny, planes = CellFields(grid, topology), 1e-12 * float(np.abs(undeformed.points).max()), []
    for block, shape in enumerate(grid.shapes):
        found = [(shape.index(1) if grid.dimension == 2 else 2, 0)]
        if middle:
            y = np.abs(undeformed.block(block)[..., 1])
            found = [(axis, int(n)) for axis in (0, 1) for n in np.flatnonzero(y.max(axis=(1 - axis, 2)) < tiny)]
        for axis, index in found:
            layer = min(index, grid.cell_shapes[block][axis] - 1)
            i, j, k = (slice(layer, layer + 1) if a == axis else all_ for a, all_ in enumerate(cells.whole(block)))
            skew = np.where(cells.bad(block, (i, j, k)), np.nan, cells.values("f_skew", block, (i, j, k)))
            nodes = np.take(grid.block(block), index, axis)[..., [0, 2 if middle else 1]]
            planes.append((nodes, skew.squeeze(axis)))
    return planes


def draw_planes(axes: Axes, planes: list[Plane], low: float, every: int = 1) -> QuadMesh:
    """Draw cells coloured by f_skew from ``low`` to 1, and every n-th grid line, n = ``every``, with the last ones."""
    import matplotlib as mpl

    colours = mpl.colormaps[SEQUENTIAL].with_extremes(bad=INVALID_COLOUR)
    for nodes, skew in planes:
        cells = axes.pcolormesh(nodes[..., 0], nodes[..., 1], skew, cmap=colours, vmin=low, vmax=1.0)
        for lines in (nodes, nodes.swapaxes(0, 1)):
            some = lines[[*range(0, len(lines) - 1, every), -1]]
            axes.plot(some[..., 0].T, some[..., 1].T, color="black", linewidth=0.18)
    axes.set_aspect("equal")
    return cells
