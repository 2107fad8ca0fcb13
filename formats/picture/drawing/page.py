"""The description of a page of panels to be drawn."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from meshdeform_core.grid import FloatArray

from ..view import View, Window
from .colours import Scale
from .image import Scene


@dataclass(frozen=True)
class Panel:
    """One picture on a page.

    Attributes
    ----------
    window : what is shown, in coordinates of the view
    arrows : (k, 2, 3) points and displacements, drawn as arrows at their true length
    frames : windows of close-ups, drawn as rectangles
    under : another scene, drawn first and seen through this one
    names : texts at points (k, 3)
    strokes : thick lines (k, 2, 3) in colours of their own
    """

    scene: Scene
    view: View
    window: Window
    title: str = ""
    arrows: FloatArray = field(default_factory=lambda: np.empty((0, 2, 3)))
    frames: tuple[Window, ...] = ()
    under: Scene | None = None
    names: tuple[tuple[str, FloatArray], ...] = ()
    strokes: tuple[tuple[FloatArray, tuple[float, float, float]], ...] = ()

    @property
    def aspect(self) -> float:
        """Height over width."""
        left, right, bottom, top = self.window
        return (top - bottom) / (right - left)


@dataclass(frozen=True)
class Page:
    """Panels side by side, or one below the other if they are flat, with colour bar and legend.

    ``legend`` are names and colours of groups; ``explained`` always includes the colour of invalid cells.
    """

    panels: tuple[Panel, ...]
    title: str = ""
    scale: Scale | None = None
    legend: tuple[tuple[str, tuple[float, float, float]], ...] = ()
    explained: bool = False

    @property
    def invalid(self) -> int:
        """Number of invalid cells in the panel that shows the most of them."""
        return max((int(panel.scene.facets.bad.sum()) for panel in self.panels), default=0)
