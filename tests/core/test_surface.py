"""Closest points of triangles against a plain twin that tries every triangle."""

import numpy as np
import pytest

from meshdeform_core.numerics.geometry.surface import TriangleTree


def to_segment(p, a, b):
    """Distances (n, m) of points (n, 1, 3) from segments (m, 3)."""
    along = np.einsum("nmi,mi->nm", p - a, b - a) / np.maximum(((b - a) ** 2).sum(axis=-1), 1e-300)
    return np.linalg.norm(p - a - np.clip(along, 0.0, 1.0)[..., None] * (b - a), axis=-1)


def to_triangles(points, corners):
    """Distances (n, m): to the plane where the foot of the perpendicular is inside, else to the nearest edge."""
    p, (a, b, c) = points[:, None], np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    inside = np.ones((len(points), len(corners)), dtype=bool)
    for one, other in ((a, b), (b, c), (c, a)):
        inside &= np.einsum("nmi,mi->nm", p - one, np.cross(normal, other - one)) >= 0
    edges = np.min([to_segment(p, *pair) for pair in ((a, b), (b, c), (c, a))], axis=0)
    return np.where(inside, np.abs(np.einsum("nmi,mi->nm", p - a, normal)), edges)


@pytest.mark.parametrize("count", [1, 9, 200])
def test_closest_points_are_those_of_all_triangles(count):
    rng = np.random.default_rng(count)
    # Small triangles in a large flat box: most are far from any point, and bounds of boxes matter on every axis.
    corners = rng.uniform(-1, 1, (count, 1, 3)) * [10.0, 5.0, 2.0] + rng.uniform(-0.5, 0.5, (count, 3, 3))
    points = rng.uniform(-1.5, 1.5, (300, 3)) * [10.0, 5.0, 2.0]
    triangle, weights, distance = TriangleTree(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3)).closest(
        points
    )
    expected = to_triangles(points, corners)
    np.testing.assert_allclose(distance, expected.min(axis=1), rtol=1e-12)
    np.testing.assert_allclose(expected[np.arange(300), triangle], distance, rtol=1e-12)
    assert (weights >= -1e-14).all()
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, rtol=1e-14)
    at = np.einsum("nc,ncd->nd", weights, corners[triangle])
    np.testing.assert_allclose(np.linalg.norm(points - at, axis=1), distance, rtol=1e-10)


def test_only_points_within_a_distance_are_looked_for():
    rng = np.random.default_rng(5)
    corners = rng.uniform(-1, 1, (50, 3, 3))
    tree, points = TriangleTree(corners.reshape(-1, 3), np.arange(150).reshape(-1, 3)), rng.uniform(-2, 2, (200, 3))
    triangle, weights, distance = tree.closest(points)
    within = distance * rng.choice([0.5, 0.999, 1.001, 3.0], 200)
    near = within > distance
    some = tree.closest(points, within)
    assert np.isinf(some[2][~near]).all()
    for all_found, found in zip((triangle, weights, distance), some, strict=True):
        np.testing.assert_array_equal(found[near], all_found[near])
