"""Unique node numbers of block sides against a search for every node."""

import numpy as np
import pytest

from meshdeform_core.grid import Grid, Side
from meshdeform_core.grid.sides import side_numbers
from meshdeform_core.grid.topology import find_topology, side_nodes


@pytest.mark.parametrize("shapes", [[(3, 4, 5), (2, 2, 2)], [(1, 4, 5), (1, 3, 2)], [(4, 1, 3)], [(5, 2, 1)]])
@pytest.mark.parametrize("mirrored", [False, True])
def test_numbers_are_those_of_the_nodes(shapes, mirrored):
    blocks = []
    for number, shape in enumerate(shapes):
        x = np.stack(np.meshgrid(*(np.arange(n, dtype=float) for n in shape), indexing="ij"), axis=-1)
        # The second block lies beside the first and shares nodes with it.
        axis = 0 if shape[0] > 1 else 1
        x[..., axis] += number * (shapes[0][axis] - 1)
        blocks.append(np.ascontiguousarray(x[..., ::-1] if mirrored else x))
    grid = Grid.from_blocks(blocks)
    topology = find_topology(grid)
    for block, shape in enumerate(shapes):
        for side in Side:
            if shape[side.axis] > 1:
                nodes = side_nodes(grid, block, side)
                expected = topology.numbers_of(nodes.ravel()).reshape(nodes.shape)
                np.testing.assert_array_equal(side_numbers(grid, topology, block, side), expected)
