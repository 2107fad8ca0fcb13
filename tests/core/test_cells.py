"""Cell measures against their definitions, written plainly with numpy."""

import itertools

import numpy as np
import pytest

from meshdeform_core.quality.cells import measure_block


def corner_frames(x):
    """Edges (3, ci, cj, ck, 8, 3) along i, j, k at the corners 4 a + 2 b + g of all cells."""
    n = np.array(x.shape[:3]) - 1

    def node(a, b, g):
        return x[a : a + n[0], b : b + n[1], g : g + n[2]]

    corners = list(itertools.product((0, 1), repeat=3))
    return np.stack(
        [
            np.stack([node(1, b, g) - node(0, b, g) for a, b, g in corners], axis=3),
            np.stack([node(a, 1, g) - node(a, 0, g) for a, b, g in corners], axis=3),
            np.stack([node(a, b, 1) - node(a, b, 0) for a, b, g in corners], axis=3),
        ]
    )


def volumes(x):
    """Gauss quadrature of the Jacobian with three points per direction: exact for trilinear cells."""
    points, weights = np.polynomial.legendre.leggauss(3)
    total = 0.0
    for index in itertools.product(range(3), repeat=3):
        shape = [np.array([1 - points[m], 1 + points[m]]) / 2 for m in index]
        slope = np.array([-1.0, 1.0]) / 2
        jacobian = []
        for axis in range(3):
            factors = [slope if axis == other else shape[other] for other in range(3)]
            jacobian.append(
                sum(
                    factors[0][a] * factors[1][b] * factors[2][g]
                    * x[a : a + x.shape[0] - 1, b : b + x.shape[1] - 1, g : g + x.shape[2] - 1]
                    for a, b, g in itertools.product((0, 1), repeat=3)
                )
            )  # fmt: skip
        total = total + np.prod(weights[list(index)]) * np.linalg.det(np.stack(jacobian, axis=-2))
    return total


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_measures_follow_their_definitions(sign):
    rng = np.random.default_rng(3)
    # Longer than a tile of the loop along k, rough enough for crossed cells, with collapsed lines.
    shape = (4, 5, 70)
    x = np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij"), axis=-1)
    x += rng.normal(size=x.shape) * 0.25
    x[1, :, 30], x[:, 2, 60] = x[2, :, 30], x[:, 3, 60]
    if sign < 0:
        x = x * [1, 1, -1]
    found = measure_block(x, sign, None)
    assert found.skew.shape == tuple(n - 1 for n in shape)

    u, v, w = corner_frames(x)
    det = sign * np.einsum("...i,...i->...", u, np.cross(v, w))
    size = np.linalg.norm(u, axis=-1) * np.linalg.norm(v, axis=-1) * np.linalg.norm(w, axis=-1)
    flat = size == 0.0
    broken = det <= 1e-13 * np.where(flat, 1.0, size)
    with np.errstate(divide="ignore", invalid="ignore"):
        terms = (size / det) ** (2 / 3)
        expected = np.where(broken.any(axis=-1), 0.0, 8 / np.where(broken, 1.0, terms).sum(axis=-1))
        smallest = np.where(flat, 0.0, det / size).min(axis=-1)
    assert 0.01 < broken.any(axis=-1).mean() < 0.9
    np.testing.assert_array_equal(found.bad, (broken << np.arange(8)).sum(axis=-1))
    np.testing.assert_allclose(found.skew, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(found.scaled, smallest, rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.jacobian, det.min(axis=-1), rtol=0, atol=1e-13)
    np.testing.assert_allclose(found.volume, sign * volumes(x), rtol=0, atol=1e-13)


def test_a_cube_is_perfect():
    x = np.stack(np.meshgrid(*(np.arange(3.0),) * 3, indexing="ij"), axis=-1)
    found = measure_block(x, 1.0, None)
    assert all((values == 1.0).all() for values in (found.skew, found.scaled, found.jacobian, found.volume))
    assert not found.bad.any()


def test_a_corner_without_area_is_bad_in_a_plane():
    """The corner (1, 1) lies on the line through its neighbours."""
    x = np.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0], [0.5, 0.5, 0.0]]])[:, :, None]
    measures = measure_block(x, 1.0, np.array([0.0, 0.0, 1.0]))
    assert measures.bad.item() != 0
    assert measures.jacobian.item() == measures.skew.item() == 0.0
