"""Figures like the paper's: grids coloured by f_skew, several panels per figure, drawn as ``meshdeform plot`` draws."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from meshdeform_core.grid import Grid
from meshdeform_core.grid.planes import Plane
from meshdeform_core.grid.topology import Topology
from meshdeform_formats.picture.page import Page, Scale, save_page
from meshdeform_formats.picture.page import Panel as Drawn
from meshdeform_formats.picture.scene import Scene, Window, cut_scene, whole_scene
from meshdeform_formats.picture.subject import Subject

from .experiment import Outcome, Trial


class Panel(NamedTuple):
    """One grid of a figure: the trial's key (``undeformed`` for the start), title and window."""

    key: str
    title: str
    window: Window | None = None


@dataclass(frozen=True)
class Figure:
    """A figure of the paper, with a picture for every row of panels; ``low`` is the lower end of the colour range."""

    name: str
    panels: tuple[Panel, ...]
    low: float = 0.0
    columns: int = 3


_AIRFOIL = Window(-0.75, 0.75, -0.75, 0.75)
_WIDE = Window(-12.5, 12.5, -12.5, 12.5)
_EDGE = Window(-0.06, 0.06, 0.42, 0.54)
_PLATE = Window(-3.6, 8.6, -6.6, 6.6)
_DOME = Window(-0.3, 0.3, 0.0, 0.3)

FIGURES: dict[str, tuple[Figure, ...]] = {
    "table2": (
        Figure("fig01-square-tfi", (Panel("undeformed", "undeformed"), Panel("tfi", "TFI"))),
        Figure("fig02-square-rbf", tuple(
            Panel(f"{key}{end}", f"{name}{', greedy' if end == '-greedy' else ''}")
            for end in ("-direct", "-greedy")
            for key, name in (("wc0", "W $C^0$"), ("wc2", "W $C^2$"), ("c1", "CTPS $C^1$"))
        )),
        Figure("fig03-square-tps", (
            Panel("tps-coarse", "TPS, 21 x 21 nodes"), Panel("tps-direct", "TPS, fine grid"),
        )),
        Figure("fig04-square-idw", (
            Panel("idw-none", "IDW without rotation"), Panel("idw-division-25", "25 division steps"),
            Panel("idw-marching-25", "25 marching steps"),
        )),
    ),
    "table3": (
        Figure("fig05-airfoil-tfi", (Panel("tfi", "TFI", _WIDE), Panel("tfi", "TFI, near field", _AIRFOIL))),
        Figure("fig06-airfoil-wc0", (
            Panel("wc0", "W $C^0$", _AIRFOIL), Panel("wc0", "W $C^0$, trailing edge", _EDGE),
        )),
        Figure("fig07-airfoil-rbf", tuple(
            Panel(key, name, zoom) for zoom in (_WIDE, _AIRFOIL)
            for key, name in (("wc2", "W $C^2$"), ("c1", "CTPS $C^1$"), ("tps", "TPS"))
        )),
        Figure("fig08-09-airfoil-ctps", tuple(
            Panel(key, name, zoom) for zoom in (_WIDE, _AIRFOIL)
            for key, name in (("c2a", "CTPS $C^2_a$"), ("c2b", "CTPS $C^2_b$"))
        ), columns=2),
        Figure("fig10-airfoil-idw", (
            Panel("idw-auto", "IDW, α by eq. 18", _WIDE), Panel("idw-auto", "near field", _AIRFOIL),
            Panel("idw-auto", "trailing edge", _EDGE),
        )),
    ),
    "table4": (
        Figure("fig12-splitter-plate", tuple(
            Panel(key, key.upper(), _PLATE)
            for key in ("tfi-tfi", "rbf-rbf", "idw-idw", "rbf-tfi", "idw-rbf", "idw-tfi")
        ), low=0.5),
    ),
    "table5": (
        Figure("fig15-hemisphere", (
            Panel("undeformed", "undeformed", _DOME),
            Panel("default", "IDW-TFI", _DOME),
            Panel("default", "top of the membrane", Window(-0.03, 0.03, 0.065, 0.105)),
            Panel("default", "junction with the plate", Window(0.067, 0.097, 0.0, 0.02)),
        ), low=0.5, columns=2),
    ),
    "figB": (
        Figure("fig17-beam", (
            Panel("one-centre", "one step, origin at the centre"),
            Panel("one-corner", "one step, origin at the corner"),
            Panel("marching-corner", "25 time steps"), Panel("division-corner", "25 division steps"),
            Panel("lie-corner", "lie (ours)"), Panel("undeformed", "undeformed"),
        ), low=0.5),
    ),
}  # fmt: skip
"""Figures of each table, by the keys of its rows."""


class Gallery:
    """Keeps the planes needed by the figures while a table is computed, then draws them."""

    def __init__(self, table: str, folder: Path):
        self._figures, self._folder = FIGURES.get(table, ()), folder
        self._wanted = {panel.key for figure in self._figures for panel in figure.panels}
        self._scenes: dict[str, Scene] = {}

    def keep(self, trial: Trial, outcome: Outcome) -> None:
        """Remember the plane of a deformed grid, and of the first undeformed one."""
        grid, topology = outcome.setup.grid, outcome.setup.topology
        if trial.key in self._wanted:
            self._scenes[trial.key] = scene_of(grid.moved(outcome.points), topology)
        if "undeformed" in self._wanted - self._scenes.keys():
            self._scenes["undeformed"] = scene_of(grid, topology)

    def write(self) -> list[str]:
        """Write the figures; returns their file names."""
        names = []
        for figure in self._figures:
            shown = [panel for panel in figure.panels if panel.key in self._scenes]
            for first in range(0, len(shown), figure.columns):
                row = [
                    drawn(self._scenes[panel.key], panel.title, panel.window)
                    for panel in shown[first : first + figure.columns]
                ]
                letter = f"-{'abcdef'[first // figure.columns]}" if len(shown) > figure.columns else ""
                names.append(f"{figure.name}{letter}.png")
                save_page(Page.of(row, Scale("f_skew", (figure.low, 1.0))), self._folder / names[-1])
        return names


def scene_of(grid: Grid, topology: Topology) -> Scene:
    """The plane of a 2-D or extruded grid; of another one, a cut beside y = 0, as nodes lie in that plane."""
    subject = Subject(grid, topology)
    return whole_scene(subject, "f_skew") or cut_scene(
        subject, Plane(np.full(3, 1e-3 * subject.size), np.eye(3)[1]), "f_skew"
    )


def drawn(scene: Scene, title: str, window: Window | None = None) -> Drawn:
    """A scene as a panel, whole or in a window."""
    return Drawn(scene, window or scene.view.window(scene.facets.corners, 0.03), title)
