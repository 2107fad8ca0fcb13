"""The quick test for healthy cells agrees with the energy of the repair."""

from __future__ import annotations

import numpy as np
import pytest
from cases import body_specs, turning
from grids import frame

from meshdeform_core.deform import Case, set_up
from meshdeform_core.repair.energy import share_of
from meshdeform_core.repair.onset import unhealthy_cells
from meshdeform_core.repair.region import Basis

GRID = frame(4, 3)
SETUP = set_up(GRID, Case(tuple(body_specs(turning("5")))))
BASIS = Basis(SETUP.original, SETUP.boundary)


def healthy(points: np.ndarray) -> bool:
    return not unhealthy_cells(SETUP.original, points).size


def distorted(seed: int, size: float) -> np.ndarray:
    """A random distortion of all nodes, smooth enough to be near the limit for many cells."""
    rng = np.random.default_rng(seed)
    x = GRID.points
    waves = sum(np.sin(x @ rng.normal(size=3) + rng.uniform(0, 6))[:, None] * rng.normal(size=3) for _ in range(4))
    return np.ascontiguousarray(x + size * waves)


@pytest.mark.parametrize("size", [0.0, 0.05, 0.1, 0.15, 0.2, 0.4, 1.0])
@pytest.mark.parametrize("seed", range(4))
def test_healthy_grids_have_no_share(seed, size):
    points = distorted(seed, size)
    plot = BASIS.whole
    share = share_of(plot.region.energy, plot.inside(points))[0]
    # The energy leaves out cells whose nodes are all prescribed, so only the other way is exact.
    if healthy(points):
        assert share == 0.0
    if size == 0.0:
        assert healthy(points)
    if size == 1.0:
        assert not healthy(points)


def test_the_limit_is_that_of_the_energy():
    """A uniform shear of all cells is healthy up to the same amount for both."""

    def sheared(amount: float) -> np.ndarray:
        points = GRID.points.copy()
        points[:, 0] += amount * GRID.points[:, 1]
        return points

    plot = BASIS.whole
    low, high = 0.0, 3.0
    for _ in range(40):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if healthy(sheared(middle)) else (low, middle)
    assert share_of(plot.region.energy, plot.inside(sheared(low * (1 - 1e-6))))[0] == 0.0
    assert share_of(plot.region.energy, plot.inside(sheared(low * (1 + 1e-6))))[0] > 0.0
