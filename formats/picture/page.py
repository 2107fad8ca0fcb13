"""Pages of panels as matplotlib figures: images of scenes in axes of equal scales, colour bar, legend, files.

Colours of values are chosen so that colour-blind people can distinguish them.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.errors import CaseError, FormatError
from meshdeform_core.grid import FloatArray
from meshdeform_core.quality.fields import CELL_MEASURES

from ..files import replacing
from .raster import FINE, render
from .scene import Facets, Scene, View, Window
from .subject import AROUND_ONE, OF_CORNERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

INVALID_COLOUR = (0.90, 0.00, 0.42)
"""Not in any of the colour maps; colour-blind people can distinguish it from them by lightness or hue."""
_REACHES = (0.01, 0.02, 0.05)
"""Shortest ranges for metrics between 0 and 1; longer ones are multiples of a tenth."""
_WITHIN_ONE = ("f_skew", "scaled_jacobian")
SEQUENTIAL, DIVERGING = "viridis", "PuOr"
NO_VALUE = (0.86, 0.86, 0.87)
SUFFIXES = (".png", ".svg", ".pdf")
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 200,
    # The same picture gives the same file.
    "svg.hashsalt": "meshdeform",
    "svg.fonttype": "none",
}
_WIDTH = 7.2
"""Width of a page, in inches."""
_CORNER = 64.0
"""Full width of the triad of axes, in points."""
_HIGH = 3.5
"""Height of a figure, in inches, from which on the label of the colour bar fits in one line."""


@dataclass(frozen=True)
class Scale:
    """Mapping of values to colours.

    ``limits`` are the ends (``None``: those that :meth:`fitted` finds), ``logarithmic`` how values are spaced between
    them, ``extended`` which ends values exceed (``neither``, ``min``, ``max``, ``both``, as for matplotlib's colour
    bars).
    """

    metric: str = "f_skew"
    limits: tuple[float, float] | None = None
    logarithmic: bool = False
    extended: str = "neither"

    @property
    def mappable(self) -> ScalarMappable:
        """Norm and colour map, for matplotlib's colour bars."""
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm, Normalize

        low, high = self.limits or (None, None)
        colours = DIVERGING if self.metric in AROUND_ONE else SEQUENTIAL
        return ScalarMappable((LogNorm if self.logarithmic else Normalize)(low, high, clip=True), colours)

    def colours(self, facets: Facets) -> FloatArray:
        """RGB (n, 3) of polygons by value; invalid cells have a colour of their own, those without a value are grey."""
        known = np.isfinite(facets.values)
        colours = np.asarray(self.mappable.to_rgba(np.where(known, facets.values, 1.0)))[:, :3]
        colours[~known] = NO_VALUE
        colours[facets.bad] = INVALID_COLOUR
        return colours

    def fitted(self, *values: FloatArray) -> Scale:
        """For all values (n,) together: between the limits, else the metric's own, else the ends of the values.

        Raises CaseError when a logarithmic scale is requested but no value is positive.
        """
        finite = np.concatenate(values)
        finite = finite[np.isfinite(finite)]
        if self.logarithmic:
            finite = finite[finite > 0]
            if finite.size == 0 or (self.limits is not None and self.limits[0] <= 0):
                raise CaseError(f"--log: {self.metric} has no positive value, or the range does not begin above zero")
        low, high = self.limits or self._ends(finite)
        beyond = bool((finite < low - 1e-12 * abs(low)).any()), bool((finite > high + 1e-12 * abs(high)).any())
        extended = {(False, False): "neither", (True, False): "min", (False, True): "max", (True, True): "both"}[beyond]
        return Scale(self.metric, (low, high), self.logarithmic, extended)

    def _ends(self, finite: FloatArray) -> tuple[float, float]:
        """The ends of the colours for values (n,)."""
        if self.metric in _WITHIN_ONE and not self.logarithmic:
            # The good end stays; the other follows the data, in steps that make round labels.
            worst = 1.0 - max(float(finite.min()) if finite.size else 0.0, 0.0)
            reach = next((step for step in _REACHES if worst <= step + 1e-9), np.ceil(10 * worst - 1e-9) / 10)
            return round(1.0 - reach, 2), 1.0
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        if self.metric in AROUND_ONE:
            # The neutral value in the middle.
            if self.logarithmic:
                factor = max(high, 1.0 / low, 1.001)
                return 1.0 / factor, factor
            reach = max(abs(high - 1.0), abs(1.0 - low), 1e-3)
            return 1.0 - reach, 1.0 + reach
        if high - low <= 1e-12 * max(abs(low), abs(high)):
            pad = 0.5 * abs(low) or 0.5
            return (0.5 * low, 2 * low) if self.logarithmic else (low - pad, high + pad)
        return low, high


