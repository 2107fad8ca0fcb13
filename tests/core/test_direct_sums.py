"""Sums in single and double precision beside plain numpy, for distances of all sizes."""

import numpy as np
import pytest

from meshdeform_core.numerics.exact.direct import sum_groups
from meshdeform_core.numerics.fastsum.plan import sum_single


def _sums(targets, sources, charges, a, kappa, every=True, single=True):
    out = np.zeros((len(targets), 8))
    half = len(sources) // 2
    pieces, span = np.array([[0, half], [half, len(sources)]]), np.array([[0, len(targets)]])
    groups = targets, span, sources, charges, pieces, np.array([[0, 2]])
    if single:
        sum_single(*groups, a, kappa, every, out)
    else:
        sum_groups(*groups, a, 5.0, kappa, every, out)
    return out


def _exact(targets, sources, charges, a, kappa):
    r = np.linalg.norm(targets[:, None] - sources, axis=2)
    weights = r**-a + kappa * r**-5.0
    return weights @ charges, weights @ np.abs(charges)


@pytest.mark.parametrize("a", [3.0, 4.0])
@pytest.mark.parametrize("kappa", [0.3, 1e12])
@pytest.mark.parametrize(("single", "error"), [(True, 2e-5), (False, 1e-14)])
@pytest.mark.parametrize("n_sources", [7, 1300])
def test_as_plain_numpy(a, kappa, n_sources, single, error):
    random = np.random.default_rng(0)
    targets, sources = 50.0 + random.random((33, 3)), 50.7 + random.random((n_sources, 3))
    charges = random.standard_normal((n_sources, 8))
    wanted, size = _exact(targets, sources, charges, a, kappa)
    assert np.abs((_sums(targets, sources, charges, a, kappa, True, single) - wanted) / size).max() < error
    some = _sums(targets, sources, charges, a, kappa, False, single)
    assert not some[:, [0, 7]].any()
    assert np.abs((some - wanted)[:, 1:7] / size[:, 1:7]).max() < error


@pytest.mark.parametrize("a", [3.0, 4.0])
@pytest.mark.parametrize("distance", [1e-6, 1e-7, 1e-9, 1e-11])
def test_targets_almost_at_a_source(a, distance):
    """First cells may be that much thinner than the brick of nodes to which their nodes belong is long."""
    random = np.random.default_rng(1)
    sources = random.random((900, 3)) * [1.0, 1.0, 0.0]
    targets = np.concatenate([sources[:20], sources[890:]]) + [0.0, 0.0, distance]
    targets[::2, 0] += 0.5 * distance
    charges = random.standard_normal((900, 8))
    # One of them is between two sources, whose weights differ little.
    sources[1] = sources[0] + [2.0 * distance, 0.0, 0.0]
    wanted, size = _exact(targets, sources, charges, a, 0.3)
    found = _sums(targets, sources, charges, a, 0.3)
    assert np.isfinite(found).all()
    assert np.abs((found - wanted) / size).max() < 1e-4
