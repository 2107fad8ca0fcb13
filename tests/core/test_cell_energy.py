"""The energy of hexahedra, computed for eight cells at a time, against its definition in plain numpy."""

import numpy as np
import pytest

from meshdeform_core.numerics.cell.foldover.loops import Unknowns, add_derivatives, energy_of_cells, places_of_pairs
from meshdeform_core.numerics.cell.foldover.samples import sample_slopes

SLOPES = sample_slopes(3)
CORNERS, ALL = (1 << 8) - 1, (1 << 27) - 1
# eps, share, cubic, elastic, exact
UNTANGLING, MINIMISING = (0.7, 1.0, 0.0, 0.0, 0.0), (0.0, 0.3, 2.0, 0.7, 1.0)


def cells(n, thin):
    """A skewed row of ``n`` cells whose height is 1 / ``thin``: undeformed, deformed and reference coordinates."""
    random = np.random.default_rng(3)
    grid = np.stack(np.meshgrid(np.arange(n + 1.0), [0.0, 1.0], [0.0, 1.0], indexing="ij"), axis=-1)
    start = (grid + 0.05 * random.standard_normal(grid.shape)) * (1.0, 1.0, 1.0 / thin)
    start[..., 0] += 0.5 * start[..., 1] + 0.3 * thin * start[..., 2]
    other, reference = (start + 0.1 * random.standard_normal(grid.shape) * (1.0, 1.0, 1.0 / thin) for _ in range(2))
    number = np.arange(4 * (n + 1)).reshape(n + 1, 2, 2)
    corners = [number[a : n + a, b, c] for a in (0, 1) for b in (0, 1) for c in (0, 1)]
    return tuple(points.reshape(-1, 3) for points in (start, other, reference)), np.stack(corners, axis=1)


def masks(m):
    """Some cells with all sample points, some without one of their corners."""
    found = np.where(np.arange(m) % 3 == 0, ALL, CORNERS)
    found[1::4] &= ~(1 << 5)
    return found


def definition(start, x, reference, cell, mask, weight, penalty):
    """The energy of one cell, as in the docstring of the package ``foldover``; its smallest D and largest f."""
    eps, share, cubic, elastic, _ = penalty
    total, lowest, highest = 0.0, np.inf, 0.0
    for s, slope in enumerate(SLOPES):
        if not mask >> s & 1:
            continue
        undeformed, deformed, held = (points[cell].T @ slope for points in (start, x, reference))
        a = deformed @ np.linalg.inv(undeformed)
        det = np.linalg.det(a)
        chi = 0.5 * (det + np.hypot(eps, det))
        f = (a**2).sum() / (3.0 * chi ** (2.0 / 3.0)) + (det**2 + 1.0) / (2.0 * chi) if chi > 0.0 else np.inf
        part = share if s < 8 else share * weight[1]
        total += part * (weight[0] * f + cubic * (f - 2.0) ** 3 / (1.0 + 0.25 * (f - 2.0)))
        if s < 8:
            total += 0.5 * elastic * weight[2] * ((a - held @ np.linalg.inv(undeformed)) ** 2).sum()
        lowest, highest = min(lowest, det), max(highest, f)
    return total, lowest, highest


@pytest.mark.parametrize("penalty", [UNTANGLING, MINIMISING])
@pytest.mark.parametrize("n", [1, 8, 13])
def test_the_energy_is_that_of_its_definition(n, penalty):
    (start, x, reference), corners = cells(n, 1.0)
    mask, weight = masks(n), np.random.default_rng(4).random((n, 3)) + 0.5
    found = energy_of_cells(x, corners, start, mask, SLOPES, weight, reference, penalty, np.arange(n))
    expected = [definition(start, x, reference, corners[c], mask[c], weight[c], penalty) for c in range(n)]
    totals, lowest, highest = zip(*expected, strict=True)
    assert found == pytest.approx((sum(totals), min(lowest), max(highest)), rel=1e-12)


def test_an_inverted_cell_has_no_energy_without_regularisation():
    (start, x, reference), corners = cells(9, 1.0)
    x[corners[4, 7]] = x[corners[4, 0]] - 1.0
    arguments = corners, start, masks(9), SLOPES, np.ones((9, 3)), reference
    energy, lowest, highest = energy_of_cells(x, *arguments, MINIMISING, np.arange(9))
    assert not np.isfinite(energy)
    assert lowest < 0.0
    assert highest == np.inf
    assert np.isfinite(energy_of_cells(x, *arguments, UNTANGLING, np.arange(9))).all()


