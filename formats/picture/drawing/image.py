"""Rendering of polygons to an image: hidden surfaces, colours, light, and grid lines as thin as the cells."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from meshdeform_core.grid import FloatArray

from ..content.facets import Facets
from ..view import View, Window
from .raster import draw_polygons, draw_segments

FINE = 3
"""Oversampling factor in each direction; the pixels are averaged."""
LINE_COLOUR = np.array([0.10, 0.11, 0.14])
INVALID_COLOUR = (0.90, 0.00, 0.42)
"""Not in any of the colour maps; colour-blind people can distinguish it from them by lightness or hue."""
_LINE_STRENGTH, _OUTLINE_STRENGTH = 0.62, 0.95
_AMBIENT = 0.55


@dataclass(frozen=True)
class Scene:
    """Polygons with a colour each, and lines over them.

    Attributes
    ----------
    colours : (n, 3) RGB, 0 to 1
    outlines : (k, 2, 3) edges drawn stronger, where they are not hidden
    walls : (l, 2, 3) edges drawn stronger still
    unlit : number of polygons at the end that are not shaded; others are shaded by their angle to the viewer if ``lit``
    lines : draw the edges of the polygons
    """

    facets: Facets
    colours: FloatArray
    outlines: FloatArray = field(default_factory=lambda: np.empty((0, 2, 3)))
    walls: FloatArray = field(default_factory=lambda: np.empty((0, 2, 3)))
    lit: bool = False
    unlit: int = 0
    lines: bool = True


@dataclass(frozen=True)
class Image:
    """RGBA pixels (height, width, 4) of 0 to 1 of a window, and which polygon each pixel of the enlarged one shows."""

    pixels: FloatArray
    window: Window
    item: np.ndarray


def render(scene: Scene, view: View, window: Window, width: int, fine: int = FINE) -> Image:
    """The image of a scene, ``width`` pixels wide, as high as the window asks for."""
    left, right, bottom, top = window
    scale = fine * width / (right - left)
    height = max(1, round(width * (top - bottom) / (right - left)))
    shape = (height * fine, width * fine)
    depth = np.full(shape, -np.inf)
    item = np.full(shape, -1, dtype=np.int32)
    line = np.zeros(shape, dtype=np.float32)

    def pixels(points: FloatArray) -> FloatArray:
        at = view.project(points)
        x, y = (at[..., 0] - left) * scale, (top - at[..., 1]) * scale
        return np.ascontiguousarray(np.stack([x, y, at[..., 2] * scale], axis=-1))

    corners = pixels(scene.facets.corners)
    if not scene.lit:
        # Inverted cells overlap their neighbours and are drawn in front of them.
        corners[scene.facets.bad, :, 2] += fine
    seen = _inside(corners, shape)
    number = np.flatnonzero(seen)
    draw_polygons(corners[seen], float(fine), depth, item, line)
    item = np.where(item >= 0, number[np.maximum(item, 0)] if number.size else -1, -1)
    cover = np.zeros(shape, dtype=np.float32)
    for edges, half in ((scene.outlines, 0.55), (scene.walls, 1.1)):
        ends = pixels(edges)
        draw_segments(ends[_inside(ends, shape)], half * fine, 2.0 * fine, depth, cover)
    return Image(_composed(scene, view, item, line, cover, fine), window, item)


def _inside(points: FloatArray, shape: tuple[int, int]) -> np.ndarray:
    """The polygons (n, m, 3), in pixels, that may touch the image."""
    low, high = points[..., :2].min(axis=1), points[..., :2].max(axis=1)
    return np.asarray(((high >= 0) & (low <= (shape[1], shape[0]))).all(axis=1))


def _composed(scene: Scene, view: View, item: np.ndarray, line: np.ndarray, cover: np.ndarray, fine: int) -> FloatArray:
    """Colours of the visible polygons with lines over them, averaged over the enlarged pixels."""
    colours = (scene.colours * _light(scene, view)[:, None] if scene.lit else scene.colours).astype(np.float32)
    height, width = item.shape
    result = np.empty((height // fine, width // fine, 4), dtype=np.float32)
    # In strips, as the enlarged image is large.
    rows = max(fine, fine * (2_000_000 // (width * fine)))
    for start in range(0, height, rows):
        part = slice(start, min(start + rows, height))
        there = item[part] >= 0
        colour = colours[np.maximum(item[part], 0)]
        dark = np.float32(_LINE_STRENGTH * scene.lines) * line[part]
        dark = np.maximum(dark, np.float32(_OUTLINE_STRENGTH) * cover[part])[..., None]
        alpha = np.maximum(there, cover[part])[..., None]
        stack = np.empty((*alpha.shape[:2], 4), dtype=np.float32)
        stack[..., 3:] = alpha
        np.multiply(colour + (LINE_COLOUR.astype(np.float32) - colour) * dark, alpha, out=stack[..., :3])
        mean = stack.reshape(-1, fine, width // fine, fine, 4).mean(axis=(1, 3))
        mean[..., :3] /= np.maximum(mean[..., 3:], 1e-9)
        result[part.start // fine : part.stop // fine] = mean
    return np.clip(result, 0.0, 1.0)


def _light(scene: Scene, view: View) -> FloatArray:
    """Brightness (n,) of every polygon, lit on both sides by a lamp next to the viewer."""
    corners = scene.facets.corners
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
    length = np.linalg.norm(normal, axis=1)
    lamp = view.towards + 0.45 * view.up - 0.25 * view.right
    cosine = np.abs(normal @ (lamp / np.linalg.norm(lamp)))
    share = np.divide(cosine, length, out=np.ones(len(corners)), where=length > 0)
    light = _AMBIENT + (1 - _AMBIENT) * share
    light[len(light) - scene.unlit :] = 1.0
    return np.asarray(light)
