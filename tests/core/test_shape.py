"""Aspect ratio, growth, non-orthogonality, skewness and pyramids: exact values, a plain twin, OpenFOAM's checkMesh."""

import itertools
import re

import numpy as np
import pytest
from grids import block_around, frame, frame_2d, permuted
from poly_mesh_witness import check_mesh

from meshdeform_core.grid import Grid
from meshdeform_core.quality.shape import DEFINITIONS, shape_measures
from meshdeform_formats import write_grid


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


def face_of(cell, axis, end):
    """Centre and area, along the axis, of a face of a cell (2, 2, 2, 3), from four triangles about its mean corner."""
    face = np.take(np.moveaxis(cell, [axis, (axis + 1) % 3, (axis + 2) % 3], [0, 1, 2]), end, axis=0)
    ring = face[[0, 1, 1, 0], [0, 0, 1, 1]]
    triangles = np.stack([ring, np.roll(ring, -1, axis=0), np.broadcast_to(ring.mean(axis=0), (4, 3))], axis=1)
    areas = 0.5 * np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return np.average(triangles.mean(axis=1), axis=0, weights=np.linalg.norm(areas, axis=1)), areas.sum(axis=0)


def center_and_pyramids(cell):
    """Centre of a cell: of its pyramids about the mean face centre; volumes (6,) of the pyramids about that centre."""
    faces = [(end, *face_of(cell, a, end)) for a in range(3) for end in (0, 1)]
    mean = np.mean([center for _, center, _ in faces], axis=0)
    volumes = [(2 * end - 1) * (center - mean) @ area for end, center, area in faces]
    center = np.average([0.75 * face + 0.25 * mean for _, face, _ in faces], axis=0, weights=volumes)
    return center, [(2 * end - 1) * (face - center) @ area / 3 for end, face, area in faces]


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
            one, two = (center_and_pyramids(corners(v))[0] for v in (c, n))
            center, area = face_of(corners(n), a, 0)
            line = two - one
            cosine = line @ area / np.linalg.norm(line) / np.linalg.norm(area)
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
    cells = itertools.product(*(range(n - 1) for n in x.shape[:3]))
    volumes = np.array([center_and_pyramids(x[i : i + 2, j : j + 2, k : k + 2])[1] for i, j, k in cells])
    assert found["face_pyramids"].wrong == (volumes < 0).sum()
    assert found["face_pyramids"].min == pytest.approx(volumes.min())


@pytest.mark.parametrize(("wild", "turned"), [(0.45, False), (0.8, False), (0.8, True)])
def test_check_mesh_says_the_same(wild, turned, tmp_path):
    """Also of cells turned inside out, and in left-handed blocks."""
    rng = np.random.default_rng(3)
    x = block_around(np.arange(8.0), np.arange(6.0), np.arange(7.0)) + rng.uniform(-wild, wild, (8, 6, 7, 3))
    grid = Grid.from_blocks([x[::-1].copy() if turned else x])
    write_grid(grid, tmp_path / "case.foam")
    said, found = check_mesh(tmp_path), shape_measures(grid)
    count = re.search(r"Error in face pyramids: (\d+) faces", said)
    assert (count is None) == (wild < 0.5)
    assert found["face_pyramids"].wrong == (int(count[1]) if count else 0)
    angle = re.search(r"non-orthogonality Max: (\S+)", said)
    assert angle is not None
    assert found["non_orthogonality_deg"].max == pytest.approx(float(angle[1]), rel=1e-5)


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
    assert all(np.isfinite((found[name].mean, found[name].max)).all() for name in DEFINITIONS)
    assert found["face_pyramids"].wrong == 0
