"""Aspect ratio, growth, non-orthogonality, skewness and pyramids: exact values, a plain twin, OpenFOAM's checkMesh."""

import itertools
import re

import numpy as np
import pytest
from cases import STILL
from grids import block_around, waved
from poly_mesh_witness import check_mesh

from meshdeform_core.boundary import BoundarySpec, Kind, classify
from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.quality import Original, assess, cells
from meshdeform_core.quality.listed import Worst
from meshdeform_core.quality.shape import DEFINITIONS, shape_measures, shape_of_cells, thickness_of
from meshdeform_formats import write_grid


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
    """The same, cell by cell in plain numpy: values of each measure, and the cells to which they belong."""
    cells = [n - 1 for n in x.shape[:3]]
    resolved = [a for a in range(3) if cells[a] > 1] or range(3)

    def corners(c):
        return x[c[0] : c[0] + 2, c[1] : c[1] + 2, c[2] : c[2] + 2]

    def sizes(c):
        return [np.linalg.norm(np.diff(corners(c), axis=a), axis=-1).mean() for a in range(3)]

    found = {name: [] for name in [*DEFINITIONS, "face_pyramids"]}
    for c in itertools.product(*map(range, cells)):
        own = np.array(sizes(c))
        found["aspect_ratio"].append((own[resolved].max() / own[resolved].min(), [c]))
        found["face_pyramids"] += [(volume, [c]) for volume in center_and_pyramids(corners(c))[1]]
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
                found[name].append((value, [c, n]))
    return found


@pytest.mark.parametrize("shape", [(5, 4, 6), (3, 2, 6), (5, 2, 2), (2, 2, 2), (6, 1, 4)])
def test_like_a_plain_twin_on_a_wild_block(shape, monkeypatch):
    """In slabs of few cells; a plane block as one layer as thick as the block is long."""
    monkeypatch.setattr(cells, "_SLAB_CELLS", 30)
    wild = np.random.default_rng(5).uniform(-0.3, 0.3, (*shape, 3)) * (np.array(shape) > 1)
    x = block_around(*map(np.arange, shape)) * [3.0, 1.0, 1.0] + wild
    grid = Grid.from_blocks([x])
    found = shape_measures(grid)
    twins = twin(np.concatenate([x, x + [0.0, np.ptp(x[..., 0]), 0.0]], axis=1) if 1 in shape else x)
    mirrored, volumes = shape_measures(Grid.from_blocks([x[::-1].copy()])), twins.pop("face_pyramids")
    smallest, (place,) = min(volumes)
    for pyramids, i in (
        (found.pop("face_pyramids"), place[0] + 1),
        (mirrored["face_pyramids"], shape[0] - 1 - place[0]),
    ):
        assert (pyramids.wrong, pyramids.min) == (sum(v < 0 for v, _ in volumes), pytest.approx(smallest))
        assert pyramids.worst.ijk == (i, place[1] + 1, place[2] + 1)
    everywhere = slice(0, shape[0] - 1), slice(0, max(shape[1] - 1, 1)), slice(0, shape[2] - 1)
    at_cells = shape_of_cells(grid, 0, everywhere, thickness_of(grid), 1.0)
    assert found.keys() == {name for name, values in twins.items() if values}
    for number, name in enumerate(found):
        largest, (place, *_) = max(twins[name], key=lambda each: each[0])
        assert (found[name].max, found[name].mean) == pytest.approx((largest, np.mean([v for v, _ in twins[name]])))
        i, j, k = place
        corners = x[i : i + 2, j : j + 2, k : k + 2].reshape(-1, 3)
        assert found[name].worst == Worst(
            found[name].max, "block1", (i + 1, j + 1, k + 1), pytest.approx(corners.mean(axis=0))
        )
        expected = np.zeros(at_cells.shape[:3])
        for value, both in twins[name]:
            for c in both:
                expected[c] = max(expected[c], value)
        np.testing.assert_allclose(at_cells[..., number], expected)


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


def test_collapsed_cells_have_no_ratio_or_direction():
    x = block_around(np.arange(4.0), np.arange(4.0), np.arange(4.0))
    x[:, 0, :, 1] = x[:, 1, :, 1]
    found = shape_measures(Grid.from_blocks([x]))
    assert all(np.isfinite((found[name].mean, found[name].max)).all() for name in DEFINITIONS)
    assert found["face_pyramids"].wrong == 0


@pytest.mark.parametrize("clustering", [2.5, 1e-3])
def test_fixed_walls_are_measured_like_moving_ones(clustering):
    """Without clustered cells the lower side of a channel is a far field or unknown, and not measured."""
    y = np.tanh(clustering * np.linspace(-1.0, 1.0, 25)) / np.tanh(clustering)
    grid = Grid.from_blocks([block_around(np.linspace(-2.0, 2.0, 21), y, np.zeros(1))])
    original = Original(grid, find_topology(grid))

    def walls(moving, fixed):
        specs = BoundarySpec("a", (moving,), Kind.MOVING, None, STILL), BoundarySpec("b", (fixed,), Kind.FIXED)
        boundary = classify(grid, original.topology, specs, {})
        return assess(original, waved(grid).points, boundary).after.walls

    one, other = walls("block1.jmin", "block1.jmax"), walls("block1.jmax", "block1.jmin")
    expected = (other["moving"], one["moving"]) if clustering > 1.0 else (None, None)
    assert (one["fixed"], other["fixed"]) == expected
