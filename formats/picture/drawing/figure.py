"""A page of panels as a figure: axes with equal scales, colour bar, legend, files of all kinds."""

from __future__ import annotations

import io
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.errors import FormatError

from ...files import replacing
from ..view import View
from .image import FINE, INVALID_COLOUR, Image, Scene, render
from .page import Page, Panel

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SUFFIXES = (".png", ".svg", ".pdf")
FILMS = (".gif", ".mp4")
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.labelsize": 9,
    "axes.titlesize": 9.5,
    "axes.linewidth": 0.6,
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
    "legend.fontsize": 8,
    "figure.dpi": 150,
    "savefig.dpi": 220,
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
_VECTOR_POLYGONS = 6000
"""Largest number of polygons drawn as lines in flat .svg and .pdf pictures; with more they become an image."""


def check_picture_path(path: Path) -> None:
    """Refuse an unknown suffix before anything is computed."""
    if path.suffix.lower() in FILMS:
        raise FormatError(f"{path} is a film; it needs a series: the folder that `meshdeform series` has written")
    if path.suffix.lower() not in SUFFIXES:
        raise FormatError(f"picture {path}: suffix {path.suffix!r} is unknown; expected {', '.join(SUFFIXES)}")


def save_page(page: Page, path: Path) -> None:
    """Write a page; the suffix picks png, svg or pdf."""
    check_picture_path(path)
    # Into memory first, as matplotlib cannot close a file on a full disk.
    buffer = io.BytesIO()
    _save(page, buffer, path.suffix.lower().lstrip("."), _WIDTH, STYLE["savefig.dpi"])
    with replacing(path) as partial:
        partial.write_bytes(buffer.getbuffer())


def page_png(page: Page, width: float = _WIDTH, dpi: int | None = None) -> bytes:
    """A page as the bytes of a PNG file, by default with the resolution of ``STYLE`` for the screen."""
    buffer = io.BytesIO()
    _save(page, buffer, "png", width, dpi or STYLE["figure.dpi"], fine=2)
    return buffer.getvalue()


def page_figure(page: Page, width: float = _WIDTH, dpi: int = 150, fine: int = FINE, vector: bool = False) -> Figure:
    """A page as a matplotlib figure, ``width`` inches wide; ``vector``: for a file that holds lines."""
    import matplotlib as mpl
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.layout_engine import ConstrainedLayoutEngine

    with mpl.rc_context(STYLE | {"figure.dpi": dpi, "savefig.dpi": dpi}):
        # Ticks may change when panels get their final shape, so that their labels need some room.
        layout = ConstrainedLayoutEngine(w_pad=0.08)
        figure = Figure(figsize=_size(page, width), layout=layout)
        FigureCanvasAgg(figure)
        axes = _frames(figure, page)
        # The layout alone, without drawing; `None` also keeps `savefig` from laying out once more.
        layout.execute(figure)
        figure.set_layout_engine(None)
        for ax, panel in zip(axes, page.panels, strict=True):
            _fill(ax, panel, fine, vector)
        return figure


def _save(page: Page, target: Any, kind: str, width: float, dpi: int, fine: int = FINE) -> None:
    import matplotlib as mpl

    metadata = {"png": {"Software": None}, "svg": {"Date": None}, "pdf": {"CreationDate": None}}[kind]
    with mpl.rc_context(STYLE | {"savefig.dpi": dpi}):
        page_figure(page, width, dpi, fine, vector=kind != "png").savefig(target, format=kind, metadata=metadata)


def _stacked(page: Page) -> bool:
    return len(page.panels) > 1 and all(panel.aspect < 0.45 for panel in page.panels[:1])


def _size(page: Page, width: float) -> tuple[float, float]:
    """Width and height of the page in inches."""
    aspects = [panel.aspect for panel in page.panels]
    side = 0.15 + (0.9 if page.scale else 0.1)
    if _stacked(page):
        height = sum((width - side - 0.5) * min(aspect, 0.8) + 0.6 for aspect in aspects)
    else:
        shares = _shares(page)
        each = (width - side - 0.55 * len(aspects)) / sum(shares)
        height = max(each * share * aspect for share, aspect in zip(shares, aspects, strict=True)) + 0.8
    return width, min(max(height, 2.2), 1.4 * width) + (0.3 if page.title else 0.0) + (0.35 if page.legend else 0.0)


