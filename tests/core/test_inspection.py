"""The pass over cells in single precision, against definitions in double precision written plainly with numpy."""

import itertools

import numpy as np
import pytest

from meshdeform_core.grid import Grid
from meshdeform_core.grid.topology import find_topology
from meshdeform_core.numerics.cell.inspection import Scratch, inspect_hexahedra
from meshdeform_core.numerics.cell.measures import measure_cells
from meshdeform_core.quality import Original, assess
from meshdeform_core.quality.validity import TOTALS

TOLERANCE = 2e-5
"""Largest relative error of the pass for cells that it does not leave open."""


def box(shape):
    return np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij"), axis=-1)


def corners(x):
    """Corners (n_cells, 8, 3) of all cells of a block."""
    low, high = slice(None, -1), slice(1, None)
    parts = [x[tuple((low, high)[n] for n in corner)] for corner in itertools.product((0, 1), repeat=3)]
    return np.stack(parts, axis=3).reshape(-1, 8, 3)


def plain(x, sign):
    """f_skew, smallest scaled corner, corner Jacobians and volume: Knupp's definitions, Gauss quadrature."""
    cells = corners(x).reshape(-1, 2, 2, 2, 3)
    jacobian, size = [], []
    for a, b, c in itertools.product((0, 1), repeat=3):
        u = cells[:, 1, b, c] - cells[:, 0, b, c]
        v = cells[:, a, 1, c] - cells[:, a, 0, c]
        w = cells[:, a, b, 1] - cells[:, a, b, 0]
        jacobian.append(sign * np.linalg.det(np.stack([u, v, w], axis=1)))
        size.append(np.linalg.norm(u, axis=1) * np.linalg.norm(v, axis=1) * np.linalg.norm(w, axis=1))
    jacobian, size = np.stack(jacobian, axis=1), np.stack(size, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        skew = np.where((jacobian > 0).all(axis=1), 8 / ((size / np.abs(jacobian)) ** (2 / 3)).sum(axis=1), 0.0)
        scaled = (jacobian / size).min(axis=1)
    return skew, scaled, jacobian, quadrature(cells, sign)


def quadrature(cells, sign):
    at, weight = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for index in itertools.product(range(3), repeat=3):
        shape = [np.array([1 - at[n], 1 + at[n]]) / 2 for n in index]
        slope = np.array([-0.5, 0.5])
        rows = [
            np.einsum("nabcd,a,b,c->nd", cells, *(slope if axis == other else shape[other] for other in range(3)))
            for axis in range(3)
        ]
        total = total + np.prod(weight[list(index)]) * np.linalg.det(np.stack(rows, axis=1))
    return sign * total


def smallest_coefficient(x, sign, parts=12):
    """The smallest of the Jacobian at many points of every cell."""
    cells, t = sign * 1.0, np.linspace(0.0, 1.0, parts)
    value, slope = np.stack([1 - t, t], axis=1), np.array([-1.0, 1.0])
    ones = np.ones(parts)
    c = corners(x).reshape(-1, 2, 2, 2, 3)
    rows = [
        np.einsum("nabcd,ra,sb,tc->nrstd", c, *(np.outer(ones, slope) if axis == o else value for o in range(3)),
                  optimize=True)
        for axis in range(3)
    ]  # fmt: skip
    return (cells * np.einsum("nrstd,nrstd->nrst", np.cross(rows[0], rows[1]), rows[2])).min(axis=(1, 2, 3))


def inspect(before, x, sign=1.0, scale=1.0):
    shape = tuple(n - 1 for n in x.shape[:3])
    out, is_open, scratch = np.empty((4, *shape), np.float32), np.empty(shape, dtype=bool), Scratch.new()
    inspect_hexahedra(before, x, before is not x, sign, scale, 0, shape[0], out, is_open, np.zeros(TOTALS), scratch)
    return out.reshape(4, -1), is_open.ravel()


def test_what_is_not_open_is_positive_everywhere():
    rng = np.random.default_rng(0)
    for amount in (0.1, 0.2, 0.3):
        x = box((12, 12, 12)) * [1.0, 1e-4, 50.0]
        x += amount * rng.standard_normal(x.shape) * [1.0, 1e-4, 50.0]
        is_open = inspect(x, x)[1]
        lowest = smallest_coefficient(x, 1.0)
        assert (lowest[~is_open] > 0).all()
        assert is_open[lowest <= 0].all()


@pytest.mark.parametrize("size", [1e-9, 1.0, 1e9])
def test_smooth_cells_are_proved_at_any_size_and_place(size):
    x = box((20, 21, 22))
    x = size * (x + 0.3 * np.sin(0.4 * x[..., ::-1])) * [1.0, 1e-3, 10.0]
    for shift in (0.0, 100.0 * size):
        out, is_open = inspect(x, x + shift, scale=1.0 / size)
        assert not is_open.any()
        np.testing.assert_allclose(out[2], 1.0, rtol=1e-4)


def test_collapsed_flat_and_minute_cells_are_left_open():
    x = box((4, 4, 4))
    x[1, :, 1] = x[2, :, 1]
    x[3, 3, 3] = [2.0, 2.0, 2.0]
    assert inspect(x, x)[1].any()
    x = box((3, 3, 3)) * 1e-14
    assert inspect(x, x)[1].all()
    x = box((3, 3, 3)) @ np.array([[1, 0, 0], [1, 1e-3, 0], [0, 0, 1.0]])
    assert inspect(x, x)[1].all()
    x = box((3, 3, 3))
    x[1, 1, 1] = np.nan
    assert inspect(x, x)[1].all()


def test_scattered_cells_are_measured_like_the_definitions():
    rng = np.random.default_rng(5)
    x = box((6, 6, 6)) + 0.35 * rng.standard_normal((6, 6, 6, 3))
    expected = plain(x, 1.0)
    assert (expected[0] == 0).any()
    for found, values in zip(measure_cells(corners(x), 1.0), expected, strict=True):
        np.testing.assert_allclose(found, values, rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("flip", [False, True])
def test_extremes_and_totals_of_a_report_are_in_double_precision(flip):
    rng = np.random.default_rng(8)
    before = box((9, 8, 7)) + 0.05 * rng.standard_normal((9, 8, 7, 3))
    after = before + 0.1 * rng.standard_normal(before.shape)
    if flip:
        before, after = (np.ascontiguousarray(x[:, ::-1]) for x in (before, after))
    grid = Grid.from_blocks([before])
    original = Original(grid, find_topology(grid))
    quality = assess(original, after.reshape(-1, 3), None).after
    new, old = (plain(x, -1.0 if flip else 1.0) for x in (after, before))
    assert quality.invalid_cells == 0
    assert quality.f_skew.min == pytest.approx(new[0].min(), rel=1e-12)
    assert quality.min_scaled_jacobian == pytest.approx(new[1].min(), rel=1e-12)
    assert quality.min_relative_jacobian == pytest.approx((new[2] / old[2]).min(), rel=1e-12)
    assert quality.volume_ratio.min == pytest.approx((new[3] / old[3]).min(), rel=1e-12)
    assert quality.volume_ratio.max == pytest.approx((new[3] / old[3]).max(), rel=1e-12)
    assert quality.total_volume == pytest.approx(new[3].sum(), rel=1e-12)
    assert quality.f_skew.mean == pytest.approx(new[0].mean(), rel=TOLERANCE)
    assert quality.f_skew.harmonic_mean == pytest.approx(1 / (1 / new[0]).mean(), rel=TOLERANCE)
    assert quality.f_skew.p01 == pytest.approx(np.sort(new[0])[-(-new[0].size // 100) - 1], rel=TOLERANCE)
    assert quality.f_skew.histogram == tuple(np.histogram(new[0], 20, (0.0, 1.0))[0])
