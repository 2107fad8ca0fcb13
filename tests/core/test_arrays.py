"""Reductions over many short rows against numpy's own."""

import numpy as np
import pytest

from meshdeform_core.numerics.arrays import distinct_pairs, extent, total, weighted_total

RNG = np.random.default_rng(4)


@pytest.mark.parametrize("count", [1, 63, 64, 65, 1000])
def test_extent_and_total_are_those_of_columns(count):
    points = RNG.standard_normal((count, 3))
    low, high = extent(points)
    np.testing.assert_array_equal(low, points.min(axis=0))
    np.testing.assert_array_equal(high, points.max(axis=0))
    np.testing.assert_allclose(total(points), points.sum(axis=0), rtol=1e-12, atol=1e-12)
    weights = RNG.uniform(size=count)
    np.testing.assert_allclose(weighted_total(weights, points), weights @ points, rtol=1e-12, atol=1e-12)
    part = np.broadcast_to(points[:, None], (count, 2, 3))[:, ::2]
    np.testing.assert_array_equal(extent(part), (low, high))


def test_extent_of_what_is_not_a_number_is_none():
    points = np.zeros((200, 3))
    points[70, 1] = np.nan
    assert np.isnan(extent(points)[0]).tolist() == [False, True, False]


@pytest.mark.parametrize("size", [0, 1, 5, 400])
def test_distinct_pairs_are_sorted(size):
    pairs = RNG.integers(0, 12, (size, 2))
    np.testing.assert_array_equal(distinct_pairs(pairs), np.unique(pairs, axis=0))