def _shares(page: Page) -> list[float]:
    """Relative widths of panels side by side, so that they are equally high."""
    return [1 / max(panel.aspect, 0.4) for panel in page.panels]


def _frames(figure: Figure, page: Page) -> list[Axes]:
    """Empty axes, colour bar, legend and titles, which determine the size of the panels."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Patch

    n = len(page.panels)
    if _stacked(page):
        grid = figure.subplots(n, 1, squeeze=False, height_ratios=[min(p.aspect, 0.8) for p in page.panels])
    else:
        grid = figure.subplots(1, n, squeeze=False, width_ratios=_shares(page))
    axes = list(grid.ravel())
    for ax, panel in zip(axes, page.panels, strict=True):
        left, right, bottom, top = panel.window
        ax.set(xlim=(left, right), ylim=(bottom, top), title=panel.title)
        if panel.view.flat:
            ax.set(xlabel=panel.view.labels[0], ylabel=panel.view.labels[1])
        else:
            ax.set_axis_off()
    if page.scale:
        mappable = plt.cm.ScalarMappable(page.scale.norm(), page.scale.map_name)
        # Keeps the label shorter than the bar.
        label = page.scale.label if figure.get_figheight() > _HIGH else page.scale.label.replace(" (", "\n(")
        bar = figure.colorbar(mappable, ax=axes, label=label, shrink=0.85, aspect=28, pad=0.015,
                              extend=page.scale.extended)  # fmt: skip
        bar.outline.set_linewidth(0.5)
    entries = [Patch(facecolor=colour, edgecolor="0.3", linewidth=0.4, label=name) for name, colour in page.legend]
    if page.invalid or page.explained:
        entries.append(Patch(facecolor=INVALID_COLOUR, label="invalid cell"))
    if entries:
        figure.legend(handles=entries, loc="outside lower center", ncols=min(len(entries), 5), frameon=False)
    if page.title:
        figure.suptitle(page.title, fontsize=10.5, fontweight="bold")
    return axes


def _fill(ax: Axes, panel: Panel, fine: int, vector: bool) -> None:
    from matplotlib.patches import Rectangle

    if panel.under is not None:
        _paint(ax, panel.under, panel, fine, vector)
    image = _paint(ax, panel.scene, panel, fine, vector, alpha=1.0 if panel.under is None else 0.75)
    _mark_invalid(ax, panel)
    # Not earlier: the layout measures labels and titles with panels of their full size.
    ax.set(xlim=panel.window[:2], ylim=panel.window[2:], aspect="equal")
    if not panel.view.flat:
        size = _triad_size(ax)
        _triad(ax, panel.view, _free_corner(panel.scene, image, _CORNER * size / _points(ax)[0]), size)
    if len(panel.arrows):
        at, shift = panel.view.project(panel.arrows[:, 0]), panel.view.project(panel.arrows[:, 1])
        ax.quiver(at[:, 0], at[:, 1], shift[:, 0], shift[:, 1], angles="xy", scale_units="xy", scale=1.0,
                  width=0.0028, facecolor="white", edgecolor="black", linewidth=0.35, zorder=4)  # fmt: skip
    for left, right, bottom, top in panel.frames:
        ax.add_patch(
            Rectangle((left, bottom), right - left, top - bottom, fill=False, linewidth=1.0, edgecolor="#c03000",
                      zorder=3)
        )  # fmt: skip
    from matplotlib.collections import LineCollection

    for edges, colour in panel.strokes:
        lines = list(panel.view.project(edges)[..., :2])
        ax.add_collection(LineCollection(lines, colors=[colour], linewidths=2.2, capstyle="round", zorder=3))
    _names(ax, panel)


def _mark_invalid(ax: Axes, panel: Panel) -> None:
    """Edges of invalid cells of a plane, which would otherwise be too thin to be seen."""
    from matplotlib.collections import PolyCollection

    facets = panel.scene.facets
    if panel.scene.lit or not facets.bad.any():
        return
    outlines = list(panel.view.project(facets.corners[facets.bad])[..., :2])
    ax.add_collection(
        PolyCollection(outlines, facecolors="none", edgecolors=[INVALID_COLOUR], linewidths=0.7, zorder=2)
    )


def _paint(ax: Axes, scene: Scene, panel: Panel, fine: int, vector: bool, alpha: float = 1.0) -> Image | None:
    """The scene as lines where it is flat and small enough and the file can hold them, else as an image."""
    if vector and panel.view.flat and not scene.lit and len(scene.facets) <= _VECTOR_POLYGONS:
        from .vector import add_polygons

        add_polygons(ax, scene, panel.view, panel.window, alpha)
        return None
    # More pixels with fewer samples each, so that files that can be enlarged take no longer than others.
    more, fine = (1.5, min(fine, 2)) if vector else (1.0, fine)
    width = max(64, round(ax.get_window_extent().width * more))
    image = render(scene, panel.view, panel.window, width, fine)
    ax.imshow(image.pixels, extent=panel.window, interpolation="nearest", aspect="equal", zorder=1, alpha=alpha)
    return image


def _names(ax: Axes, panel: Panel) -> None:
    from matplotlib.patheffects import withStroke

    left, right, bottom, top = panel.window
    for name, point in panel.names:
        x, y, _ = panel.view.project(point)
        if left < x < right and bottom < y < top:
            ax.text(x, y, name, ha="center", va="center", fontsize=7.5, zorder=6, clip_on=True,
                    path_effects=[withStroke(linewidth=2.0, foreground="white")])  # fmt: skip


def _points(ax: Axes) -> tuple[float, float]:
    """Width and height of axes in points."""
    box, scale = ax.get_window_extent(), 72 / ax.figure.dpi
    return box.width * scale, box.height * scale


def _triad_size(ax: Axes) -> float:
    return min(1.0, _points(ax)[0] / 260)


def _free_corner(scene: Scene, image: Image | None, part: float) -> tuple[float, float]:
    """The corner of a panel, in fractions of its width and height, that shows least apart from the backdrop; corners
    are squares whose side is the fraction ``part`` of the width."""
    corners = ((0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (1.0, 1.0))
    if image is None:
        return corners[0]
    drawn = (image.item >= 0) & (image.item < len(scene.facets) - scene.unlit)
    reach = max(1, min(round(part * drawn.shape[1]), *drawn.shape))
    rows = {0.0: np.s_[-reach:], 1.0: np.s_[:reach]}
    columns = {0.0: np.s_[:reach], 1.0: np.s_[-reach:]}
    return min(corners, key=lambda corner: float(drawn[rows[corner[1]], columns[corner[0]]].mean()))


def _triad(ax: Axes, view: View, corner: tuple[float, float], size: float) -> None:
    """The directions of x, y and z in a corner."""
    from matplotlib.patheffects import withStroke

    white = [withStroke(linewidth=2.0, foreground="white")]
    side = _CORNER * size
    x, y = (side / 2 + part * (length - side) for part, length in zip(corner, _points(ax), strict=True))
    for name, unit in zip("xyz", np.eye(3), strict=True):
        right, up, _ = view.project(unit) * size
        # Seen end-on, an axis would be a meaningless dot.
        if np.hypot(right, up) < 0.15 * size:
            continue
        ax.annotate(
            "", xy=(x + 20 * right, y + 20 * up), xytext=(x, y), xycoords="axes points", textcoords="axes points",
            zorder=5, arrowprops={"arrowstyle": "-|>", "linewidth": 0.75, "color": "0.15", "shrinkA": 0, "shrinkB": 0,
                                  "mutation_scale": 6 * size, "path_effects": white},
        )  # fmt: skip
        ax.annotate(
            name, xy=(x + 27 * right, y + 27 * up), xycoords="axes points", ha="center", va="center",
            fontsize=5 + 3 * size, zorder=5, path_effects=white,
        )  # fmt: skip
