"""Weights of cells in a repair: large at walls, whatever the number of layers."""

from __future__ import annotations

import numpy as np

from meshdeform_core.repair.walls import nearness, weigh


def test_first_cells_at_walls_weigh_most_however_few_layers_there_are():
    cells = np.array([[0, 1, 2, 3], [2, 3, 4, 5], [6, 7, 8, 9]])
    for layers in (5, 40):
        share = nearness(np.repeat(np.arange(layers), 2))
        start = np.random.default_rng(0).uniform(1.0, 2.0, (2 * layers, 2))
        weight = weigh(share[cells], float(share.min()), start, cells)
        assert weight[0] >= 400.0 / share.min()
        assert weight[0] > weight[1] >= weight[2] >= 1.0
    free = nearness(np.full(10, -1))
    np.testing.assert_array_equal(weigh(free[cells], float(free.min()), start, cells), 1.0)
