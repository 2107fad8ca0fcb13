"""Pictures of polygons with hidden parts hidden: a depth buffer."""

import math

import numpy as np

from meshdeform_core.numerics.jit import inlined, kernel

# Grid lines: width as a fraction of the spacing of the lines, within limits (pixels), and the spacing below which they
# fade and vanish, so that fine regions do not turn black.
_WIDTH, _THINNEST, _THICKEST = 0.06, 0.9, 2.2
_VANISH, _FULL = 2.5, 9.0


@kernel
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


@kernel
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
