"""Figures like the paper's: grids coloured by f_skew, all with one colour map, several panels per figure."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from meshdeform_core.deform import Setup
from meshdeform_core.grid import FloatArray, Grid
from meshdeform_formats.files import replacing
from meshdeform_formats.picture.page import STYLE, draw
from meshdeform_formats.picture.scene import Facets, block_facets, joined
from meshdeform_formats.picture.subject import Subject
from meshdeform_formats.picture.view import Window, along

from .experiment import Outcome, Trial

_SUFFIX = ".png"
_LINES = 30
_DOTS = 110
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
        self._slices: dict[str, Slice] = {}

    def keep(self, trial: Trial, outcome: Outcome) -> None:
        """Remember the plane of a deformed grid, and of the first undeformed one."""
        setup = outcome.setup
        if trial.key in self._wanted:
            self._slices[trial.key] = Slice.of(setup, outcome.points, self._middle)
        if "undeformed" in self._wanted and "undeformed" not in self._slices:
            self._slices["undeformed"] = Slice.of(setup, setup.grid.points, self._middle)

    def draw(self) -> list[str]:
        """Write the figures; returns their file names."""
        return [_draw(figure, self._slices, self._folder) for figure in self._figures]


@dataclass(frozen=True)
class Slice:
    """The cells of a plane with their values, the grid lines to draw, and the direction of view."""

    facets: Facets
    lines: tuple[FloatArray, ...]
    view: str

    @classmethod
    def of(cls, setup: Setup, points: FloatArray, middle: bool) -> Slice:
        """The whole of a deformed 2-D grid; the first k plane of a 3-D grid, or its ``middle`` plane y = 0."""
        grid = setup.grid.moved(points)
        planes = _planes(setup.grid, middle)
        subject = Subject(grid, setup.topology)
        facets = [block_facets(subject, *plane, "f_skew") for plane in planes]
        nodes = [np.take(grid.block(block), index, axis).squeeze() for block, axis, index in planes]
        every = -(-max(max(plane.shape[:2]) for plane in nodes) // _LINES)
        lines = [line for plane in nodes for line in _lines(plane, every)]
        return cls(joined(facets), tuple(lines), "y" if middle else "z")


Plane = tuple[int, int, int]
"""Block, index axis and node index."""


def _planes(grid: Grid, middle: bool) -> list[Plane]:
    if middle:
        return [plane for block in range(grid.n_blocks) for plane in _flat_in_y(grid, block)]
    return [(block, shape.index(1) if grid.dimension == 2 else 2, 0) for block, shape in enumerate(grid.shapes)]


def _flat_in_y(grid: Grid, block: int) -> list[Plane]:
    """Node planes of a block in y = 0."""
    y = np.abs(grid.block(block)[..., 1])
    tiny = 1e-12 * float(np.abs(grid.points).max())
    found = []
    for axis in (0, 1):
        others = tuple(a for a in range(3) if a != axis)
        found += [(block, axis, int(index)) for index in np.flatnonzero(y.max(axis=others) < tiny)]
    return found


def _lines(plane: FloatArray, every: int) -> list[FloatArray]:
    """Every n-th grid line in either direction of a plane (na, nb, 3), with n = ``every``, and the last ones.

    Between two crossings a line has one additional node, enough for a smooth curve.
    """
    along = max(1, every // 2)
    lines = []
    for nodes in (plane, plane.swapaxes(0, 1)):
        thinned = np.concatenate([nodes[:, :-1:along], nodes[:, -1:]], axis=1)
        lines += [*thinned[:-1:every], thinned[-1]]
    return lines


def _draw(figure: Figure, slices: dict[str, Slice], folder: Path) -> str:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.collections import LineCollection

    panels = [panel for panel in figure.panels if panel.key in slices]
    rows = -(-len(panels) // figure.columns)
    with plt.rc_context(STYLE):
        whole, axes = plt.subplots(
            rows,
            figure.columns,
            figsize=(3.3 * figure.columns + 0.6, (2.9 * figure.height + 0.55) * rows),
            layout="constrained",
            squeeze=False,
        )
        for place, panel, letter in zip(axes.flat, panels, "abcdefghi", strict=False):
            part = slices[panel.key]
            view = along(part.view)
            lines = [view.project(line)[:, :2] for line in part.lines]
            window = Window(*panel.zoom) if panel.zoom else None
            collection = draw(place, part.facets, view=view, window=window, limits=(figure.low, 1.0), lines=False)
            place.add_collection(LineCollection(lines, colors="black", linewidths=0.18))
            if panel.zoom:
                place.set_xlim(*panel.zoom[:2])
                place.set_ylim(*panel.zoom[2:])
            place.set_xlabel(f"{view.labels[0]} [{figure.unit}]", labelpad=1)
            place.set_ylabel(f"{view.labels[1]} [{figure.unit}]", labelpad=1)
            place.set_title(f"({letter}) {panel.title}", fontsize=9)
        for place in axes.flat[len(panels) :]:
            place.set_axis_off()
        bar = whole.colorbar(collection, ax=axes, label="$f_{skew}$ [-]", shrink=0.8, aspect=30, pad=0.015)
        bar.outline.set_linewidth(0.5)
        with replacing(folder / f"{figure.name}{_SUFFIX}") as partial:
            whole.savefig(partial, format="png", dpi=_DOTS)
        plt.close(whole)
    return f"{figure.name}{_SUFFIX}"