def derivatives_of(x, given, which, penalty=MINIMISING, unknowns=None, ranges=()):
    """Gradient (n, 3) and Hessian (n, n, 3, 3) of the energy of the cells ``which``, some rows at a time; ``given``:
    corners, undeformed coordinates, masks, slopes, weights, reference."""
    n = len(x)
    unknowns = unknowns or Unknowns(np.arange(n), np.tile(np.eye(3), (n, 1, 1)), np.ones(n, bool))
    gradient, hessian = np.zeros((n, 3)), np.zeros((n, n, 3, 3))
    places = places_of_pairs(unknowns.number[given[0]], np.arange(n + 1) * n, np.tile(np.arange(n, dtype=np.int32), n))
    for low, high in ranges or [(0, n)]:
        blocks = np.zeros(((high - low) * n, 3, 3))
        rows = low, high, low * n
        add_derivatives(x, *given, penalty, np.asarray(which), places, unknowns, rows, blocks, gradient)
        hessian[low:high] = blocks.reshape(-1, n, 3, 3)
    assert not hessian[np.tril_indices(n, -1)].any()
    diagonal = hessian * np.eye(n)[:, :, None, None]
    return gradient, hessian + (hessian - diagonal).transpose(1, 0, 3, 2)


@pytest.mark.parametrize("thin", [1.0, 1e5])
def test_derivatives_are_those_of_the_energy_whatever_the_frames_and_rows(thin):
    (start, x, reference), corners = cells(13, thin)
    mask, weight = masks(13), np.random.default_rng(4).random((13, 3)) + 0.5
    random, n = np.random.default_rng(5), len(x)
    frame, plain = np.tile(np.eye(3), (n, 1, 1)), random.random(n) < 0.7
    frame[~plain] = np.linalg.qr(random.standard_normal((n, 3, 3)))[0][~plain]
    number = np.where(random.random(n) < 0.8, np.arange(n), -1)
    given = corners, start, mask, SLOPES, weight, reference
    rest = given, range(13), MINIMISING, Unknowns(number, frame, plain)
    gradient, hessian = derivatives_of(x, *rest, [(0, 11), (11, n)])
    np.testing.assert_array_equal(hessian, derivatives_of(x, *rest)[1])
    step = random.standard_normal((n, 3)) * (1.0, 1.0, 1.0 / thin) * (number >= 0)[:, None]
    along = np.einsum("nji,nj->ni", frame, step)
    energies, ends = zip(*((energy_of_cells(at, *given, MINIMISING, np.arange(13))[0], derivatives_of(at, *rest)[0])
                           for at in (x - 1e-6 * step, x + 1e-6 * step)), strict=True)  # fmt: skip
    assert (energies[1] - energies[0]) / 2e-6 == pytest.approx((gradient * along).sum(), rel=1e-6)
    change = np.einsum("noij,oj->ni", hessian, along)
    expected = (ends[1] - ends[0]) / 2e-6
    np.testing.assert_allclose(change, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("penalty", [UNTANGLING, MINIMISING])
def test_derivatives_of_a_cell_do_not_depend_on_the_cells_beside_it(penalty):
    (start, x, reference), corners = cells(8, 1.0)
    # Cells without common nodes, so that nothing is added to the derivatives of one of them.
    start, x, reference = (points[corners].reshape(-1, 3) for points in (start, x, reference))
    corners = np.arange(64).reshape(8, 8)
    given = corners, start, masks(8), SLOPES, np.full((8, 3), 0.8), reference
    broken = x.copy()
    broken[corners[3]] = np.nan
    broken[corners[6, 2]] = np.inf
    together = derivatives_of(x, given, range(8), penalty)
    beside = derivatives_of(broken, given, range(8), penalty)
    for c in range(8):
        alone = derivatives_of(x, given, [c], penalty)
        own = corners[c][:, None], corners[c]
        assert np.isfinite(alone[1]).all()
        assert np.abs(alone[0]).max() > 0.0
        for found in (together, beside) if c not in (3, 6) else (together,):
            np.testing.assert_array_equal(found[0][corners[c]], alone[0][corners[c]])
            np.testing.assert_array_equal(found[1][own], alone[1][own])


@pytest.mark.parametrize("size", [1e-30, 1e17, 1e30])
def test_derivatives_scale_with_the_cells_also_where_some_points_do_not_count(size):
    (start, x, reference), corners = cells(8, 1.0)
    mask, weight = masks(8), np.full((8, 3), 0.8)
    gradient, hessian = derivatives_of(x, (corners, start, mask, SLOPES, weight, reference), range(8))
    given = corners, size * start, mask, SLOPES, weight, size * reference
    scaled = derivatives_of(size * x, given, range(8))
    np.testing.assert_allclose(size * scaled[0], gradient, rtol=0.0, atol=1e-11 * np.abs(gradient).max())
    np.testing.assert_allclose(size * size * scaled[1], hessian, rtol=0.0, atol=1e-11 * np.abs(hessian).max())
