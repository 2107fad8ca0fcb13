"""Fast evaluation of radial basis functions: trees of targets, polynomials on boxes, and the accuracy of the whole."""

import numpy as np
import pytest
from clouds import sphere
from grids import frame

from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.radial import radial_sums
from meshdeform_core.numerics.fastsum.radial import FastRadial, make_radial_targets


def grid_targets(wanted=None):
    grid = frame(12, 12)
    flat = np.arange(grid.n_nodes) if wanted is None else wanted
    return grid, flat, make_radial_targets(grid.points, grid.shapes, grid.offsets, flat)


@pytest.mark.parametrize(
    ("basis", "tolerance"),
    [
        ("tps", 1e-1), ("tps", 1e-6), ("wendland-c0", 1e-3), ("ctps-c1", 1e-3),
    ],
)  # fmt: skip
def test_sums_are_exact_to_the_tolerance_of_local_cells(basis, tolerance):
    grid, _, targets = grid_targets()
    kind, centres = BASES[basis], np.concatenate([sphere(1500) * 0.3, 1.1 * sphere(900) + 0.2]) / 3
    points = grid.points / 3
    targets = targets._replace(coordinates=points, tree=shrunk(targets.tree, 3), sizes=targets.sizes / 3)
    coefficients = np.random.default_rng(0).standard_normal((len(centres), 3))
    out = np.full((len(points), 3), np.nan)

    def use(flat, sums):
        out[flat] = sums

    fast = FastRadial(kind, centres)
    # The coefficients are no solution of a smooth motion, and the trial aims at a quarter of the tolerance.
    fast.prepare(coefficients, targets, tolerance)
    fast.apply(use)
    exact = radial_sums(kind, points, centres, coefficients)
    error = np.linalg.norm(out - exact, axis=1)[targets.samples] / targets.sizes
    assert error.max() <= tolerance
    # The same again, with what was found out.
    share, again = fast.share, out.copy()
    fast.prepare(coefficients, targets, tolerance)
    fast.apply(use)
    assert fast.share == share
    np.testing.assert_array_equal(out, again)


def shrunk(tree, factor):
    return tree._replace(center=tree.center / factor, half=tree.half / factor)
