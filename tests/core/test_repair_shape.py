"""The last steps of a repair, which improve the worst shapes."""

from __future__ import annotations

import numpy as np
from cases import formulas

from meshdeform_core.boundary import BoundarySpec, Kind
from meshdeform_core.deform import Case, Timing, impose, set_up
from meshdeform_core.grid import Grid
from meshdeform_core.quality.comparison import Comparison
from meshdeform_core.quality.validity import judge
from meshdeform_core.repair import untangle
from meshdeform_core.repair.constraints import Constraints
from meshdeform_core.repair.neighbourhood import Neighbourhood
from meshdeform_core.repair.repair import Repairer
from meshdeform_core.repair.shape import hexahedron_shapes, lost, triangle_shapes
from meshdeform_core.repair.walls import nearness, weigh
from meshdeform_samples.reproduce.experiment import Sample, prepare_sample

CORNERS = np.array([[a >> 2, a >> 1 & 1, a & 1] for a in range(8)], dtype=float)


def test_shapes_are_the_f_skew_of_the_report():
    random = np.random.default_rng(3)
    block = np.stack(np.meshgrid(*[np.arange(4.0)] * 3, indexing="ij"), axis=-1)
    block += 0.15 * random.standard_normal(block.shape)
    grid = Grid.from_blocks([block])
    setup = set_up(grid, Case((BoundarySpec("all", ("*",), Kind.MOVING, None, formulas("0", "0", "0")),)))
    low = np.array(np.unravel_index(np.arange(27), (3, 3, 3))).T
    nodes = np.ravel_multi_index(tuple((low[:, None] + CORNERS.astype(int)).transpose(2, 0, 1)), (4, 4, 4))
    found = hexahedron_shapes(grid.points, nodes, np.full(27, 255))
    np.testing.assert_allclose(found, Comparison(setup.original, grid.points).after.skews, rtol=1e-5)


def test_shapes_do_not_depend_on_size_and_count_the_chosen_corners():
    sheared = CORNERS * [1e-4, 1e-4, 3.0]
    sheared[:, 0] += sheared[:, 1]
    nodes = np.arange(8)[None]
    for mask in (255, 1, 1 << 6):
        np.testing.assert_allclose(hexahedron_shapes(sheared, nodes, np.array([mask])), np.sqrt(0.5) ** (2 / 3))
    assert hexahedron_shapes(sheared, nodes, np.array([0]))[0] == 1.0
    triangle = np.array([[0.0, 0.0], [5.0, 0.0], [0.01, 0.01]])
    np.testing.assert_allclose(triangle_shapes(triangle, np.array([[0, 1, 2]])), np.sqrt(0.5))
    np.testing.assert_array_equal(lost(np.array([0.5, 0.46, 0.44]), np.array([1.0, 0.5, 0.5])), [0.5, 1.0, 0.44])


def test_the_worst_shape_improves_and_jacobians_are_kept(monkeypatch):
    setup = prepare_sample(Sample("beam", 40))
    bent = impose(setup.with_repair("off"), lambda part: 3.0 * setup.displacement(0.0, part), 1, "float64", Timing())
    points = bent.grid.points
    verdict = judge(setup.original, points)
    assert not verdict.valid
    skew, ratio = [], []
    for steps in (0, untangle._SHAPING):
        monkeypatch.setattr(untangle, "_SHAPING", steps)
        outcome = Repairer(setup.original, setup.boundary).repair(points, verdict)
        assert outcome.verdict.valid
        skew.append(Comparison(setup.original, outcome.points).after.skews.min())
        ratio.append(outcome.verdict.ratio.min())
    assert skew[1] > 1.04 * skew[0]
    assert ratio[1] > 0.98 * ratio[0]


def test_first_cells_at_walls_are_guarded_however_few_layers_there_are():
    x = np.arange(9.0)
    block = np.stack(np.meshgrid(x, x, np.zeros(1), indexing="ij"), axis=-1)
    setup = set_up(
        Grid.from_blocks([block]),
        Case((BoundarySpec("floor", ("*.jmin",), Kind.MOVING, None, formulas("0", "1", "0")),)),
    )
    for layers in (5, 40):
        share = nearness(np.repeat(np.arange(layers), 2))
        cells = np.array([[0, 1, 2, 3], [2, 3, 4, 5], [6, 7, 8, 9]])
        start = np.random.default_rng(0).uniform(1.0, 2.0, (2 * layers, 2))
        weights = weigh(share[cells], float(share.min()), start, cells)
        assert weights.guarded[0]
        assert weights.sum[0] > weights.sum[1] >= weights.sum[2]
    # Without any walls nothing is.
    free = nearness(np.full(10, -1))
    assert not weigh(free[cells], float(free.min()), start, cells).guarded.any()
    near = Neighbourhood(Constraints.of(setup.grid, setup.topology, setup.boundary))
    guarded = near.plot(near.around(np.arange(setup.grid.n_cells), None)).region.energy.weights.guarded
    # Of 64 cells the eight at the floor: four corners each, but for two corners without a free node.
    assert guarded.sum() == 30
