"""Fast evaluation of radial basis functions: trees of targets, polynomials on boxes, and the accuracy of the whole."""

import numpy as np
import pytest
from clouds import sphere
from grids import frame

from meshdeform_core.numerics.exact.basis import BASES
from meshdeform_core.numerics.exact.radial import radial_matrix, radial_sums
from meshdeform_core.numerics.fastsum.radial.polynomials import (
    GROWTH,
    NEAREST,
    add_polynomial,
    spaces_of,
    to_coefficients,
)
from meshdeform_core.numerics.fastsum.radial.sums import FastRadial
from meshdeform_core.numerics.fastsum.radial.targets import make_radial_targets

SHAPES = np.array([[1.0, 1.0, 1.0], [2.0, 0.9, 0.3], [0.1, 1.0, 0.004], [1.0, 0.0, 0.5], [3.0, 0.0, 0.0]])


def in_box(half, values, spaces, s, points):
    """What values at the interpolation points give at points in [-1, 1]^3 of a box along the axes."""
    first, last = spaces.start[s], spaces.start[s + 1]
    coefficients, out = np.empty((last - first, 3)), np.zeros((len(points), 3))
    to_coefficients(spaces.matrix, spaces.begin[s], values, coefficients)
    add_polynomial(np.zeros(3), np.eye(3), half, spaces.degree[first:last], coefficients, points * half, out)
    return out


@pytest.mark.parametrize("row", range(len(SHAPES)))
def test_polynomials_of_the_space_are_reproduced(row):
    spaces, which = spaces_of(SHAPES, 1e-7)
    s, half = which[row], SHAPES[row]
    at = spaces.points[spaces.start[s] : spaces.start[s + 1]]
    inside = np.random.default_rng(row).uniform(-1, 1, (50, 3)) * (half > 0)

    def quadratic(x):
        return np.stack([x[:, 0] ** 2 - x[:, 2], x[:, 0] * x[:, 1] + 1, x[:, 1] * x[:, 2] - x[:, 1] ** 2], axis=1)

    np.testing.assert_allclose(in_box(half, quadratic(at), spaces, s, inside), quadratic(inside), atol=1e-12)


@pytest.mark.parametrize("row", range(len(SHAPES)))
def test_errors_of_spaces_are_as_the_table_says(row):
    spaces, which = spaces_of(SHAPES, 1e-7)
    s, half = which[row], SHAPES[row]
    radius, random = np.linalg.norm(half), np.random.default_rng(row)
    at, inside = spaces.points[spaces.start[s] : spaces.start[s + 1]], random.uniform(-1, 1, (60, 3))
    for n in (1, 3, 6):
        sources = random.standard_normal((3, 3))
        sources *= (NEAREST * GROWTH**n * radius / np.linalg.norm(sources, axis=1))[:, None]
        found = in_box(half, radial_matrix(0, at * half, sources), spaces, s, inside * (half > 0))
        error = np.abs(found - radial_matrix(0, inside * half, sources)).max() / radius**2
        # Boxes of similar shape share a space, and r^2 log r has r^2 log(radius) more, which polynomials reproduce.
        assert error <= 3 * spaces.error[s, n] + 1e-12


def grid_targets(wanted=None):
    grid = frame(12, 12)
    flat = np.arange(grid.n_nodes) if wanted is None else wanted
    return grid, flat, make_radial_targets(grid.points, grid.shapes, grid.offsets, flat)


@pytest.mark.parametrize("every", [1, 7])
def test_trees_hold_every_target_once_in_its_boxes(every):
    grid, flat, targets = grid_targets(np.arange(0, frame(12, 12).n_nodes, every))
    tree = targets.tree
    np.testing.assert_array_equal(np.sort(tree.targets), flat)
    assert tree.span[targets.leaves].tolist() == sorted(tree.span[targets.leaves].tolist())
    assert np.diff(tree.span[targets.leaves]).sum() == len(flat)
    for n in range(len(tree.span)):
        x = grid.points[tree.targets[tree.span[n, 0] : tree.span[n, 1]]]
        local = np.abs((x - tree.center[n]) @ tree.axes[n].T)
        assert (local <= tree.half[n] * (1 + 1e-9) + 1e-12).all()
        if tree.child[n, 0] >= 0:
            one, two = tree.child[n]
            assert tree.span[one, 0] == tree.span[n, 0]
            assert tree.span[one, 1] == tree.span[two, 0]
            assert tree.span[two, 1] == tree.span[n, 1]


@pytest.mark.parametrize(
    ("basis", "tolerance"),
    [
        ("tps", 1e-1), ("tps", 1e-3), ("tps", 1e-6), ("wendland-c0", 1e-3), ("ctps-c1", 1e-3),
        *(pytest.param(basis, tolerance, marks=pytest.mark.slow)
          for basis in ("wendland-c0", "ctps-c1") for tolerance in (1e-1, 1e-6)),
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
