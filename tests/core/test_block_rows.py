"""Products of the matrix of a Newton step with vectors, against dense algebra."""

import numpy as np
import pytest

from meshdeform_core.numerics.systems.block_rows import with_room
from meshdeform_core.repair.newton import multiply_rows, sweep_back, sweep_on


def matrix_of(n, d):
    """A symmetric matrix of blocks (d, d) with unit diagonal, some of them absent: in parts, and as a dense array."""
    random = np.random.default_rng(n)
    there = np.tril(random.random((n, n)) < 0.6) | np.eye(n, dtype=bool)
    there |= there.T
    whole = 0.1 * random.standard_normal((n, n, d, d))
    whole = (whole + whole.transpose(1, 0, 3, 2)).astype(np.float32)
    whole[np.arange(n), np.arange(n)] = np.eye(d)
    whole[~there] = 0.0
    rows, columns = np.nonzero(there)
    blocks = with_room((len(rows), d, d), np.float32)
    blocks[...] = whole[rows, columns]
    starts = np.append(0, np.cumsum(np.bincount(rows, minlength=n)))
    return (blocks, starts, columns.astype(np.int32)), whole.transpose(0, 2, 1, 3).reshape(n * d, n * d).astype(float)


def vector_of(n, d):
    found = with_room((n, d))
    found[...] = np.random.default_rng(7).standard_normal((n, d))
    return found


@pytest.mark.parametrize("n", [1, 2, 7])
def test_products_with_blocks_of_nine_numbers(n):
    matrix, dense = matrix_of(n, 3)
    p, image = vector_of(n, 3), np.full((n, 3), np.nan)
    products = sum(multiply_rows(*matrix, p, image, low, high) for low, high in ((0, n // 2), (n // 2, n)))
    np.testing.assert_allclose(image.ravel(), dense @ p.ravel(), rtol=0.0, atol=1e-14)
    assert products == pytest.approx(p.ravel() @ dense @ p.ravel(), rel=1e-13)


@pytest.mark.parametrize("n", [1, 2, 7])
@pytest.mark.parametrize("middle", [0, 1, 3])
def test_sweeps_with_blocks_of_four_numbers(n, middle):
    matrix, dense = matrix_of(n, 2)
    relaxation, ranges = 1.3, [(low, high) for low, high in ((0, min(middle, n)), (min(middle, n), n)) if low < high]
    p, t, image = vector_of(n, 2), with_room((n, 2)), with_room((n, 2))
    for low, high in ranges:
        sweep_back(matrix, relaxation, p, t, low, high)
    products = sum(sweep_on(matrix, relaxation, p, t, image, low, high) for low, high in ranges)
    part = np.repeat(np.arange(n) >= middle, 2)
    block = np.repeat(np.arange(n), 2)
    lower = np.where((part[:, None] == part) & (block[:, None] > block), dense, 0.0)
    factor = np.eye(2 * n) / relaxation + lower
    expected = np.linalg.solve(factor, dense @ np.linalg.solve(factor.T, p.ravel()))
    np.testing.assert_allclose(t.ravel(), np.linalg.solve(factor.T, p.ravel()), rtol=0.0, atol=1e-13)
    np.testing.assert_allclose(image.ravel(), expected, rtol=0.0, atol=1e-13)
    assert products == pytest.approx(p.ravel() @ expected, rel=1e-12)
