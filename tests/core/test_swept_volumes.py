"""Volumes swept by cell faces: exact for the trilinear cells, and what a solver on the moving grid needs of them."""

from fractions import Fraction

import numpy as np
import pytest
from grids import frame, frame_2d, permuted, polar

import meshdeform as md
from meshdeform_core.grid import Grid
from meshdeform_core.grid.planes import block_handedness, plane_normal
from meshdeform_core.quality.cells import measure_block
from meshdeform_core.velocity import face_fields, grid_velocity, swept_volumes, volume_flux


def volumes(grid: Grid, points: np.ndarray) -> list[np.ndarray]:
    """Exact cell volumes (2-D: areas) of each block."""
    sign, normal = block_handedness(grid), plane_normal(grid)
    return [measure_block(grid.block(b, points), float(sign[b]), normal).volume for b in range(grid.n_blocks)]


def net(faces: tuple[np.ndarray, ...], shape: tuple[int, ...]) -> np.ndarray:
    """Far minus near faces of every cell of a block."""
    total = np.zeros([max(n - 1, 1) for n in shape])
    for axis, part in enumerate(faces):
        if part.size:
            total += np.diff(part, axis=axis)
    return total


def shaken(grid: Grid, size: float, seed: int) -> np.ndarray:
    moved = grid.points + size * np.random.default_rng(seed).normal(size=grid.points.shape)
    if grid.dimension == 2:
        moved[:, 2] = grid.points[:, 2]
    return moved


GRIDS = {
    "frame": frame(),
    "o-grid": polar(),
    "plane": frame_2d(),
    "left-handed": Grid.from_blocks([permuted(frame(), (1, 0, 2), (False, False, False)).block(0)]),
    "flat i": Grid.from_blocks([frame_2d().block(0).transpose(2, 0, 1, 3).copy()]),
    "flat j": Grid.from_blocks([frame_2d().block(0).transpose(0, 2, 1, 3).copy()]),
}


@pytest.mark.parametrize("name", GRIDS)
def test_volume_of_every_cell_changes_by_what_its_faces_sweep(name):
    grid = GRIDS[name]
    before, after = shaken(grid, 0.02, 1), shaken(grid, 0.05, 2)
    swept = swept_volumes(grid, before, after)
    old, new = volumes(grid, before), volumes(grid, after)
    for b, shape in enumerate(grid.shapes):
        assert np.abs(old[b] + net(swept[b], shape) - new[b]).max() < 1e-13 * np.abs(old[b]).min()
        assert (new[b] - old[b]).any()


def _exact(faces: np.ndarray) -> Fraction:
    """Integral of x_u x x_v . x_t over the cube, x trilinear in the corners (2, 2, 2, 3), by Simpson's rule in exact
    numbers: the integrand is of degree 2 in each of u, v, t."""
    x = np.vectorize(Fraction)(faces)
    total, rule = Fraction(0), ((Fraction(0), 1), (Fraction(1, 2), 4), (Fraction(1), 1))
    for u, p in rule:
        for v, q in rule:
            for t, r in rule:
                w = [np.array([1 - s, s], dtype=object) for s in (u, v, t)]
                d = np.array([Fraction(-1), Fraction(1)], dtype=object)
                a = np.einsum("i,j,k,ijkd->d", d, w[1], w[2], x)
                b = np.einsum("i,j,k,ijkd->d", w[0], d, w[2], x)
                c = np.einsum("i,j,k,ijkd->d", w[0], w[1], d, x)
                total += p * q * r * (np.cross(a, b) @ c)
    return total / 216


def test_swept_volumes_are_exact():
    """Against the integral in rational numbers, for a single cell."""
    rng = np.random.default_rng(4)
    grid = Grid.from_blocks([np.stack(np.meshgrid([0, 1], [0, 1], [0, 1], indexing="ij"), axis=-1) * 1.0])
    before, after = (grid.points + 0.3 * rng.normal(size=(8, 3)) for _ in range(2))
    (faces,) = swept_volumes(grid, before, after)
    old, new = before.reshape(2, 2, 2, 3), after.reshape(2, 2, 2, 3)
    for axis in range(3):
        for end in range(2):
            quads = [np.moveaxis(np.take(x, end, axis=axis), 0, int(axis == 1)) for x in (old, new)]
            exact = float(_exact(np.stack(quads, axis=2)))
            assert np.take(faces[axis], end, axis=axis).item() == pytest.approx(exact, rel=1e-13, abs=1e-15)


def test_second_order_fluxes_match_the_differences_of_volumes():
    """Levels of any spacing: the rate of the volume by three backward differences is the sum of the fluxes."""
    grid, times = frame(), (0.0, 0.1, 0.35)
    points = [shaken(grid, 0.02, seed) for seed in range(3)]
    swept = [swept_volumes(grid, points[n], points[n + 1]) for n in range(2)]
    flux = volume_flux(times, swept)
    rates = [volumes(grid, x) for x in points]
    h, before = times[2] - times[1], times[1] - times[0]
    for b, shape in enumerate(grid.shapes):
        slope, earlier = (rates[2][b] - rates[1][b]) / h, (rates[1][b] - rates[0][b]) / before
        expected = slope + (slope - earlier) * h / (h + before)
        np.testing.assert_allclose(net(flux[b], shape), expected, atol=1e-12 * np.abs(rates[0][b]).max())


def test_fields_at_the_first_levels():
    grid = frame()
    points = [shaken(grid, 0.02, seed) for seed in range(2)]
    still = face_fields(grid, (0.0,), points[:1])
    assert not any(field.values.any() for field in still)
    fields = {(f.name, f.location, f.block): f.values for f in face_fields(grid, (0.0, 0.5), points)}
    np.testing.assert_array_equal(fields["VolumeFlux", "jface", 0], fields["SweptVolume", "jface", 0] / 0.5)
    np.testing.assert_allclose(grid_velocity((0.0, 0.5), points, "swept"), (points[1] - points[0]) / 0.5)


def test_step_gives_the_volumes_since_another_step():
    x, y = np.meshgrid(np.linspace(0, 1, 6), np.linspace(0, 1, 5), indexing="ij")
    grid = md.Grid([np.stack([x, y], axis=-1)])
    mesh = md.prepare(grid, moving={"top": ["block1.jmax"]})
    one = mesh.deform(lambda x, t: np.stack([0 * x[:, 0], 0.1 * np.sin(np.pi * x[:, 0])], axis=1))
    two = mesh.deform(lambda x, t: np.stack([0 * x[:, 0], -0.1 * np.sin(np.pi * x[:, 0])], axis=1))
    for step, before in ((one, mesh.grid), (two, one), (two, one.grid)):
        ((across_i, across_j),) = step.swept_volumes(before)
        assert across_i.shape == (6, 4)
        assert across_j.shape == (5, 5)
        start = before.grid if isinstance(before, md.Step) else before
        area = [np.array(volumes(g.core, g.core.points)[0])[..., 0] for g in (start, step.grid)]
        np.testing.assert_allclose(area[1] - area[0], np.diff(across_i, axis=0) + np.diff(across_j, axis=1), atol=1e-15)
    with pytest.raises(md.GridError, match="expected a step or a grid"):
        one.swept_volumes(3)
    with pytest.raises(md.GridError):
        one.swept_volumes(md.Grid([np.zeros((3, 3, 2)) + np.arange(3)[:, None, None]]))
