"""Flat pictures as lines instead of pixels."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from meshdeform_core.grid import FloatArray

from ..content.facets import Facets
from ..view import View, Window, spread
from .colours import scale_of
from .image import LINE_COLOUR, Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_RASTER_ABOVE = 20_000


def add_polygons(ax: Axes, scene: Scene, view: View, window: Window, alpha: float = 1.0) -> None:
    """Draw the polygons of a scene within a window into matplotlib axes."""
    from matplotlib.collections import LineCollection, PolyCollection

    flat = view.project(scene.facets.corners)[..., :2]
    low, high = flat.min(axis=1), flat.max(axis=1)
    left, right, bottom, top = window
    seen = ((high >= (left, bottom)) & (low <= (right, top))).all(axis=1)
    # Inverted cells overlap their neighbours and are drawn last.
    seen = np.flatnonzero(seen)[np.argsort(scene.facets.bad[seen], kind="stable")]
    widths, strength = _line_widths(flat[seen], ax.get_window_extent().width * 72 / ax.figure.dpi / (right - left))
    edges = np.concatenate([np.tile(LINE_COLOUR, (len(widths), 1)), 0.62 * strength[:, None]], axis=1)
    ax.add_collection(
        PolyCollection(
            list(flat[seen]),
            facecolors=scene.colours[seen],
            edgecolors=edges if scene.lines else scene.colours[seen],
            linewidths=widths if scene.lines else 0.1,
            alpha=None if alpha == 1.0 else alpha,
        )
    )
    for edges, width in ((scene.outlines, 0.6), (scene.walls, 1.2)):
        lines = view.project(edges)[..., :2]
        ax.add_collection(LineCollection(list(lines), colors="black", linewidths=width, capstyle="round"))


def _line_widths(flat: FloatArray, points: float) -> tuple[FloatArray, FloatArray]:
    """Line width (points) and strength (0 to 1) of polygons (n, m, 2): lines vanish where cells are small."""
    x, y = flat[..., 0], flat[..., 1]
    following = np.roll(flat, -1, axis=1)
    area = 0.5 * np.abs((x * following[..., 1] - y * following[..., 0]).sum(axis=1))
    longest = np.linalg.norm(following - flat, axis=2).max(axis=1)
    spacing = points * np.divide(area, longest, out=np.zeros_like(area), where=longest > 0)
    return np.clip(0.06 * spacing, 0.1, 0.6), np.clip((spacing - 0.5) / 3.0, 0.0, 1.0)


def draw(
    axes: Axes, facets: Facets, *, view: View | None = None, limits: tuple[float, float] | None = None,
    lines: bool = True,
) -> Any:  # fmt: skip
    """Draw polygons into matplotlib axes, far ones first; returns the collection (for a colour bar).

    For figures assembled by the caller. ``limits`` of the colours default to those of the values.
    """
    from matplotlib.collections import PolyCollection

    view = view or spread(facets.corners)
    flat = view.project(facets.corners)
    depth = np.argsort(flat[..., 2].mean(axis=1), kind="stable")
    many = len(flat) > _RASTER_ABOVE
    scale = scale_of("f_skew", facets.values, limits)
    collection = PolyCollection(
        list(flat[depth][..., :2]),
        array=facets.values[depth],
        cmap=scale.map_name,
        norm=scale.norm(),
        edgecolors="black" if lines else "face",
        linewidths=0.08 if many else 0.2,
        rasterized=many,
    )
    axes.add_collection(collection)
    axes.set_aspect("equal")
    axes.autoscale_view()
    axes.set(xlabel=view.labels[0], ylabel=view.labels[1])
    return collection