@dataclass(frozen=True)
class Panel:
    """One picture on a page.

    Attributes
    ----------
    window : what is shown, in coordinates of the view
    frames : windows of close-ups, drawn as rectangles
    """

    scene: Scene
    window: Window
    title: str = ""
    frames: tuple[Window, ...] = ()

    @property
    def aspect(self) -> float:
        """Height over width."""
        return self.window.height / self.window.width


@dataclass(frozen=True)
class Page:
    """Panels side by side, or one below the other if they are flat, with colour bar and legend."""

    panels: tuple[Panel, ...]
    title: str
    scale: Scale

    @classmethod
    def of(cls, panels: Sequence[Panel], scale: Scale, title: str = "") -> Page:
        """Panels in the colours of all their values together."""
        return cls(tuple(panels), title, scale.fitted(*(panel.scene.facets.values for panel in panels)))

    @property
    def explained(self) -> set[str]:
        """Kinds of cells that the legend explains: ``invalid`` ones, those whose values are ``absent``."""
        facets = [panel.scene.facets for panel in self.panels]
        invalid = {"invalid"} if any(each.bad.any() for each in facets) else set()
        return invalid | ({"absent"} if any(not np.isfinite(each.values).all() for each in facets) else set())


def check_picture_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix.lower() not in SUFFIXES:
        raise FormatError(f"picture {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")


def save_page(page: Page, path: Path) -> None:
    """Write a page; the suffix picks png, svg or pdf."""
    check_picture_path(path)
    # Into memory first, as matplotlib cannot close a file on a full disk.
    data = _saved(page, path.suffix.lower().lstrip("."), _WIDTH, STYLE["savefig.dpi"], FINE)
    with replacing(path) as partial:
        partial.write_bytes(data)


def page_png(page: Page, width: float = _WIDTH, dpi: int | None = None) -> bytes:
    """A page as the bytes of a PNG file, by default with the resolution of ``STYLE`` for the screen."""
    return _saved(page, "png", width, dpi or STYLE["figure.dpi"], 2)


def _saved(page: Page, kind: str, width: float, dpi: int, fine: int) -> bytes:
    import matplotlib as mpl

    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE | {"savefig.dpi": dpi}):
        page_figure(page, width, dpi, fine).savefig(buffer, format=kind, metadata=metadata)
    return buffer.getvalue()


