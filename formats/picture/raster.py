"""Images of scenes with hidden parts hidden, by a depth buffer: colours, light, grid lines as thin as the cells."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from meshdeform_core.grid import FloatArray, IntArray
from meshdeform_core.numerics.jit import inlined, kernel

from .facets import joined
from .scene import Scene
from .view import Window

FINE = 3
"""Oversampling factor in each direction; the pixels are averaged."""
_BAND = 1 << 18
"""Enlarged pixels that are drawn at a time: memory follows them, not the picture."""
_LINE_COLOUR = np.array([0.10, 0.11, 0.14], dtype=np.float32)
_WHITE = np.full(3, 255)
_PALE = (0.93, 0.94, 0.96)
_LINE_STRENGTH, _OUTLINE_STRENGTH = np.float32(0.62), np.float32(0.95)
_AMBIENT = 0.55
_OVER = 0.75
"""Strength of a scene over another one that is seen through it."""
# Grid lines: width as a fraction of the spacing of the lines, within limits (pixels), and the spacing below which they
# fade and vanish, so that fine regions do not turn black.
_WIDTH, _THINNEST, _THICKEST = 0.06, 0.9, 2.2
_VANISH, _FULL = 2.5, 9.0


@dataclass(frozen=True)
class Image:
    """Opaque RGBA pixels (height, width, 4) of 0 to 255, and the polygon (height, width) seen in the middle of each:
    its number in the scene, -1 for none, beyond the last one for the backdrop."""

    pixels: np.ndarray
    item: np.ndarray


def render(
    scene: Scene,
    colours: FloatArray,
    window: Window,
    width: int,
    fine: int = FINE,
    lines: bool = True,
    under: Image | None = None,
) -> Image:
    """The image of a scene, ``width`` pixels wide, as high as the window asks for.

    ``colours`` (n, 3) RGB, 0 to 1, of the polygons; ``under`` is seen through them, otherwise white around them.
    """
    scale = fine * width / window.width
    height = max(1, round(width * window.height / window.width))

    def placed(points: FloatArray) -> FloatArray:
        at = scene.view.project(points)
        return np.stack([at[..., 0] - window.left, window.top - at[..., 1], at[..., 2]], axis=-1) * scale

    facets, light = scene.facets, _light(scene) if scene.lit else np.ones(len(scene.facets))
    colours = colours * light[:, None]
    if scene.backdrop is not None:
        facets = joined([facets, scene.backdrop])
        colours = np.concatenate([colours, np.tile(_PALE, (len(scene.backdrop), 1))])
    corners = placed(facets.corners)
    if not scene.lit:
        # Inverted cells overlap their neighbours and are drawn in front of them.
        corners[facets.bad, :, 2] += fine
    edges = [(placed(scene.outlines), 0.55 * fine), (placed(scene.walls), 1.1 * fine)]
    image = Image(np.full((height, width, 4), 255, np.uint8), np.empty((height, width), np.int32))
    rows = max(1, _BAND // (width * fine**2))
    for start in range(0, height, rows):
        band = slice(start, min(start + rows, height))
        shape = ((band.stop - start) * fine, width * fine)
        depth, line = np.full(shape, -np.inf), np.zeros(shape, dtype=np.float32)
        item, cover = np.full(shape, -1, dtype=np.int32), np.zeros(shape, dtype=np.float32)
        some, number = _inside(corners, start * fine, shape)
        draw_polygons(some, float(fine), depth, item, line)
        item = np.where(item >= 0, number[item] if number.size else -1, -1)
        for ends, half in edges:
            draw_segments(_inside(ends, start * fine, shape)[0], half, 2.0 * fine, depth, cover)
        dark = np.maximum(_LINE_STRENGTH * lines * line, _OUTLINE_STRENGTH * cover)
        mean = _averaged(colours, item, dark, np.maximum(item >= 0, cover), fine)
        share, behind = (
            mean[..., 3:] * (1.0 if under is None else _OVER),
            _WHITE if under is None else under.pixels[band],
        )
        image.pixels[band][..., :3] = np.rint(255 * share * mean[..., :3] + (1 - share) * behind[..., :3])
        image.item[band] = item[fine // 2 :: fine, fine // 2 :: fine]
    return image


def _inside(points: FloatArray, first: int, shape: tuple[int, int]) -> tuple[FloatArray, IntArray]:
    """The polygons (n, m, 3), in pixels, that may touch a band of rows from ``first`` on, shifted to it, and their
    numbers; lines reach a little beyond their ends."""
    low, high = points[..., :2].min(axis=1, initial=np.inf), points[..., :2].max(axis=1, initial=-np.inf)
    margin = 8.0
    seen = (high >= (-margin, first - margin)) & (low <= (shape[1] + margin, first + shape[0] + margin))
    number = np.flatnonzero(seen.all(axis=1))
    return np.ascontiguousarray(points[number] - (0.0, float(first), 0.0)), number


def _averaged(colours: FloatArray, item: np.ndarray, dark: np.ndarray, alpha: np.ndarray, fine: int) -> np.ndarray:
    """RGBA pixels (height, width, 4), 0 to 1, of polygons with ``dark`` lines over them, from enlarged ones."""
    colour = colours.astype(np.float32)[np.maximum(item, 0)] if len(colours) else np.zeros((*item.shape, 3), np.float32)
    stack = np.empty((*item.shape, 4), dtype=np.float32)
    stack[..., 3] = alpha
    np.multiply(colour + (_LINE_COLOUR - colour) * dark[..., None], alpha[..., None], out=stack[..., :3])
    mean = stack.reshape(item.shape[0] // fine, fine, item.shape[1] // fine, fine, 4).mean(axis=(1, 3))
    mean[..., :3] /= np.maximum(mean[..., 3:], 1e-9)
    return np.clip(mean, 0.0, 1.0)


def _light(scene: Scene) -> FloatArray:
    """Brightness (n,) of every polygon, lit on both sides by a lamp next to the viewer."""
    corners, view = scene.facets.corners, scene.view
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, -1] - corners[:, 1])
    length = np.linalg.norm(normal, axis=1)
    lamp = view.towards + 0.45 * view.up - 0.25 * view.right
    cosine = np.abs(normal @ (lamp / np.linalg.norm(lamp)))
    return np.asarray(
        _AMBIENT + (1 - _AMBIENT) * np.divide(cosine, length, out=np.ones(len(corners)), where=length > 0)
    )


@kernel("f8[:, :, ::1], f8, f8[:, ::1], i4[:, ::1], f4[:, ::1]")
def draw_polygons(corners, scale, depth, item, line):
    """Draw polygons; of those that cover a pixel the nearest to the viewer stays.

    Parameters
    ----------
    corners : (n, m, 3) pixel coordinates x, y (origin at the upper left corner) and depth, larger is nearer; polygons
        with fewer corners repeat the last one; convex or nearly so
    scale : pixels of this picture per pixel of the final one (supersampling)
    depth : (height, width) in and out, -inf where nothing is
    item : (height, width) int32 in and out, number of the polygon seen, -1 for none
    line : (height, width) float32 in and out, 0 to 1, how much of the pixel is covered by the polygon's edges
    """
    m = corners.shape[1]
    strength, half = np.empty(m), np.empty(m)
    for n in range(corners.shape[0]):
        p = corners[n]
        _line_widths(p, scale, strength, half)
        for t in range(1, m - 1):
            _draw_triangle(p, t, n, strength, half, depth, item, line)


@inlined
def _line_widths(p, scale, strength, half):
    """Strength and half width of the line along each edge, from the spacing to the opposite edge (area over length)."""
    m = p.shape[0]
    area = 0.0
    for e in range(m):
        f = (e + 1) % m
        area += p[e, 0] * p[f, 1] - p[f, 0] * p[e, 1]
    area = 0.5 * abs(area)
    for e in range(m):
        f = (e + 1) % m
        length = math.hypot(p[f, 0] - p[e, 0], p[f, 1] - p[e, 1])
        spacing = area / length / scale if length > 0.0 else 0.0
        strength[e] = min(max((spacing - _VANISH) / (_FULL - _VANISH), 0.0), 1.0)
        half[e] = 0.5 * scale * min(max(_WIDTH * spacing, _THINNEST), _THICKEST)


@inlined
def _draw_triangle(p, t, n, strength, half, depth, item, line):
    """The triangle of the corners 0, t and t + 1."""
    ax, ay, bx, by, cx, cy = p[0, 0], p[0, 1], p[t, 0], p[t, 1], p[t + 1, 0], p[t + 1, 1]
    double_area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
    if double_area == 0.0:
        return
    x0, x1 = max(math.floor(min(ax, bx, cx)), 0), min(math.ceil(max(ax, bx, cx)) + 1, depth.shape[1])
    y0, y1 = max(math.floor(min(ay, by, cy)), 0), min(math.ceil(max(ay, by, cy)) + 1, depth.shape[0])
    for row in range(y0, y1):
        y = row + 0.5
        for column in range(x0, x1):
            x = column + 0.5
            u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / double_area
            v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / double_area
            w = 1.0 - u - v
            # A little more than the triangle, so that round-off leaves no gaps between neighbours.
            if u < -1e-9 or v < -1e-9 or w < -1e-9:
                continue
            z = u * p[0, 2] + v * p[t, 2] + w * p[t + 1, 2]
            if z > depth[row, column]:
                depth[row, column] = z
                item[row, column] = n
                line[row, column] = _edge_cover(p, x, y, strength, half)


@inlined
def _edge_cover(p, x, y, strength, half):
    """Fraction of the pixel at (x, y) that the edges of a polygon cover."""
    cover = 0.0
    for e in range(p.shape[0]):
        if strength[e] > 0.0:
            _, distance = _nearest(x, y, p[e], p[(e + 1) % p.shape[0]])
            cover = max(cover, strength[e] * min(max(half[e] + 0.5 - distance, 0.0), 1.0))
    return cover


@inlined
def _nearest(x, y, a, b):
    """The place on the segment from a (0) to b (1) that is nearest to a point, and its distance."""
    ux, uy = b[0] - a[0], b[1] - a[1]
    square = ux * ux + uy * uy
    along = ((x - a[0]) * ux + (y - a[1]) * uy) / square if square > 0.0 else 0.0
    along = min(max(along, 0.0), 1.0)
    return along, math.hypot(x - a[0] - along * ux, y - a[1] - along * uy)


@kernel("f8[:, :, ::1], f8, f8, f8[:, ::1], f4[:, ::1]")
def draw_segments(ends, half, bias, depth, cover):
    """Draw straight lines over polygons, where they are not behind them.

    Parameters
    ----------
    ends : (n, 2, 3) as ``corners`` of :func:`draw_polygons`
    half : half of the line width (pixels)
    bias : distance by which lines may lie behind a polygon and still be seen
    depth : (height, width) of the polygons
    cover : (height, width) float32 in and out, 0 to 1, how much of the pixel the lines cover
    """
    for n in range(ends.shape[0]):
        a, b = ends[n, 0], ends[n, 1]
        x0 = max(math.floor(min(a[0], b[0]) - half - 1.0), 0)
        x1 = min(math.ceil(max(a[0], b[0]) + half + 1.0) + 1, depth.shape[1])
        y0 = max(math.floor(min(a[1], b[1]) - half - 1.0), 0)
        y1 = min(math.ceil(max(a[1], b[1]) + half + 1.0) + 1, depth.shape[0])
        for row in range(y0, y1):
            for column in range(x0, x1):
                along, distance = _nearest(column + 0.5, row + 0.5, a, b)
                seen = a[2] + along * (b[2] - a[2]) >= depth[row, column] - bias
                if seen and distance < half + 0.5:
                    cover[row, column] = max(cover[row, column], min(half + 0.5 - distance, 1.0))
