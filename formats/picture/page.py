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
from .raster import render
from .scene import Facets, Scene, Window
from .subject import OF_CORNERS

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

INVALID_COLOUR = (0.90, 0.00, 0.42)
"""Not in any of the colour maps; colour-blind people can distinguish it from them by lightness or hue."""
_REACHES = (0.01, 0.02, 0.05, *(n / 10 for n in range(1, 11)))
"""Ranges for metrics between 0 and 1, which make round labels."""
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
    "figure.dpi": 200,
    # The same picture gives the same file.
    "svg.hashsalt": "meshdeform",
    "svg.fonttype": "none",
}
_WIDTH = 7.2
"""Width of a page, in inches."""
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
        colours = DIVERGING if CELL_MEASURES[self.metric].worst == "far" else SEQUENTIAL
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
        low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
        if self.metric in _WITHIN_ONE and not self.logarithmic:
            # The good end stays, the other follows the data.
            return 1.0 - next(reach for reach in _REACHES if reach >= 1.0 - max(low, 0.0) - 1e-9), 1.0
        if CELL_MEASURES[self.metric].worst == "far":
            # The neutral value in the middle.
            factor, reach = max(high, 1.0 / low if low else 0.0, 1.001), max(high - 1.0, 1.0 - low, 1e-3)
            return (1.0 / factor, factor) if self.logarithmic else (1.0 - reach, 1.0 + reach)
        # A single value is in the middle, too.
        around = (0.1 * abs(low) or 0.1) if high - low <= 1e-12 * abs(low) else 0.0
        return low - around, high + around


@dataclass(frozen=True)
class Panel:
    """One picture on a page.

    Attributes
    ----------
    window : what is shown, in coordinates of the view
    """

    scene: Scene
    window: Window
    title: str = ""

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
    data = page_bytes(page, path.suffix.lower().lstrip("."))
    with replacing(path) as partial:
        partial.write_bytes(data)


def page_bytes(page: Page, kind: str = "png") -> bytes:
    """A page as the bytes of a png, svg or pdf file."""
    import matplotlib as mpl

    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
    buffer = io.BytesIO()
    with mpl.rc_context(STYLE):
        page_figure(page).savefig(buffer, format=kind, metadata=metadata)
    return buffer.getvalue()


def page_figure(page: Page) -> Figure:
    """A page as a matplotlib figure."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with mpl.rc_context(STYLE):
        # Ticks may change when panels get their final shape, so that their labels need some room.
        layout = ConstrainedLayoutEngine(w_pad=0.08)
        aspects, side = [panel.aspect for panel in page.panels], 1.05
        if len(aspects) > 1 and aspects[0] < 0.45:
            shares = [min(aspect, 0.8) for aspect in aspects]
            height, rows, ratios = (
                sum((_WIDTH - side - 0.5) * share + 0.6 for share in shares),
                len(shares),
                "height_ratios",
            )
        else:
            # Side by side and equally high.
            shares = [1 / max(aspect, 0.4) for aspect in aspects]
            each = (_WIDTH - side - 0.55 * len(aspects)) / sum(shares)
            height = max(each * share * aspect for share, aspect in zip(shares, aspects, strict=True)) + 0.8
            rows, ratios = 1, "width_ratios"
        height = min(max(height, 2.2), 1.4 * _WIDTH) + (0.3 if page.title else 0.0) + (0.35 if page.explained else 0.0)
        figure = Figure(figsize=(_WIDTH, height), layout=layout)
        FigureCanvasAgg(figure)
        options: dict[str, Any] = {ratios: shares}
        axes = list(figure.subplots(rows, len(shares) // rows, squeeze=False, **options).flat)
        _frame(figure, axes, page)
        # The layout alone, without drawing; `None` also keeps `savefig` from laying out once more.
        layout.execute(figure)
        figure.set_layout_engine(None)
        for ax, panel in zip(axes, page.panels, strict=True):
            _fill_axes(ax, panel, page)
        return figure


def _frame(figure: Figure, axes: list[Axes], page: Page) -> None:
    """Titles and labels, colour bar and legend, which determine the size of the panels."""
    from matplotlib.patches import Patch

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


def _fill_axes(ax: Axes, panel: Panel, page: Page) -> None:
    from matplotlib.collections import PolyCollection

    scene, view = panel.scene, panel.scene.view
    width = max(64, round(ax.get_window_extent().width))
    image = render(scene, page.scale.colours(scene.facets), panel.window, width)
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
        # The directions of x, y and z in the lower left corner.
        for name, (across, upwards, _) in zip("xyz", view.project(np.eye(3)).tolist(), strict=True):
            ax.annotate(
                name, xy=(32, 32), xytext=(32 + 27 * across, 32 + 27 * upwards), xycoords="axes points",
                textcoords="axes points", ha="center", va="center", arrowprops={"arrowstyle": "<-", "shrinkB": 0},
            )  # fmt: skip