def page_figure(page: Page, width: float = _WIDTH, dpi: int = 150, fine: int = FINE) -> Figure:
    """A page as a matplotlib figure, ``width`` inches wide."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with mpl.rc_context(STYLE | {"figure.dpi": dpi, "savefig.dpi": dpi}):
        # Ticks may change when panels get their final shape, so that their labels need some room.
        layout = ConstrainedLayoutEngine(w_pad=0.08)
        aspects, side = [panel.aspect for panel in page.panels], 1.05
        if _stacked(page):
            height = sum((width - side - 0.5) * min(aspect, 0.8) + 0.6 for aspect in aspects)
        else:
            shares = _shares(page)
            each = (width - side - 0.55 * len(aspects)) / sum(shares)
            height = max(each * share * aspect for share, aspect in zip(shares, aspects, strict=True)) + 0.8
        height = min(max(height, 2.2), 1.4 * width) + (0.3 if page.title else 0.0) + (0.35 if page.explained else 0.0)
        figure = Figure(figsize=(width, height), layout=layout)
        FigureCanvasAgg(figure)
        axes = _frames(figure, page)
        # The layout alone, without drawing; `None` also keeps `savefig` from laying out once more.
        layout.execute(figure)
        figure.set_layout_engine(None)
        for ax, panel in zip(axes, page.panels, strict=True):
            _fill_axes(ax, panel, page, fine)
        return figure


def _stacked(page: Page) -> bool:
    return len(page.panels) > 1 and page.panels[0].aspect < 0.45


def _shares(page: Page) -> list[float]:
    """Relative widths of panels side by side, so that they are equally high."""
    return [1 / max(panel.aspect, 0.4) for panel in page.panels]


def _frames(figure: Figure, page: Page) -> list[Axes]:
    """Empty axes, colour bar, legend and titles, which determine the size of the panels."""
    from matplotlib.patches import Patch

    n = len(page.panels)
    if _stacked(page):
        grid = figure.subplots(n, 1, squeeze=False, height_ratios=[min(p.aspect, 0.8) for p in page.panels])
    else:
        grid = figure.subplots(1, n, squeeze=False, width_ratios=_shares(page))
    axes = list(grid.ravel())
    for ax, panel in zip(axes, page.panels, strict=True):
        ax.set(xlim=panel.window[:2], ylim=panel.window[2:], title=panel.title)
        if panel.scene.view.flat:
            ax.set(xlabel=panel.scene.view.labels[0], ylabel=panel.scene.view.labels[1])
        else:
            ax.set_axis_off()
    metric = page.scale.metric
    label = CELL_MEASURES[metric].definition
    if figure.get_figheight() <= _HIGH:
        # Shorter than the bar.
        label = label.replace(" (", "\n(")
    bar = figure.colorbar(page.scale.mappable, ax=axes, label=label, shrink=0.85, aspect=28, pad=0.015,
                          extend=page.scale.extended)  # fmt: skip
    bar.outline.set_linewidth(0.5)
    absent = "collapsed edge" if metric in OF_CORNERS else "no value"
    legend = [(absent, NO_VALUE)] if "absent" in page.explained else []
    legend += [("invalid cell", INVALID_COLOUR)] if "invalid" in page.explained else []
    if legend:
        entries = [Patch(facecolor=colour, edgecolor="0.3", linewidth=0.4, label=name) for name, colour in legend]
        figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False)
    if page.title:
        figure.suptitle(page.title, fontsize=10.5, fontweight="bold")
    return axes


def _fill_axes(ax: Axes, panel: Panel, page: Page, fine: int) -> None:
    from matplotlib.collections import PolyCollection
    from matplotlib.patches import Rectangle

    scene, view = panel.scene, panel.scene.view
    width = max(64, round(ax.get_window_extent().width))
    image = render(scene, page.scale.colours(scene.facets), panel.window, width, fine)
    ax.imshow(image, extent=panel.window, interpolation="nearest", aspect="equal", zorder=1)
    if not scene.lit and scene.facets.bad.any():
        # Edges of invalid cells of a plane, which would otherwise be too thin to be seen.
        thin = list(view.project(scene.facets.corners[scene.facets.bad])[..., :2])
        ax.add_collection(
            PolyCollection(thin, facecolors="none", edgecolors=[INVALID_COLOUR], linewidths=0.7, zorder=2)
        )
    # Not earlier: the layout measures labels and titles with panels of their full size.
    ax.set(xlim=panel.window[:2], ylim=panel.window[2:], aspect="equal")
    ax.apply_aspect()
    if not view.flat:
        _triad(ax, view)
    for frame in panel.frames:
        ax.add_patch(Rectangle((frame.left, frame.bottom), frame.width, frame.height, fill=False, linewidth=1.0,
                               edgecolor="#c03000", zorder=3))  # fmt: skip


def _triad(ax: Axes, view: View) -> None:
    """The directions of x, y and z in the lower left corner."""
    from matplotlib.patheffects import withStroke

    white = [withStroke(linewidth=2.0, foreground="white")]
    box, points = ax.get_window_extent(), 72 / ax.get_figure(root=True).dpi  # type: ignore[union-attr]
    size = min(1.0, box.width * points / 260)
    x = y = _CORNER * size / 2
    for name, unit in zip("xyz", np.eye(3), strict=True):
        across, upwards, _ = view.project(unit) * size
        # Seen end-on, an axis would be a meaningless dot.
        if np.hypot(across, upwards) < 0.15 * size:
            continue
        ax.annotate(
            "", xy=(x + 20 * across, y + 20 * upwards), xytext=(x, y), xycoords="axes points",
            textcoords="axes points", zorder=5,
            arrowprops={"arrowstyle": "-|>", "linewidth": 0.75, "color": "0.15", "shrinkA": 0, "shrinkB": 0,
                        "mutation_scale": 6 * size, "path_effects": white},
        )  # fmt: skip
        ax.annotate(
            name, xy=(x + 27 * across, y + 27 * upwards), xycoords="axes points", ha="center", va="center",
            fontsize=5 + 3 * size, zorder=5, path_effects=white,
        )  # fmt: skip
