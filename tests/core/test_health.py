"""The quick test for healthy cells agrees with the energy of the repair."""

import numpy as np
from cases import body_specs, turning
from grids import frame

from meshdeform_core.deform import Case, set_up
from meshdeform_core.repair.energy import share_of
from meshdeform_core.repair.outcome import unhealthy_cells
from meshdeform_core.repair.region import Basis

GRID = frame(4, 3)
SETUP = set_up(GRID, Case(tuple(body_specs(turning("5")))))
BASIS = Basis(SETUP.original, SETUP.boundary)


def healthy(points: np.ndarray) -> bool:
    return not unhealthy_cells(SETUP.original, points).size


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
