"""Aspect ratio, growth, non-orthogonality and skewness against exact values and a plain twin."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, permuted

from meshdeform_core.grid import Grid
from meshdeform_core.quality.shape import DEFINITIONS, shape_measures


def box(x, y, z, shear=0.0):
    points = block_around(np.array(x, float), np.array(y, float), np.array(z, float))
    points[..., 0] += shear * points[..., 1]
    return Grid.from_blocks([points])


def test_a_stretched_box():
    found = shape_measures(box([0, 1, 3, 6], [0, 1, 2], [0, 0.5, 1]))
    assert found["aspect_ratio"].max == pytest.approx(6.0)
    assert found["aspect_ratio"].worst.ijk == (3, 1, 1)
    assert found["growth_ratio"].max == pytest.approx(2.0)
    assert found["growth_ratio"].worst.ijk == (1, 1, 1)
    assert found["growth_ratio"].worst.center == pytest.approx((0.5, 0.5, 0.25))
    assert found["non_orthogonality_deg"].max == pytest.approx(0.0, abs=1e-5)
    assert found["skewness"].max == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("angle", [10.0, 30.0, 45.0])
def test_a_sheared_box_is_not_orthogonal_by_its_angle(angle):
    cells = np.arange(4)
    found = shape_measures(box(cells, cells, cells, np.tan(np.deg2rad(angle))))
    assert found["non_orthogonality_deg"].max == pytest.approx(angle)
    assert found["growth_ratio"].max == pytest.approx(1.0)


def twin(x):
    """The same, cell by cell in plain numpy."""
    cells = [n - 1 for n in x.shape[:3]]

    def corners(c):
        return x[c[0] : c[0] + 2, c[1] : c[1] + 2, c[2] : c[2] + 2]

    def sizes(c):
        return [np.linalg.norm(np.diff(corners(c), axis=a), axis=-1).mean() for a in range(3)]

    worst = dict.fromkeys(DEFINITIONS, 0.0)
    for c in itertools.product(*map(range, cells)):
        own = np.array(sizes(c))
        worst["aspect_ratio"] = max(worst["aspect_ratio"], own.max() / own.min())
        for a in range(3):
            n = tuple(v + (a == b) for b, v in enumerate(c))
            if n[a] == cells[a]:
                continue
            ratio = sizes(n)[a] / own[a]
            one, two = (corners(v).reshape(-1, 3).mean(axis=0) for v in (c, n))
            face = np.take(corners(n), 0, axis=a)
            area = np.cross(face[1, 1] - face[0, 0], face[0, 1] - face[1, 0])
            line, center = two - one, face.reshape(-1, 3).mean(axis=0)
            cosine = abs(line @ area) / np.linalg.norm(line) / np.linalg.norm(area)
            hit = one + line * ((center - one) @ area) / (line @ area)
            values = (
                max(ratio, 1 / ratio),
                np.rad2deg(np.arccos(cosine)),
                np.linalg.norm(hit - center) / np.linalg.norm(line),
            )
            for name, value in zip(list(DEFINITIONS)[1:], values, strict=True):
                worst[name] = max(worst[name], value)
    return worst


def test_like_a_plain_twin_on_a_wild_block():
    rng = np.random.default_rng(5)
    x = block_around(np.arange(5.0), np.arange(4.0), np.arange(6.0)) + rng.uniform(-0.3, 0.3, (5, 4, 6, 3))
    found = shape_measures(Grid.from_blocks([x]))
    for name, value in twin(x).items():
        assert found[name].max == pytest.approx(value), name


@pytest.mark.parametrize("axes", [(2, 0, 1), (1, 0, 2)])
def test_index_order_does_not_matter(axes):
    rng = np.random.default_rng(2)
    grid = frame()
    grid = grid.moved(grid.points + rng.uniform(-0.02, 0.02, grid.points.shape))
    one, two = shape_measures(grid), shape_measures(permuted(grid, axes, (True, False, True)))
    for name in DEFINITIONS:
        assert one[name].max == pytest.approx(two[name].max)
        assert one[name].mean == pytest.approx(two[name].mean)
        assert one[name].worst.center == pytest.approx(two[name].worst.center, abs=0.7)


def test_plane_grids_and_collapsed_cells():
    flat = shape_measures(frame_2d())
    assert flat["non_orthogonality_deg"].max == pytest.approx(0.0, abs=1e-5)
    assert flat["aspect_ratio"].max < 5.0
    x = block_around(np.arange(4.0), np.arange(4.0), np.arange(4.0))
    x[:, 0, :, 1] = x[:, 1, :, 1]
    found = shape_measures(Grid.from_blocks([x]))
    assert all(np.isfinite((m.mean, m.max)).all() for m in found.values())
