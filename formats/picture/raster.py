"""Images of scenes with hidden parts hidden, by a depth buffer: colours, light, grid lines as thin as the cells."""

from __future__ import annotations

import math

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.numerics.jit import kernel

from .scene import Scene, Window, stacked

FINE = 2
"""Oversampling factor in each direction; the pixels are averaged."""
_BAND = 1 << 18
"""Enlarged pixels that are drawn at a time: memory follows them, not the picture."""
_LINE_COLOUR = np.array([0.10, 0.11, 0.14])
_PALE = (0.93, 0.94, 0.96)
_LINE_STRENGTH = 0.62
_AMBIENT = 0.55
# Grid lines: width as a fraction of the spacing of the lines, within limits (pixels), and the spacing below which they
# fade and vanish, so that fine regions do not turn black.
_WIDTH, _THINNEST, _THICKEST = 0.06, 0.9, 2.2
_VANISH, _FULL = 2.5, 9.0


def render(scene: Scene, colours: FloatArray, window: Window, width: int) -> np.ndarray:
    """The image of a scene on white, ``width`` pixels wide: RGB (height, width, 3), 0 to 255.

    ``colours`` (n, 3) RGB, 0 to 1, of the polygons.
    """
    scale, height = FINE * width / window.width, max(1, round(width * window.height / window.width))

    def placed(points: FloatArray) -> FloatArray:
        at = scene.view.project(points)
        return np.stack([at[..., 0] - window.left, window.top - at[..., 1], at[..., 2]], axis=-1) * scale

    polygons = [placed(each) for each in (scene.facets.corners, scene.backdrop) if each is not None]
    if not scene.lit:
        # Inverted cells overlap their neighbours and are drawn in front of them.
        polygons[0][scene.facets.bad, :, 2] += 2 * FINE
    widths = ((scene.outlines, 0.55), (scene.walls, 1.1))
    strokes = [strokes_of(placed(edges), half * FINE, 4.0 * FINE) for edges, half in widths]
    corners, count = stacked([*polygons, *strokes]), sum(map(len, polygons))
    light = np.ones(len(scene.facets))
    if scene.lit:
        # On both sides, by a lamp next to the viewer.
        facets, view = scene.facets.corners, scene.view
        normal = np.cross(facets[:, 2] - facets[:, 0], facets[:, -1] - facets[:, 1])
        length, lamp = np.linalg.norm(normal, axis=1), view.towards + 0.45 * view.up - 0.25 * view.right
        cosine = np.abs(normal @ (lamp / np.linalg.norm(lamp)))
        light = _AMBIENT + (1 - _AMBIENT) * np.divide(cosine, length, out=light, where=length > 0)
    shades = np.empty((len(corners), 3))
    shades[: len(light)], shades[len(light) : count], shades[count:] = colours * light[:, None], _PALE, _LINE_COLOUR
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    pixels = np.empty((height, width, 3), np.uint8)
    rows = max(1, _BAND // (width * FINE**2))
    for start in range(0, height, rows):
        stop = min(start + rows, height)
        some = np.flatnonzero(((high >= (0, start * FINE)) & (low <= (width * FINE, stop * FINE))).all(axis=1))
        drawn = corners[some] - (0.0, float(start * FINE), 0.0)
        lined = int(np.searchsorted(some, count))
        lines, dark = grid_lines(drawn[:lined], shades[some[:lined]])
        depth = np.full(((stop - start) * FINE, width * FINE), -np.inf)
        item = np.full(depth.shape, -1, dtype=np.int32)
        draw_polygons(stacked([drawn, lines]), depth, item)
        # What nothing covers, number -1, is white.
        seen = np.concatenate([shades[some], dark, np.ones((1, 3))])[item]
        mean = np.mean([seen[row::FINE, column::FINE] for row, column in np.ndindex(FINE, FINE)], axis=0)
        pixels[start:stop] = np.rint(255 * mean)
    return pixels


def grid_lines(corners: FloatArray, shades: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The edges of polygons (n, m, 3) with colours (n, 3) as strokes (k, 4, 3) with colours (k, 3), in enlarged pixels.

    The spacing to the opposite edge decides how wide and strong a line is.
    """
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2)
    (x, y, _), (to_x, to_y, _) = np.moveaxis(ends, (2, 3), (0, 1))
    length, area = np.hypot(to_x - x, to_y - y), 0.5 * np.abs((x * to_y - to_x * y).sum(axis=1))
    spacing = np.divide(area[:, None], FINE * length, out=np.zeros_like(length), where=length > 0)
    strength = _LINE_STRENGTH * np.clip((spacing - _VANISH) / (_FULL - _VANISH), 0.0, 1.0)
    polygon, edge = np.nonzero(strength)
    half = 0.5 * FINE * np.clip(_WIDTH * spacing[polygon, edge], _THINNEST, _THICKEST)
    dark = shades[polygon] + strength[polygon, edge, None] * (_LINE_COLOUR - shades[polygon])
    return strokes_of(ends[polygon, edge], half[:, None], FINE), dark


def strokes_of(ends: FloatArray, half: float | FloatArray, bias: float) -> FloatArray:
    """Straight lines as rectangles (n, 4, 3), all in pixels.

    Parameters
    ----------
    ends : (n, 2, 3) as corners of :func:`draw_polygons`
    half : half of the line width, for all or each (n, 1)
    bias : distance by which a line may lie behind a polygon and still be seen
    """
    along = ends[:, 1, :2] - ends[:, 0, :2]
    along = half * along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    corners = ends[:, [0, 0, 1, 1]]
    corners[..., :2] += np.stack([-along - across, across - along, along + across, along - across], axis=1)
    corners[..., 2] += bias
    return corners


@kernel("f8[:, :, ::1], f8[:, ::1], i4[:, ::1]")
def draw_polygons(corners, depth, item):
    """Draw polygons; of those that cover a pixel the nearest to the viewer stays.

    Parameters
    ----------
    corners : (n, m, 3) pixel coordinates x, y (origin at the upper left corner) and depth, larger is nearer; polygons
        with fewer corners repeat the last one; convex or nearly so
    depth : (height, width) in and out, -inf where nothing is
    item : (height, width) int32 in and out, number of the polygon seen, -1 for none
    """
    for n in range(corners.shape[0]):
        ax, ay, az = corners[n, 0, 0], corners[n, 0, 1], corners[n, 0, 2]
        for t in range(1, corners.shape[1] - 1):
            bx, by, bz = corners[n, t, 0], corners[n, t, 1], corners[n, t, 2]
            cx, cy, cz = corners[n, t + 1, 0], corners[n, t + 1, 1], corners[n, t + 1, 2]
            double_area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
            if double_area == 0.0:
                continue
            x0, x1 = max(math.floor(min(ax, bx, cx)), 0), min(math.ceil(max(ax, bx, cx)) + 1, depth.shape[1])
            y0, y1 = max(math.floor(min(ay, by, cy)), 0), min(math.ceil(max(ay, by, cy)) + 1, depth.shape[0])
            for row in range(y0, y1):
                for column in range(x0, x1):
                    x, y = column + 0.5, row + 0.5
                    u = ((cx - bx) * (y - by) - (cy - by) * (x - bx)) / double_area
                    v = ((ax - cx) * (y - cy) - (ay - cy) * (x - cx)) / double_area
                    z = u * az + v * bz + (1.0 - u - v) * cz
                    # A little more than the triangle, so that round-off leaves no gaps between neighbours.
                    if u >= -1e-9 and v >= -1e-9 and u + v <= 1.0 + 1e-9 and z > depth[row, column]:
                        depth[row, column], item[row, column] = z, n
