"""Images of scenes with hidden parts hidden, by a depth buffer: colours, light, grid lines as thin as the cells."""

from __future__ import annotations

import math

import numpy as np

from meshdeform_core.grid import FloatArray
from meshdeform_core.numerics.jit import kernel

from .scene import Scene, Window, stacked

FINE = 3
"""Oversampling factor in each direction; the pixels are averaged."""
_BAND = 1 << 16
"""Enlarged pixels that are drawn at a time: memory follows them, not the picture."""
_LINE_COLOUR = np.array([0.10, 0.11, 0.14], dtype=np.float32)
_PALE = (0.93, 0.94, 0.96)
_LINE_STRENGTH = 0.62
_AMBIENT = 0.55
# Grid lines: width as a fraction of the spacing of the lines, within limits (pixels), and the spacing below which they
# fade and vanish, so that fine regions do not turn black.
_WIDTH, _THINNEST, _THICKEST = 0.06, 0.9, 2.2
_VANISH, _FULL = 2.5, 9.0


def render(scene: Scene, colours: FloatArray, window: Window, width: int, fine: int = FINE) -> np.ndarray:
    """The image of a scene on white, ``width`` pixels wide, as high as the window asks for: opaque RGBA (height, width,
    4), 0 to 255.

    ``colours`` (n, 3) RGB, 0 to 1, of the polygons.
    """
    scale = fine * width / window.width
    height = max(1, round(width * window.height / window.width))

    def placed(points: FloatArray) -> FloatArray:
        at = scene.view.project(points)
        return np.stack([at[..., 0] - window.left, window.top - at[..., 1], at[..., 2]], axis=-1) * scale

    polygons = [placed(each) for each in (scene.facets.corners, scene.backdrop) if each is not None]
    if not scene.lit:
        # Inverted cells overlap their neighbours and are drawn in front of them.
        polygons[0][scene.facets.bad, :, 2] += fine
    widths = ((scene.outlines, 0.55), (scene.walls, 1.1))
    strokes = [strokes_of(placed(edges), half * fine, 2.0 * fine) for edges, half in widths]
    corners, count = stacked([*polygons, *strokes]), sum(map(len, polygons))
    light = np.ones(len(scene.facets))
    if scene.lit:
        # On both sides, by a lamp next to the viewer.
        facets, view = scene.facets.corners, scene.view
        normal = np.cross(facets[:, 2] - facets[:, 0], facets[:, -1] - facets[:, 1])
        length, lamp = np.linalg.norm(normal, axis=1), view.towards + 0.45 * view.up - 0.25 * view.right
        cosine = np.abs(normal @ (lamp / np.linalg.norm(lamp)))
        light = _AMBIENT + (1 - _AMBIENT) * np.divide(cosine, length, out=light, where=length > 0)
    shades = np.empty((len(corners), 3), dtype=np.float32)
    shades[: len(light)], shades[len(light) : count], shades[count:] = colours * light[:, None], _PALE, _LINE_COLOUR
    low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
    pixels = np.full((height, width, 4), 255, np.uint8)
    rows = max(1, _BAND // (width * fine**2))
    for start in range(0, height, rows):
        band = slice(start, min(start + rows, height))
        reach = (band.start * fine, band.stop * fine)
        touching = (high >= (0, reach[0])) & (low <= (width * fine, reach[1]))
        number = np.flatnonzero(touching.all(axis=1))
        some = np.ascontiguousarray(corners[number] - (0.0, float(reach[0]), 0.0))
        lined = int(np.searchsorted(number, count))
        mean = _drawn(some, shades[number], lined, (reach[1] - reach[0], fine * width), fine)
        pixels[band, :, :3] = np.rint(255 * (mean[..., :3] + 1 - mean[..., 3:]))
    return pixels


def _drawn(corners: FloatArray, shades: np.ndarray, lined: int, size: tuple[int, int], fine: int) -> np.ndarray:
    """Mean colours (rows, columns, 4) of a band: RGB times opacity, and opacity.

    ``shades`` (n, 3) are the colours of the polygons ``corners`` (n, m, 3), of which the first ``lined`` have edges;
    ``size`` are its rows and columns of enlarged pixels, ``fine`` of them in each direction make one.
    """
    depth, item = np.full(size, -np.inf), np.full(size, -1, dtype=np.int32)
    draw_polygons(corners, depth, item)
    colour = np.append(np.pad(shades, ((0, 0), (0, 1)), constant_values=1), np.zeros((1, 4), np.float32), axis=0)[item]
    pixels = np.nonzero((item >= 0) & (item < lined))
    dark = _LINE_STRENGTH * lines_over(corners[:lined], item[pixels], pixels, fine)
    under = colour[pixels]
    under[:, :3] += dark[:, None] * (_LINE_COLOUR - under[:, :3])
    colour[pixels] = under
    mean: np.ndarray = np.mean([colour[row::fine, column::fine] for row, column in np.ndindex(fine, fine)], axis=0)
    return mean


def strokes_of(ends: FloatArray, half: float, bias: float) -> FloatArray:
    """Straight lines as rectangles (n, 4, 3), all in pixels.

    Parameters
    ----------
    ends : (n, 2, 3) as corners of :func:`draw_polygons`
    half : half of the line width
    bias : distance by which a line may lie behind a polygon and still be seen
    """
    along = ends[:, 1, :2] - ends[:, 0, :2]
    along = half * along / np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-300)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    corners = ends[:, [0, 0, 1, 1]]
    corners[..., :2] += np.stack([-along - across, across - along, along + across, along - across], axis=1)
    corners[..., 2] += bias
    return corners


def lines_over(corners: FloatArray, item: np.ndarray, pixels: tuple[np.ndarray, ...], fine: int) -> np.ndarray:
    """How much of each pixel the edges of the polygon that is seen there cover (k,), 0 to 1.

    Parameters
    ----------
    corners : (n, m, 3) of the polygons, in pixels
    item : (k,) number of the polygon at each pixel
    pixels : rows (k,) and columns (k,)
    fine : these pixels per pixel of the final picture
    """
    start, end = corners[..., :2], np.roll(corners[..., :2], -1, axis=1)
    along = end - start
    length = np.linalg.norm(along, axis=2)
    area = 0.5 * np.abs((start[..., 0] * end[..., 1] - end[..., 0] * start[..., 1]).sum(axis=1))
    # The spacing to the opposite edge decides how wide and strong a line is.
    some = np.maximum(length, 1e-300)
    spacing = np.where(length > 0, area[:, None] / some / fine, 0.0)
    normal = np.stack([-along[..., 1], along[..., 0]], axis=2) / some[..., None]
    strength = np.clip((spacing - _VANISH) / (_FULL - _VANISH), 0.0, 1.0)
    half = 0.5 * fine * np.clip(_WIDTH * spacing, _THINNEST, _THICKEST)
    of_edges = np.stack([normal[..., 0], normal[..., 1], -(normal * start).sum(axis=2), strength, half + 0.5], axis=2)
    cover = np.zeros(len(item))
    row, column = pixels[0] + 0.5, pixels[1] + 0.5
    for e in np.flatnonzero(strength.any(axis=0)):
        across, upwards, offset, strong, reach = of_edges[item, e].T
        distance = np.abs(across * column + upwards * row + offset)
        np.maximum(cover, strong * np.clip(reach - distance, 0.0, 1.0), out=cover)
    return cover


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
