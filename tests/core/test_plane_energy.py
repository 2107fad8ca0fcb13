"""The energy of triangles of plane grids, whose derivatives are computed for eight of them at a time."""

import numpy as np
import pytest

from meshdeform_core.numerics.cell.foldover.hexahedra import Unknowns
from meshdeform_core.numerics.cell.foldover.plane import add_triangles, energy_of_triangles

TRIANGLES = 13
# eps, share, cubic, elastic, exact
UNTANGLING, MINIMISING = (0.7, 1.0, 0.0, 0.0, 0.0), (0.0, 0.3, 2.0, 0.7, 1.0)


def triangles():
    """A strip of triangles: deformed coordinates, reference, nodes, gradients of their shape functions, weights."""
    random, n = np.random.default_rng(3), TRIANGLES + 2
    start = np.stack([0.5 * np.arange(n), np.arange(n) % 2], axis=1) + 0.05 * random.standard_normal((n, 2))
    x, reference = (start + 0.1 * random.standard_normal((n, 2)) for _ in range(2))
    node = np.arange(TRIANGLES)[:, None] + np.arange(3)
    edges = np.linalg.inv(start[node[:, 1:]] - start[node[:, :1]]).transpose(0, 2, 1)
    slope = np.concatenate([-edges.sum(axis=1, keepdims=True), edges], axis=1)
    return x, reference, node, slope, random.random(TRIANGLES) + 0.5


def unknowns_of(n):
    """Some nodes that do not move, and some with frames of their own."""
    random = np.random.default_rng(5)
    frame, plain = np.tile(np.eye(2), (n, 1, 1)), random.random(n) < 0.6
    frame[~plain] = np.linalg.qr(random.standard_normal((n, 2, 2)))[0][~plain]
    return Unknowns(np.where(random.random(n) < 0.8, np.arange(n), -1), frame, plain)


def derivatives(x, unknowns, penalty, ranges, which=None):
    _, reference, node, slope, weight = triangles()
    n = len(x)
    gradient, hessian = np.zeros((n, 2)), np.zeros((n, n, 2, 2))
    starts, columns = np.arange(n + 1) * n, np.tile(np.arange(n, dtype=np.int32), n)
    which = np.arange(TRIANGLES) if which is None else np.asarray(which)
    for low, high in ranges:
        blocks = np.zeros(((high - low) * n, 2, 2))
        rows = low, high, starts, columns
        add_triangles(x, node, slope, weight, reference, penalty, which, unknowns, rows, blocks, gradient)
        hessian[low:high] = blocks.reshape(-1, n, 2, 2)
    return gradient, hessian


@pytest.mark.parametrize("penalty", [UNTANGLING, MINIMISING])
def test_ranges_of_rows_have_the_derivatives_of_all_rows(penalty):
    x = triangles()[0]
    unknowns, n = unknowns_of(len(x)), len(x)
    whole = derivatives(x, unknowns, penalty, [(0, n)])
    assert (np.abs(whole[1]).max(axis=(1, 2, 3)) > 0.0).sum() == (unknowns.number >= 0).sum()
    for found, expected in zip(derivatives(x, unknowns, penalty, [(0, 5), (5, 6), (6, n)]), whole, strict=True):
        np.testing.assert_array_equal(found, expected)


def test_derivatives_are_those_of_the_energy_whatever_the_frames():
    x, reference, node, slope, weight = triangles()
    unknowns, n = unknowns_of(len(x)), len(x)
    assert 0 < unknowns.plain.sum() < n > (unknowns.number >= 0).sum() > 0
    step = np.random.default_rng(6).standard_normal((n, 2)) * (unknowns.number >= 0)[:, None]
    along = np.einsum("nji,nj->ni", unknowns.frame, step)
    gradient, hessian = derivatives(x, unknowns, MINIMISING, [(0, n)])
    ends = [x - 1e-6 * step, x + 1e-6 * step]
    low, high = (energy_of_triangles(at, node, slope, weight, reference, MINIMISING, 0, TRIANGLES)[0] for at in ends)
    assert (high - low) / 2e-6 == pytest.approx((gradient * along).sum(), rel=1e-6)
    before, after = (derivatives(at, unknowns, MINIMISING, [(0, n)])[0] for at in ends)
    expected = (after - before) / 2e-6
    change = np.einsum("noij,oj->ni", hessian, along)
    np.testing.assert_allclose(change, expected, atol=1e-6 * np.abs(expected).max())


def test_derivatives_of_a_triangle_do_not_depend_on_those_beside_it():
    x = triangles()[0]
    n = len(x)
    unknowns = Unknowns(np.arange(n), np.tile(np.eye(2), (n, 1, 1)), np.ones(n, bool))
    broken = x.copy()
    # Of the triangles 0, 3, 6, 9, 12, which have no common nodes, one is not finite.
    broken[6] = np.nan
    some = [0, 3, 6, 9, 12]
    together = derivatives(x, unknowns, MINIMISING, [(0, n)], some)
    beside = derivatives(broken, unknowns, MINIMISING, [(0, n)], some)
    for m in some:
        own = slice(m, m + 3)
        alone = derivatives(x, unknowns, MINIMISING, [(0, n)], [m])
        for found in (together, beside) if m != 6 else (together,):
            np.testing.assert_array_equal(found[0][own], alone[0][own])
            np.testing.assert_array_equal(found[1][own, own], alone[1][own, own])
