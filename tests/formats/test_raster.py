"""The depth buffer against a plain twin and against geometry."""

from __future__ import annotations

import numpy as np

from meshdeform_formats.picture import raster
from meshdeform_formats.picture.raster import draw_polygons, lines_over, strokes_of
from meshdeform_formats.picture.scene import Facets, Scene
from meshdeform_formats.picture.view import Window, along


def drawn(corners, shape=(40, 50), scale=1.0):
    corners = np.asarray(corners, dtype=float)
    depth, item, line = np.full(shape, -np.inf), np.full(shape, -1, dtype=np.int32), np.zeros(shape)
    draw_polygons(corners, depth, item)
    seen = np.nonzero(item >= 0)
    line[seen] = lines_over(corners, item[seen], seen, scale)
    return depth, item, line


def twin(corners, shape):
    """Which convex polygon is nearest at every pixel centre: half-planes and the plane of its first three corners."""
    depth, item = np.full(shape, -np.inf), np.full(shape, -1)
    for n, p in enumerate(np.asarray(corners, dtype=float)):
        plane = np.linalg.solve(np.c_[p[:3, :2], np.ones(3)], p[:3, 2])
        for row in range(shape[0]):
            for column in range(shape[1]):
                x, y = column + 0.5, row + 0.5
                turns = [(b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])
                         for a, b in zip(p, np.roll(p, -1, axis=0), strict=True)]  # fmt: skip
                z = plane @ (x, y, 1.0)
                if (min(turns) >= 0 or max(turns) <= 0) and z > depth[row, column]:
                    depth[row, column], item[row, column] = z, n
    return depth, item


def regular(n, center, radius, slope, turn):
    angle = turn + np.arange(n) * 2 * np.pi / n
    x, y = center[0] + radius * np.cos(angle), center[1] + radius * np.sin(angle)
    return np.stack([x, y, center[2] + slope[0] * x + slope[1] * y], axis=1)


def test_nearest_of_overlapping_polygons_at_every_pixel():
    rng = np.random.default_rng(7)
    polygons = [
        regular(6, rng.uniform((-5, -5, 0), (55, 45, 5)), rng.uniform(2, 20), rng.normal(0, 0.1, 2), rng.uniform())
        for _ in range(6)
    ]
    depth, item, _ = drawn(polygons)
    expected_depth, expected = twin(polygons, depth.shape)
    np.testing.assert_array_equal(item, expected)
    np.testing.assert_allclose(depth, expected_depth)


def test_neighbours_leave_no_gap():
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.linspace(-3, 53, 30), np.linspace(-3, 43, 25), indexing="ij")
    nodes = np.stack([x, y, 0 * x], axis=-1)
    nodes[1:-1, 1:-1, :2] += rng.uniform(-0.4, 0.4, (28, 23, 2))
    quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2).reshape(-1, 4, 3)
    _, item, _ = drawn(quads)
    assert (item >= 0).all()


def test_lines_fade_where_cells_are_small():
    def covered(n):
        t = np.linspace(0, 40, n + 1)
        x, y = np.meshgrid(t, t, indexing="ij")
        nodes = np.stack([x, y, 0 * x], axis=-1)
        quads = np.stack([nodes[:-1, :-1], nodes[1:, :-1], nodes[1:, 1:], nodes[:-1, 1:]], axis=2).reshape(-1, 4, 3)
        return float(drawn(quads, (40, 40))[2].mean())

    # Cells of 20, 10, 4 and 1 pixels: more lines, never a black area, nothing when they cannot be told apart.
    assert 0.05 < covered(2) < covered(4) < 0.35
    assert covered(10) < 0.45
    assert covered(40) == 0.0


def test_bands_make_one_picture(monkeypatch):
    """Memory follows the height of a band; what is seen does not."""
    turns = np.linspace(0, 3, 9)
    polygons = np.array([regular(4, (t, 1.5, t), 1.2, (0.2, 0.1), t) for t in turns])
    facets = Facets.plain(polygons)
    scene = Scene(facets, along("z"), outlines=polygons[:, :2], lit=True)
    colours = np.linspace(0, 1, 27).reshape(9, 3)
    found = []
    for band in (1 << 30, 1000):
        monkeypatch.setattr(raster, "_BAND", band)
        found.append(raster.render(scene, colours, Window(-1.0, 4.0, 0.0, 3.0), 90))
    np.testing.assert_array_equal(found[1].pixels, found[0].pixels)
    np.testing.assert_array_equal(found[1].item, found[0].item)
    assert len(np.unique(found[0].item)) > 5


def test_lines_are_hidden_behind_polygons_and_seen_before_them():
    square = np.array([[[10, 10, 1.0], [30, 10, 1.0], [30, 30, 1.0], [10, 30, 1.0]]])
    seen = []
    for z in (0.0, 2.0):
        line = strokes_of(np.array([[[0, 20, z], [40, 20, z]]], dtype=float), 1.0, 0.1)
        seen.append(drawn(np.concatenate([square, line]))[1][19:21] == 1)
    assert not seen[0][:, 12:28].any()
    assert seen[1][:, 12:28].all()
    assert seen[0][:, 2:8].all()
    np.testing.assert_array_equal(seen[0][:, :8], seen[1][:, :8])


def test_polygons_without_area_and_outside_draw_nothing():
    flat = [
        [[5, 5, 0.0]] * 4,
        [[5, 5, 0], [20, 5, 0], [20, 5, 0], [5, 5, 0]],
        [[90, 90, 0], [99, 90, 0], [99, 99, 0], [90, 99, 0]],
    ]
    assert (drawn(flat)[1] == -1).all()
