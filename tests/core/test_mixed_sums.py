"""Sums with weights in single precision: beside plain numpy, and alike in both directions."""

import numpy as np
import pytest

from meshdeform_core.numerics.exact.mixed import scale_of, sum_groups_mixed


def _sums(targets, sources, charges, a, kappa, every=True):
    out = np.zeros((len(targets), 8))
    charged = np.concatenate([sources, charges], axis=1)
    half = len(sources) // 2
    pieces = np.array([[0, half], [half, len(sources)]])
    scale = scale_of([targets, sources])
    span = np.array([[0, len(targets)]])
    sum_groups_mixed(targets, span, charged, pieces, np.array([[0, 2]]), scale, a, kappa, every, out)
    return out


@pytest.mark.parametrize("a", [3.0, 4.0])
@pytest.mark.parametrize("n_sources", [7, 300])
def test_as_plain_numpy(a, n_sources):
    random = np.random.default_rng(0)
    targets, sources = 50.0 + random.random((33, 3)), 50.7 + random.random((n_sources, 3))
    charges = random.standard_normal((n_sources, 8))
    r = np.linalg.norm(targets[:, None] - sources, axis=2)
    weights = r**-a + 0.3 * r**-5.0
    wanted, size = weights @ charges, weights @ np.abs(charges)
    assert np.abs((_sums(targets, sources, charges, a, 0.3) - wanted) / size).max() < 2e-6
    some = _sums(targets, sources, charges, a, 0.3, every=False)
    assert not some[:, [0, 7]].any()
    assert np.abs((some - wanted)[:, 1:7] / size[:, 1:7]).max() < 2e-6


@pytest.mark.parametrize("a", [3.0, 4.0])
def test_a_weight_is_the_same_in_both_directions(a):
    random = np.random.default_rng(1)
    one, other = random.random((21, 3)), random.random((37, 3)) * [1.0, 1e-3, 1.0]
    for n in (0, 20):
        charges = np.zeros((37, 8))
        charges[n, 1] = 1.0
        forward = _sums(one, other, charges, a, 2.0)[:, 1]
        charges = np.zeros((21, 8))
        for m in range(21):
            charges[:] = 0.0
            charges[m, 1] = 1.0
            assert _sums(other, one, charges, a, 2.0)[n, 1] == forward[m]


def test_weights_too_large_for_single_precision_are_told():
    sources = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    found = _sums(np.array([[1e-9, 0.0, 0.0], [0.5, 0.0, 0.0]]), sources, np.ones((2, 8)), 4.0, 1.0)
    assert not np.isfinite(found[0]).any()
    assert np.isfinite(found[1]).all()
